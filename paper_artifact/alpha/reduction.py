"""Persistence pairs of a filtered Delaunay triangulation over Z/2.

The filtration's order is (value, dimension, index), so ties give a valid pairing and empty bars. First the
apparent pairs are taken out: a simplex and its earliest coface of which it is the latest face (Bauer 2021);
they are most of the complex, and empty when the values are equal. Of what is left: H0 by union-find over the
edges in increasing value; H2 by duality, union-find over the tetrahedra and the outside with the triangles in
decreasing value; H1 by column reduction of the triangles that kill loops (clearing: Chen & Kerber 2011;
paper, Method).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from paper_artifact.alpha.ordering import sort_keys

# A triangle's state: not yet paired; apparent pair with a cell; paired with a cell; apparent pair with an
# edge.
OPEN, FILLED, CLOSES, KILLS = 0, 1, 2, 3


def increasing(values: np.ndarray) -> np.ndarray:
    """Return the order (n,) int32 of (n,) non-negative float64 values, equal ones by index."""
    # The bits of non-negative doubles sort as integers.
    return sort_keys(values.view(np.uint64))


@njit("int32(int32[::1], int32)", cache=True, nogil=True)
def _root(parents: np.ndarray, i: int) -> int:
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(cache=True, nogil=True)
def apparent_voids(
    cell_values: np.ndarray, triangle_values: np.ndarray, of_cell: np.ndarray, sides: np.ndarray
) -> tuple:
    """Take out the empty pairs of a triangle and a cell; return (state, parents).

    state (k,) int8 of each triangle; parents (m+1,) int32: the cell, or m for the outside, that a cell so
    filled belongs to from then on.
    """
    m = len(cell_values)
    state = np.zeros(len(sides), dtype=np.int8)
    parents = np.arange(m + 1).astype(np.int32)
    for t in range(m):
        latest = of_cell[t, 0]
        for i in range(1, 4):
            f = of_cell[t, i]
            if triangle_values[f] > triangle_values[latest] or (
                triangle_values[f] == triangle_values[latest] and f > latest
            ):
                latest = f
        if triangle_values[latest] != cell_values[t]:
            continue
        other = sides[latest, 0] if sides[latest, 1] == t else sides[latest, 1]
        if other < 0:
            other = m
        elif cell_values[other] < cell_values[t] or (cell_values[other] == cell_values[t] and other < t):
            continue
        state[latest] = FILLED
        parents[t] = other
    return state, parents


@njit(cache=True, nogil=True)
def apparent_loops(
    triangle_values: np.ndarray, edge_values: np.ndarray, of_triangle: np.ndarray, state: np.ndarray
) -> np.ndarray:
    """Return the empty pairs of an edge and a triangle: (e,) int32, the triangle or -1.

    The state of those triangles becomes KILLS, IN PLACE.
    """
    first = np.full(len(edge_values), np.int32(-1))
    for f in range(len(of_triangle)):
        for i in range(3):
            edge = of_triangle[f, i]
            if first[edge] < 0 or triangle_values[f] < triangle_values[first[edge]]:
                first[edge] = f
    killer = np.full(len(edge_values), np.int32(-1))
    for f in range(len(of_triangle)):
        latest = of_triangle[f, 0]
        for i in range(1, 3):
            edge = of_triangle[f, i]
            if edge_values[edge] > edge_values[latest] or (
                edge_values[edge] == edge_values[latest] and edge > latest
            ):
                latest = edge
        if edge_values[latest] == triangle_values[f] and first[latest] == f:
            killer[latest] = f
            state[f] = KILLS
    return killer


@njit(cache=True, nogil=True)
def components(
    edges: np.ndarray, order: np.ndarray, vertex_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return H0: (vertex (r,) that is merged away, edge (r,) that merges it, merges (e,) bool of each edge).

    Of two components the one whose first vertex has the larger index ends. order: the edges by value.
    """
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
def voids(
    sides: np.ndarray, order: np.ndarray, cell_values: np.ndarray, parents: np.ndarray, state: np.ndarray
) -> tuple:
    """Return H2: (triangle (r,) that closes a void, cell (r,) that fills it), without the apparent pairs.

    The state of those triangles becomes CLOSES, IN PLACE. sides: (k, 2) cells of each triangle, -1 outside;
    `order`: the open triangles in increasing value; parents: of apparent_voids. Backwards in the filtration
    the triangles join the cells, and the void whose last cell comes earlier ends.
    """
    outside = len(cell_values)
    sizes = np.ones(outside + 1, dtype=np.int32)
    # Of each component's root: its last cell in the filtration.
    tops = np.arange(outside + 1).astype(np.int32)
    births, deaths = np.empty(len(order), dtype=np.int32), np.empty(len(order), dtype=np.int32)
    count = 0
    for place in range(len(order) - 1, -1, -1):
        triangle = order[place]
        other = sides[triangle, 1]
        if other < 0:
            other = outside
        u, v = _root(parents, sides[triangle, 0]), _root(parents, other)
        if u == v:
            continue
        lower, higher = tops[u], tops[v]
        if higher != outside:
            x, y = cell_values[lower] if lower != outside else np.inf, cell_values[higher]
            if lower == outside or x > y or (x == y and lower > higher):
                lower, higher = higher, lower
        if sizes[u] < sizes[v]:
            u, v = v, u
        parents[v] = u
        sizes[u] += sizes[v]
        tops[u] = higher
        state[triangle] = CLOSES
        births[count], deaths[count] = triangle, lower
        count += 1
    return births[:count], deaths[:count]


@njit(cache=True, nogil=True)
def _highest_bit(word: int) -> int:
    place = 0
    for shift in (32, 16, 8, 4, 2, 1):
        if word >> np.uint64(shift):
            word >>= np.uint64(shift)
            place += shift
    return place


@njit(cache=True, nogil=True)
def _grown(array: np.ndarray, used: int, size: int) -> np.ndarray:
    larger = np.empty(size, dtype=np.int32)
    for i in range(used):
        larger[i] = array[i]
    return larger


@njit(cache=True, nogil=True)
def loops(
    of_triangle: np.ndarray,
    order: np.ndarray,
    state: np.ndarray,
    edge_order: np.ndarray,
    merges: np.ndarray,
    apparent: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return H1: (edge (r,) that closes a loop, triangle (r,) that fills it), without the apparent pairs.

    order: the triangles open after apparent_voids and apparent_loops in increasing value; those that close a
    void are left out. Rows are the edges that merge no components (the others never become a pivot). A column
    is reduced in a bit field over the rows; a reduced column is kept as a list of rows, except for the
    triangles of `apparent`, which are reduced as they are.
    """
    row_of = np.full(len(edge_order), np.int32(-1))
    edge_at = np.empty(len(edge_order), dtype=np.int32)
    rows = 0
    for edge in edge_order:
        if not merges[edge]:
            row_of[edge] = rows
            edge_at[rows] = edge
            rows += 1
    columns = np.full(rows, np.int32(-1))  # of a pivot row: its place in starts, births, deaths
    starts = np.empty(rows + 1, dtype=np.int64)
    births, deaths = np.empty(rows, dtype=np.int32), np.empty(rows, dtype=np.int32)
    kept = np.empty(4 * rows + 1024, dtype=np.int32)
    count = used = 0
    starts[0] = 0
    bits = np.zeros(rows // 64 + 1, dtype=np.uint64)
    one = np.uint64(1)
    for triangle in order:
        if state[triangle] == CLOSES:
            continue
        pivot, least = -1, rows
        addend = triangle  # a triangle's own column, or -1: the kept column of the pivot
        while True:
            if addend >= 0:
                for i in range(3):
                    row = row_of[of_triangle[addend, i]]
                    if row >= 0:
                        bits[row >> 6] ^= one << np.uint64(row & 63)
                        pivot, least = max(pivot, row), min(least, row)
            else:
                for i in range(starts[columns[pivot]], starts[columns[pivot] + 1]):
                    row = kept[i]
                    bits[row >> 6] ^= one << np.uint64(row & 63)
                    least = min(least, row)
            word = pivot >> 6
            while bits[word] == 0:
                word -= 1
            pivot = 64 * word + _highest_bit(bits[word])
            addend = apparent[edge_at[pivot]]
            if addend < 0 and columns[pivot] < 0:
                break
        if used + pivot + 2 > len(kept):
            kept = _grown(kept, used, 2 * len(kept) + rows)
        for word in range(pivot >> 6, (least >> 6) - 1, -1):
            while bits[word] != 0:
                bit = _highest_bit(bits[word])
                bits[word] ^= one << np.uint64(bit)
                kept[used] = 64 * word + bit
                used += 1
        births[count], deaths[count] = edge_at[pivot], triangle
        columns[pivot] = count
        count += 1
        starts[count] = used
    return births[:count], deaths[:count]
