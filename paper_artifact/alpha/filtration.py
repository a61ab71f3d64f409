"""The alpha filtration on a Delaunay triangulation: triangles, edges, every simplex's squared radius.

A tetrahedron has its squared circumradius; a triangle or edge its own if it is Gabriel (no coface's opposite
vertex strictly inside its smallest circumsphere; decided exactly), else the smallest value of its cofaces. A
value never exceeds a coface's.

Accuracy: float64 for a well-shaped simplex, judged by its determinant; double-doubles for a flat one; exact
expansions for one flat beyond that. Squared radii carry a relative error below 1e-10, mostly 1e-15.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.alpha.expansions import Formula, evaluate, exact
from paper_artifact.alpha.predicates import edge_exact, edge_filter, triangle_exact, triangle_filter
from paper_artifact.kernel_cache import njit

# Relative determinants below which a circumradius is evaluated in double-doubles (the error in float64 is at
# most 1e-15 / FLAT), and in exact expansions (in double-doubles at most 1e-30 / FLATTER).
FLAT, FLATTER = 1e-4, 1e-18


def _circumcentre() -> tuple[np.ndarray, np.ndarray]:
    """Return the steps for a tetrahedron with difference vectors u, v, w, and the registers of
    N = |u|²(v x w) + |v|²(w x u) + |w|²(u x v), twice the determinant times the vector to the circumcentre.

    The determinant u·(v x w) is the last step.
    """
    formula = Formula(3)
    u, v, w = formula.inputs
    vw, wu, uv = formula.cross(v, w), formula.cross(w, u), formula.cross(u, v)
    lengths = (formula.dot(u, u), formula.dot(v, v), formula.dot(w, w))
    centre = [formula.dot(lengths, (vw[k], wu[k], uv[k])) for k in range(3)]
    formula.dot(u, vw)
    return formula.steps(), np.array(centre, dtype=np.int64)


def _normal() -> tuple[np.ndarray, np.ndarray]:
    """Return the steps for a triangle with difference vectors u, v, and the registers of u x v."""
    formula = Formula(2)
    normal = formula.cross(*formula.inputs)
    return formula.steps(), np.array(normal, dtype=np.int64)


TETRAHEDRON, CENTRE = _circumcentre()
TRIANGLE, NORMAL = _normal()


@njit(cache=True, nogil=True, forceinline=True)
def tetrahedron_value(points: np.ndarray, a: int, b: int, c: int, d: int, ws: np.ndarray) -> float:
    """Return the squared circumradius of a tetrahedron, not exactly flat, given by row indices.

    Infinite when it overflows.
    """
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    wx, wy, wz = points[d, 0] - points[a, 0], points[d, 1] - points[a, 1], points[d, 2] - points[a, 2]
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    px, py, pz = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
    det = ux * px + uy * py + uz * pz
    if det * det > FLAT * FLAT * uu * vv * ww:
        x = uu * px + vv * (wy * uz - wz * uy) + ww * (uy * vz - uz * vy)
        y = uu * py + vv * (wz * ux - wx * uz) + ww * (uz * vx - ux * vz)
        z = uu * pz + vv * (wx * uy - wy * ux) + ww * (ux * vy - uy * vx)
        return (x * x + y * y + z * z) / (4.0 * det * det)
    return _flat_tetrahedron_value(points, a, b, c, d, uu * vv * ww, ws)


@njit(cache=True, nogil=True)
def _flat_tetrahedron_value(
    points: np.ndarray, a: int, b: int, c: int, d: int, unit: float, ws: np.ndarray
) -> float:
    """Return what tetrahedron_value does, by double-doubles or, where det² < FLATTER² unit, exactly."""
    values = np.empty((9 + len(TETRAHEDRON), 2))
    rows = np.array([b, c, d, a])
    det = evaluate(points, rows, TETRAHEDRON, values)
    if det * det < FLATTER * FLATTER * unit:
        det = exact(points, rows, TETRAHEDRON, ws, values)
    half = 0.5 / det
    x, y, z = values[CENTRE[0], 0] * half, values[CENTRE[1], 0] * half, values[CENTRE[2], 0] * half
    return x * x + y * y + z * z


@njit(cache=True, nogil=True, forceinline=True)
def triangle_value(points: np.ndarray, a: int, b: int, c: int, ws: np.ndarray) -> float:
    """Return the squared circumradius of a triangle, not exactly collinear, given by row indices."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    wx, wy, wz = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1], points[c, 2] - points[b, 2]
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = x * x + y * y + z * z
    if area <= FLAT * FLAT * uu * vv:
        area = _flat_triangle_area(points, a, b, c, uu * vv, ws)
    return uu * vv / area * ww / 4.0


@njit(cache=True, nogil=True)
def _flat_triangle_area(points: np.ndarray, a: int, b: int, c: int, unit: float, ws: np.ndarray) -> float:
    """Return |u x v|² by double-doubles or, below FLATTER² unit, exactly."""
    values = np.empty((6 + len(TRIANGLE), 2))
    rows = np.array([b, c, a])
    evaluate(points, rows, TRIANGLE, values)
    area = values[NORMAL[0], 0] ** 2 + values[NORMAL[1], 0] ** 2 + values[NORMAL[2], 0] ** 2
    if area < FLATTER * FLATTER * unit:
        exact(points, rows, TRIANGLE, ws, values)
        area = values[NORMAL[0], 0] ** 2 + values[NORMAL[1], 0] ** 2 + values[NORMAL[2], 0] ** 2
    return area


@njit(cache=True, nogil=True)
def faces(cells: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (cell_triangles, triangles, sides) of (m, 4) cells, all int32.

    cell_triangles (m, 4): the triangle opposite each vertex; triangles (k, 3): vertices; sides (k, 2): the
    cells on both sides, -1 outside the hull.
    """
    m = len(cells)
    hull = 0
    for t in range(m):
        for i in range(4):
            if neighbours[t, i] < 0:
                hull += 1
    count = (4 * m + hull) // 2
    of_cell = np.empty((m, 4), dtype=np.int32)
    triangles = np.empty((count, 3), dtype=np.int32)
    sides = np.empty((count, 2), dtype=np.int32)
    k = 0
    for t in range(m):
        for i in range(4):
            other = neighbours[t, i]
            if 0 <= other < t:
                for j in range(4):
                    if neighbours[other, j] == t:
                        of_cell[t, i] = of_cell[other, j]
                continue
            of_cell[t, i] = k
            place = 0
            for j in range(4):
                if j != i:
                    triangles[k, place] = cells[t, j]
                    place += 1
            sides[k, 0], sides[k, 1] = t, other
            k += 1
    return of_cell, triangles, sides


@njit(cache=True, nogil=True)
def edges_of(triangles: np.ndarray, vertex_count: int, edge_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (triangle_edges (k, 3): edge opposite each corner; edges (edge_count, 2): vertices), int32.

    edge_count is exact (Euler).
    """
    table = 1024
    while table < 2 * edge_count:
        table *= 2
    slots = np.full(table, np.int32(-1))
    edges = np.empty((edge_count, 2), dtype=np.int32)
    of_triangle = np.empty((len(triangles), 3), dtype=np.int32)
    found = 0
    for k in range(len(triangles)):
        for i in range(3):
            u, v = triangles[k, (i + 1) % 3], triangles[k, (i + 2) % 3]
            if u > v:
                u, v = v, u
            mixed = (np.uint64(u) * np.uint64(vertex_count) + np.uint64(v)) * np.uint64(0x9E3779B97F4A7C15)
            place = np.int64(mixed >> np.uint64(32)) & (table - 1)
            while slots[place] >= 0 and (edges[slots[place], 0] != u or edges[slots[place], 1] != v):
                place = (place + 1) & (table - 1)
            if slots[place] < 0:
                slots[place] = found
                edges[found, 0], edges[found, 1] = u, v
                found += 1
            of_triangle[k, i] = slots[place]
    return of_triangle, edges


@njit(cache=True, nogil=True, forceinline=True)
def _apex(cells: np.ndarray, t: int, a: int, b: int, c: int) -> int:
    """Return the vertex of cell t that is not a, b or c."""
    return np.int64(cells[t, 0]) + cells[t, 1] + cells[t, 2] + cells[t, 3] - a - b - c


@njit(cache=True, nogil=True)
def _open_sign(
    points: np.ndarray, a: int, b: int, c: int, i: int, cells: np.ndarray, sides: np.ndarray, ws: np.ndarray
) -> float:
    """Return a number with the right sign for the i-th test of `values` at triangle (a, b, c)."""
    if i < 2:
        return triangle_exact(points, a, b, c, _apex(cells, np.int64(sides[i]), a, b, c), ws)
    if i == 2:
        return edge_exact(points, b, c, a, ws)
    if i == 3:
        return edge_exact(points, c, a, b, ws)
    return edge_exact(points, a, b, c, ws)


@njit(cache=True, nogil=True)
def values(
    points: np.ndarray,
    cells: np.ndarray,
    triangles: np.ndarray,
    sides: np.ndarray,
    of_cell: np.ndarray,
    edges: np.ndarray,
    of_triangle: np.ndarray,
    ws: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the squared radii of cells (m,), triangles (k,) and edges (e,), float64, unit of `points`
    squared.
    """
    m, k, e = len(cells), len(triangles), len(edges)
    cell_values, triangle_values, edge_values = np.empty(m), np.empty(k), np.full(e, np.inf)
    for t in range(m):
        a, b, c = np.int64(cells[t, 0]), np.int64(cells[t, 1]), np.int64(cells[t, 2])
        cell_values[t] = tetrahedron_value(points, a, b, c, np.int64(cells[t, 3]), ws)
    edge_gabriel = np.ones(e, dtype=np.bool_)
    signs, bounds = np.empty(5), np.empty(5)
    for f in range(k):
        a, b, c = np.int64(triangles[f, 0]), np.int64(triangles[f, 1]), np.int64(triangles[f, 2])
        inner, other = np.int64(sides[f, 0]), np.int64(sides[f, 1])
        # All signs first: without a branch between them the processor overlaps them.
        signs[0], bounds[0] = triangle_filter(points, a, b, c, _apex(cells, inner, a, b, c))
        signs[1], bounds[1] = 1.0, 0.0  # no cell outside the hull: nothing is in the sphere
        if other >= 0:
            signs[1], bounds[1] = triangle_filter(points, a, b, c, _apex(cells, other, a, b, c))
        signs[2], bounds[2] = edge_filter(points, b, c, a)
        signs[3], bounds[3] = edge_filter(points, c, a, b)
        signs[4], bounds[4] = edge_filter(points, a, b, c)
        own = triangle_value(points, a, b, c, ws)
        least = cell_values[inner] if other < 0 else min(cell_values[inner], cell_values[other])
        for i in range(5):
            if abs(signs[i]) <= bounds[i]:
                signs[i] = _open_sign(points, a, b, c, i, cells, sides[f], ws)
        value = min(own, least) if signs[0] >= 0.0 and signs[1] >= 0.0 else least
        triangle_values[f] = value
        for i in range(3):
            edge = of_triangle[f, i]
            edge_gabriel[edge] &= signs[2 + i] >= 0.0
            edge_values[edge] = min(edge_values[edge], value)
    _own_edge_values(points, edges, edge_gabriel, edge_values)
    return cell_values, triangle_values, edge_values


@njit(cache=True, nogil=True)
def _own_edge_values(points: np.ndarray, edges: np.ndarray, gabriel: np.ndarray, values: np.ndarray) -> None:
    """Set the values of Gabriel edges to their own, IN PLACE, never above a coface's."""
    for i in range(len(edges)):
        if gabriel[i]:
            a, b = edges[i, 0], edges[i, 1]
            x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
            values[i] = min((x * x + y * y + z * z) / 4.0, values[i])


@njit(cache=True, nogil=True)
def planar_values(
    points: np.ndarray, triangles: np.ndarray, edges: np.ndarray, of_triangle: np.ndarray, ws: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the squared radii of triangles (k,) and edges (e,) of a planar Delaunay triangulation, and the
    triangles beside each edge (e, 2) int32, -1 outside the hull.
    """
    k, e = len(triangles), len(edges)
    triangle_values, edge_values = np.empty(k), np.full(e, np.inf)
    gabriel, sides = np.ones(e, dtype=np.bool_), np.full((e, 2), np.int32(-1))
    for f in range(k):
        a, b, c = np.int64(triangles[f, 0]), np.int64(triangles[f, 1]), np.int64(triangles[f, 2])
        triangle_values[f] = triangle_value(points, a, b, c, ws)
        for i in range(3):
            edge = of_triangle[f, i]
            sign, bound = edge_filter(points, b, c, a)
            if abs(sign) <= bound:
                sign = edge_exact(points, b, c, a, ws)
            gabriel[edge] &= sign >= 0.0
            edge_values[edge] = min(edge_values[edge], triangle_values[f])
            sides[edge, 0 if sides[edge, 0] < 0 else 1] = f
            a, b, c = b, c, a
    _own_edge_values(points, edges, gabriel, edge_values)
    return triangle_values, edge_values, sides
