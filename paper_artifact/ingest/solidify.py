"""A triangle soup as a solid: the boundary of all that is within ε of it, without enclosed pockets.

Paper §4 and suppl. B: exact weld, exact unsigned distance field, marching cubes at iso ε, enclosed pockets
dropped, and certification by measurement. The result depends on the input's points, ε and the spacing alone:
rebuilds are bit-identical.

The outer surface is closed, orientable and a manifold at every ε: b0 = b2, b1 = 2 × genus. What changes with
ε is how often it is pierced: below half the width of a gap of the soup the surface passes through it to the
soup's inner side. `export.solid` tries a ladder of offsets. One gap in a sphere leaves a double wall whose
Betti numbers are those of the sphere, so a body must also have enclosed volume (`Rung.inside`), or walls that
are thicker than what ε makes of a single sheet (`Rung.backed`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from scipy import ndimage
from skimage.measure import marching_cubes
from trimesh.exchange.ply import export_ply
from trimesh.exchange.stl import export_stl

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.certify.homology import labels_of_graph
from paper_artifact.errors import InputError
from paper_artifact.files import atomic_path
from paper_artifact.formats.polygons import with_doubles
from paper_artifact.ingest.distance import distance_grid
from paper_artifact.mesh import Mesh, checked_mesh, load_mesh, weld

LARGEST_OFFSET = 0.25
OFFSETS = (0.004, 0.005, 0.006, 0.008, 0.01, 0.0125, 0.016, 0.02)  # ε / diagonal, a factor of 1.25 apart
OFFSET = 0.008  # ε / diagonal of `solidify`
# Grid cells per ε. With 1.5, which takes half the time, bob's C0 passes at an ε where 2 shows two handles.
CELLS = 2.0
# Field values closer to ε than this fraction of a cell are moved away: no vertex then falls on a grid point.
NUDGE = 1e-3
FAR = 0.02  # of a cell: the coarsest float32 spacing that the shell's points may have
# A body's inside is at least this share of its volume; a tube of radius 2ε has .11, a double wall 0.
INSIDE = 0.1
# … or this share of its surface has a wall of its own behind it; of a double wall it is about 0.
BACKED = 0.9
DEEP = 3.0  # such a wall, from the surface inwards, in ε: the soup's own is thicker than ε; a sheet gives 2
FORMATS = (".ply", ".obj", ".stl")

Betti = tuple[int, int, int]


@dataclass(frozen=True)
class Wanted:
    """The homology that a solid must have."""

    betti: Betti  # of the solid's surface
    body: bool  # whether it has an inside; False: a thick shell around an open surface


@dataclass(frozen=True)
class Rung:
    """What one offset gives."""

    offset: float  # ε / diagonal of the soup
    betti: Betti  # of the outer surface
    genus: int  # summed over its components
    inside: float  # share of a body's volume that the soup enclosed, least of all bodies; 0: open or double
    backed: float  # share of a component's surface with a wall of its own behind it, least of all
    pockets: int  # enclosed cavities, filled
    triangles: int  # of the surface
    grid: tuple[int, int, int]  # points per axis

    def meets(self, wanted: Wanted) -> bool:
        """Whether Betti numbers and, for a body, the inside or the walls are as wanted."""
        return self.betti == wanted.betti and (self.backed >= BACKED or self.sure(wanted))

    def sure(self, wanted: Wanted) -> bool:
        """Whether there is an inside, where a body is wanted. Walls alone may be those of a double sheet with
        a gap: an offset that closes it is better."""
        return self.inside >= INSIDE or not wanted.body


@dataclass(frozen=True, eq=False)
class Solid:
    """A solidified mesh."""

    shell: Mesh  # the closed surface, vertices rounded to float32 and welded, wound outwards
    raw: Certificate  # of the input
    certificate: Certificate  # of the shell
    offset: float  # ε, world units
    cell: float  # spacing of the grid, world units
    grid: tuple[int, int, int]  # points per axis
    pockets: int  # enclosed cavities that were filled

    @property
    def sha256(self) -> str:
        """The sha256 (hex) of the shell's float32 vertices and int32 faces: equal for equal rebuilds."""
        digest = hashlib.sha256(self.shell.vertices.astype("<f4").tobytes())
        digest.update(self.shell.faces.astype("<i4").tobytes())
        return digest.hexdigest()

    def to_json(self) -> dict:
        """Return a JSON-able dict: both certificates, ε, spacing, grid, pockets and the shell's hash."""
        return {
            "shell": self.shell.name,
            "sha256": self.sha256,
            "offset": self.offset,
            "cell": self.cell,
            "grid": list(self.grid),
            "pockets_dropped": self.pockets,
            "raw": self.raw.to_json(),
            "certificate": self.certificate.to_json(),
        }


def solidify(mesh: Mesh, offset: float = OFFSET, cells: float = CELLS) -> Solid:
    """Return the Solid of a raw Mesh.

    offset: ε divided by the bounding-box diagonal; cells: grid cells per ε, at least 1. Features and gaps
    below 2ε close. Raises InputError for an offset outside (0, 0.25], fewer than one cell, a grid too large,
    or a mesh so far from the origin that float32 cannot hold its shell.
    """
    check_ladder([offset], cells)
    raw = certify_mesh(mesh)
    rung, surface = outer_surface(mesh, offset, cells)
    shell = checked_mesh(surface.vertices, surface.faces, surface.name)
    certificate = certify_mesh(shell)
    epsilon = float(offset * mesh.diagonal)
    return Solid(
        shell=replace(shell, betti=certificate.betti if certificate.passed else None),
        raw=raw,
        certificate=certificate,
        offset=epsilon,
        cell=epsilon / cells,
        grid=rung.grid,
        pockets=rung.pockets,
    )


def outer_surface(mesh: Mesh, offset: float, cells: float) -> tuple[Rung, Mesh]:
    """Return the outer surface of all that is within ε of a raw Mesh: its Rung, and the surface as marching
    cubes gives it, not welded, wound outwards, its points float32 values.

    offset: ε divided by the diagonal; cells: grid cells per ε. The Betti numbers are counted on the
    understanding that the surface is closed and a manifold, as marching cubes makes it: components, Euler
    characteristic. `certify` counts without that. Raises InputError for a grid too large, or a mesh so far
    from the origin that float32 cannot hold it.
    """
    epsilon = offset * mesh.diagonal
    cell = epsilon / cells
    vertices, faces = weld(mesh.vertices, mesh.faces)
    farthest = float(np.abs(vertices).max())
    if farthest * np.finfo(np.float32).eps > FAR * cell:
        raise InputError(
            f"cells of {cell:.3g} are too small beside the coordinates of {mesh.name}, up to {farthest:.3g}, "
            "for the shell's float32 points; move it to the origin, or take a larger offset or fewer cells"
        )
    if cell < 2.0**-110:
        raise InputError(f"cells of {cell:.3g} are too small for float32 points; scale {mesh.name} up")
    distances, origin = distance_grid(vertices, faces, cell, epsilon + 2 * cell)
    near = distances <= np.float32(epsilon)
    values, pockets = without_pockets(distances, epsilon, NUDGE * cell)
    filled = values < np.float32(epsilon)
    # marching_cubes adds 2e-16 to each difference of values: tiny ones are scaled up by a power of two.
    unit = np.float32(min(1.0, np.ldexp(1.0, int(np.frexp(epsilon)[1]) + 30)))
    values /= unit
    iso = np.float32(epsilon) / unit
    points, triangles, inwards, _ = marching_cubes(values, iso, gradient_direction="descent")
    label = labels_of_graph(triangles[:, [0, 1]].reshape(-1), triangles[:, [1, 2]].reshape(-1), len(points))
    deep = np.rint(points + DEEP * epsilon / cell * inwards).astype(int)
    walled = filled[tuple(np.clip(deep, 0, np.array(values.shape) - 1).T)]
    count, euler = int(label.max()) + 1, len(points) - len(triangles) // 2
    rounded = (points.astype(np.float64) * cell + origin).astype(np.float32).astype(np.float64)
    rung = Rung(
        offset=offset,
        betti=(count, 2 * count - euler, count),
        genus=(2 * count - euler) // 2,
        inside=_least_inside(filled, near),
        backed=float((np.bincount(label, walled) / np.bincount(label)).min()),
        pockets=pockets,
        triangles=len(triangles),
        grid=values.shape,
    )
    return rung, Mesh(rounded, triangles, f"{mesh.name} shell")


def _least_inside(filled: np.ndarray, near: np.ndarray) -> float:
    """Return the least share, over the 6-connected bodies of `filled`, of points that are not `near`."""
    labels, count = ndimage.label(filled)
    if count == 1:
        return float(1 - near.sum() / filled.sum())
    whole = np.bincount(labels[filled], minlength=count + 1)[1:]
    walls = np.bincount(labels[near], minlength=count + 1)[1:]
    return float(1 - (walls / whole).max())


def without_pockets(values: np.ndarray, iso: float, nudge: float) -> tuple[np.ndarray, int]:
    """Return the field with every enclosed pocket filled, and their number.

    values (nx,ny,nz) float32 ≤ iso inside, > iso at the grid's border; a pocket is a 6-connected set of
    outside points that does not reach the border, and gets values below iso. Values within `nudge` of iso
    move to that distance, on their side of it.
    """
    outside = values > iso
    labels, count = ndimage.label(outside)
    pocket = outside & (labels != labels[0, 0, 0])
    values = np.where(
        outside & ~pocket, np.maximum(values, iso + nudge), np.minimum(values, iso - nudge)
    ).astype(np.float32)
    return values, int(count) - 1


def wanted_of(betti: Sequence[int]) -> Wanted:
    """Return what a solid of a surface with Betti numbers (b0, b1, b2) must have.

    A closed surface (b2 = b0, b1 even) is wanted itself. An open one (b2 = 0) has no inside: its solid is a
    thick shell around it, whose surface is (b0, 2·b1, b0). Raises InputError for what no surface in space
    has.
    """
    text = ",".join(map(str, betti))
    if len(betti) != 3 or min(betti) < 0 or betti[0] == 0:
        raise InputError(
            f"Betti numbers are b0,b1,b2 with b0 ≥ 1 and none negative, such as 1,2,1; got {text}"
        )
    b0, b1, b2 = (int(each) for each in betti)
    if b2 == 0:
        return Wanted((b0, 2 * b1, b0), body=False)
    if b2 != b0:
        raise InputError(
            f"no solid has the Betti numbers {text}: each of its components is one closed surface, so "
            f"b2 = b0 (or 0 for a thick shell around open surfaces); give {b0},{b1},{b0}"
        )
    if b1 % 2:
        raise InputError(
            f"no closed surface in space has b1 = {b1}: it is twice the number of handles; "
            f"give {b0},{b1 - 1},{b2} or {b0},{b1 + 1},{b2}"
        )
    return Wanted((b0, b1, b2), body=True)


def check_ladder(offsets: Iterable[float], cells: float = CELLS) -> tuple[float, ...]:
    """Return the offsets ε / diagonal in rising order, each once. Raises InputError for none, one outside of
    (0, 0.25], and fewer than one grid cell per ε."""
    rungs = tuple(sorted(set(offsets)))
    if not rungs:
        raise InputError("no offset to try; give at least one, as a fraction of the diagonal such as 0.008")
    if wrong := [offset for offset in rungs if not 0 < offset <= LARGEST_OFFSET]:
        raise InputError(f"the offset must be in (0, {LARGEST_OFFSET}] of the diagonal, got {wrong[0]}")
    if not (np.isfinite(cells) and cells >= 1):
        raise InputError(f"there must be at least one grid cell per offset, got {cells}")
    return rungs


def plateau(rungs: Sequence[Rung]) -> tuple[Betti, float]:
    """Return the Betti numbers that last longest, in log ε, on consecutive rungs with an inside (on any,
    where none has one), and the share of the ladder that they last over, 1 for a single rung; of equally long
    ones those at the smaller offsets."""
    enclosed = [rung.inside >= INSIDE for rung in rungs]
    edges = np.log([rung.offset for rung in rungs])
    best, longest, start = rungs[0].betti, -1.0, 0
    for i, rung in enumerate(rungs):
        if i and (rung.betti, enclosed[i]) != (rungs[i - 1].betti, enclosed[i - 1]):
            start = i
        if edges[i] - edges[start] > longest and (enclosed[i] or not any(enclosed)):
            best, longest = rung.betti, edges[i] - edges[start]
    return best, float(longest / (edges[-1] - edges[0])) if len(rungs) > 1 else 1.0


def check_format(path: Path | str) -> None:
    """Raise InputError unless the path ends in a format that holds float32 points exactly."""
    if Path(path).suffix.lower() not in FORMATS:
        raise InputError(f"cannot write a shell as {path}: its name must end in {', '.join(FORMATS)}")


def write_shell(path: Path | str, shell: Mesh) -> Certificate:
    """Write a Mesh by the path's ending; return the certificate of what was written.

    The formats are binary PLY, OBJ and, for vertices that are float32 values, binary STL. The file appears
    only when it reads back to the same points and passes the certificate. Raises InputError otherwise, for
    another ending, and when the folder is not writable.
    """
    check_format(path)
    return write_certified(path, shell, _encoded(shell, Path(path).suffix.lower()))


def write_certified(path: Path | str, shell: Mesh, data: bytes) -> Certificate:
    """Write `data`, a mesh file that holds `shell`; return the certificate of what was written, reading and
    raising as `write_shell` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
        again = load_mesh(temporary, welded=False)
        certificate = certify_mesh(Mesh(again.vertices, again.faces, Path(path).stem))
        if not np.array_equal(np.unique(again.vertices, axis=0), np.unique(shell.vertices, axis=0)):
            raise InputError(f"{path} would not hold the shell's points exactly; write PLY instead")
        if not certificate.passed:
            raise InputError(
                f"the shell fails its certificate ({'; '.join(certificate.reasons)}), so {path} was not "
                "written; try another offset or more cells per offset"
            )
    return certificate


def _encoded(shell: Mesh, ending: str) -> bytes:
    single = shell.vertices.astype(np.float32)
    points = single if np.array_equal(single, shell.vertices) else shell.vertices
    if ending == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in points]
        return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in (shell.faces + 1).tolist()] + [""]).encode()
    mesh = trimesh.Trimesh(shell.vertices, shell.faces, process=False)
    if ending == ".stl":
        return export_stl(mesh)
    data = export_ply(mesh, vertex_normal=False)
    return data if points is single else with_doubles(data, points)
