"""Mesh → COLMAP scene on disk: images, sparse model, SfM cloud, ground-truth mesh, where it all came from.

A `Perturbation` gives such a scene what photographs suffer from: noise in images, cameras and cloud. Held-out
views and the ground truth stay clean.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from tqdm import tqdm

from paper_artifact import __version__, arithmetic
from paper_artifact.archives import write_npz
from paper_artifact.errors import InputError
from paper_artifact.files import cut_name, file_digest, write_json
from paper_artifact.frame import frame_for
from paper_artifact.mesh import Mesh, mesh_hash
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.cameras import CAMERA_DISTANCE, FIELD_OF_VIEW, Camera, fibonacci_cameras, unframed
from paper_artifact.scene.colmap import FARTHEST, pinhole_model, write_model
from paper_artifact.scene.folder import DESCRIPTION, GROUND_TRUTH, holds, value_digest, whole_folder
from paper_artifact.scene.ground_truth import (
    background_colour,
    mesh_texture,
    render_ground_truth,
    solid_texture,
)
from paper_artifact.scene.load import EVERY

TEXTURE = "texture"  # a background that is infinitely far away, see `surrounding`
SCENE_FORMAT = 2  # raised whenever the same configuration would give other files
FIXED = {"texture_frequency": 1.0}  # of the configuration, as keys and scene.json have it
SEED = 0  # of everything here: the runs of all seeds see one scene
GAPS = 3  # places in which the cloud is cut out
OUTLIER_BOX = 1.5  # outliers lie in the cloud's box, that much larger


@dataclass(frozen=True)
class Perturbation:
    """How much of each; checked where a run is configured (`paper_artifact.config.NOISES`)."""

    image_noise: float = 0.0  # standard deviation per pixel and channel, colours in [0,1]
    camera_noise: float = 0.0  # standard deviation per axis of a camera's centre, / diagonal
    cloud_noise: float = 0.0  # standard deviation per axis of a point, / diagonal
    cloud_outliers: float = 0.0  # share of points that lie anywhere
    cloud_missing: float = 0.0  # share of points that is cut out


CLEAN = Perturbation()


def _noisy_image(image: np.ndarray, perturbation: Perturbation, view: int) -> np.ndarray:
    """Return `image` (H,W,3) in [0,1] with Gaussian noise, clipped to [0,1]; view: its place."""
    if perturbation.image_noise == 0:
        return image
    noise = arithmetic.normals(stream(SEED, "image noise", view), *image.shape)
    return np.clip(image + perturbation.image_noise * noise, 0.0, 1.0)


def moved_camera(camera: Camera, perturbation: Perturbation, diagonal: float, view: int) -> Camera:
    """Return `camera` with its centre displaced and its orientation kept.

    What lies at the scene's distance is displaced in the image as if it had moved by the same length.
    diagonal: the mesh's, world units; view: its place.
    """
    if perturbation.camera_noise == 0:
        return camera
    step = perturbation.camera_noise * diagonal * arithmetic.normals(stream(SEED, "camera noise", view), 3)
    x, y, z = (np.asarray(camera.translation) - arithmetic.product(camera.rotation, step)).tolist()
    return replace(camera, translation=(x, y, z))


def perturbed_cloud(
    positions: np.ndarray, colours: np.ndarray, perturbation: Perturbation, diagonal: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (positions (m,3), colours (m,3)) of an SfM cloud (n,3): gaps first, then noise, then outliers.

    A gap holds the points nearest to one of the cloud, drawn by chance. diagonal: the mesh's, world units.
    """
    if perturbation.cloud_missing > 0:
        draws = stream(SEED, "cloud gaps")
        total = round(perturbation.cloud_missing * len(positions))
        for count in np.diff(np.linspace(0, total, GAPS + 1).round().astype(int)):
            centre = positions[draws.integers(len(positions))]
            order = np.argsort(arithmetic.norm(positions - centre), kind="stable")
            kept = np.sort(order[count:])
            positions, colours = positions[kept], colours[kept]
    low, high = positions.min(axis=0), positions.max(axis=0)
    if perturbation.cloud_noise > 0:
        noise = arithmetic.normals(stream(SEED, "cloud noise"), *positions.shape)
        positions = positions + perturbation.cloud_noise * diagonal * noise
    if perturbation.cloud_outliers > 0:
        draws = stream(SEED, "cloud outliers")
        chosen = draws.permutation(len(positions))[: round(perturbation.cloud_outliers * len(positions))]
        positions = positions.copy()
        anywhere = OUTLIER_BOX * (draws.random((len(chosen), 3)) - 0.5)
        positions[chosen] = (low + high) / 2 + anywhere * (high - low)
    return positions, colours


def surrounding(camera: Camera) -> np.ndarray:
    """Return the image (H,W,3) float32 in [0,1] of a pattern infinitely far away, one for all cameras: the
    meshes' texture on the sphere of directions."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack(
        [
            (columns - camera.centre_x) / camera.focal_x,
            (rows - camera.centre_y) / camera.focal_y,
            np.ones(rows.shape),
        ],
        axis=-1,
    )
    directions = (rays / arithmetic.norm(rays)[..., None]).reshape(-1, 3)
    directions = arithmetic.product(directions, camera.rotation)
    return solid_texture(directions, np.zeros(3), 1.0).reshape(*rows.shape, 3)


@dataclass(frozen=True)
class SceneConfig:
    """How a scene is made of a mesh (paper, Experimental setup: 24-72 views at 200-256 pixels).

    Raises InputError for values out of range.
    """

    views: int = 48  # cameras on a Fibonacci sphere, every 8th is held out
    size: int = 200  # image side, pixels
    background: str = "white"  # "black" or TEXTURE
    supersample: int = 4  # samples per pixel and axis
    points: int = 15000  # of the SfM cloud, drawn from the surface, uniform by area
    seed: int = 0  # of the SfM cloud
    perturbation: Perturbation = CLEAN  # of training views, cameras and cloud

    def __post_init__(self) -> None:
        for name, lowest, highest in (
            ("views", 2, 10000),
            ("size", 8, 8192),
            ("supersample", 1, 16),
            ("points", 4, 10**7),
            ("seed", 0, 2**63 - 1),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
                raise InputError(
                    f"the scene's {name} must be a whole number from {lowest} to {highest}, got {value}"
                )
        _background(self.background)


def scene_key(mesh: Mesh, config: SceneConfig) -> str:
    """Return the sha256 (hex) of everything the scene's files depend on: format, configuration, mesh."""
    values = asdict(config) | FIXED
    if config.perturbation == CLEAN:  # a clean scene keeps the key it had before there were others
        del values["perturbation"]
    content = {"format": SCENE_FORMAT, "config": values, "mesh": mesh_hash(mesh), "name": mesh.name}
    return value_digest(content)


def scene_folder(mesh: Mesh, config: SceneConfig, root: Path | str) -> Path:
    """Return a folder below `root` that no other mesh or configuration shares."""
    return Path(root) / f"{cut_name(mesh.name)}-{scene_key(mesh, config)[:12]}"


def build_scene(mesh: Mesh, config: SceneConfig, folder: Path | str, progress: bool = False) -> Path:
    """Write the COLMAP scene of `mesh` to `folder` and return the folder.

    Contents: images/view_000.png …, sparse/0/{cameras,images,points3D}.bin, ground_truth.npz (the mesh,
    float64 world units), scene.json (name, configuration, hashes, background, bounding sphere). All or
    nothing: built in a temporary folder beside and renamed. A folder that already holds this very scene is
    returned as it is. `progress` shows a bar.

    Raises InputError when the folder holds anything else or cannot be written.
    """
    folder = Path(folder)
    key = scene_key(mesh, config)
    if holds(folder, key):
        if not (folder / GROUND_TRUTH).is_file():
            raise InputError(
                f"the scene in {folder} has lost {GROUND_TRUTH}; remove the folder to build it again"
            )
        return folder
    farthest = float(arithmetic.norm(mesh.centre)) + CAMERA_DISTANCE * mesh.radius
    if not farthest < FARTHEST / 10:  # noise takes cameras and points farther
        raise InputError(
            f"{mesh.name} takes a scene out to {farthest:.3g}, which is not read back; scale it down"
        )
    with whole_folder(folder, key) as temporary:
        _write_scene(mesh, config, temporary, key, progress)
    return folder


def _background(name: str) -> np.ndarray:
    """Return what training and held-out views compose over: of TEXTURE (see `surrounding`) grey."""
    return np.full(3, 0.5, np.float32) if name == TEXTURE else background_colour(name)


def _write_scene(mesh: Mesh, config: SceneConfig, folder: Path, key: str, progress: bool) -> None:
    background = _background(config.background)
    user, frame = mesh, frame_for(mesh.centre, mesh.radius)
    mesh = user.framed(frame)  # what is drawn is drawn in float32; what is written is the user's
    cameras = fibonacci_cameras(mesh, config.views, config.size)
    views = {}
    (folder / "images").mkdir()
    bar = tqdm(cameras, desc=f"rendering {mesh.name}", unit="view", disable=not progress)
    for place, camera in enumerate(bar):
        name, trained_on = f"view_{place:03d}.png", place % EVERY > 0
        behind = surrounding(camera) if config.background == TEXTURE and trained_on else background
        image = render_ground_truth(mesh, camera, behind, config.supersample)
        if trained_on:
            image = _noisy_image(image, config.perturbation, place)
            camera = moved_camera(camera, config.perturbation, mesh.diagonal, place)
        Image.fromarray(np.round(image * 255).astype(np.uint8)).save(folder / "images" / name)
        views[name] = unframed(camera, frame)
    positions, _, _ = sample_surface(
        mesh.vertices, mesh.faces, config.points, stream(config.seed, "sfm cloud")
    )
    colours = np.round(mesh_texture(positions, mesh) * 255).astype(np.uint8)
    positions, colours = perturbed_cloud(positions, colours, config.perturbation, mesh.diagonal)
    model = pinhole_model(views, [1] * len(views), frame.outward(positions), colours)
    write_model(model, folder / "sparse" / "0")
    truth = {
        "vertices": user.vertices,
        "faces": mesh.faces,
        "name": np.array(mesh.name),
        "betti": np.array(mesh.betti or [], dtype=np.int64),
    }
    write_npz(folder / GROUND_TRUTH, truth, compressed=False)
    files = {
        path.relative_to(folder).as_posix(): file_digest(path) for path in folder.rglob("*") if path.is_file()
    }
    write_json(
        folder / DESCRIPTION,
        {
            "format": SCENE_FORMAT,
            "package": __version__,
            "key": key,
            "config": asdict(config) | FIXED,
            "files": files,
            "background": background.tolist(),
            "centre": user.centre.tolist(),
            "radius": user.radius,
            "camera_distance_in_radii": CAMERA_DISTANCE,
            "field_of_view_degrees": FIELD_OF_VIEW,
            "mesh": {
                "name": mesh.name,
                "sha256": mesh_hash(user),
                "vertices": len(mesh.vertices),
                "faces": len(mesh.faces),
                "betti": mesh.betti,
                "diagonal": user.diagonal,
            },
        },
    )
