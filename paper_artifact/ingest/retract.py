"""The outer surface moved back towards the soup: the topology stays, the thickness of ε goes.

Every vertex moves along the straight line to its nearest point of the soup. Those lines do not cross, but
triangles of finite size may, where the nearest point jumps (in concave creases): vertices of triangles that
would meet stay farther out, in the worst case where they were. So the result is embedded, as the outer
surface is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper_artifact.certify.simplices import edges_of
from paper_artifact.ingest.closest import Nearest, nearest_on
from paper_artifact.ingest.crossings import crossing_faces
from paper_artifact.mesh import Mesh

BACK = 0.95  # of the way; all of it would lay both walls of an open sheet onto each other
ROUNDS = 12  # the first half halve the way, the rest undo it around what still meets, in growing rings


@dataclass(frozen=True, eq=False)
class Retracted:
    """A surface moved back."""

    mesh: Mesh  # the same faces, vertices that hold float32 values
    nearest: Nearest  # of each vertex, before it moved
    moved: np.ndarray  # (V,) float64, share of the way to the soup
    crossings: int | None  # triangles that may still meet another; 0 unless the outer surface's own do


def retract(shell: Mesh, soup: np.ndarray, reach: float) -> Retracted:
    """Return the shell moved towards the triangles soup (T,3,3) float64, no vertex farther from it than
    `reach`; world units. Raises InputError as `nearest_on` does."""
    nearest = nearest_on(soup, shell.vertices, reach)
    way = nearest.points - shell.vertices
    share, held = np.full(len(way), BACK), np.ones(len(way), dtype=bool)
    links = edges_of(shell.faces, len(way))
    for turn in range(ROUNDS + 1):
        vertices = (shell.vertices + share[:, None] * way).astype(np.float32).astype(np.float64)
        meeting = crossing_faces(vertices, shell.faces, links, held)
        if not meeting.any() or turn == ROUNDS:
            break
        held = np.zeros(len(way), dtype=bool)
        held[shell.faces[meeting]] = True
        for _ in range(max(1, turn - ROUNDS // 2)):
            held[shell.faces[held[shell.faces].any(axis=1)]] = True
        share[held] *= 0.5 if turn < ROUNDS // 2 else 0.0
    return Retracted(Mesh(vertices, shell.faces, shell.name), nearest, share, int(meeting.sum()))
