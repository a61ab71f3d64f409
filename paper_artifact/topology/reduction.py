"""Persistence pairs of a filtered Delaunay triangulation over Z/2.

H0 by union-find over the edges in increasing value; H2 by duality, union-find over the tetrahedra and the outside with the triangles in
decreasing value; H1 by column reduction of what is left, the triangles that kill loops against the edges that close them (clearing:
Chen & Kerber 2011; paper, Method). The filtration's order is (value, dimension, index), so ties give a valid pairing and empty bars.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from paper_artifact.topology.ordering import sort_keys


@njit(cache=True, nogil=True)
def _root(parents: np.ndarray, i: int) -> int:
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(cache=True, nogil=True)
def components(edges: np.ndarray, order: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """H0: (vertex (r,) that is merged away, edge (r,) that merges it, merges (e,) bool for each edge); of two components the one whose
    first vertex has the larger index ends. `order`: the edges in increasing value."""
    parents = np.arange(vertex_count).astype(np.int32)
    merges = np.zeros(len(edges), dtype=np.bool_)
    births, deaths = np.empty(vertex_count, dtype=np.int32), np.empty(vertex_count, dtype=np.int32)
    count = 0
    for edge in order:
        u, v = _root(parents, edges[edge, 0]), _root(parents, edges[edge, 1])
        if u == v:
            continue
        if u > v:
            u, v = v, u
        parents[v] = u
        merges[edge] = True
        births[count], deaths[count] = v, edge
        count += 1
    return births[:count], deaths[:count], merges


@njit(cache=True, nogil=True)
def voids(sides: np.ndarray, order: np.ndarray, cell_rank: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """H2: (triangle (r,) that closes a void, cell (r,) that fills it, closes (k,) bool for each triangle).

    sides: (k, 2) cells of each triangle, -1 outside; `order`: the triangles in increasing value; cell_rank: (m,) place of each cell in
    increasing value. Backwards in the filtration the triangles join the cells: the void of the lower-ranked of two ends.
    """
    outside = len(cell_rank)
    parents = np.arange(outside + 1).astype(np.int32)
    tops = np.empty(outside + 1, dtype=np.int32)  # of each component's root: the rank of its highest cell
    sizes = np.ones(outside + 1, dtype=np.int32)
    cell_at = np.empty(outside, dtype=np.int32)
    for t in range(outside):
        tops[t] = cell_rank[t]
        cell_at[cell_rank[t]] = t
    tops[outside] = outside
    closes = np.zeros(len(sides), dtype=np.bool_)
    births, deaths = np.empty(outside, dtype=np.int32), np.empty(outside, dtype=np.int32)
    count = 0
    for place in range(len(order) - 1, -1, -1):
        triangle = order[place]
        other = sides[triangle, 1]
        u, v = _root(parents, sides[triangle, 0]), _root(parents, other if other >= 0 else outside)
        if u == v:
            continue
        if sizes[u] < sizes[v]:
            u, v = v, u
        lower, higher = min(tops[u], tops[v]), max(tops[u], tops[v])
        parents[v] = u
        sizes[u] += sizes[v]
        tops[u] = higher
        closes[triangle] = True
        births[count], deaths[count] = triangle, cell_at[lower]
        count += 1
    return births[:count], deaths[:count], closes


@njit(cache=True, nogil=True)
def _highest_bit(word: int) -> int:
    place = 0
    for shift in (32, 16, 8, 4, 2, 1):
        if word >> np.uint64(shift):
            word >>= np.uint64(shift)
            place += shift
    return place


@njit(cache=True, nogil=True)
def loops(
    of_triangle: np.ndarray, triangle_order: np.ndarray, closes: np.ndarray, edge_order: np.ndarray, merges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """H1: (edge (r,) that closes a loop, triangle (r,) that fills it).

    Columns are the triangles that close no void, rows the edges that merge no components (the other rows never become a pivot). A
    column is reduced in a bit field over the rows; a reduced column is kept as a list of rows, highest first.
    """
    row_of = np.full(len(edge_order), np.int32(-1))
    edge_at = np.empty(len(edge_order), dtype=np.int32)
    rows = 0
    for edge in edge_order:
        if not merges[edge]:
            row_of[edge] = rows
            edge_at[rows] = edge
            rows += 1
    killer = np.full(rows, np.int32(-1))  # triangle whose reduced column has this highest row
    starts, ends = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int64)
    kept = np.empty(8 * rows + 1024, dtype=np.int32)
    used = 0
    bits = np.zeros(rows // 64 + 1, dtype=np.uint64)
    one = np.uint64(1)
    for triangle in triangle_order:
        if closes[triangle]:
            continue
        pivot, least = -1, rows
        column = np.int32(0)
        for i in range(3):
            row = row_of[of_triangle[triangle, i]]
            if row >= 0:
                kept[used + column] = row
                column += 1
                pivot, least = max(pivot, row), min(least, row)
        if killer[pivot] >= 0:
            for i in range(column):
                bits[kept[used + i] >> 6] ^= one << np.uint64(kept[used + i] & 63)
            while killer[pivot] >= 0:
                for i in range(starts[pivot], ends[pivot]):
                    row = kept[i]
                    bits[row >> 6] ^= one << np.uint64(row & 63)
                    least = min(least, row)
                word = pivot >> 6
                while bits[word] == 0:
                    word -= 1
                pivot = 64 * word + _highest_bit(bits[word])
            if used + pivot + 64 > len(kept):
                larger = np.empty(2 * len(kept) + rows + 64, dtype=np.int32)
                for i in range(used):
                    larger[i] = kept[i]
                kept = larger
            column = 0
            for word in range(pivot >> 6, (least >> 6) - 1, -1):
                while bits[word] != 0:
                    bit = _highest_bit(bits[word])
                    bits[word] ^= one << np.uint64(bit)
                    kept[used + column] = 64 * word + bit
                    column += 1
        killer[pivot] = triangle
        starts[pivot], ends[pivot] = used, used + column
        used += column
        if used + 64 > len(kept):
            larger = np.empty(2 * len(kept) + 64, dtype=np.int32)
            for i in range(used):
                larger[i] = kept[i]
            kept = larger
    return edge_at[:rows], killer


@njit(cache=True, nogil=True)
def increasing(values: np.ndarray) -> np.ndarray:
    """The order of (n,) non-negative float64 values, equal ones by index: (n,) int32. (Their bits sort as integers.)"""
    return sort_keys(values.view(np.uint64))
