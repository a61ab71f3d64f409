"""`solidify MESH` on 20 damaged meshes, beside voxels, Poisson and CGAL's alpha wrap.

Nine procedural bodies of known topology, three of them thin-walled, sizes drawn from SEED, damaged in five
ways, four bodies each (`DAMAGES`). `solidify` is given the Betti numbers, all else by default; the others
take no such numbers and have one fixed setting. One row per mesh and way: whether the certificate passes with
the right Betti numbers, 95 % two-sided Hausdorff distance to the undamaged surface in % of its diagonal,
volume over the true one, CPU seconds, or the sentence of a refusal. Notebook 19 reads it. An hour.

pymeshlab (Poisson, alpha wrap) is no dependency: run it in a side environment (docs/study.md). The meshes of
SEED are for the table alone; `solidify` was developed on --seed 1, 2 … The script goes on from the rows that
are stored.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

from common import Clock, import_pymeshlab, kept, options, write

import numpy as np
import pandas as pd
import trimesh
from skimage.measure import marching_cubes
from solid_peers import Surface, poisson, voxels

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.cli.solids import offset_table
from paper_artifact.export.solid import distances_to, placed, solidify_mesh
from paper_artifact.ingest.solidify import CELLS, OFFSETS
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.randomness import stream

SEED = 20
GRID = 150  # cells along the longest side of a body
WAYS = ["solidify", "voxels", "poisson", "alpha wrap"]
ROW = ["mesh", "damage", "way"]
COLUMNS = ["right", "passes", "b0", "b1", "b2", "hausdorff95", "volume", "seconds", "refusal"]
NESTED = "nested shells"  # the outer one is wanted
Field = Callable[[np.ndarray], np.ndarray]  # points (n,3) → below 0 inside, roughly a distance


def ellipsoid(a: float, b: float, c: float) -> Field:
    return lambda p: (np.linalg.norm(p / (a, b, c), axis=1) - 1) * min(a, b, c)


def ring(large: float, small: float, centre: tuple = (0, 0, 0), turn: tuple = (0, 1, 2)) -> Field:
    """A torus; turn: the axes that are its x, y, z."""

    def field(p: np.ndarray) -> np.ndarray:
        x, y, z = (p - centre)[:, turn].T
        return np.hypot(np.hypot(x, y) - large, z) - small

    return field


def cylinder(radius: float, low: float, high: float) -> Field:
    return lambda p: np.max([np.hypot(p[:, 0], p[:, 1]) - radius, low - p[:, 2], p[:, 2] - high], axis=0)


def union(*fields: Field) -> Field:
    return lambda p: np.min([field(p) for field in fields], axis=0)


def without(field: Field, other: Field) -> Field:
    return lambda p: np.maximum(field(p), -other(p))


def cup(wall: float, height: float, handles: int) -> Field:
    """A cup of radius .5 with a thin wall and handles around it."""
    sides = [(0.62, 0.0), (-0.31, 0.537), (-0.31, -0.537)][:handles]
    outer = cylinder(0.5, 0, height)
    held = []
    for x, y in sides:
        turned = np.array([[x, y, 0], [-y, x, 0], [0, 0, 0.62]]) / 0.62
        grip = ring(0.25, 0.06, (0, 0, 0), (0, 2, 1))
        held.append(lambda p, turned=turned, grip=grip: grip(p @ turned.T - (0.5, 0, height / 2)))
    solid = union(outer, *held)
    return without(solid, cylinder(0.5 - wall, wall, height + 1))


def bodies(draw: np.random.Generator) -> dict[str, tuple[Field, tuple[int, int, int]]]:
    """Return nine bodies, (field, Betti numbers) by name; walls of .9 to 1.3 % of the diagonal."""
    size = iter(draw.uniform(0.85, 1.15, 40))
    wall = iter(draw.uniform(0.015, 0.02, 8))
    a, b = 0.4 * next(size), 0.16 * next(size)
    chain = [ring(a, b, (2 * (a - b / 3) * (i - 1), 0, 0)) for i in range(3)]
    bore = 0.3 * next(size)
    return {
        "sphere": (ellipsoid(*(next(size) for _ in range(3))), (1, 0, 1)),
        NESTED: (ellipsoid(*(next(size) for _ in range(3))), (1, 0, 1)),
        "torus": (ring(next(size), 0.35 * next(size)), (1, 2, 1)),
        "genus 2": (union(*chain[:2]), (1, 4, 1)),
        "genus 3": (union(*chain), (1, 6, 1)),
        "linked tori": (
            union(ring(0.7, 0.2 * next(size)), ring(0.7, 0.2 * next(size), (0.7, 0, 0), (0, 2, 1))),
            (2, 4, 2),
        ),
        "mug": (cup(next(wall), next(size), 1), (1, 2, 1)),
        "cup with three handles": (cup(next(wall), next(size), 3), (1, 6, 1)),
        "tube": (without(cylinder(bore, -0.5, 0.5), cylinder(bore - next(wall), -1, 1)), (1, 2, 1)),
    }


def meshed(field: Field, name: str, betti: tuple[int, int, int]) -> Mesh:
    """Return the certified mesh of a field's zero set within (±2)³."""
    coarse = np.stack(np.meshgrid(*[np.linspace(-2, 2, 81)] * 3, indexing="ij"), -1).reshape(-1, 3)
    inside = coarse[field(coarse) < 0.06]
    low, high = inside.min(axis=0) - 0.1, inside.max(axis=0) + 0.1
    step = (high - low).max() / GRID
    axes = [np.arange(x, y, step) for x, y in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    values = field(points.reshape(-1, 3)).reshape(points.shape[:3])
    vertices, faces = marching_cubes(values, 0.0, spacing=(step,) * 3)[:2]
    mesh = checked_mesh(vertices + low, faces, name)
    found = certify_mesh(mesh)
    if not (found.passed and found.betti == betti):
        raise SystemExit(f"the undamaged {name} is {found.betti}, not {betti}: {found.reasons}")
    return replace(mesh, betti=betti)


def normals_of(mesh: Mesh) -> np.ndarray:
    return np.array(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).vertex_normals)


def patches(mesh: Mesh, radii: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """Return (F,) bool: discs of triangles, radii in diagonals, each on one side of a wall."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    normals = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    gone = np.zeros(len(centres), dtype=bool)
    for radius in radii * mesh.diagonal:
        at = draw.integers(len(centres))
        near = np.linalg.norm(centres - centres[at], axis=1) < radius
        gone |= near & (normals @ normals[at] > 0)
    return gone


def double_sheet(mesh: Mesh, draw: np.random.Generator) -> Surface:
    """Two sheets .5 to .8 % of the diagonal apart, the inner one wound inwards, each with small holes."""
    apart = draw.uniform(0.005, 0.008) * mesh.diagonal
    vertices = np.concatenate([mesh.vertices, mesh.vertices - apart * normals_of(mesh)])
    faces = np.concatenate([mesh.faces, len(mesh.vertices) + mesh.faces[:, ::-1]])
    holes = [patches(mesh, draw.uniform(0.004, 0.008, 20), draw) for _ in range(2)]
    return vertices, faces[~np.concatenate(holes)]


def holes(mesh: Mesh, draw: np.random.Generator) -> Surface:
    """A scan: eight holes of 2 to 8 % of the diagonal across, and one of 12."""
    return mesh.vertices, mesh.faces[~patches(mesh, np.append(draw.uniform(0.01, 0.04, 8), 0.06), draw)]


def overlap(mesh: Mesh, draw: np.random.Generator) -> Surface:
    """Three overlapping open pieces, .3 % of the diagonal out of place; in nested shells also two smaller
    ones that cross each other."""
    along = mesh.vertices[mesh.faces].mean(axis=1)[:, int(np.argmax(np.ptp(mesh.vertices, axis=0)))]
    low, high = along.min(), along.max()
    parts: list[Surface] = []
    for third in range(3):
        begin, end = (low + (high - low) * (third + each) / 3 for each in (-0.15, 1.15))
        shift = draw.normal(size=3)
        moved = mesh.vertices + 0.003 * mesh.diagonal * shift / np.linalg.norm(shift)
        parts.append((moved, mesh.faces[(along >= begin) & (along <= end)]))
    if mesh.name == NESTED:
        parts += [(0.4 * mesh.vertices + offset, mesh.faces) for offset in (0.2, -0.1)]
    return joined(parts)


def torn(mesh: Mesh, draw: np.random.Generator) -> Surface:
    """A third of the triangles turned, a tenth twice, 2 % missing, each corner out of place by .05 % of the
    diagonal: no two triangles share a point."""
    faces = mesh.faces[draw.random(len(mesh.faces)) > 0.02]
    faces = np.concatenate([faces, faces[draw.random(len(faces)) < 0.1]])
    turned = draw.random(len(faces)) < 1 / 3
    faces[turned] = faces[turned][:, ::-1]
    corners = mesh.vertices[faces].reshape(-1, 3)
    corners = corners + 0.0005 * mesh.diagonal * draw.normal(size=corners.shape)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def noisy(mesh: Mesh, draw: np.random.Generator) -> Surface:
    """Noise along the normals of .15 % of the diagonal, and a patch of 15 % across is missing."""
    noise = 0.0015 * mesh.diagonal * draw.normal(size=(len(mesh.vertices), 1))
    return mesh.vertices + noise * normals_of(mesh), mesh.faces[~patches(mesh, np.array([0.075]), draw)]


def joined(parts: list[Surface]) -> Surface:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])[:-1]
    faces = [start + faces for start, (_, faces) in zip(starts, parts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


DAMAGES = {
    "double sheet": (double_sheet, ("sphere", "genus 2", "linked tori", "mug")),
    "holes": (holes, ("torus", "genus 2", "cup with three handles", "tube")),
    "overlap": (overlap, (NESTED, "genus 3", "linked tori", "tube")),
    "torn": (torn, ("torus", "genus 3", "mug", "cup with three handles")),
    "noise": (noisy, ("sphere", "genus 2", "linked tori", "mug")),
}


def damaged(seed: int) -> Iterator[tuple[str, Mesh, Mesh]]:
    """Yield (damage, undamaged mesh with its Betti numbers, damaged mesh), 20 of them."""
    fields = bodies(stream(seed, "bodies"))
    for damage, (done, names) in DAMAGES.items():
        for name in names:
            whole = meshed(fields[name][0], name, fields[name][1])
            made = done(whole, stream(seed, f"{damage} {name}"))
            yield damage, whole, checked_mesh(*made, name, welded=False)


def by_solidify(mesh: Mesh, whole: Mesh) -> Mesh | str:
    """Return the solid with the Betti numbers of the undamaged mesh, or the sentence of a refusal."""
    solid = solidify_mesh(mesh, whole.betti, OFFSETS, CELLS, lambda rung: None)
    return offset_table(solid).splitlines()[-1] if solid.mesh is None else placed(solid.mesh, solid.frame)


def wrapped(mesh: Mesh, pymeshlab: ModuleType) -> Surface:
    """Return CGAL's alpha wrap, pymeshlab's defaults: alpha 2 %, offset .1 % of the diagonal."""
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=mesh.vertices, face_matrix=mesh.faces))
    meshes.generate_alpha_wrap()
    made = meshes.current_mesh()
    return np.array(made.vertex_matrix()), np.array(made.face_matrix())


def judged(made: Mesh | Surface | str, whole: Mesh) -> dict:
    """Return what the certificate says of a made surface, and how far it is from the undamaged one."""
    if isinstance(made, str):
        return {"right": False, "refusal": made}
    if not len(made.faces if isinstance(made, Mesh) else made[1]):
        return {"right": False, "refusal": "an empty mesh"}
    mesh = made if isinstance(made, Mesh) else checked_mesh(*made, whole.name)
    found = certify_mesh(mesh)
    both = (trimesh.Trimesh(each.vertices, each.faces, process=False) for each in (mesh, whole))
    volume, true = (each.volume for each in both)
    return {
        "right": found.passed and found.closed and found.betti == whole.betti,
        "passes": found.passed,
        **dict(zip(("b0", "b1", "b2"), found.betti, strict=True)),
        "hausdorff95": 100 * distances_to(mesh, whole)["hausdorff95"],
        "volume": volume / true,
    }


def main() -> None:
    """Measure what is missing in the CSV."""
    seed = {"type": int, "default": SEED, "help": "sizes and damages (%(default)s)"}
    given = options(__doc__, seed=seed, ways={"nargs": "*", "default": WAYS, "help": "of %(default)s"})
    pymeshlab: Any = given.ways != ["solidify"] and import_pymeshlab()
    calls: dict[str, Callable[[Mesh, Mesh], Mesh | Surface | str]] = {
        "solidify": by_solidify,
        "voxels": lambda mesh, whole: voxels(mesh),
        "poisson": lambda mesh, whole: poisson(mesh, pymeshlab)["poisson"],
        "alpha wrap": lambda mesh, whole: wrapped(mesh, pymeshlab),
    }
    path = given.out / "damaged.csv"
    table = kept(path, ROW)
    known = set(table[ROW].itertuples(index=False, name=None))
    for damage, whole, mesh in damaged(given.seed):
        for way in given.ways:
            if (whole.name, damage, way) in known:
                continue
            with Clock() as clock:
                made = calls[way](mesh, whole)
            row = {**dict(zip(ROW, (whole.name, damage, way), strict=True)), **judged(made, whole)}
            own = pd.DataFrame([row | {"seconds": clock.cpu}])
            table = pd.concat([table, own], ignore_index=True) if len(table) else own
            write(table[[*ROW, *(each for each in COLUMNS if each in table)]], path)


if __name__ == "__main__":
    main()
