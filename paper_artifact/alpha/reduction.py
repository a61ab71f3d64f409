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

from paper_artifact.alpha.ordering import sort_keys
from paper_artifact.kernel_cache import njit

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


@njit(cache=True, nogil=True, forceinline=True)
def _later(i: int, i_value: float, j: int, j_value: float) -> tuple[int, float]:
    """Return the later of two simplices of one dimension, and its value."""
    later = (j_value > i_value) | ((j_value == i_value) & (j > i))
    return (j if later else i), (j_value if later else i_value)


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
        latest, value = of_cell[t, 0], triangle_values[of_cell[t, 0]]
        for i in range(1, 4):
            latest, value = _later(latest, value, of_cell[t, i], triangle_values[of_cell[t, i]])
        if value != cell_values[t]:
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
    # No coface of an edge has a lower value: the first triangle of the same value is the earliest one.
    met = np.zeros(len(edge_values), dtype=np.bool_)
    killer = np.full(len(edge_values), np.int32(-1))
    for f in range(len(of_triangle)):
        here = triangle_values[f]
        a, b, c = of_triangle[f, 0], of_triangle[f, 1], of_triangle[f, 2]
        latest, value = _later(a, edge_values[a], b, edge_values[b])
        latest, value = _later(latest, value, c, edge_values[c])
        if value == here and not met[latest]:
            killer[latest] = f
            state[f] = KILLS
        met[a] |= edge_values[a] == here
        met[b] |= edge_values[b] == here
        met[c] |= edge_values[c] == here
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
def _grown(array: np.ndarray, used: int, size: int) -> np.ndarray:
    larger = np.empty(size, dtype=np.int32)
    for i in range(used):
        larger[i] = array[i]
    return larger


@njit(cache=True, nogil=True)
def _bit_tree(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an empty set of rows below `rows`: (words of 64 bits, first word of each level).

    A bit of level 0 is a row, a bit of a higher level a word of the level below that is not empty; the last
    level is one word (the bit-tree column of PHAT: Bauer, Kerber, Reininghaus & Wagner 2017).
    """
    levels, words, total = 1, rows // 64 + 1, rows // 64 + 1
    while words > 1:
        words = (words + 63) // 64
        total += words
        levels += 1
    starts = np.zeros(levels, dtype=np.int64)
    words = rows // 64 + 1
    for level in range(1, levels):
        starts[level] = starts[level - 1] + words
        words = (words + 63) // 64
    return np.zeros(total, dtype=np.uint64), starts


@njit(cache=True, nogil=True, forceinline=True)
def _flip(tree: np.ndarray, starts: np.ndarray, row: int) -> None:
    """Add a row to the set, or take it out if it is there."""
    for level in range(len(starts)):
        word = starts[level] + (row >> 6)
        before = tree[word]
        tree[word] = before ^ (np.uint64(1) << np.uint64(row & 63))
        if before != 0 and tree[word] != 0:
            return
        row >>= 6


@njit(cache=True, nogil=True, forceinline=True)
def _last(tree: np.ndarray, starts: np.ndarray) -> int:
    """Return the largest row of a set that is not empty."""
    row = 0
    for level in range(len(starts) - 1, -1, -1):
        word = tree[starts[level] + row]
        row <<= 6
        for shift in (32, 16, 8, 4, 2, 1):
            more = word >> np.uint64(shift)
            word = more if more != 0 else word
            row += shift if more != 0 else 0
    return row


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
    is reduced in a bit tree over the rows; a reduced column is kept as a list of rows, except for the
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
    tree, levels = _bit_tree(rows)
    for triangle in order:
        if state[triangle] == CLOSES:
            continue
        addend = triangle  # a triangle's own column, or -1: the kept column of the pivot
        pivot = np.int64(-1)
        size = 0  # of the column, at most
        while True:
            if addend >= 0:
                for i in range(3):
                    row = np.int64(row_of[of_triangle[addend, i]])
                    if row >= 0:
                        _flip(tree, levels, row)
                        size += 1
            else:
                first, end = starts[columns[pivot]], starts[columns[pivot] + 1]
                for i in range(first, end):
                    _flip(tree, levels, np.int64(kept[i]))
                size += end - first
            pivot = _last(tree, levels)
            addend = apparent[edge_at[pivot]]
            if addend < 0 and columns[pivot] < 0:
                break
        if used + size > len(kept):
            kept = _grown(kept, used, 2 * len(kept) + size)
        row = pivot
        while True:
            _flip(tree, levels, row)
            kept[used] = row
            used += 1
            if tree[-1] == 0:
                break
            row = _last(tree, levels)
        births[count], deaths[count] = edge_at[pivot], triangle
        columns[pivot] = count
        count += 1
        starts[count] = used
    return births[:count], deaths[:count]
