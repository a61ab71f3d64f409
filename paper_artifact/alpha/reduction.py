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

from paper_artifact.alpha.ordering import grown, sort_keys
from paper_artifact.kernel_cache import njit

# A triangle's state: not yet paired; apparent pair with a cell; paired with one; apparent pair with an edge.
OPEN, FILLED, CLOSES, KILLS = 0, 1, 2, 3
SHORT, NOTHING = 96, -2  # rows of a column that is worked on as a list; no apparent triangle


def increasing(values: np.ndarray) -> np.ndarray:
    """Return the order (n,) int32 of (n,) non-negative float64 values, equal ones by index."""
    return sort_keys(values.view(np.uint64))  # the bits of non-negative doubles sort as integers


@njit(cache=True, nogil=True)
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
def apparent_voids(cell_values: np.ndarray, triangle_values: np.ndarray, sides: np.ndarray) -> tuple:
    """Take out the empty pairs of a triangle and a cell; return (state, parents).

    state (k,) int8 of each triangle; parents (m+1,) int32: the cell, or m for the outside, that a cell so
    filled belongs to from then on.
    """
    m = len(cell_values)
    state = np.zeros(len(sides), dtype=np.int8)
    parents = np.arange(m + 1).astype(np.int32)
    latest_of = np.full(m, np.int32(-1))
    for f in range(len(sides)):
        for t in sides[f]:
            if t >= 0 and (latest_of[t] < 0 or triangle_values[f] >= triangle_values[latest_of[t]]):
                latest_of[t] = f
    for t in range(m):
        latest = latest_of[t]
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
def components(ends: np.ndarray, order: np.ndarray, vertex_count: int, edge_count: int) -> tuple:
    """Return H0: (vertex (r,) that is merged away, edge (r,) that merges it, merges (e,) bool of each edge).

    Of two components the one whose first vertex has the larger index ends. order (k,): edges by value, all
    that may merge; ends (k, 2): their vertices.
    """
    parents = np.arange(vertex_count).astype(np.int32)
    merges = np.zeros(edge_count, dtype=np.bool_)
    births, deaths = np.empty(vertex_count, dtype=np.int32), np.empty(vertex_count, dtype=np.int32)
    count = 0
    for k in range(len(order)):
        u, v = _root(parents, ends[k, 0]), _root(parents, ends[k, 1])
        if u != v:
            u, v = min(u, v), max(u, v)
            parents[v] = u
            merges[order[k]] = True
            births[count], deaths[count] = v, order[k]
            count += 1
    return births[:count], deaths[:count], merges


@njit(cache=True, nogil=True)
def voids(
    ends: np.ndarray, order: np.ndarray, cell_values: np.ndarray, parents: np.ndarray, state: np.ndarray
) -> tuple:
    """Return H2: (triangle (r,) that closes a void, cell (r,) that fills it), without the apparent pairs.

    The state of those triangles becomes CLOSES, IN PLACE. order (k,): the open triangles by value;
    ends (k, 2): their cells, -1 outside; parents: of apparent_voids. Backwards in the filtration triangles
    join the cells, and the void whose last cell comes earlier ends.
    """
    outside = np.int32(len(cell_values))
    sizes = np.ones(outside + 1, dtype=np.int32)
    tops = np.arange(outside + 1).astype(np.int32)  # of a component's root: its last cell in the filtration
    births, deaths = np.empty(len(order), dtype=np.int32), np.empty(len(order), dtype=np.int32)
    count = 0
    for place in range(len(order) - 1, -1, -1):
        other = ends[place, 1] if ends[place, 1] >= 0 else outside
        u, v = _root(parents, ends[place, 0]), _root(parents, other)
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
        state[order[place]] = CLOSES
        births[count], deaths[count] = order[place], lower
        count += 1
    return births[:count], deaths[:count]


@njit(cache=True, nogil=True)
def _bit_tree(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an empty set of rows below `rows`: (words of 64 bits, first word of each level).

    A bit of level 0 is a row, a bit of a higher level a word of the level below that is not empty; the last
    level is one word (the bit-tree column of PHAT: Bauer, Kerber, Reininghaus & Wagner 2017).
    """
    starts, levels, words = np.zeros(8, dtype=np.int64), 1, rows // 64 + 1
    total = words
    while words > 1:
        starts[levels] = total
        words = (words + 63) // 64
        total += words
        levels += 1
    return np.zeros(total, dtype=np.uint64), starts[:levels]


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
    of_triangle: np.ndarray, order: np.ndarray, edges: np.ndarray, apparent: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return H1: (edge (r,) that closes a loop, triangle (r,) that fills it), without the apparent pairs.

    order: by value, the triangles that are open after apparent_voids and apparent_loops and close no void;
    edges: by value, those that merge no components (the others never become a pivot), the rows. A column is a
    list of decreasing rows while it is short, as nearly all are, and a bit tree over the rows from then on; a
    reduced column is kept as a list, except for the triangles of `apparent`, which stay as they are.
    """
    rows, count = len(edges), len(order)
    row_of = np.full(len(apparent), np.int32(-1))
    for row in range(rows):
        row_of[edges[row]] = row
    others = np.full((rows, 2), np.int32(NOTHING))  # of a row with an apparent triangle: its others, or -1
    for row in range(rows):
        edge, place = edges[row], 0
        if apparent[edge] >= 0:
            for i in range(3):
                other = of_triangle[apparent[edge], i]
                if other != edge:
                    others[row, place] = row_of[other]
                    place += 1
    # All columns first: reads from everywhere overlap where none waits for the one before.
    columns = np.empty((count, 3), dtype=np.int32)
    for k in range(count):
        for i in range(3):
            columns[k, i] = row_of[of_triangle[order[k], i]]
    starts = np.zeros(rows, dtype=np.int64)  # of the kept column of a pivot row; its size 0: there is none
    sizes = np.zeros(rows, dtype=np.int32)
    births = np.empty(count, dtype=np.int32)
    kept, used = np.empty(4 * rows + 1024, dtype=np.int32), 3  # the first: an apparent triangle's column
    tree, levels = _bit_tree(rows)
    # The column and room for a sum with it: halves of one array, for numba counts references to arrays that
    # change their names, with a memory fence each time.
    column, here, there = np.empty(2 * SHORT, dtype=np.int32), 0, SHORT
    for k in range(count):
        size = 0
        for i in range(3):
            row, place = columns[k, i], size
            if row >= 0:
                while place > 0 and column[here + place - 1] < row:
                    column[here + place] = column[here + place - 1]
                    place -= 1
                column[here + place] = row
                size += 1
        long = False
        while True:
            pivot = np.int64(column[here])
            one, two = others[pivot, 0], others[pivot, 1]
            if one != NOTHING:
                kept[0], kept[1], kept[2] = pivot, max(one, two), min(one, two)
                first, end = 0, 1 + (one >= 0) + (two >= 0)
            elif sizes[pivot] > 0:
                first, end = starts[pivot], starts[pivot] + sizes[pivot]
            else:
                break
            if size + end - first > SHORT:
                long = True
                break
            i, last, to = here, here + size, there
            while i < last and first < end:
                ours, theirs = column[i], kept[first]
                if ours != theirs:
                    column[to] = max(ours, theirs)
                    to += 1
                i += ours >= theirs
                first += theirs >= ours
            for rest in range(i, last):
                column[to] = column[rest]
                to += 1
            for rest in range(first, end):
                column[to] = kept[rest]
                to += 1
            size = to - there
            here, there = there, here
        if long:
            for i in range(size):
                _flip(tree, levels, np.int64(column[here + i]))
        while long:
            pivot = _last(tree, levels)
            left, right = np.int64(others[pivot, 0]), np.int64(others[pivot, 1])
            if left != NOTHING:
                _flip(tree, levels, pivot)
                if left >= 0:
                    _flip(tree, levels, left)
                if right >= 0:
                    _flip(tree, levels, right)
                size += 2  # at most
            elif sizes[pivot] > 0:
                for i in range(starts[pivot], starts[pivot] + sizes[pivot]):
                    _flip(tree, levels, np.int64(kept[i]))
                size += sizes[pivot]
            else:
                break
        if used + size > len(kept):
            kept = grown(kept, 2 * len(kept) + size)
        starts[pivot] = used
        if long:
            while tree[-1] != 0:
                row = _last(tree, levels)
                _flip(tree, levels, row)
                kept[used] = row
                used += 1
        else:
            for i in range(size):
                kept[used] = column[here + i]
                used += 1
        sizes[pivot] = used - starts[pivot]
        births[k] = edges[pivot]
    return births, order
