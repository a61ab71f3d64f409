"""Exact homology over Z/2 of a two-dimensional complex by sparse reduction, and b2 once more by duality.

b0: union-find over the edges. The edges outside a spanning forest are a basis of the cycles; each triangle is
a relation among them. Relations are eliminated without fill-in as long as some edge lies in one live relation
only (a free face; clearing as in Chen & Kerber 2011); where none is left, one triangle is set aside, and at
the end each such column is reduced against the pivots: it vanishes (a 2-cycle, b2), or enters a small dense
elimination. b1 = cycles - rank. This is independent of any alpha complex and of floating point.

The dual count of b2 solves for the 2-cycles themselves: triangles across an edge of exactly two have equal
coefficients, the edge of one triangle sets zero, the others give the equations. The two counts share no
elimination, so their agreement is a check.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.certify.simplices import Complex, labels_of_graph
from paper_artifact.kernel_cache import njit

# Beyond this many bits of dense equations the dual count is left out; no surface comes near.
DUAL_LIMIT = 400_000_000


def betti_numbers(simplices: Complex) -> np.ndarray:
    """Return (C,3) int64: b0 = 1, b1 and b2 over Z/2 of each component."""
    count = simplices.components
    tree = _forest(simplices.edges, len(simplices.component_of_vertex))
    deferred, pivots, rows = _eliminate(simplices.face_edges, tree)
    of_face = simplices.component_of_vertex[simplices.faces[:, 0]]
    rank = np.bincount(of_face[pivots], minlength=count)
    voids = np.zeros(count, dtype=np.int64)
    bases: dict[int, dict[int, int]] = {}
    for face, row in zip(deferred.tolist(), rows, strict=True):
        component = int(of_face[face])
        if _enters(bases.setdefault(component, {}), row):
            rank[component] += 1
        else:
            voids[component] += 1
    cycles = np.bincount(simplices.component_of_vertex[simplices.edges[~tree, 0]], minlength=count)
    return np.stack([np.ones(count, dtype=np.int64), cycles - rank, voids], axis=1)


def dual_voids(simplices: Complex) -> int | None:
    """Return b2 of the whole complex, the dimension of its 2-cycles over Z/2; None beyond DUAL_LIMIT."""
    sides = simplices.face_edges.reshape(-1)
    face_of_side = np.arange(len(simplices.faces)).repeat(3)
    order = np.argsort(sides, kind="stable")
    degree = np.bincount(sides, minlength=len(simplices.edges))
    start = np.concatenate([[0], np.cumsum(degree)])
    sorted_faces = face_of_side[order]
    double = start[:-1][degree == 2]
    group = labels_of_graph(sorted_faces[double], sorted_faces[double + 1], len(simplices.faces))
    groups = int(group.max()) + 1 if len(group) else 0
    zero = np.zeros(groups, dtype=bool)
    zero[group[sorted_faces[start[:-1][degree == 1]]]] = True
    equations = set()
    for edge in np.flatnonzero(degree > 2).tolist():
        members, times = np.unique(group[sorted_faces[start[edge] : start[edge + 1]]], return_counts=True)
        equations.add(tuple(members[(times % 2 == 1) & ~zero[members]].tolist()))
    unknown = sorted({member for equation in equations for member in equation})
    if len(unknown) * len(equations) > DUAL_LIMIT:
        return None
    place = {member: index for index, member in enumerate(unknown)}
    basis: dict[int, int] = {}
    rank = sum(
        _enters(basis, sum(1 << place[member] for member in equation)) for equation in sorted(equations)
    )
    return groups - int(zero.sum()) - rank


def _enters(basis: dict[int, int], row: int) -> bool:
    """Reduce `row` (bits) by `basis` (highest bit → row) and keep the rest there; False when none is left."""
    while row:
        pivot = row.bit_length()
        if pivot not in basis:
            basis[pivot] = row
            return True
        row ^= basis[pivot]
    return False


def _forest(edges: np.ndarray, vertex_count: int) -> np.ndarray:
    return _forest_kernel(np.ascontiguousarray(edges), vertex_count)


@njit(cache=True)
def _forest_kernel(edges: np.ndarray, vertex_count: int) -> np.ndarray:
    parent = np.arange(vertex_count)
    tree = np.zeros(len(edges), dtype=np.bool_)
    for edge in range(len(edges)):
        ends = (edges[edge, 0], edges[edge, 1])
        u, v = ends
        while parent[u] != u:
            parent[u] = parent[parent[u]]
            u = parent[u]
        while parent[v] != v:
            parent[v] = parent[parent[v]]
            v = parent[v]
        if u != v:
            parent[max(u, v)] = min(u, v)
            tree[edge] = True
    return tree


def _eliminate(face_edges: np.ndarray, tree: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return the faces set aside (d,), those that were pivots (p,), and what is left of the former's rows, as
    bits.
    """
    face_edges = np.ascontiguousarray(face_edges)
    pivot_faces, pivot_time, deferred, deferred_time = _collapse(face_edges, tree)
    flat, ends = _reduce(face_edges, tree, pivot_faces, pivot_time, deferred, deferred_time)
    place: dict[int, int] = {}
    rows, begin = [], 0
    for end in ends.tolist():
        rows.append(sum(1 << place.setdefault(edge, len(place)) for edge in flat[begin:end].tolist()))
        begin = end
    return deferred, pivot_faces, rows


@njit(cache=True)
def _collapse(face_edges: np.ndarray, tree: np.ndarray):
    """Return the pivots in order, faces (p,) and time (E,) of each edge or -1; the faces set aside and their
    time.
    """
    face_count, edge_count = len(face_edges), len(tree)
    degree = np.zeros(edge_count, dtype=np.int64)
    # xor of the live faces at an edge: the face itself when one is left
    both = np.zeros(edge_count, dtype=np.int64)
    for face in range(face_count):
        for side in range(3):
            edge = face_edges[face, side]
            if not tree[edge]:
                degree[edge] += 1
                both[edge] ^= face
    # A push follows a decrement that leaves degree 1, or the start: at most two per edge.
    stack = np.empty(2 * edge_count + 1, dtype=np.int64)
    top = 0
    for edge in range(edge_count - 1, -1, -1):
        if degree[edge] == 1:
            stack[top] = edge
            top += 1
    live = np.ones(face_count, dtype=np.bool_)
    pivot_faces, pivot_time = np.empty(face_count, dtype=np.int64), np.full(edge_count, -1)
    deferred, deferred_time = np.empty(face_count, dtype=np.int64), np.empty(face_count, dtype=np.int64)
    pivots, set_aside, cursor = 0, 0, 0
    while True:
        face = -1
        while top > 0 and face < 0:
            top -= 1
            edge = stack[top]
            if degree[edge] == 1:
                face = both[edge]
                pivot_faces[pivots] = face
                pivot_time[edge] = pivots
                pivots += 1
        if face < 0:
            while cursor < face_count and not live[cursor]:
                cursor += 1
            if cursor == face_count:
                break
            face = cursor
            deferred[set_aside], deferred_time[set_aside] = face, pivots
            set_aside += 1
        live[face] = False
        for side in range(3):
            edge = face_edges[face, side]
            if not tree[edge]:
                degree[edge] -= 1
                both[edge] ^= face
                if degree[edge] == 1:
                    stack[top] = edge
                    top += 1
    return (
        pivot_faces[:pivots].copy(),
        pivot_time,
        deferred[:set_aside].copy(),
        deferred_time[:set_aside].copy(),
    )


@njit(cache=True)
def _reduce(face_edges, tree, pivot_faces, pivot_time, deferred, deferred_time):
    """Return what is left of each face set aside without the pivots: edges, list after list, and the lists'
    ends.

    An eliminated relation holds its pivot and edges that become pivots later or never, so one sweep in order
    of time does it.
    """
    bits = np.zeros(len(pivot_faces) // 64 + 1, dtype=np.uint64)
    odd = np.zeros(len(tree), dtype=np.bool_)
    touched = np.empty(1024, dtype=np.int64)
    flat, ends = np.empty(1024, dtype=np.int64), np.empty(len(deferred), dtype=np.int64)
    used = 0
    one = np.uint64(1)
    for column in range(len(deferred)):
        face, time, waiting, count = deferred[column], deferred_time[column], 0, 0
        while True:
            for side in range(3):
                edge = face_edges[face, side]
                if tree[edge]:
                    continue
                t = pivot_time[edge]
                if t >= 0:
                    mask = one << np.uint64(t & 63)
                    waiting += -1 if bits[t >> 6] & mask else 1
                    bits[t >> 6] ^= mask
                else:
                    odd[edge] = not odd[edge]
                    if count == len(touched):
                        touched = np.concatenate((touched, np.empty(count, dtype=np.int64)))
                    touched[count] = edge
                    count += 1
            if waiting == 0:
                break
            while not (bits[time >> 6] >> np.uint64(time & 63)) & one:
                time = time + 1 if bits[time >> 6] >> np.uint64(time & 63) else ((time >> 6) + 1) << 6
            face = pivot_faces[time]
        for place in range(count):
            edge = touched[place]
            if odd[edge]:
                odd[edge] = False
                if used == len(flat):
                    flat = np.concatenate((flat, np.empty(used, dtype=np.int64)))
                flat[used] = edge
                used += 1
        ends[column] = used
    return flat[:used].copy(), ends
