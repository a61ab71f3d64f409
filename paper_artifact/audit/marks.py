"""Where on the mesh a bar is, for the 3-D view: a loop's cycle, a void's largest ball, a gap between parts.

A loop is born with an edge that closes it: its mark is that edge and the shortest way back through the
samples, along steps that the filtration holds by then, so a cycle of the class. It dies with a triangle, a
void with a tetrahedron: its circumscribed ball, of the radius of the death, is the largest that fits there
without a sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from paper_artifact.alpha.persistence import alpha_filtration, alpha_persistence
from paper_artifact.export.models import Triangles, mesh_triangles, plain_triangles
from paper_artifact.frame import Frame
from paper_artifact.mesh import Mesh, weld

MOST = 8  # marks per dimension
COLOURS = ("#c0392b", "#1f5fbf", "#2e8b57", "#c47f00", "#7d3c98", "#008b8b", "#b03a78", "#5d6d7e")
THICKNESS = 0.006  # of a tube, radius / diagonal
SHRUNK = 0.45  # a triangle's size in the see-through mesh


@dataclass(frozen=True, eq=False)
class Mark:
    """One bar, and where it is."""

    dimension: int  # 0, 1 or 2
    margin: float  # its lifetime over the floor: above 1 it is measurable
    line: np.ndarray  # (n,3) float64, world units: a gap's two ends, a loop's closed path; (0,3) for a void
    centre: np.ndarray  # (3,) float64, world units: of the ball around the simplex that ends it
    radius: float  # of that ball: the death, world units


def find_marks(points: np.ndarray, floor: float, expected: Sequence[int]) -> tuple[Mark, ...]:
    """Return the marks of the significant bars of `points` (M,3) float64, world units, longest first.

    floor: a length in world units. Where fewer bars of a dimension are significant than `expected` (three
    counts), the next longest are marked too. At most MOST a dimension.
    """
    marks, filtration = [], alpha_filtration(points)
    for dimension, pairs in enumerate(alpha_persistence(points)):
        lengths = pairs.deaths - pairs.births
        count = min(max(int((lengths > floor).sum()), expected[dimension]), MOST)
        for row in np.argsort(-lengths, kind="stable")[:count]:
            death = points[pairs.death_simplices[row]]
            line = np.zeros((0, 3))
            if dimension == 0:
                line = death
            elif dimension == 1:
                loop = filtration.shortest_loop(pairs.birth_simplices[row])
                line = points[np.append(loop, loop[0])]
            marks.append(
                Mark(dimension, float(lengths[row] / floor), line, _centre(death), float(pairs.deaths[row]))
            )
    return tuple(marks)


def _centre(corners: np.ndarray) -> np.ndarray:
    """Return the centre (3,) of the smallest sphere through 2 to 4 points (k,3)."""
    sides = corners[1:] - corners[0]
    weights = np.linalg.lstsq(2 * sides @ sides.T, (sides**2).sum(axis=1), rcond=None)[0]
    return corners[0] + weights @ sides


def view_parts(
    mesh: Mesh, marks: Sequence[Mark], frame: Frame, colours: Sequence[str] = COLOURS
) -> dict[str, Triangles]:
    """Return what the 3-D view shows by name: the mesh with its marks, and both with a see-through mesh.

    mesh, marks: world units; frame: in whose coordinates the triangles are. colours (#rrggbb): of the marks,
    in turn.
    """
    surface = mesh_triangles(mesh.framed(frame))
    if not marks:
        return {"mesh": surface}
    tubes, balls = [], []
    for rank, mark in enumerate(marks):
        colour = tuple(int(colours[rank % len(colours)][i : i + 2], 16) / 255 for i in (1, 3, 5))
        if len(mark.line):
            thick = frame.length(THICKNESS * mesh.diagonal)
            tubes.append(plain_triangles(_tube(frame.inward(mark.line), thick), colour))
        if mark.dimension == 2:
            ball = trimesh.creation.icosphere(subdivisions=3, radius=0.97 * frame.length(mark.radius))
            balls.append(plain_triangles((ball.vertices + frame.inward(mark.centre))[ball.faces], colour))
    middle = surface.vertices.mean(axis=1, keepdims=True)
    shrunk = middle + SHRUNK * (surface.vertices - middle)
    parts = {"on the mesh": _joined([surface, *tubes])} if tubes else {"mesh": surface}
    return parts | {"seen through": _joined([plain_triangles(shrunk), *tubes, *balls])}


def _tube(line: np.ndarray, radius: float) -> np.ndarray:
    """Return the triangles (T,3,3) of a six-sided tube around each segment of the line (n,3)."""
    triangles = []
    for start, end in zip(line[:-1], line[1:], strict=True):
        if np.linalg.norm(end - start) > 0:
            tube = trimesh.creation.cylinder(radius, segment=[start, end], sections=6)
            triangles.append(np.asarray(tube.vertices)[tube.faces])
    return np.concatenate(triangles) if triangles else np.zeros((0, 3, 3))


def _joined(parts: Sequence[Triangles]) -> Triangles:
    return Triangles(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("vertices", "colours", "opacity")
        )
    )


def light_mesh(mesh: Mesh, most: int = 60_000) -> Mesh:
    """Return the mesh itself or, above `most` triangles, a coarser one for a picture only.

    The vertices in each cell of a grid are merged to their mean where their normals lie in one octant: the
    two sides of a thin wall stay apart. The grid is coarsened until at most `most` triangles are
    left. A closed surface stays closed; the topology may change.
    """
    cells = 256
    vertices, faces = mesh.vertices, mesh.faces
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.vertices)
    for place in range(3):
        np.add.at(normals, mesh.faces[:, place], across)
    octant = (normals > 0) @ (1 << np.arange(60, 63))
    while len(faces) > most:
        low, cell = mesh.vertices.min(axis=0), mesh.diagonal / cells
        keys = np.floor((mesh.vertices - low) / cell).astype(np.int64) @ (1 << np.array([0, 20, 40]))
        _, group = np.unique(keys + octant, return_inverse=True)
        size = np.bincount(group)
        vertices = np.stack(
            [np.bincount(group, weights=mesh.vertices[:, axis]) / size for axis in range(3)], axis=1
        )
        vertices, faces = weld(vertices, group[mesh.faces])
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        faces = faces[first[count % 2 == 1]]  # two sides of nothing go
        cells = cells * 3 // 4
    return Mesh(vertices, faces, mesh.name)
