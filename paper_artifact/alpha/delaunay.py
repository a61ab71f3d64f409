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
from paper_artifact.alpha.ordering import grown
from paper_artifact.alpha.predicates import insphere, insphere_of, orient3d, orient3d_exact, orient3d_filter
from paper_artifact.kernel_cache import njit

INFINITE = -1  # the last vertex of a cell outside the hull
DEAD = -2  # the first vertex of an unused row

# A row of a mesh: a cell's vertices and, opposite to each, 4 times the neighbour's row plus the place of this
# cell among its neighbours. At first, a tetrahedron (0, 1, 2, 3) and the four infinite cells around it.
START = np.array(
    [
        [0, 1, 2, 3, 7, 11, 15, 19],
        [3, 1, 2, INFINITE, 17, 8, 12, 0],
        [0, 3, 2, INFINITE, 5, 16, 13, 1],
        [0, 1, 3, INFINITE, 6, 10, 18, 2],
        [1, 0, 2, INFINITE, 9, 4, 14, 3],
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
def _at(row: int, column: int) -> np.uint64:
    """Return where a mesh has a column of a row; unsigned, so that numba does not look for a negative one."""
    return np.uint64(8 * np.int64(row) + column)


@njit(cache=True, nogil=True, forceinline=True)
def _vertices(mesh: np.ndarray, t: int) -> tuple:
    """Return the vertices of cell t, int64."""
    a, b, c, d = mesh[_at(t, 0)], mesh[_at(t, 1)], mesh[_at(t, 2)], mesh[_at(t, 3)]
    return np.int64(a), np.int64(b), np.int64(c), np.int64(d)


@njit(cache=True, nogil=True, forceinline=True)
def _copy(source: np.ndarray, row: int, target: np.ndarray, to: int) -> None:
    """Copy a row's vertices."""
    a, b, c, d = source[_at(row, 0)], source[_at(row, 1)], source[_at(row, 2)], source[_at(row, 3)]
    target[_at(to, 0)], target[_at(to, 1)], target[_at(to, 2)], target[_at(to, 3)] = a, b, c, d


@njit(cache=True, nogil=True, forceinline=True)
def _insphere_lanes(lanes: np.ndarray, tests: int, x: float, y: float, z: float) -> None:
    """Evaluate insphere_of for `tests` tests IN PLACE, four at a time: compiled to vector instructions.

    lanes: 14 rows of 64; column k of row r is the r-th difference of test k, from row 12 on value and bound.
    """
    row = np.uint64(64)
    for k in range((tests + 3) & ~3):
        a = np.uint64(k)
        b, c, d = a + 3 * row, a + 6 * row, a + 9 * row
        lanes[a + 12 * row], lanes[a + 13 * row] = insphere_of(
            (
                *(lanes[a] - x, lanes[a + row] - y, lanes[a + 2 * row] - z),
                *(lanes[b] - x, lanes[b + row] - y, lanes[b + 2 * row] - z),
                *(lanes[c] - x, lanes[c + row] - y, lanes[c + 2 * row] - z),
                *(lanes[d] - x, lanes[d + row] - y, lanes[d + 2 * row] - z),
            )
        )


@njit(cache=True, nogil=True, forceinline=True)
def _in_conflict(points: np.ndarray, mesh: np.ndarray, t: int, p: int, ws: np.ndarray) -> bool:
    """Return whether p destroys cell t: p inside its sphere, or, for an infinite cell, beyond its triangle.

    In the plane of the triangle, inside its circle: that is where the plane meets the inner cell's sphere.
    """
    a, b, c, d = _vertices(mesh, t)
    if d == INFINITE:
        side = orient3d(points, a, b, c, p, ws)
        if side != 0.0:
            return side > 0.0
        a, b, c, d = _vertices(mesh, mesh[_at(t, 7)] >> 2)
    return insphere(points, a, b, c, d, p, ws) > 0.0


@njit(cache=True, nogil=True, forceinline=True)
def _locate(points: np.ndarray, mesh: np.ndarray, t: int, p: int, ws: np.ndarray) -> int:
    """Walk from cell t; return the finite cell that contains p, or an infinite one p lies beyond."""
    if mesh[_at(t, 3)] == INFINITE:
        t = mesh[_at(t, 7)] >> 2
    came = -1
    while mesh[_at(t, 3)] != INFINITE:
        following = -1
        for i in range(4):
            if i == came:
                continue
            a, b = np.int64(mesh[_at(t, FACE[i, 0])]), np.int64(mesh[_at(t, FACE[i, 1])])
            c = np.int64(mesh[_at(t, FACE[i, 2])])
            side, bound = orient3d_filter(points, a, b, c, p)
            if abs(side) <= bound:
                side = orient3d_exact(points, a, b, c, p, ws)
            if side < 0.0:
                following = np.int64(mesh[_at(t, 4 + i)])
                break
        if following < 0:
            return t
        t, came = following >> 2, following & 3
    return t


@njit(cache=True, nogil=True)
def _insert(points: np.ndarray, mesh: np.ndarray, mark: np.ndarray, state: np.ndarray, room: int) -> None:
    """Insert points IN PLACE from number state[0] on, until all are in or there is no room for the next.

    state: next point, used rows of the mesh, first unused row (its column 4 has the next, or -1), last cell,
    duplicates, last mark. room: for the cells of a cavity.

    No array gets another name in here: numba would count references in every step, with a memory fence each.
    """
    n, flat = len(points), points.reshape(-1)
    p, used, free, last, duplicates, stamp = state[0], state[1], state[2], state[3], state[4], state[5]
    ws, lanes, tested = np.empty(WORKSPACE), np.zeros(14 * 64), np.empty(64, dtype=np.int32)
    cavity, rim = np.empty(room, dtype=np.int32), np.empty(8 * (2 * room + 8), dtype=np.int32)
    places, beyond = np.empty(2 * room + 8, dtype=np.int32), np.empty(2 * room + 8, dtype=np.int32)
    while p < n:
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        first = _locate(points, mesh, last, p, ws)
        known = False
        for i in range(4):
            v = np.int64(mesh[_at(first, i)])  # INFINITE counts from the end and is not looked at
            known |= points[v, 0] == x and points[v, 1] == y and points[v, 2] == z
        if known and mesh[_at(first, 3)] != INFINITE:
            duplicates += 1
            last = first
            p += 1
            continue
        # The cavity: all cells in conflict, connected. The neighbours of sixteen cells are tested together.
        stamp += 2
        inside, outside = np.int32(stamp), np.int32(stamp + 1)
        cavity[0] = first
        mark[np.uint64(first)] = inside
        count, done = 1, 0
        while done < count and count + 64 <= room:
            tests, begin = 0, done
            done = min(count, begin + 16)
            for k in range(begin, done):
                for i in range(4):
                    other = np.uint64(mesh[_at(cavity[np.uint64(k)], 4 + i)] >> 2)
                    tested[np.uint64(tests)] = other
                    tests += mark[other] < inside
                    mark[other] = outside - (mark[other] == inside)
            for k in range(tests):
                for i in range(4):
                    v = np.int64(mesh[_at(tested[np.uint64(k)], i)])
                    v = np.uint64(3 * v * (v > 0))
                    place = np.uint64(k + 192 * i)
                    lanes[place] = flat[v]
                    lanes[place + np.uint64(64)] = flat[v + np.uint64(1)]
                    lanes[place + np.uint64(128)] = flat[v + np.uint64(2)]
            _insphere_lanes(lanes, tests, x, y, z)
            for k in range(tests):
                other, value = np.uint64(tested[np.uint64(k)]), lanes[np.uint64(12 * 64 + k)]
                conflict = value > 0.0
                if abs(value) <= lanes[np.uint64(13 * 64 + k)] or mesh[_at(other, 3)] == INFINITE:
                    conflict = _in_conflict(points, mesh, np.int64(other), p, ws)
                mark[other] = outside - conflict
                cavity[np.uint64(count)] = other
                count += conflict
        if done < count or 8 * (used + count + 2) > len(mesh):
            break
        # Its rim: triangle f, opposite place i of cell t, makes a new cell with p; ~f stands there.
        faces = 0
        for k in range(count):
            for i in range(4):
                code = 4 * cavity[np.uint64(k)] + i
                places[np.uint64(faces)] = code
                faces += mark[np.uint64(mesh[_at(code >> 2, 4 + i)] >> 2)] == outside
        for f in range(faces):
            code = places[np.uint64(f)]
            _copy(mesh, code >> 2, rim, f)
            for j in range(4, 8):
                rim[_at(f, j)] = -1
            there = _at(code >> 2, 4 + (code & 3))
            beyond[np.uint64(f)], mesh[there] = mesh[there], ~np.int32(f)
            rim[_at(f, code & 3)], rim[_at(f, 4 + (code & 3))] = p, 0
        # New cells with a common edge of the rim are neighbours: the old cells around it lead there.
        for f in range(faces):
            for j in range(4):
                if rim[_at(f, 4 + j)] < 0:
                    t, entry, leave = places[np.uint64(f)] >> 2, places[np.uint64(f)] & 3, j
                    code = mesh[_at(t, 4 + leave)]
                    while code >= 0:
                        opposite, t, entry, leave = mesh[_at(t, entry)], code >> 2, code & 3, 0
                        for k in range(1, 4):
                            leave += k * (mesh[_at(t, k)] == opposite)
                        code = mesh[_at(t, 4 + leave)]
                    rim[_at(f, 4 + j)], rim[_at(~code, 4 + entry)] = 4 * ~code + entry, 4 * f + j
        for k in range(count):
            t = np.int64(cavity[np.uint64(k)])
            mesh[_at(t, 0)], mesh[_at(t, 4)] = DEAD, free
            free = t
        for f in range(faces):
            t = used if free < 0 else free
            places[np.uint64(f)] = 4 * t + (places[np.uint64(f)] & 3)
            if free < 0:
                used += 1
            else:
                free = np.int64(mesh[_at(t, 4)])
        for f in range(faces):
            code, out = places[np.uint64(f)], beyond[np.uint64(f)]
            _copy(rim, f, mesh, code >> 2)
            for j in range(4):
                mate = rim[_at(f, 4 + j)]
                mesh[_at(code >> 2, 4 + j)] = 4 * (places[np.uint64(mate >> 2)] >> 2) + (mate & 3)
            mesh[_at(code >> 2, 4 + (code & 3))], mesh[_at(out >> 2, 4 + (out & 3))] = out, code
        last = np.int64(places[np.uint64(faces - 1)] >> 2)
        p += 1
    state[0], state[1], state[2], state[3], state[4], state[5] = p, used, free, last, duplicates, stamp


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
    rows, room = 9 * n + 64, 256
    mesh, mark = grown(START.reshape(-1), 8 * rows), np.zeros(rows, dtype=np.int32)
    state = np.array([4, 5, -1, 0, 0, 0])
    while True:
        _insert(points, mesh, mark, state, room)
        if state[0] == n:
            return mesh[: 8 * state[1]].reshape(-1, 8), n - state[4]
        room *= 2
        if state[1] + room > rows:
            rows = 2 * rows + room
            mesh, mark = grown(mesh, 8 * rows), np.zeros(rows, dtype=np.int32)  # all marks so far are old


@njit(cache=True, nogil=True)
def finite_cells(mesh: np.ndarray, rank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the finite cells (m, 4) int32 of `triangulate` and their neighbours (m, 4) int32, -1 outside.

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
                neighbours[number[t], i] = number[mesh[t, 4 + i] >> 2]
    return cells, neighbours
