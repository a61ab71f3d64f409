"""The fast alpha persistence: triangulation, filtration and reduction, one after the other.

The compiled code is cached beside the modules (numba, __pycache__), about 20 s of CPU the first time. numba
looks for changes in the module of each function only: after an edit of expansions, predicates or ordering,
remove the cache.
"""

from __future__ import annotations

import time

import numpy as np

from paper_artifact.alpha import delaunay, filtration, ordering, reduction
from paper_artifact.alpha.expansions import WORKSPACE


def squared_pairs(points: np.ndarray, marks: list[float]) -> tuple | None:
    """Return (births, deaths, birth simplices, death simplices) of dimensions 0, 1, 2.

    Births and deaths are SQUARED radii in the unit of the points squared, births < deaths in dimensions 1 and
    2; simplices are row indices of `points`. None when the points span no tetrahedron.
    points: (n, 3) float64, finite. `marks` receives the process' CPU time at the start of each stage of
    persistence.STAGES.
    """
    marks.append(time.process_time())
    scaled, unit = ordering.normalised(points)
    if len(points) < 4:
        return None
    order = ordering.insertion_order(scaled, ordering.ROUNDS)
    ordered = np.ascontiguousarray(scaled[order])
    if not delaunay.first_tetrahedron(ordered, order):
        return None
    mesh, distinct = delaunay.triangulate(ordered)
    # From here on the vertices follow the Hilbert curve: fewer cache misses.
    along = ordering.insertion_order(ordered, 0)
    rank = np.empty_like(along)
    rank[along] = np.arange(len(along), dtype=np.int32)
    order, ordered = order[along], np.ascontiguousarray(ordered[along])
    cells, neighbours = delaunay.finite_cells(mesh, rank)
    marks.append(time.process_time())
    of_cell, triangles, sides = filtration.faces(cells, neighbours)
    edge_count = distinct + len(triangles) - len(cells) - 1  # Euler's formula for a ball
    of_triangle, edges = filtration.edges_of(triangles, len(order), edge_count)
    cell_values, triangle_values, edge_values = filtration.values(
        ordered, cells, triangles, sides, of_cell, edges, of_triangle, np.empty(WORKSPACE)
    )
    marks.append(time.process_time())
    state, parents = reduction.apparent_voids(cell_values, triangle_values, of_cell, sides)
    apparent = reduction.apparent_loops(triangle_values, edge_values, of_triangle, state)
    left = np.flatnonzero(state == reduction.OPEN).astype(np.int32)
    left = left[reduction.increasing(triangle_values[left])]
    edge_order = reduction.increasing(edge_values)
    ended, merging, merges = reduction.components(edges, edge_order, len(order))
    closing, filling = reduction.voids(sides, left, cell_values, parents, state)
    looping, killing = reduction.loops(of_triangle, left, state, edge_order, merges, apparent)
    marks.append(time.process_time())
    square = unit * unit
    keep = np.flatnonzero(triangle_values[killing] > edge_values[looping])
    looping, killing = looping[keep], killing[keep]
    keep = np.flatnonzero(cell_values[filling] > triangle_values[closing])
    closing, filling = closing[keep], filling[keep]
    return (
        (np.zeros(len(ended)), edge_values[merging] * square, order[ended][:, None], order[edges[merging]]),
        (
            edge_values[looping] * square,
            triangle_values[killing] * square,
            order[edges[looping]],
            order[triangles[killing]],
        ),
        (
            triangle_values[closing] * square,
            cell_values[filling] * square,
            order[triangles[closing]],
            order[cells[filling]],
        ),
    )
