"""Three-dimensional Delaunay triangulation by incremental insertion, exact on normalised points.

Bowyer-Watson insertion in biased randomised Hilbert order with a walk for location. Outside the convex hull
lie "infinite" tetrahedra, one per hull triangle, with the vertex -1 in the last place. Ties: a later point
counts as lifted infinitesimally higher on the paraboloid than all earlier ones, so a point on a sphere is
outside it; the result is a regular triangulation of the perturbed lift, has no flat tetrahedron, and the
alpha persistence diagram does not depend on the choice.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.alpha.expansions import WORKSPACE
from paper_artifact.alpha.predicates import (
    insphere,
    insphere_filter,
    orient3d,
    orient3d_exact,
    orient3d_filter,
)
from paper_artifact.kernel_cache import njit

INFINITE = -1  # the last vertex of a cell outside the hull
DEAD = -2  # the first vertex of an unused row

# The first tetrahedron (0, 1, 2, 3) and the four infinite cells around it: vertices, then the neighbours
# opposite to them.
START = np.array(
    [
        [0, 1, 2, 3, 1, 2, 3, 4],
        [3, 1, 2, INFINITE, 4, 2, 3, 0],
        [0, 3, 2, INFINITE, 1, 4, 3, 0],
        [0, 1, 3, INFINITE, 1, 2, 4, 0],
        [1, 0, 2, INFINITE, 2, 1, 3, 0],
    ],
    dtype=np.int32,
)
# The triangle opposite vertex i, turned so that orient3d with a point on the side of vertex i is positive.
FACE = np.array([[2, 1, 3], [0, 2, 3], [1, 0, 3], [0, 1, 2]])


@njit(cache=True, nogil=True)
def _collinear(points: np.ndarray, i: int, lifted: np.ndarray, ws: np.ndarray) -> bool:
    """Return whether rows 0, 1 and i are exactly collinear.

    They are when all coordinate projections have zero area, each read off an orientation with a point above.
    lifted: (4, 3) float64, overwritten.
    """
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for k in range(4):
            row = (0, 1, i, 0)[k]
            lifted[k, 0], lifted[k, 1], lifted[k, 2] = points[row, u], points[row, v], 0.0
        lifted[3, 2] = 1.0
        if orient3d(lifted, 0, 1, 2, 3, ws) != 0.0:
            return False
    return True


@njit(cache=True, nogil=True)
def _swap(points: np.ndarray, order: np.ndarray, i: int, j: int) -> None:
    for k in range(3):
        points[i, k], points[j, k] = points[j, k], points[i, k]
    order[i], order[j] = order[j], order[i]


@njit("int64(float64[:,::1], int32[::1])", cache=True, nogil=True)
def first_simplex(points: np.ndarray, order: np.ndarray) -> int:
    """Move affinely independent rows to the front, four of them positively oriented; return how many.

    Fewer than four: all points are equal (1), exactly collinear (2), exactly coplanar (3); 0: no points.
    Changes points (n, 3) and order (n,) IN PLACE.
    """
    ws, lifted = np.empty(WORKSPACE), np.empty((4, 3))
    found = min(1, len(points))
    for i in range(1, len(points)):
        if found == 1:
            use = points[i, 0] != points[0, 0] or points[i, 1] != points[0, 1] or points[i, 2] != points[0, 2]
        elif found == 2:
            use = not _collinear(points, i, lifted, ws)
        else:
            use = orient3d(points, 0, 1, 2, i, ws) != 0.0
        if use:
            _swap(points, order, found, i)
            found += 1
            if found == 4:
                if orient3d(points, 0, 1, 2, 3, ws) < 0.0:
                    _swap(points, order, 0, 1)
                break
    return found


@njit(cache=True, nogil=True, forceinline=True)
def _conflict_filter(points: np.ndarray, mesh: np.ndarray, t: int, p: int) -> tuple[float, float]:
    """Return (value, bound) of p in the sphere of cell t, open (0, 0) for an infinite cell."""
    d = mesh[t, 3]
    if d == INFINITE:
        return 0.0, 0.0
    return insphere_filter(
        points, np.int64(mesh[t, 0]), np.int64(mesh[t, 1]), np.int64(mesh[t, 2]), np.int64(d), p
    )


@njit(cache=True, nogil=True)
def _in_conflict(points: np.ndarray, mesh: np.ndarray, t: int, p: int, ws: np.ndarray) -> bool:
    """Return whether p destroys cell t: p inside its sphere, or, for an infinite cell, beyond its triangle.

    In the plane of the triangle, inside its circle: that is where the plane meets the inner cell's sphere.
    """
    a, b, c = np.int64(mesh[t, 0]), np.int64(mesh[t, 1]), np.int64(mesh[t, 2])
    if mesh[t, 3] == INFINITE:
        side = orient3d(points, a, b, c, p, ws)
        if side != 0.0:
            return side > 0.0
        t = mesh[t, 7]
        a, b, c = np.int64(mesh[t, 0]), np.int64(mesh[t, 1]), np.int64(mesh[t, 2])
    return insphere(points, a, b, c, np.int64(mesh[t, 3]), p, ws) > 0.0


@njit(cache=True, nogil=True, forceinline=True)
def _locate(points: np.ndarray, mesh: np.ndarray, t: int, p: int, ws: np.ndarray) -> int:
    """Walk from cell t; return the finite cell that contains p, or an infinite one p lies beyond."""
    if mesh[t, 3] == INFINITE:
        t = mesh[t, 7]
    previous = np.int32(-1)
    while mesh[t, 3] != INFINITE:
        following = np.int32(-1)
        for i in range(4):
            other = mesh[t, 4 + i]
            if other == previous:
                continue
            a, b = np.int64(mesh[t, FACE[i, 0]]), np.int64(mesh[t, FACE[i, 1]])
            c = np.int64(mesh[t, FACE[i, 2]])
            side, bound = orient3d_filter(points, a, b, c, p)
            if abs(side) <= bound:
                side = orient3d_exact(points, a, b, c, p, ws)
            if side < 0.0:
                following = other
                break
        if following < 0:
            return t
        previous = t
        t = following
    return t


@njit(cache=True, nogil=True)
def _grown(array: np.ndarray, rows: int) -> np.ndarray:
    """Return a copy of (m, k) `array` with `rows` rows, the new ones 0."""
    larger = np.zeros((rows, array.shape[1]), dtype=np.int32)
    for i in range(len(array)):  # a slice assignment takes seconds to compile
        for j in range(array.shape[1]):
            larger[i, j] = array[i, j]
    return larger


@njit("Tuple((int32[:,::1], int64))(float64[:,::1])", cache=True, nogil=True)
def triangulate(points: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the Delaunay tetrahedra of `points` and the number of distinct points.

    points: (n, 3) float64, n >= 4, scaled as ordering.normalised does, inserted in the order given; the first
    four rows are affinely independent and positively oriented (first_simplex). The tetrahedra are a mesh
    (c, 8) int32: rows of four vertices and the four neighbours opposite to them, finite cells positively
    oriented, infinite cells with vertex -1 in column 3, unused rows with -2 in column 0. A row that exactly
    duplicates an earlier one is in no cell.
    """
    n = len(points)
    ws = np.empty(WORKSPACE)
    distinct = n
    capacity = 9 * n + 64
    mesh = np.empty((capacity, 8), dtype=np.int32)  # a cell's vertices, then its neighbours opposite to them
    mark = np.zeros((capacity, 1), dtype=np.int32)  # 2p: in conflict with p, 2p + 1: not; less: not yet known
    for t in range(len(START)):
        for i in range(8):
            mesh[t, i] = START[t, i]
    used = 5
    free = np.empty((capacity, 1), dtype=np.int32)
    free_count = 0
    cavity = np.empty((256, 1), dtype=np.int32)
    rim = np.empty((256, 6), dtype=np.int32)  # new cell's vertices, the slot of p, the cell outside
    values, bounds = np.empty(4), np.empty(4)
    table = 1024
    slot_keys = np.empty(table, dtype=np.int64)
    slot_sides = np.empty(table, dtype=np.int32)
    slot_stamps = np.zeros(table, dtype=np.int32)
    last = np.int32(0)
    for p in range(4, n):
        first = _locate(points, mesh, last, p, ws)
        if mesh[first, 3] != INFINITE:
            known = False
            for i in range(4):
                v = mesh[first, i]
                if (
                    points[v, 0] == points[p, 0]
                    and points[v, 1] == points[p, 1]
                    and points[v, 2] == points[p, 2]
                ):
                    known = True
            if known:
                distinct -= 1
                last = first
                continue
        # The cavity: all cells in conflict, connected; its rim becomes the new cells.
        inside, outside = np.int32(2 * p), np.int32(2 * p + 1)
        cavity[0, 0] = first
        mark[first, 0] = inside
        count, done, faces = 1, 0, 0
        while done < count:
            t = cavity[done, 0]
            done += 1
            if count + 4 > len(cavity):
                cavity = _grown(cavity, 2 * len(cavity))
            if faces + 4 > len(rim):
                rim = _grown(rim, 2 * len(rim))
            # All neighbours' values first: without a branch between them the processor overlaps them.
            for i in range(4):
                other = np.uint32(mesh[t, 4 + i])
                if mark[other, 0] < inside:
                    values[i], bounds[i] = _conflict_filter(points, mesh, other, p)
            for i in range(4):
                other = np.uint32(mesh[t, 4 + i])
                state = mark[other, 0]
                if state == inside:
                    continue
                if state != outside:
                    conflict = values[i] > 0.0
                    if abs(values[i]) <= bounds[i]:
                        conflict = _in_conflict(points, mesh, np.int64(other), p, ws)
                    if conflict:
                        mark[other, 0] = inside
                        cavity[count, 0] = other
                        count += 1
                        continue
                    mark[other, 0] = outside
                for j in range(4):
                    rim[faces, j] = mesh[t, j]
                rim[faces, i] = p
                rim[faces, 4] = 4 * t + i
                rim[faces, 5] = other
                faces += 1
        # The outside cells still name the old ones: find the slot before those are overwritten.
        for f in range(faces):
            other, old = np.uint32(rim[f, 5]), rim[f, 4] >> 2
            back = 0
            for j in range(1, 4):
                if mesh[other, 4 + j] == old:
                    back = j
            rim[f, 4] = 4 * (rim[f, 4] & 3) + back
        if free_count + count > len(free):
            free = _grown(free, 2 * len(free) + count)
        for k in range(count):
            free[free_count, 0] = cavity[k, 0]
            free_count += 1
            mesh[cavity[k, 0], 0] = DEAD
        if used + faces > len(mesh):
            rows = 2 * len(mesh) + faces
            mesh, mark = _grown(mesh, rows), _grown(mark, rows)
        if 3 * faces > table:
            while table < 6 * faces:
                table *= 2
            slot_keys = np.empty(table, dtype=np.int64)
            slot_sides = np.empty(table, dtype=np.int32)
            slot_stamps = np.zeros(table, dtype=np.int32)
        for f in range(faces):
            if free_count > 0:
                free_count -= 1
                t = np.uint32(free[free_count, 0])
            else:
                t = np.uint32(used)
                used += 1
            i, back, other = rim[f, 4] >> 2, rim[f, 4] & 3, np.uint32(rim[f, 5])
            for j in range(4):
                mesh[t, j] = rim[f, j]
            mark[t, 0] = 0
            mesh[t, 4 + i] = other
            mesh[other, 4 + back] = t
            last = np.int32(t)
            # The triangle opposite j holds p and an edge of the rim, which one other new cell has as well.
            for j in range(4):
                if j == i:
                    continue
                u, v = -1, -1
                for k in range(4):
                    if k != i and k != j:
                        u, v = v, rim[f, k]
                if u > v:
                    u, v = v, u
                key = (np.int64(u) + 1) * np.int64(n + 1) + np.int64(v)
                place = ((u + 1) * 73856093 ^ v * 19349663) & (table - 1)
                while slot_stamps[place] == p and slot_keys[place] != key:
                    place = (place + 1) & (table - 1)
                if slot_stamps[place] == p:
                    mate, side = np.uint32(slot_sides[place] >> 2), slot_sides[place] & 3
                    mesh[t, 4 + j] = mate
                    mesh[mate, 4 + side] = t
                else:
                    slot_stamps[place] = p
                    slot_keys[place] = key
                    slot_sides[place] = 4 * t + j
    return mesh[:used], distinct


@njit(cache=True, nogil=True)
def finite_cells(mesh: np.ndarray, rank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the finite cells (m, 4) of `triangulate` and their neighbours (m, 4), -1 outside the hull;
    int32.

    Row v is renamed rank[v] (rank: (n,) int32, a permutation). The cells are sorted by their smallest vertex,
    so that near cells are near in memory.
    """
    used = len(mesh)
    firsts = np.full(used, np.int32(-1))
    starts = np.zeros(len(rank) + 1, dtype=np.int32)
    for t in range(used):
        if mesh[t, 0] != DEAD and mesh[t, 3] != INFINITE:
            firsts[t] = min(min(rank[mesh[t, 0]], rank[mesh[t, 1]]), min(rank[mesh[t, 2]], rank[mesh[t, 3]]))
            starts[firsts[t] + 1] += 1
    for v in range(len(rank)):
        starts[v + 1] += starts[v]
    m = starts[len(rank)]
    number = np.full(used, np.int32(-1))
    for t in range(used):
        if firsts[t] >= 0:
            number[t] = starts[firsts[t]]
            starts[firsts[t]] += 1
    cells, neighbours = np.empty((m, 4), dtype=np.int32), np.empty((m, 4), dtype=np.int32)
    for t in range(used):
        if number[t] >= 0:
            for i in range(4):
                cells[number[t], i] = rank[mesh[t, i]]
                neighbours[number[t], i] = number[mesh[t, 4 + i]]
    return cells, neighbours
