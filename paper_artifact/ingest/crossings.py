"""Where a triangle mesh crosses itself, and moving a shell back to its soup without a crossing.

Crossings: every edge is held against every triangle that it shares no corner with; of two triangles that
cross, one has an edge that meets the other. A pair counts as apart only when a sign proves it, by float64
determinants beyond their error bound (Shewchuk 1997): a mesh without a count has no crossing; one with a
count may merely touch. Neighbours folded flat onto each other are counted too.

Moving back: the topology of the shell stays, its distance of ε to the soup goes. Every vertex moves along
the straight line to its nearest point of the soup. Those lines do not cross, but triangles of finite size
may, where the nearest point jumps (in concave creases): vertices of triangles that would meet stay farther
out, in the worst case where they were. So the result is embedded if the shell is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper_artifact.alpha.predicates import orient3d_filter
from paper_artifact.certify.homology import edges_of
from paper_artifact.errors import InputError
from paper_artifact.ingest.distance import Boxes, Nearest, file_boxes, items_near, nearest_on
from paper_artifact.kernel_cache import njit
from paper_artifact.mesh import Mesh

FLAT_BOUND = 1e-15  # above (3 + 16 u) u for the two-dimensional determinant, u = 2^-53


def crossing_faces(
    vertices: np.ndarray,
    faces: np.ndarray,
    links: tuple[np.ndarray, np.ndarray] | None = None,
    changed: np.ndarray | None = None,
) -> np.ndarray:
    """Return (F,) bool: the faces (F,3) int64 that may meet another one beyond what they share.

    vertices (V,3) float64. A face with an edge that meets another face is marked, and so is that other one.
    links: `edges_of(faces, V)`, where known. changed (V,) bool: only pairs with such a vertex are looked at.
    Raises InputError for vertices that are not finite.
    """
    if not np.isfinite(vertices).all():
        raise InputError(
            "a vertex has a coordinate that is not finite; remove it before crossings are looked for"
        )
    if not len(faces):
        return np.zeros(0, dtype=bool)
    points, faces = _scaled(vertices), np.ascontiguousarray(faces, dtype=np.int64)
    edges, face_edges = edges_of(faces, len(points)) if links is None else links
    cell = _cell(points, edges)
    if changed is None:
        changed = np.ones(len(points), dtype=bool)
    some_faces, some_edges = changed[faces].any(axis=1), changed[edges].any(axis=1)
    meets, met = np.zeros(len(edges), dtype=bool), np.zeros(len(faces), dtype=bool)
    for chosen, with_edges in ((some_faces, np.ones(len(edges), dtype=bool)), (~some_faces, some_edges)):
        if chosen.any() and with_edges.any():
            some = faces[chosen]
            edge, face = _meetings(points, some, edges[with_edges], file_boxes(points[some], cell))
            meets[with_edges] |= edge
            met[chosen] |= face
    met |= meets[face_edges].any(axis=1)
    shared = np.zeros(len(edges), dtype=bool)
    shared[face_edges[some_faces]] = True
    beside = shared[face_edges].any(axis=1)
    met[beside] |= _folded(points, faces[beside], face_edges[beside], len(edges))
    return met


def _scaled(vertices: np.ndarray) -> np.ndarray:
    """Return the vertices by a power of two, which is exact and keeps the determinants away from the ends of
    double precision."""
    scale = 2.0 ** -np.ceil(np.log2(max(float(np.abs(vertices).max()), 1e-300)))
    return np.ascontiguousarray(vertices, dtype=np.float64) * scale


def _cell(points: np.ndarray, edges: np.ndarray) -> float:
    some = edges[:: 1 + len(edges) // 100_000]
    return 1.5 * float(np.median(np.linalg.norm(points[some[:, 0]] - points[some[:, 1]], axis=1)))


def crossing_segments(vertices: np.ndarray, faces: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Return (S,) bool: the segments (S,2) int64 between vertices (V,3) that may meet a face (F,3) int64 that
    they share no corner with."""
    points, faces = _scaled(vertices), np.ascontiguousarray(faces, dtype=np.int64)
    boxes = file_boxes(points[faces], _cell(points, edges_of(faces, len(points))[0]))
    return _meetings(points, faces, np.ascontiguousarray(segments), boxes)[0]


def _folded(points: np.ndarray, faces: np.ndarray, face_edges: np.ndarray, count: int) -> np.ndarray:
    """Return (F,) bool: faces that lie flat on a neighbour (normals opposite to rounding)."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    order = np.argsort(face_edges.reshape(-1), kind="stable")
    degree = np.bincount(face_edges.reshape(-1), minlength=count)
    first = (np.cumsum(degree) - degree)[degree == 2]
    left, right = order[first] // 3, order[first + 1] // 3
    flat = (normal[left] * normal[right]).sum(axis=1) <= -(1 - 1e-12) * length[left] * length[right]
    result = np.zeros(len(faces), dtype=bool)
    result[left[flat]] = result[right[flat]] = True
    return result


@njit(cache=True)
def _meetings(
    points: np.ndarray, faces: np.ndarray, edges: np.ndarray, boxes: Boxes
) -> tuple[np.ndarray, np.ndarray]:
    """Return (E,) bool edges that meet a face, and (F,) bool faces that an edge meets."""
    meets, met = np.zeros(len(edges), np.bool_), np.zeros(len(faces), np.bool_)
    for edge in range(len(edges)):
        p, q = edges[edge, 0], edges[edge, 1]
        low, high = np.minimum(points[p], points[q]), np.maximum(points[p], points[q])
        for face in items_near(boxes, low, high):
            far = meets[edge] and met[face]
            for axis in range(3):
                far |= boxes.low[face, axis] > high[axis] or boxes.high[face, axis] < low[axis]
            if far:
                continue
            a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
            if p in (a, b, c) or q in (a, b, c):
                continue
            if not _apart(points, p, q, a, b, c):
                meets[edge] = met[face] = True
    return meets, met


@njit(cache=True)
def _sign(points, a, b, c, d):
    value, bound = orient3d_filter(points, a, b, c, d)
    return 1 if value > bound else (-1 if value < -bound else 0)


@njit(cache=True)
def _apart(points, p, q, a, b, c):
    """Whether signs prove that segment pq does not meet triangle abc."""
    sp, sq = _sign(points, a, b, c, p), _sign(points, a, b, c, q)
    if sp != 0 and sp == sq:
        return True
    if sp == 0 and sq == 0:
        return _apart_in_plane(points, p, q, a, b, c)
    ab, bc, ca = _sign(points, p, q, a, b), _sign(points, p, q, b, c), _sign(points, p, q, c, a)
    return max(ab, bc, ca) == 1 and min(ab, bc, ca) == -1


@njit(cache=True)
def _apart_in_plane(points, p, q, a, b, c):
    """The same for five points in a plane: a line along one of the four sides separates them, seen along some
    axis."""
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for x, y, z in ((a, b, c), (b, c, a), (c, a, b)):
            side = _turn(points, u, v, x, y, z)
            if side != 0 and _turn(points, u, v, x, y, p) == -side and _turn(points, u, v, x, y, q) == -side:
                return True
        side = _turn(points, u, v, p, q, a)
        if side != 0 and _turn(points, u, v, p, q, b) == side and _turn(points, u, v, p, q, c) == side:
            return True
    return False


@njit(cache=True)
def _turn(points, u, v, a, b, c):
    left = (points[a, u] - points[c, u]) * (points[b, v] - points[c, v])
    right = (points[a, v] - points[c, v]) * (points[b, u] - points[c, u])
    bound = FLAT_BOUND * (abs(left) + abs(right))
    return 1 if left - right > bound else (-1 if left - right < -bound else 0)


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
