"""The alpha complex and its pairs: triangulation, filtration and reduction, one after the other.

A cloud in space is triangulated by tetrahedra. A cloud in one plane (every (n, 2) cloud) is triangulated as
the base of a cone: with one more point off the plane, the tetrahedra are the plane's Delaunay triangles, each
joined to that point, and the same exact predicates decide. A cloud on one line is sorted along it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from paper_artifact.alpha import delaunay, filtration, ordering, reduction
from paper_artifact.kernel_cache import njit

# Two squared radii closer than this, relative to the larger, are one value: rounding is about 1e-15.
ROUNDING = 1e-12
Stage = Callable[[str], None]
Bars = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # squared births and deaths, simplices of both


@dataclass(eq=False)
class Complex:
    """Simplices and their SQUARED radii, in units of 2^(2 exponent). Vertices run along the Hilbert curve."""

    exponent: int  # points = 2^exponent × the scaled points that the values belong to
    names: np.ndarray  # (n,) int32: the row of the points that each vertex was given in
    simplices: list[np.ndarray]  # of dimension d = 0 to 3: (k,d+1) int32 vertices
    values: list[np.ndarray]  # of dimension d: (k,) float64
    of_triangle: np.ndarray  # (k,3) int32: the edge opposite each corner
    sides: np.ndarray  # (k,2) int32: cells beside a triangle; without cells (e,2): triangles beside an edge


def build(points: np.ndarray, begin: Stage) -> Complex:
    """Return the alpha complex of `points` (n,3) or (n,2) float64, finite. begin: called with each stage."""
    begin("delaunay")
    n = len(points)
    points = points if points.shape[1] == 3 else np.column_stack([points, np.zeros(n)])
    scaled, exponent = ordering.normalised(points)
    places = ordering.hilbert_indices(scaled) if n else np.zeros(0, dtype=np.uint64)
    order = ordering.insertion_order(places)
    ordered = np.ascontiguousarray(scaled[order])
    found = delaunay.first_simplex(ordered, order)
    if found < 3:
        return _on_a_line(ordered, order, exponent, begin)
    if found == 3:  # cone over the plane: one of three directions leads out of it
        ordered, order = _coned(ordered, order)
    mesh, distinct = delaunay.triangulate(ordered)
    along = ordering.sort_keys(np.append(places, np.uint64(2**63))[order])  # an apex is the last vertex, n
    rank = np.empty_like(along)
    rank[along] = np.arange(len(along), dtype=np.int32)
    cells, neighbours = delaunay.finite_cells(mesh, rank)
    cloud, names = np.ascontiguousarray(ordered[along[:n]]), order[along[:n]]
    del scaled, ordered, mesh, rank, along  # the largest arrays: a million points need their room
    begin("filtration")
    if found == 3:
        triangles = np.ascontiguousarray(cells[cells != n].reshape(-1, 3))
        cells = np.zeros((0, 4), dtype=np.int32)
        of_triangle, edges = filtration.edges_of(triangles, n, distinct - 1 + len(triangles) - 1)  # a disc
        *values, sides = filtration.planar_values(cloud, triangles, edges, of_triangle)
        values.append(np.zeros(0))
    else:
        triangles, sides = filtration.faces(cells, neighbours)
        del neighbours
        edge_count = distinct + len(triangles) - len(cells) - 1  # a ball
        of_triangle, edges = filtration.edges_of(triangles, n, edge_count)
        values = filtration.values(cloud, (edges, triangles, cells), of_triangle, sides)
    simplices = [np.arange(n, dtype=np.int32)[:, None], edges, triangles, cells]
    return Complex(exponent, names, simplices, [np.zeros(n), *values], of_triangle, sides)


def _coned(ordered: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points and order with a point off their plane in row 3; its number is n."""
    for axis in np.eye(3):
        coned = np.ascontiguousarray(np.insert(ordered, 3, ordered[0] + axis, axis=0))
        names = np.insert(order, 3, len(order)).astype(np.int32)
        if delaunay.first_simplex(coned[:4], names[:4]) == 4:
            return coned, names
    raise AssertionError("three independent directions lie in one plane")


def _on_a_line(ordered: np.ndarray, order: np.ndarray, exponent: int, begin: Stage) -> Complex:
    """Return the complex of points on one line: edges between neighbours."""
    axis = int(np.ptp(ordered, axis=0).argmax()) if len(ordered) else 0
    along = np.argsort(ordered[:, axis], kind="stable")
    points = ordered[along]
    first = np.ones(len(points), dtype=bool)
    first[1:] = (points[1:] != points[:-1]).any(axis=1)
    places = np.flatnonzero(first).astype(np.int32)
    begin("filtration")
    x, y, z = (points[places[1:]] - points[places[:-1]]).T
    edges = np.column_stack([places[:-1], places[1:]])
    two, three, four = (np.zeros((0, columns), dtype=np.int32) for columns in (2, 3, 4))
    values = [np.zeros(len(points)), (x * x + y * y + z * z) / 4.0, np.zeros(0), np.zeros(0)]
    simplices = [np.arange(len(points), dtype=np.int32)[:, None], edges, three, four]
    return Complex(exponent, order[along], simplices, values, three, two)


def squared_bars(made: Complex, top: int, names: np.ndarray) -> list[Bars]:
    """Return the bars of dimensions 0 to `top` (at most 2); none above a flat cloud's own dimension.

    names (n,) int32: of the vertices, in the bars. The complex is used up: a million points need the room.
    """
    solid = top > 0 and len(made.simplices[3]) > 0
    made.simplices[2] = np.zeros((0, 3), dtype=np.int32)
    if solid:
        state, parents = reduction.apparent_voids(made.values[3], made.values[2], made.sides)
        apparent = reduction.apparent_loops(made.values[2], made.values[1], made.of_triangle, state)
        left = np.flatnonzero(state == reduction.OPEN).astype(np.int32)
        left = left[reduction.increasing(made.values[2][left])]
        pairs = reduction.voids(made.sides[left], left, made.values[3], parents, state)
        del made.sides, parents
        voids = _bars(made, 2, pairs, names)
        del made.simplices[3], made.values[3], pairs
    order = reduction.increasing(made.values[1])
    pairs = order[apparent[order] < 0] if solid else order  # an apparent pair's edge closes a loop
    *pairs, merges = reduction.components(made.simplices[1][pairs], pairs, len(made.names), len(order))
    found = [_bars(made, 0, pairs, names)]
    if solid:
        left = left[state[left] != reduction.CLOSES]
        order = order[~merges[order]]
        pairs = reduction.loops(made.of_triangle, left, order, apparent)
        del left, state, order, merges, apparent
        found += [_bars(made, 1, pairs, names), voids]
    elif top > 0 and len(made.values[2]):  # in a plane, edges that close a loop and triangles are dual to H0
        parents = np.arange(len(made.values[2]) + 1, dtype=np.int32)
        state = np.zeros(len(order), dtype=np.int8)
        pairs = reduction.voids(made.sides[order], order, made.values[2], parents, state)
        found.append(_bars(made, 1, pairs, names))
    return found[: top + 1]


def _bars(made: Complex, dimension: int, pairs: Sequence[np.ndarray], names: np.ndarray) -> Bars:
    """Return the lasting bars of `pairs`: rows (r,) int32 of the simplices that bear and end it."""
    births, deaths = (made.values[dimension + i][pairs[i]] for i in (0, 1))
    keep = lasting(births, deaths)
    simplices = []
    for at, rows in enumerate(pairs, dimension):
        rows = rows[keep]
        found = _corners(made.simplices[1], made.of_triangle, rows) if at == 2 else made.simplices[at][rows]
        simplices.append(named(found, names))
    return births[keep], deaths[keep], *simplices


@njit(cache=True, nogil=True)
def _corners(edges: np.ndarray, of_triangle: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the vertices (r,3) int32 of triangles by their edges: the list of triangles can go early."""
    corners = np.empty((len(rows), 3), dtype=np.int32)
    for k in range(len(rows)):
        one, other = of_triangle[rows[k], 0], of_triangle[rows[k], 1]
        a, b, c = edges[one, 0], edges[one, 1], edges[other, 0]
        corners[k, 0], corners[k, 1] = a, b
        corners[k, 2] = edges[other, 1] if c in (a, b) else c
    return corners


def lasting(births: np.ndarray, deaths: np.ndarray) -> np.ndarray:
    """Return the order (k,) int32 of the bars of positive length by birth, then death."""
    keep = np.flatnonzero(deaths - births > ROUNDING * deaths).astype(np.int32)
    keep = keep[reduction.increasing(deaths[keep])]
    return keep[reduction.increasing(births[keep])]


@njit("int64[:,::1](int32[:,:], int32[::1])", cache=True, nogil=True)
def named(simplices: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Return simplices (k,d) with their vertices renamed, each row increasing."""
    count, width = simplices.shape
    result = np.empty((count, width), dtype=np.int64)
    for k in range(count):
        for i in range(width):
            name, place = np.int64(names[simplices[k, i]]), i
            while place > 0 and result[k, place - 1] > name:
                result[k, place] = result[k, place - 1]
                place -= 1
            result[k, place] = name
    return result
