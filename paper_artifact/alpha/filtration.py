"""The alpha filtration on a Delaunay triangulation: triangles, edges, every simplex's squared radius.

A tetrahedron has its squared circumradius; a triangle or edge its own if it is Gabriel (no coface's opposite
vertex strictly inside its smallest circumsphere; decided exactly), else the smallest value of its cofaces. A
value never exceeds a coface's.

Accuracy: float64 for a well-shaped simplex, judged by its determinant; double-doubles for a flat one; exact
expansions for one flat beyond that. Squared radii carry a relative error below 1e-10, mostly 1e-15.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.alpha.expansions import WORKSPACE, Formula, evaluate, exact, recorded
from paper_artifact.alpha.predicates import edge_exact, edge_filter, triangle_exact, triangle_filter
from paper_artifact.kernel_cache import njit

# Relative determinants below which a circumradius is evaluated in double-doubles (the error in float64 is at
# most 1e-15 / FLAT), and in exact expansions (in double-doubles at most 1e-30 / FLATTER).
FLAT, FLATTER = 1e-4, 1e-18


def _circumcentre(formula: Formula, u: tuple, v: tuple, w: tuple) -> list[int]:
    """Return the registers of N = |u|²(v x w) + |v|²(w x u) + |w|²(u x v) of a tetrahedron.

    N is twice the determinant u·(v x w), the last step, times the vector to the circumcentre.
    """
    vw, wu, uv = formula.cross(v, w), formula.cross(w, u), formula.cross(u, v)
    lengths = (formula.dot(u, u), formula.dot(v, v), formula.dot(w, w))
    centre = [formula.dot(lengths, (vw[k], wu[k], uv[k])) for k in range(3)]
    formula.dot(u, vw)
    return centre


TETRAHEDRON, CENTRE = recorded(3, _circumcentre)
TRIANGLE, NORMAL = recorded(2, Formula.cross)


@njit(cache=True, nogil=True, forceinline=True)
def tetrahedron_filter(points: np.ndarray, a: int, b: int, c: int, d: int) -> float:
    """Return the squared circumradius of the rows a to d, inf when it overflows; -(|u||v||w|)² if flat."""
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
    return -uu * vv * ww


@njit(cache=True, nogil=True)
def flat_tetrahedron_value(
    points: np.ndarray, a: int, b: int, c: int, d: int, unit: float, ws: np.ndarray
) -> float:
    """Return the squared circumradius by double-doubles or, where det² < FLATTER² unit, exactly."""
    values = np.empty((9 + len(TETRAHEDRON), 2))
    rows = np.array([b, c, d, a])
    det = evaluate(points, rows, TETRAHEDRON, values)
    if det * det < FLATTER * FLATTER * unit:
        det = exact(points, rows, TETRAHEDRON, ws, values)
    half = 0.5 / det
    x, y, z = values[CENTRE[0], 0] * half, values[CENTRE[1], 0] * half, values[CENTRE[2], 0] * half
    return x * x + y * y + z * z


@njit(cache=True, nogil=True, forceinline=True)
def triangle_sides(points: np.ndarray, a: int, b: int, c: int) -> tuple[float, float, float]:
    """Return |u|²|v|², |u x v|² and |w|² of a triangle with the sides u, v, w, given by row indices."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    wx, wy, wz = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1], points[c, 2] - points[b, 2]
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return uu * vv, x * x + y * y + z * z, ww


@njit(cache=True, nogil=True)
def flat_triangle_area(points: np.ndarray, a: int, b: int, c: int, unit: float, ws: np.ndarray) -> float:
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
def faces(cells: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (k, 3) of (m, 4) cells and the cells beside them (k, 2), -1 outside; int32."""
    hull = 0
    for t in range(len(cells)):
        for i in range(4):
            hull += neighbours[t, i] < 0
    count = (4 * len(cells) + hull) // 2
    triangles, sides = np.empty((count, 3), dtype=np.int32), np.empty((count, 2), dtype=np.int32)
    k = 0
    for t in range(len(cells)):
        for i in range(4):
            if not 0 <= neighbours[t, i] < t:
                place = 0
                for j in range(4):
                    if j != i:
                        triangles[k, place] = cells[t, j]
                        place += 1
                sides[k, 0], sides[k, 1] = t, neighbours[t, i]
                k += 1
    return triangles, sides


@njit(cache=True, nogil=True)
def edges_of(triangles: np.ndarray, vertex_count: int, edge_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the edge opposite each corner (k, 3) and edges (edge_count, 2), as many as Euler says; int32."""
    table = 1024
    while table < 2 * edge_count:
        table *= 2
    near = table // vertex_count  # an edge is looked for near its first vertex: that is in the cache
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
            place, tries = (u * near + np.int64(mixed >> np.uint64(54))) & (table - 1), 0
            while slots[place] >= 0 and (edges[slots[place], 0] != u or edges[slots[place], 1] != v):
                tries += 1
                place = (place + 1 if tries != 32 else np.int64(mixed >> np.uint64(32))) & (table - 1)
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
def values(points: np.ndarray, simplices: tuple, of_triangle: np.ndarray, sides: np.ndarray) -> tuple:
    """Return the squared radii of edges (e,), triangles (k,), cells (m,); float64, of the points' unit.

    simplices: edges, triangles, cells; of_triangle: of edges_of; sides: of faces.
    """
    edges, triangles, cells = simplices
    ws = np.empty(WORKSPACE)
    m, k, e = len(cells), len(triangles), len(edges)
    cell_values, triangle_values, edge_values = np.empty(m), np.empty(k), np.full(e, np.inf)
    for t in range(m):
        a, b, c = np.int64(cells[t, 0]), np.int64(cells[t, 1]), np.int64(cells[t, 2])
        d = np.int64(cells[t, 3])
        cell_values[t] = tetrahedron_filter(points, a, b, c, d)
        if not cell_values[t] > 0.0:
            cell_values[t] = flat_tetrahedron_value(points, a, b, c, d, -cell_values[t], ws)
    edge_gabriel = np.ones(e, dtype=np.bool_)
    for f in range(k):
        a, b, c = np.int64(triangles[f, 0]), np.int64(triangles[f, 1]), np.int64(triangles[f, 2])
        inner = np.int64(sides[f, 0])
        outer = np.int64(sides[f, 1]) if sides[f, 1] >= 0 else inner
        d, e = _apex(cells, inner, a, b, c), _apex(cells, outer, a, b, c)
        # All signs first: without a branch between them the processor overlaps them.
        in_d, d_bound = triangle_filter(points, a, b, c, d)
        in_e, e_bound = triangle_filter(points, a, b, c, e)
        in_a, a_bound = edge_filter(points, b, c, a)
        in_b, b_bound = edge_filter(points, c, a, b)
        in_c, c_bound = edge_filter(points, a, b, c)
        unit, area, third = triangle_sides(points, a, b, c)
        if abs(in_d) <= d_bound:
            in_d = triangle_exact(points, a, b, c, d, ws)
        if abs(in_e) <= e_bound:
            in_e = triangle_exact(points, a, b, c, e, ws)
        if abs(in_a) <= a_bound:
            in_a = edge_exact(points, b, c, a, ws)
        if abs(in_b) <= b_bound:
            in_b = edge_exact(points, c, a, b, ws)
        if abs(in_c) <= c_bound:
            in_c = edge_exact(points, a, b, c, ws)
        if area <= FLAT * FLAT * unit:
            area = flat_triangle_area(points, a, b, c, unit, ws)
        value = min(cell_values[inner], cell_values[outer])
        if in_d >= 0.0 and in_e >= 0.0:
            value = min(unit / area * third / 4.0, value)
        triangle_values[f] = value
        for i in range(3):
            edge = of_triangle[f, i]
            edge_gabriel[edge] &= (in_a, in_b, in_c)[i] >= 0.0
            edge_values[edge] = min(edge_values[edge], value)
    _own_edge_values(points, edges, edge_gabriel, edge_values)
    return edge_values, triangle_values, cell_values


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
    points: np.ndarray, triangles: np.ndarray, edges: np.ndarray, of_triangle: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the squared radii of edges (e,) and triangles (k,) of a planar Delaunay triangulation, and the
    triangles beside each edge (e, 2) int32, -1 outside the hull.
    """
    k, e = len(triangles), len(edges)
    ws, triangle_values, edge_values = np.empty(WORKSPACE), np.empty(k), np.full(e, np.inf)
    gabriel, sides = np.ones(e, dtype=np.bool_), np.full((e, 2), np.int32(-1))
    for f in range(k):
        a, b, c = np.int64(triangles[f, 0]), np.int64(triangles[f, 1]), np.int64(triangles[f, 2])
        unit, area, third = triangle_sides(points, a, b, c)
        if area <= FLAT * FLAT * unit:
            area = flat_triangle_area(points, a, b, c, unit, ws)
        triangle_values[f] = unit / area * third / 4.0
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
    return edge_values, triangle_values, sides
