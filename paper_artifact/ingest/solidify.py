"""Offset solidification: the boundary of all that is within ε of a triangle soup, without enclosed pockets.

Paper §4 and suppl. B: exact weld, exact unsigned distance field, marching cubes at iso ε, enclosed pockets
dropped, and certification by measurement. The result depends on the input's points, ε and the spacing alone:
rebuilds are bit-identical.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.certify.simplices import labels_of_graph
from paper_artifact.errors import InputError
from paper_artifact.ingest.distance import distance_grid
from paper_artifact.mesh import Mesh, checked_mesh, weld

OFFSET = 0.008  # ε / diagonal
CELLS = 2.0  # grid cells per ε
# Field values closer to ε than this fraction of a cell are moved away: no vertex then falls on a grid point.
NUDGE = 1e-3
FAR = 0.02  # of a cell: the coarsest float32 spacing that the shell's points may have


@dataclass(frozen=True, eq=False)
class OuterSurface:
    """The boundary of a solidified soup as marching cubes gives it, wound outwards."""

    vertices: np.ndarray  # (V,3) float64 that hold float32 values, world units
    faces: np.ndarray  # (F,3) integers
    name: str  # for messages
    cell: float  # spacing of the grid, world units
    grid: tuple[int, int, int]  # points per axis
    pockets: int  # enclosed cavities that were filled
    inside: float  # share of a body's volume that was such a cavity, least of all bodies; see `offsets`

    def shell(self) -> Mesh:
        """Return the surface as a Mesh, welded exactly."""
        return checked_mesh(self.vertices, self.faces, self.name)

    @property
    def betti(self) -> tuple[int, int, int]:
        """(b0, b1, b2), counted on the understanding that the surface is closed and a manifold, as marching
        cubes makes it: components, Euler characteristic. `certify` counts without that.
        """
        sides = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]]])
        count = len(np.unique(labels_of_graph(sides[:, 0], sides[:, 1], len(self.vertices))))
        euler = len(self.vertices) - len(self.faces) // 2
        return count, 2 * count - euler, count


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
    check_offset(offset, cells)
    raw = certify_mesh(mesh)
    epsilon = offset * mesh.diagonal
    surface = outer_surface(mesh, epsilon, epsilon / cells)
    shell = surface.shell()
    certificate = certify_mesh(shell)
    return Solid(
        shell=replace(shell, betti=certificate.betti if certificate.passed else None),
        raw=raw,
        certificate=certificate,
        offset=float(epsilon),
        cell=surface.cell,
        grid=surface.grid,
        pockets=surface.pockets,
    )


def check_offset(offset: float, cells: float) -> None:
    """Raise InputError unless ε / diagonal is in (0, 0.25] and there is at least one grid cell per ε."""
    if not 0 < offset <= 0.25:
        raise InputError(f"the offset must be in (0, 0.25] of the diagonal, got {offset}")
    if not (np.isfinite(cells) and cells >= 1):
        raise InputError(f"there must be at least one grid cell per offset, got {cells}")


def outer_surface(mesh: Mesh, epsilon: float, cell: float) -> OuterSurface:
    """Return the outer surface of all that is within epsilon of a raw Mesh; both lengths in world units.

    Raises InputError for a grid too large, or a mesh so far from the origin that float32 cannot hold it.
    """
    vertices, faces = weld(mesh.vertices, mesh.faces)
    farthest = float(np.abs(vertices).max())
    if farthest * np.finfo(np.float32).eps > FAR * cell:
        raise InputError(
            f"{mesh.name} lies too far from the origin (coordinates to {farthest:.3g}, cells of {cell:.3g}) "
            "for the shell's float32 points; move it towards the origin first"
        )
    field = distance_grid(vertices, faces, cell, epsilon + 2 * cell)
    near = field.values <= np.float32(epsilon)
    values, pockets = without_pockets(field.values, epsilon, NUDGE * cell)
    points, triangles, _, _ = marching_cubes(values, np.float32(epsilon), gradient_direction="descent")
    rounded = (points.astype(np.float64) * cell + field.origin).astype(np.float32).astype(np.float64)
    return OuterSurface(
        vertices=rounded,
        faces=triangles,
        name=f"{mesh.name} shell",
        cell=float(cell),
        grid=tuple(int(n) for n in values.shape),
        pockets=pockets,
        inside=_least_inside(values < np.float32(epsilon), near),
    )


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
