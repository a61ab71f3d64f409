"""The fast alpha persistence: triangulation, filtration, reduction, one after the other, with a clock for the benchmark."""

from __future__ import annotations

import time

import numpy as np

from paper_artifact.topology import delaunay, filtration, ordering, reduction
from paper_artifact.topology.expansions import WORKSPACE


def squared_pairs(points: np.ndarray, clock: dict[str, float] | None = None) -> tuple | None:
    """For dimensions 0, 1, 2: (births, deaths, birth simplices, death simplices), SQUARED radii in the unit of the points squared and
    row indices of `points`; all pairs, empty ones too. None when the points span no tetrahedron.

    points: (n, 3) float64, finite. `clock`, when given, receives the seconds of each stage.
    """
    marks = [time.perf_counter()]
    scaled, unit = ordering.normalised(points)
    if len(points) < 4:
        return None
    order = ordering.insertion_order(scaled)
    ordered = np.ascontiguousarray(scaled[order])
    cells, neighbours, same = delaunay.triangulate(ordered, order)
    if len(cells) == 0:
        return None
    marks.append(time.perf_counter())
    of_cell, triangles, sides = filtration.faces(cells, neighbours)
    vertices = int((same == np.arange(len(same))).sum())
    of_triangle, edges = filtration.edges_of(triangles, len(same), vertices + len(triangles) - len(cells) - 1)  # Euler
    cell_values, triangle_values, edge_values = filtration.values(
        ordered, cells, triangles, sides, of_cell, edges, of_triangle, np.empty(WORKSPACE)
    )
    marks.append(time.perf_counter())
    cell_order, triangle_order, edge_order = (reduction.increasing(v) for v in (cell_values, triangle_values, edge_values))
    cell_rank = np.empty(len(cells), dtype=np.int32)
    cell_rank[cell_order] = np.arange(len(cells), dtype=np.int32)
    ended, merging, merges = reduction.components(edges, edge_order, len(same))
    closing, filling, closes = reduction.voids(sides, triangle_order, cell_rank)
    looping, killing = reduction.loops(of_triangle, triangle_order, closes, edge_order, merges)
    marks.append(time.perf_counter())
    square = unit * unit
    result = (
        (np.zeros(len(ended)), edge_values[merging] * square, order[ended][:, None], order[edges[merging]]),
        (edge_values[looping] * square, triangle_values[killing] * square, order[edges[looping]], order[triangles[killing]]),
        (triangle_values[closing] * square, cell_values[filling] * square, order[triangles[closing]], order[cells[filling]]),
    )
    marks.append(time.perf_counter())
    if clock is not None:
        clock.update(zip(("delaunay", "filtration", "reduction", "pairs"), np.diff(marks).tolist()))
    return result
