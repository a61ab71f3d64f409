"""The alpha complex and its pairs: triangulation, filtration and reduction, one after the other.

A cloud in space is triangulated by tetrahedra. A cloud in one plane (every (n, 2) cloud) is triangulated as
the base of a cone: with one more point off the plane, the tetrahedra are the plane's Delaunay triangles, each
joined to that point, and the same exact predicates decide. A cloud on one line is sorted along it.

The compiled code is kept beside the modules (`kernel_cache`), about 12 s of CPU the first time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from paper_artifact.alpha import delaunay, filtration, ordering, reduction
from paper_artifact.alpha.expansions import WORKSPACE
from paper_artifact.kernel_cache import njit

# Two squared radii closer than this, relative to the larger, are one value: rounding is about 1e-15.
ROUNDING = 1e-12
Stage = Callable[[str], None]
Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # squared births, deaths, simplices of both


@dataclass(eq=False)
class Complex:
    """Simplices and their SQUARED radii, in units of 2^(2 exponent). Vertices run along the Hilbert curve."""

    exponent: int  # points = 2^exponent × the scaled points that the values belong to
    names: np.ndarray  # (n,) int32: the row of the points that each vertex was given in
    edges: np.ndarray  # (e,2) int32 vertices
    edge_values: np.ndarray  # (e,) float64
    triangles: np.ndarray  # (k,3) int32 vertices
    triangle_values: np.ndarray  # (k,) float64
    cells: np.ndarray  # (m,4) int32 vertices
    cell_values: np.ndarray  # (m,) float64
    of_triangle: np.ndarray  # (k,3) int32: the edge opposite each corner
    of_cell: np.ndarray  # (m,4) int32: the triangle opposite each vertex
    sides: np.ndarray  # (k,2) int32: cells beside a triangle; without cells (e,2): triangles beside an edge


def build(points: np.ndarray, begin: Stage) -> Complex:
    """Return the alpha complex of `points` (n,3) float64, finite. begin: called with each stage's name."""
    begin("delaunay")
    n = len(points)
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
    ws = np.empty(WORKSPACE)
    if found == 3:
        triangles = np.ascontiguousarray(cells[cells != n].reshape(-1, 3))
        of_triangle, edges = filtration.edges_of(triangles, n, distinct - 1 + len(triangles) - 1)  # a disc
        values, edge_values, sides = filtration.planar_values(cloud, triangles, edges, of_triangle, ws)
        cells = of_cell = np.zeros((0, 4), dtype=np.int32)
        cell_values = np.zeros(0)
    else:
        of_cell, triangles, sides = filtration.faces(cells, neighbours)
        del neighbours
        edge_count = distinct + len(triangles) - len(cells) - 1  # a ball
        of_triangle, edges = filtration.edges_of(triangles, n, edge_count)
        cell_values, values, edge_values = filtration.values(
            cloud, cells, triangles, sides, of_cell, edges, of_triangle, ws
        )
    return Complex(
        exponent,
        names,
        edges,
        edge_values,
        triangles,
        values,
        cells,
        cell_values,
        of_triangle,
        of_cell,
        sides,
    )


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
    values = (x * x + y * y + z * z) / 4.0
    two, three, four = (np.zeros((0, columns), dtype=np.int32) for columns in (2, 3, 4))
    none = np.zeros(0)
    return Complex(exponent, order[along], edges, values, three, none, four, none, three, four, two)


def squared_pairs(made: Complex, dimension: int) -> list[Rows]:
    """Return the pairs of dimensions 0 to `dimension` (at most 2) as numbers of vertices.

    Empty bars of dimensions 1 and 2 may be among them. A flat cloud has no pairs above its own dimension. The
    complex is used up: a million points need the room of what is done with.
    """
    if not len(made.cells):
        return _flat_pairs(made)[: dimension + 1]
    if dimension == 0:
        return [_components(made)[0]]
    voids, left, state, apparent = _voids(made)
    rows, edge_order, merges = _components(made)
    looping, killing = reduction.loops(made.of_triangle, left, state, edge_order, merges, apparent)
    ends = made.edge_values[looping], made.triangle_values[killing]
    return [rows, (*ends, made.edges[looping], made.triangles[killing]), voids][: dimension + 1]


def _components(made: Complex) -> tuple[Rows, np.ndarray, np.ndarray]:
    """Return the pairs of dimension 0, the edges by value (e,) and which of them merge components (e,)."""
    order = reduction.increasing(made.edge_values)
    ended, merging, merges = reduction.components(made.edges, order, len(made.names))
    rows = np.zeros(len(ended)), made.edge_values[merging], ended[:, None], made.edges[merging]
    return rows, order, merges


def _voids(made: Complex) -> tuple[Rows, np.ndarray, np.ndarray, np.ndarray]:
    """Return the pairs of dimension 2, and for `reduction.loops` the open triangles by value, their state and
    the apparent pairs."""
    state, parents = reduction.apparent_voids(
        made.cell_values, made.triangle_values, made.of_cell, made.sides
    )
    del made.of_cell
    apparent = reduction.apparent_loops(made.triangle_values, made.edge_values, made.of_triangle, state)
    left = np.flatnonzero(state == reduction.OPEN).astype(np.int32)
    left = left[reduction.increasing(made.triangle_values[left])]
    closing, filling = reduction.voids(made.sides, left, made.cell_values, parents, state)
    ends = made.triangle_values[closing], made.cell_values[filling]
    rows = (*ends, made.triangles[closing], made.cells[filling])
    del made.sides, made.cells, made.cell_values
    return rows, left, state, apparent


def _flat_pairs(made: Complex) -> list[Rows]:
    """Return the pairs of a cloud in a plane or on a line: the edges that close a loop and the triangles are
    dual to dimension 0."""
    rows, order, _ = _components(made)
    if not len(made.triangles):
        return [rows]
    parents = np.arange(len(made.triangles) + 1, dtype=np.int32)
    state = np.zeros(len(made.edges), dtype=np.int8)
    looping, killing = reduction.voids(made.sides, order, made.triangle_values, parents, state)
    ends = made.edge_values[looping], made.triangle_values[killing]
    return [rows, (*ends, made.edges[looping], made.triangles[killing])]


def sorted_rows(rows: Rows, names: np.ndarray) -> Rows:
    """Return the bars of positive length by birth, then death; simplices as increasing int64 names."""
    births, deaths, birth_simplices, death_simplices = rows
    keep = np.flatnonzero(deaths - births > ROUNDING * deaths).astype(np.int32)
    keep = keep[reduction.increasing(deaths[keep])]
    keep = keep[reduction.increasing(births[keep])]
    simplices = [named(each, keep, names) for each in (birth_simplices, death_simplices)]
    return births[keep], deaths[keep], simplices[0], simplices[1]


@njit("int64[:,::1](int32[:,:], int32[::1], int32[::1])", cache=True, nogil=True)
def named(simplices: np.ndarray, rows: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Return the chosen `rows` (r,) of simplices (k,d) with their vertices renamed, each row increasing."""
    width = simplices.shape[1]
    result = np.empty((len(rows), width), dtype=np.int64)
    for k in range(len(rows)):
        for i in range(width):
            name, place = np.int64(names[simplices[rows[k], i]]), i
            while place > 0 and result[k, place - 1] > name:
                result[k, place] = result[k, place - 1]
                place -= 1
            result[k, place] = name
    return result
