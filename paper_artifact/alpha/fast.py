"""The fast alpha persistence: triangulation, filtration and reduction, one after the other.

The compiled code is kept beside the modules (`kernel_cache`), about 12 s of CPU the first time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from paper_artifact.alpha import delaunay, filtration, ordering, reduction
from paper_artifact.alpha.expansions import WORKSPACE


class _Cells(NamedTuple):
    """A triangulation with its vertices along the Hilbert curve: near ones are near in memory."""

    points: np.ndarray  # (n,3) float64, scaled
    order: np.ndarray  # (n,) int32: the row that each of them was given in
    cells: np.ndarray  # (m,4) int32 vertices
    neighbours: np.ndarray  # (m,4) int32, -1 outside the hull
    distinct: int  # number of distinct points


class _Filtration(NamedTuple):
    """Simplices and their squared radii, in the unit of the scaled points squared."""

    cell_values: np.ndarray  # (m,) float64
    triangle_values: np.ndarray  # (k,) float64
    edge_values: np.ndarray  # (e,) float64
    of_cell: np.ndarray  # (m,4) int32: triangle opposite each vertex
    triangles: np.ndarray  # (k,3) int32 vertices
    sides: np.ndarray  # (k,2) int32 cells, -1 outside
    of_triangle: np.ndarray  # (k,3) int32: edge opposite each corner
    edges: np.ndarray  # (e,2) int32 vertices


def squared_pairs(points: np.ndarray, begin: Callable[[str], None]) -> tuple | None:
    """Return (births, deaths, birth simplices, death simplices) of dimensions 0, 1, 2.

    Births and deaths are SQUARED radii in the unit of the points squared, births < deaths in dimensions 1 and
    2; simplices are row indices of `points`. None when the points span no tetrahedron.
    points: (n, 3) float64, finite. begin: called with the name of each stage of persistence.STAGES.
    """
    begin("delaunay")
    scaled, unit = ordering.normalised(points)
    triangulation = _triangulation(scaled)
    if triangulation is None:
        return None
    begin("filtration")
    order, cells = triangulation.order, triangulation.cells
    filtered = _filtered(triangulation)
    del triangulation, scaled  # the largest arrays: a million points need their room
    begin("reduction")
    (ended, merging), (looping, killing), (closing, filling) = _reduced(filtered, len(order))
    begin("pairs")
    square = unit * unit
    edges, edge_values = filtered.edges, filtered.edge_values
    triangles, values = filtered.triangles, filtered.triangle_values
    return (
        (np.zeros(len(ended)), edge_values[merging] * square, order[ended][:, None], order[edges[merging]]),
        (
            edge_values[looping] * square,
            values[killing] * square,
            order[edges[looping]],
            order[triangles[killing]],
        ),
        (
            values[closing] * square,
            filtered.cell_values[filling] * square,
            order[triangles[closing]],
            order[cells[filling]],
        ),
    )


def _triangulation(scaled: np.ndarray) -> _Cells | None:
    if len(scaled) < 4:
        return None
    places = ordering.hilbert_indices(scaled)
    order = ordering.insertion_order(places)
    ordered = np.ascontiguousarray(scaled[order])
    if not delaunay.first_tetrahedron(ordered, order):
        return None
    mesh, distinct = delaunay.triangulate(ordered)
    along = ordering.sort_keys(places[order])
    rank = np.empty_like(along)
    rank[along] = np.arange(len(along), dtype=np.int32)
    cells, neighbours = delaunay.finite_cells(mesh, rank)
    return _Cells(np.ascontiguousarray(ordered[along]), order[along], cells, neighbours, distinct)


def _filtered(made: _Cells) -> _Filtration:
    of_cell, triangles, sides = filtration.faces(made.cells, made.neighbours)
    edge_count = made.distinct + len(triangles) - len(made.cells) - 1  # Euler's formula for a ball
    of_triangle, edges = filtration.edges_of(triangles, len(made.order), edge_count)
    cell_values, triangle_values, edge_values = filtration.values(
        made.points, made.cells, triangles, sides, of_cell, edges, of_triangle, np.empty(WORKSPACE)
    )
    return _Filtration(
        cell_values=cell_values,
        triangle_values=triangle_values,
        edge_values=edge_values,
        of_cell=of_cell,
        triangles=triangles,
        sides=sides,
        of_triangle=of_triangle,
        edges=edges,
    )


def _reduced(made: _Filtration, vertex_count: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return (births, deaths) of dimensions 0, 1, 2 as simplices' numbers; no empty bars in 1 and 2."""
    state, parents = reduction.apparent_voids(
        made.cell_values, made.triangle_values, made.of_cell, made.sides
    )
    apparent = reduction.apparent_loops(made.triangle_values, made.edge_values, made.of_triangle, state)
    left = np.flatnonzero(state == reduction.OPEN).astype(np.int32)
    left = left[reduction.increasing(made.triangle_values[left])]
    edge_order = reduction.increasing(made.edge_values)
    ended, merging, merges = reduction.components(made.edges, edge_order, vertex_count)
    closing, filling = reduction.voids(made.sides, left, made.cell_values, parents, state)
    looping, killing = reduction.loops(made.of_triangle, left, state, edge_order, merges, apparent)
    lasts = made.triangle_values[killing] > made.edge_values[looping]
    fills = made.cell_values[filling] > made.triangle_values[closing]
    return (ended, merging), (looping[lasts], killing[lasts]), (closing[fills], filling[fills])
