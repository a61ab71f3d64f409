"""Meshes by name: the paper's analytic shapes, external meshes, the pot's stand-in, mesh files.

The analytic shapes are closed, outward-oriented triangle meshes with known Betti numbers. The paper prints no
parameters; those here were inferred by matching its published margins (documentation of each builder). All
are in world units, centred at the origin.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from os.path import lexists
from pathlib import Path

import numpy as np
import trimesh

from paper_artifact.arithmetic import cos, norm, sin
from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh, checked_mesh, load_mesh
from paper_artifact.scene.fetch import TABLE, mesh_path, sources

SPHERE_SUBDIVISIONS = 5
BOWL_SUBDIVISIONS = 4  # the paper's rims follow from dropping faces of this very mesh
TORUS_TUBE = 0.38
DOUBLE_TORUS_TUBE = 0.30
TWO_SPHERES_GAP = 1.6
BOWL_RIMS = {"bowl_narrow": 0.14, "bowl_wide": 0.50}
POT = "pot"  # the ingested shell of the procedural hot pot, in the role of the paper's pot


def make_shape(name: str) -> Mesh:
    """Return the analytic shape `name` (one of SHAPES) as a welded Mesh, world units, with its Betti numbers.

    Raises InputError for an unknown name.
    """
    if not isinstance(name, str) or name not in SHAPES:
        raise InputError(
            f"unknown shape {name!r:.40}; choose one of {', '.join(SHAPES)}, or give a mesh file"
        )
    return SHAPES[name]()


def sphere() -> Mesh:
    """Return the unit sphere, an icosphere of 20,480 faces within 3e-4 of the sphere; D = 2·sqrt(3)."""
    return checked_mesh(*_icosphere(SPHERE_SUBDIVISIONS), "sphere", (1, 0, 1))


def cube() -> Mesh:
    """Return the cube of side 1 (12 faces); D = sqrt(3)."""
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    return checked_mesh(box.vertices, box.faces, "cube", (1, 0, 1))


def cylinder() -> Mesh:
    """Return the closed cylinder of radius 1, height 2 along z: our choice, the paper prints no margin for
    it.
    """
    segments = 96
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([cos(angle), sin(angle)], axis=1)
    vertices = np.concatenate(
        [np.column_stack([ring, np.full(segments, z)]) for z in (-1.0, 1.0)]
        + [[[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]]
    )
    low = np.arange(segments)
    after = (low + 1) % segments
    high, high_after, bottom, top = low + segments, after + segments, 2 * segments, 2 * segments + 1
    faces = np.concatenate(
        [
            np.column_stack([low, after, high_after]),
            np.column_stack([low, high_after, high]),
            np.column_stack([after, low, np.full(segments, bottom)]),
            np.column_stack([high, high_after, np.full(segments, top)]),
        ]
    )
    return checked_mesh(vertices, faces, "cylinder", (1, 0, 1))


def torus() -> Mesh:
    """Return the torus with major radius 1 and tube radius .38, axis z (27,648 faces)."""
    around, tube = 192, 72  # vertices
    phi = np.repeat(2 * np.pi * np.arange(around)[:, None] / around, tube, axis=1)
    theta = np.repeat(2 * np.pi * np.arange(tube)[None, :] / tube, around, axis=0)
    vertices = _torus_points(phi, theta, TORUS_TUBE).reshape(-1, 3)
    faces = _grid_faces(np.arange(around * tube).reshape(around, tube), wrap_rows=True)
    return checked_mesh(vertices, faces, "torus", (1, 2, 1))


def two_spheres() -> Mesh:
    """Return two unit spheres, centres on the x axis, 1.6 apart from surface to surface: D = 6.274.

    A gap of at least 1.6 r is what the paper's component margin asks for (measured: H0 margin 2.58 of 2.61).
    """
    vertices, faces = _icosphere(SPHERE_SUBDIVISIONS)
    offset = np.array([1 + TWO_SPHERES_GAP / 2, 0.0, 0.0])
    return checked_mesh(
        np.concatenate([vertices - offset, vertices + offset]),
        np.concatenate([faces, faces + len(vertices)]),
        "two_spheres",
        (2, 0, 2),
    )


def double_torus() -> Mesh:
    """Return the boundary of the union of two tori, radii 1 and .30, centres (±1, 0, 0): genus 2, D = 5.318.

    The union is symmetric in x = 0, and its half x ≤ 0 is the torus at (-1, 0, 0) without the part at x > 0,
    which lies within the other torus (|x| > 0 puts every point nearer to the centre circle on its own side,
    the circles being tangent at the origin). That half is meshed in the torus' own angles: at tube angle
    theta the ring angle phi runs from phi0 to 2 pi - phi0, cos phi0 = 1/(1 + .3 cos theta) on the outer half,
    where the tube meets x = 0, and phi0 = 0 on the inner half. Vertices lie on the surface, the crease at x =
    0 is made of mesh edges.
    """
    around, tube = 160, 36  # cells along a ring, along half a tube
    # Outer half in uniform steps of t, theta = pi/2·cos(t): dense at the crease's two tips, where phi0 grows
    # like sqrt(pi/2 - theta). Inner half in uniform steps of theta.
    outer = np.pi / 2 * cos(np.pi * np.arange(tube + 1) / tube)
    inner = -np.pi / 2 - np.pi * np.arange(1, tube) / tube
    theta = np.concatenate([outer, inner])
    start = np.zeros(len(theta))
    start[1:tube] = _arccos(1 / (1 + DOUBLE_TORUS_TUBE * cos(outer[1:-1])))
    fraction = np.arange(around + 1) / around
    phi = start[None, :] + (2 * np.pi - 2 * start[None, :]) * fraction[:, None]
    points = _torus_points(phi, np.broadcast_to(theta, phi.shape), DOUBLE_TORUS_TUBE)
    points[..., 0] -= 1
    points[-1] = points[0] * [1, -1, 1]
    points[[0, -1], : tube + 1, 0] = 0.0  # exactly on the mirror plane, so that the weld joins the halves
    points[[0, -1], tube:, 1] = 0.0  # phi = 0 and 2 pi are one curve
    points[[0, -1], 0] = [0.0, 0.0, DOUBLE_TORUS_TUBE]
    points[[0, -1], tube] = [0.0, 0.0, -DOUBLE_TORUS_TUBE]
    half = points.reshape(-1, 3)
    faces = _grid_faces(np.arange(len(half)).reshape(points.shape[:2]), wrap_rows=False)
    faces = faces[:, ::-1]  # theta falls along the columns
    return checked_mesh(
        np.concatenate([half, half * [-1, 1, 1]]),
        np.concatenate([faces, faces[:, ::-1] + len(half)]),
        "double_torus",
        (1, 4, 1),
    )


def bowl(name: str) -> Mesh:
    """Return the unit icosphere of 4 subdivisions with an opening of rim radius a (.14 or .50) at +z.

    The faces whose centroid has z > sqrt(1 - a²) are dropped. It is a disc, while samples of it read as a
    void.
    """
    vertices, faces = _icosphere(BOWL_SUBDIVISIONS)
    kept = vertices[faces].mean(axis=1)[:, 2] <= np.sqrt(1 - BOWL_RIMS[name] ** 2)
    return checked_mesh(vertices, faces[kept], name, (1, 0, 0))


def _icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosahedron()
    vertices, faces = np.asarray(ball.vertices, np.float64), np.asarray(ball.faces, np.int64)
    for _ in range(subdivisions):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
        vertices = vertices / norm(vertices)[:, None]
    return vertices, faces.astype(np.int64)


def _arccos(x: np.ndarray) -> np.ndarray:
    """Return the angles (n,) in (0, π/2] of cosines (n,) in [0, 1), by Newton's steps."""
    angle = np.sqrt(2 * (1 - x))
    for _ in range(6):
        angle = angle + (cos(angle) - x) / sin(angle)
    return angle


def _torus_points(phi: np.ndarray, theta: np.ndarray, tube: float) -> np.ndarray:
    """Return points (..., 3) at ring angle phi and tube angle theta (radians) of a torus of radius 1 around
    z.
    """
    ring = 1 + tube * cos(theta)
    return np.stack([ring * cos(phi), ring * sin(phi), tube * sin(theta)], axis=-1)


def _grid_faces(index: np.ndarray, wrap_rows: bool) -> np.ndarray:
    """Return two triangles per cell of a grid of vertex indices; columns wrap around, rows when asked to."""
    row, column = (np.roll(index, -1, axis=0), np.roll(index, -1, axis=1))
    both = np.roll(row, -1, axis=1)
    cells = [block if wrap_rows else block[:-1] for block in (index, row, both, column)]
    a, b, c, d = (block.reshape(-1) for block in cells)
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


SHAPES: dict[str, Callable[[], Mesh]] = {
    "sphere": sphere,
    "cube": cube,
    "cylinder": cylinder,
    "torus": torus,
    "two_spheres": two_spheres,
    "double_torus": double_torus,
    "bowl_narrow": lambda: bowl("bowl_narrow"),
    "bowl_wide": lambda: bowl("bowl_wide"),
}


def is_named(shape: str) -> bool:
    """Return whether find_mesh knows `shape` by name, whatever files of that name there are."""
    # Without a checkout there is no table; the study's own names are worth its error, others may be files.
    return (
        shape in SHAPES or shape == POT or bool((TABLE.is_file() or shape_row(shape)) and shape in sources())
    )


def find_mesh(shape: str, welded: bool = True) -> Mesh:
    """Return the mesh of an analytic shape, an external mesh's key (fetched if needed), the pot, or a mesh
    file.

    welded=False keeps a file's own vertices, for a certificate that counts them. Raises InputError when the
    name is none of these, or the file cannot be had.
    """
    if not isinstance(shape, str | os.PathLike):
        raise InputError(f"a shape is a name or a path, not {shape!r:.60}")
    if shape in SHAPES:
        return make_shape(shape)
    if shape == POT:
        # scikit-image and compiled kernels: only when needed
        from paper_artifact.ingest.hot_pot import pot_solid

        return replace(pot_solid().shell, name=shape)
    if is_named(shape):
        return replace(load_mesh(mesh_path(shape), welded=welded), name=shape)
    if Path(shape).suffix or lexists(shape):
        return load_mesh(Path(shape), welded=welded)
    raise InputError(
        f"unknown shape {shape!r}; choose one of {', '.join(SHAPES)}, {POT}, "
        "a key of `python -m paper_artifact fetch --list`, or the path of a mesh file"
    )


@cache
def surface(shape: str) -> Mesh:
    """Return the mesh of a name as `find_mesh` does, read once per process."""
    return find_mesh(shape)
