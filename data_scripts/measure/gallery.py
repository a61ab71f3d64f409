"""What three stated Betti numbers do to point clouds from public samples, before and after.

Three examples, each on a cloud on which its setting was chosen and on a second one that was not used for
choosing: close a gap in a scanned pipe, separate two parts that nearly touch, keep a handle while smoothing.
Every step of Adam lowers `BettiLoss` (a plan each step) plus a data term: `keep` times the squared way of
every point from its place, and in the last example `smooth` times its squared distance from the plane of its
neighbours, in squared spacings of the first cloud. `reach`: points move by a field that is smooth over so
many spacings (a Gaussian); 0: each alone.

gallery.csv, one row per cloud and state ("before", "after", "data term alone"): counts of gudhi's exact
alpha complex above 6 median spacings, the longest bars in floors, the ways of the points in spacings; and
one per library: CPU seconds a step. Peers take STEPS steps of the same loop with `peers_task.stated_loss`, on
the first cloud of each example; where one is missing or fails, `note` says why. gallery_clouds.npz: the
clouds, float32. Notebook 21 reads both. Needs the side environment of docs/study.md. The samples are
downloaded, or read from the folder in PAPER_ARTIFACT_MIRROR; they are CGAL's data (CC0-1.0), trimesh's models
(MIT) and the project's own mug. Two minutes of CPU, torch-topological the most of it.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from common import Clock, options, write

import gudhi
import numpy as np
import pandas as pd
import pooch
import torch
from peers import OURS, PEERS, Diagrams, reason, version_of, why_missing
from peers_task import Task, stated_loss
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from torch import Tensor

from paper_artifact.files import REPOSITORY, atomic_path
from paper_artifact.mesh import load_mesh
from paper_artifact.randomness import stream
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.fetch import MIRROR_VARIABLE, RAW
from paper_artifact.topology import BettiLoss
from paper_artifact.topology.floor import MULTIPLIER, median_spacing

CGAL = "CGAL/releases", "a220b59f8a6c079285d4f1bb433f330ceb2bbd87", "data/"
TRIMESH = "mikedh/trimesh", "a513c0e2cfa6dfbd3121a6dfd8ceb002b9ef55d8", "models/"
SHA256 = {
    "meshes/pipe.off": "de951aa3c0c9f6617b422e833116a1523fd41abfb588444f71eeed42378ef9bf",
    "meshes/rotor.off": "8db85ca5041eef6d952e48f0553a25fddb42f237b80a37b7aff096b8df3aca32",
    "meshes/spool.off": "84ec2367becf6994f96055fa88aaf3a00df1fdd84bd0fa615bdc043c9944b7b1",
    "meshes/joint.off": "a412da1a4b90a1d018d44e0b06307ee692da4afd255975d2a93945e091098649",
    "featuretype.STL": "c9946c4bb8034cd43522526a2f325200e2d2322a0c7258f848a81f00e418dab3",
    "idler_riser.STL": "8fb9237ab07cdd50b033ade13d79f14ba9ac68cefb0be07cb993a535a344b733",
    "tube.obj": "933aa18c58fb88adcb6ce36fdfa418e59902b54519a99e35f17ccdc107d01506",
}
STEPS, RATE, NEIGHBOURS = 1, 0.2, 12  # a peer's steps; Adam's rate in spacings; of a plane

Loss = Callable[[Tensor], Tensor]


def file(origin: tuple[str, str, str], name: str) -> Path:
    """Return the path of a sample: downloaded with the pinned sha256, or in the mirror, unchecked."""
    repository, commit, folder = origin
    mirror = os.environ.get(MIRROR_VARIABLE)
    if mirror:
        return Path(mirror) / repository.replace("/", "+") / folder / name
    return Path(pooch.retrieve(f"{RAW}/{repository}/{commit}/{folder}{name}", f"sha256:{SHA256[name]}"))


def surface(origin: tuple[str, str, str], name: str, count: int) -> np.ndarray:
    """Return `count` uniform samples of a sample's surface, (count,3), its longest side 1."""
    mesh = load_mesh(file(origin, name))
    points, _, _ = sample_surface(mesh.vertices, mesh.faces, count, stream(0, f"gallery {name}"))
    return (points - points.mean(axis=0)) / np.ptp(points, axis=0).max()


def noisy(points: np.ndarray, spacings: float) -> np.ndarray:
    """Return points (n,3) with Gaussian noise of so many median spacings."""
    noise = stream(0, "gallery noise").standard_normal(points.shape)
    return points + spacings * median_spacing(points) * noise


def pipe(origin: tuple[str, str, str], name: str) -> np.ndarray:
    """Return a scanned pipe, (about 1000,3): the outer wall (radius 1, length 3) of a sample with noise, less
    the patch that the scanner did not see, 100 degrees wide and half as long as the pipe."""
    points = surface(origin, name, 12000)
    points = np.roll(points, 2 - int(np.ptp(points, axis=0).argmax()), axis=1)
    points -= (points.max(axis=0) + points.min(axis=0)) / 2
    radii = np.hypot(points[:, 0], points[:, 1])
    points, radii = points / radii.max(), radii / radii.max()
    points = points[(radii > 0.9) & (abs(points[:, 2]) <= 1.5)][:1200]
    angle = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    return noisy(points[(abs(angle) > 50) | (abs(points[:, 2]) > 0.75)], 0.25)


def parts(origin: tuple[str, str, str], names: tuple[str, str], gap: float = 1.5) -> np.ndarray:
    """Return two parts side by side, (1000,3), evenly thinned as a scan is, `gap` median spacings apart."""
    first, second = (even(surface(origin, name, 6000), 500) for name in names)
    second = second + [np.ptp(first, axis=0)[0] + np.ptp(second, axis=0)[0], 0, 0]
    wanted = gap * median_spacing(first)
    for _ in range(50):  # along x until the nearest pair is as far apart as wanted
        near = cKDTree(first).query(second)[0].min()
        second = second - [max(near - wanted, 0.0), 0, 0]
    return np.concatenate([first, second])


def even(points: np.ndarray, count: int) -> np.ndarray:
    """Return `count` of the points (n,3), each the farthest from those before it."""
    chosen, far = [0], np.full(len(points), np.inf)
    for _ in range(count - 1):
        far = np.minimum(far, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(far.argmax()))
    return points[chosen]


def joint() -> np.ndarray:
    """Return 1,500 points of the surface of CGAL's joint, a bearing with one wide bore, with noise."""
    return noisy(surface(CGAL, "meshes/joint.off", 1500), 0.5)


def mug() -> np.ndarray:
    """Return 1,500 points of structure from motion of the project's mug, with their own noise."""
    points = read_model(REPOSITORY / "data_scripts" / "mug" / "sparse" / "0").positions
    return points[stream(0, "gallery mug").permutation(len(points))[:1500]]


@dataclass(frozen=True)
class Example:
    """A cloud, what is stated of it and how it is moved."""

    name: str
    cloud: str
    start: Callable[[], np.ndarray]
    betti: tuple[int, int, int]
    dimensions: tuple[int, ...]  # that the loss acts in
    steps: int
    keep: float = 0.003
    reach: float = 4.0
    smooth: float = 0.0


pipe_closed = partial(Example, "close a gap", betti=(1, 1, 0), dimensions=(0, 1), steps=100)
separated = partial(
    Example, "separate parts", betti=(2, 0, 0), dimensions=(0,), steps=150, keep=0.0003, reach=0.0
)
smoothed = partial(
    Example, "keep a handle", betti=(1, 1, 0), dimensions=(1,), steps=40, keep=0.3, reach=0.0, smooth=1.0
)
EXAMPLES = (  # the first cloud of a name is the one on which its setting was chosen
    pipe_closed("CGAL pipe", partial(pipe, CGAL, "meshes/pipe.off")),
    pipe_closed("trimesh tube", partial(pipe, TRIMESH, "tube.obj")),
    separated("CGAL rotor, spool", partial(parts, CGAL, ("meshes/rotor.off", "meshes/spool.off"))),
    separated("trimesh riser, block", partial(parts, TRIMESH, ("idler_riser.STL", "featuretype.STL"))),
    smoothed("CGAL joint", joint),
    smoothed("mug, photographs", mug),
)


def off_plane(points: Tensor) -> Tensor:
    """Return each point's squared distance (n,) from the plane of its nearest points, itself among them; the
    planes are constants."""
    cloud = points.detach().numpy()
    _, nearest = cKDTree(cloud).query(cloud, k=NEIGHBOURS)
    centre = cloud[nearest].mean(axis=1)
    around = cloud[nearest] - centre[:, None]
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return ((points - torch.tensor(centre)) * torch.tensor(axes[:, :, 0])).sum(dim=1) ** 2


def descend(example: Example, start: np.ndarray, loss: Loss | None, steps: int) -> tuple[np.ndarray, float]:
    """Return the cloud (n,3) after so many steps, and CPU seconds a step. loss None: the data term alone."""
    spacing, place = median_spacing(start), torch.tensor(start)
    field = torch.eye(len(start), dtype=torch.float64)
    if example.reach:
        weights = np.exp(-((cdist(start, start) / (example.reach * spacing)) ** 2) / 2)
        field = torch.tensor(weights / weights.sum(axis=1, keepdims=True))
    moves = torch.zeros_like(place, requires_grad=True)
    optimiser = torch.optim.Adam([moves], lr=RATE * spacing)
    with Clock() as clock:
        for _ in range(steps):
            optimiser.zero_grad()
            points = place + field @ moves
            total = example.keep * ((points - place) ** 2).sum() / spacing**2
            if example.smooth:
                total = total + example.smooth * off_plane(points).sum() / spacing**2
            if loss is not None:
                total = total + loss(points)
            total.backward()
            optimiser.step()
    return (place + field @ moves).detach().numpy(), clock.cpu / max(1, steps)


def counted(points: np.ndarray) -> dict[str, str]:
    """Return gudhi's counts above 6 median spacings of points (n,3), and the two longest bars in floors."""
    tree = gudhi.AlphaComplex(points=points, precision="exact").create_simplex_tree()
    tree.compute_persistence()
    floor, counts, longest = MULTIPLIER * median_spacing(points), [], []
    for dimension in range(3):
        bars = np.sqrt(tree.persistence_intervals_in_dimension(dimension).reshape(-1, 2))
        lifetimes = np.sort(bars[:, 1] - bars[:, 0])[::-1] / floor
        counts.append(str(int((lifetimes > 1).sum())))
        longest.append(" ".join(f"{each:.2f}" for each in lifetimes[np.isfinite(lifetimes)][:2]))
    return {"counts": ",".join(counts), "longest": "; ".join(longest)}


def moves(start: np.ndarray, points: np.ndarray) -> dict[str, float | int]:
    """Return median and largest way of the points (n,3) in spacings of `start`, and how many of them lie on
    the smaller side of the widest gap."""
    ways = np.linalg.norm(points - start, axis=1) / median_spacing(start)
    sides = np.bincount(fcluster(linkage(points, "single"), 2, "maxclust"))[1:]
    return {"median_way": np.median(ways), "largest_way": ways.max(), "smaller_side": int(sides.min())}


def peer_loss(diagrams: Diagrams, example: Example, spacing: float, points: Tensor) -> Tensor:
    """Return T2's loss (scalar) of points (n,3) in the example's dimensions, of a library's diagrams."""
    found, what = diagrams(points / spacing), (example.name, example.start, example.betti)
    tasks = [Task(*what, dimension, RATE) for dimension in example.dimensions]
    return torch.stack([stated_loss(lambda _: found, task, points) for task in tasks]).sum()


def peer_rows() -> Iterator[dict]:
    """Yield a row for each peer and example, its first cloud: CPU seconds a step, or why there are none."""
    for example in {each.name: each for each in reversed(EXAMPLES)}.values():
        start = example.start()
        for peer in PEERS:
            row = {"example": example.name, "cloud": example.cloud, "points": len(start)}
            row |= {"library": peer.name, "note": why_missing(peer)}
            try:
                if row["note"] is None:
                    row |= {"library": f"{peer.name} {version_of(peer)}", "note": peer.note}
                    loss = partial(peer_loss, peer.diagrams, example, median_spacing(start))
                    _, row["seconds_a_step"] = descend(example, start, loss, STEPS)
            except Exception as error:  # a peer's own failure is a finding, not ours
                row["note"] = f"failed: {reason(error)}"
            yield row


def rows(clouds: dict[str, np.ndarray]) -> Iterator[dict]:
    """Yield our rows; the clouds are put into `clouds` as "EXAMPLE | CLOUD | STATE"."""
    for example in EXAMPLES:
        start = example.start()
        betti = partial(BettiLoss, example.betti, diagonal=median_spacing(start), refresh_every=1)
        descend(example, start, betti(dimensions=example.dimensions), 1)  # compiles
        after, seconds = descend(example, start, betti(dimensions=example.dimensions), example.steps)
        print(example.cloud, counted(after), f"{seconds:.3f} CPU s a step", flush=True)
        states = {"before": start, "after": after}
        if example.smooth:
            states["data term alone"], _ = descend(example, start, None, example.steps)
        what = {"example": example.name, "cloud": example.cloud, "points": len(start)}
        what["stated"] = ",".join(map(str, example.betti))
        for state, points in states.items():
            clouds[f"{example.name} | {example.cloud} | {state}"] = points.astype(np.float32)
            yield what | {"state": state} | counted(points) | moves(start, points)
        yield what | {"library": OURS, "seconds_a_step": seconds, "note": f"{example.steps} steps"}


if __name__ == "__main__":
    folder = options(__doc__).out
    kept: dict[str, np.ndarray] = {}
    with one_torch_thread():
        found = list(rows(kept))
        with atomic_path(folder / "gallery_clouds.npz") as path:
            np.savez_compressed(path, **kept)
        write(pd.DataFrame(found), folder / "gallery.csv")  # in case that a peer takes too long
        write(pd.DataFrame([*found, *peer_rows()]), folder / "gallery.csv")
