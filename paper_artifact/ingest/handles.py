"""Where the handles, holes and voids of a closed surface are, and surgery that cuts a handle or fills a hole.

A surface of genus g in space has g independent loops that bound inside of it and g that bound outside. A loop
that bounds in the material goes around a handle: along it the handle is cut. A loop that bounds outside goes
around a hole (a tunnel): along it the hole is filled. Which is which is exact, without rays: c⁺ is loop c
pushed off the surface outwards, and θ(c, d) the linking number of c⁺ and d; d bounds inside where θ(·, d) = 0
and outside where θ(d, ·) = 0 (Alexander duality).

Short loops are two shortest paths from one vertex and an edge between their ends (Erickson and Whittlesey,
"Greedy optimal homotopy and homology generators", SODA 2005). Their classes are read off 2g integer cocycles,
one for each edge that neither a spanning tree nor a spanning tree of the faces holds. The shortest loops that
are independent are kept; base vertices are all of a small mesh, else some far apart and those on the loops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, dijkstra

from paper_artifact.certify.homology import edges_of, forest, labels_of_graph
from paper_artifact.errors import InputError
from paper_artifact.ingest.crossings import crossing_faces, crossing_segments
from paper_artifact.kernel_cache import njit
from paper_artifact.mesh import Mesh, checked_mesh, weld
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface

HANDLE, HOLE = "handle", "hole"
ALL_BASES, BASES = 1500, 48  # vertices of a small mesh; bases of others
MOST_STEPS = 4_000_000  # bases × vertices
ROUNDS = 4  # of the search from the loops' own vertices
ON_LOOP = 12  # of these, on each loop
PUSH = 0.01  # of a vertex's shortest edge
PRIME = 2**31 - 1
ATTEMPTS = 5  # of surgery, with finer triangles or a wider band
TRIES = 30  # of a disc, each without a diagonal of the last


@dataclass(frozen=True, eq=False)
class Loop:
    """A short closed path of edges around a handle or a hole."""

    kind: str  # "handle" or "hole"
    vertices: np.ndarray  # (n,) int64 of the welded mesh, each once, in order
    length: float  # world units


@dataclass(frozen=True, eq=False)
class Void:
    """What one component of a closed surface encloses."""

    centre: np.ndarray  # (3,) float64, world units, of a large ball in it
    radius: float  # of that ball, to the sampling of the surface
    volume: float  # signed: negative where the component is wound inwards, as the wall of a cavity


class _Surface:
    """One closed, oriented, connected surface: graph, cocycles, shortest paths."""

    def __init__(self, points: np.ndarray, faces: np.ndarray) -> None:
        self.points, self.faces = points, faces
        self.edges, sides = edges_of(faces, len(points))
        self.lengths = np.linalg.norm(points[self.edges[:, 0]] - points[self.edges[:, 1]], axis=1)
        both = np.concatenate([self.edges, self.edges[:, ::-1]])
        self.graph = coo_array((np.tile(self.lengths, 2), both.T), shape=(len(points),) * 2).tocsr()
        self.keys = self.edges[:, 0] * len(points) + self.edges[:, 1]
        tree = forest(np.ascontiguousarray(self.edges), len(points))
        beside = np.argsort(sides.reshape(-1), kind="stable").reshape(-1, 2) // 3
        free = np.flatnonzero(~tree)
        dual = coo_array((np.ones(len(free)), beside[free].T), shape=(len(faces),) * 2).tocsr()
        order, before = breadth_first_order(dual, 0, directed=False)
        later = order[1:]
        same = sides[later][:, :, None] == sides[before[later]][:, None, :]
        place = same.any(axis=2).argmax(axis=1)
        crossed = np.zeros(len(self.edges), dtype=bool)
        crossed[sides[later, place]] = True
        left = np.flatnonzero(~tree & ~crossed)
        self.cocycles = np.zeros((len(self.edges), len(left)), dtype=np.int8)
        self.cocycles[left, np.arange(len(left))] = 1
        signs = np.where(faces < faces[:, [1, 2, 0]], 1, -1)
        _close(self.cocycles, sides, signs, later[::-1].copy(), place[::-1].copy())

    def between(self, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the edges from vertices to vertices, and 1 where an edge has this direction, else -1."""
        key = np.minimum(start, end) * len(self.points) + np.maximum(start, end)
        return np.searchsorted(self.keys, key), np.where(start < end, 1, -1)

    def paths(self, base: int) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and predecessors of the shortest paths from a vertex."""
        return dijkstra(self.graph, indices=base, return_predecessors=True)

    def candidates(self, base: int) -> Iterable[tuple[float, np.ndarray, int, int]]:
        """Yield length, class (2g,), base and closing edge of the shortest loop of each class at `base`."""
        distance, before = self.paths(base)
        order = np.argsort(distance, kind="stable")[1:]
        edge, sign = self.between(before[order], order)
        along = np.zeros((len(self.points), self.cocycles.shape[1]), dtype=np.int32)
        _add_up(along, self.cocycles, order, before, edge, sign)
        start, end = self.edges.T
        classes = along[start] + self.cocycles - along[end]
        chosen = np.flatnonzero(classes.any(axis=1))
        length = distance[start[chosen]] + self.lengths[chosen] + distance[end[chosen]]
        chosen = chosen[np.argsort(length, kind="stable")]
        mixed = stream(0, "loop classes").integers(1, 2**40, classes.shape[1])
        _, first = np.unique(np.abs(classes[chosen] @ mixed), return_index=True)  # a class is its negative
        for each in chosen[first].tolist():
            total = float(distance[start[each]] + self.lengths[each] + distance[end[each]])
            yield total, classes[each].astype(np.int64), base, each

    def loop(self, base: int, edge: int) -> np.ndarray:
        """Return the vertices (n,) of a candidate, without the way from `base` that it goes twice."""
        _, before = self.paths(base)
        ways = []
        for vertex in self.edges[edge].tolist():
            way = [vertex]
            while way[-1] != base:
                way.append(int(before[way[-1]]))
            ways.append(way[::-1])
        common = next(
            (i for i, (a, b) in enumerate(zip(*ways, strict=False)) if a != b), min(map(len, ways))
        )
        return np.array(ways[0][common - 1 :] + ways[1][: common - 1 : -1])

    def length_of(self, vertices: np.ndarray) -> float:
        """Return the length of a closed path."""
        return float(self.lengths[self.between(vertices, np.roll(vertices, -1))[0]].sum())


@njit(cache=True)
def _close(cocycles, sides, signs, faces, place):
    """Fill in the cocycles on the edges to each face's parent, leaves first: their sum around a face is 0."""
    for n in range(len(faces)):
        face = faces[n]
        own = place[n]
        for column in range(cocycles.shape[1]):
            total = 0
            for i in range(3):
                if i != own:
                    total += signs[face, i] * cocycles[sides[face, i], column]
            cocycles[sides[face, own], column] = -signs[face, own] * total


@njit(cache=True)
def _add_up(along, cocycles, order, before, edge, sign):
    """Add the cocycles up along the paths of a tree, nearest vertices first."""
    for n in range(len(order)):
        vertex = order[n]
        for column in range(cocycles.shape[1]):
            along[vertex, column] = along[before[vertex], column] + sign[n] * cocycles[edge[n], column]


@njit(cache=True)
def linking_number(first: np.ndarray, second: np.ndarray) -> float:
    """Return the linking number of two disjoint closed polygons (n,3) and (m,3), by Gauss' integral."""
    total = 0.0
    normals = np.empty((4, 3))
    for i in range(len(first)):
        a, b = first[i], first[(i + 1) % len(first)]
        for j in range(len(second)):
            c, d = second[j], second[(j + 1) % len(second)]
            ac, ad, bc, bd = c - a, d - a, c - b, d - b
            normals[0], normals[1] = np.cross(ac, ad), np.cross(ad, bd)
            normals[2], normals[3] = np.cross(bd, bc), np.cross(bc, ac)
            angle = 0.0
            for k in range(4):
                one, two = normals[k], normals[(k + 1) % 4]
                size = np.sqrt((one * one).sum() * (two * two).sum())
                if size > 0:
                    angle += np.arcsin(min(1.0, max(-1.0, (one * two).sum() / size)))
            side = (np.cross(d - c, b - a) * ac).sum()
            total += angle if side > 0 else (-angle if side < 0 else 0.0)
    return total / (4 * np.pi)


def find_loops(mesh: Mesh, progress: Callable[[str], None] | None = None) -> tuple[Loop, ...]:
    """Return the loops around all handles, then those around all holes of a welded Mesh, each shortest first.

    The mesh must be closed, orientable and a manifold, as a certificate says, and wound outwards; a mesh that
    is wound inwards as a whole is taken as if it were not. Raises InputError where inside and outside cannot
    be told apart, as in a surface that crosses itself.
    """
    stage = progress or (lambda name: None)
    labels, volumes = _components(mesh)
    outward = 1.0 if volumes[np.abs(volumes).argmax()] > 0 else -1.0
    found: list[Loop] = []
    for label in range(len(volumes)):
        own = np.flatnonzero(labels == label)
        faces = np.searchsorted(own, mesh.faces[labels[mesh.faces[:, 0]] == label])
        if len(own) - len(faces) // 2 == 2:
            continue
        stage(f"loops of component {label + 1} of {len(volumes)}")
        surface = _Surface(mesh.vertices[own], faces)
        for kind, vertices in _loops_of(surface, outward):
            found.append(Loop(kind, own[vertices], surface.length_of(vertices)))
    return tuple(sorted(found, key=lambda each: (each.kind != HANDLE, each.length)))


def _components(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the component of each vertex (V,) and the signed volume of each component (C,)."""
    edges, _ = edges_of(mesh.faces, len(mesh.vertices))
    labels = labels_of_graph(edges[:, 0], edges[:, 1], len(mesh.vertices))
    a, b, c = ((mesh.vertices - mesh.centre)[mesh.faces[:, i]] for i in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return labels, np.bincount(labels[mesh.faces[:, 0]], weights=volumes)


def _loops_of(surface: _Surface, outward: float) -> list[tuple[str, np.ndarray]]:
    genus = surface.cocycles.shape[1] // 2
    kinds = _kinds(surface, outward)
    best: dict[str, dict[tuple, tuple]] = {HANDLE: {}, HOLE: {}}
    chosen: list[tuple[str, np.ndarray]] = []
    bases, tried, before = _bases(surface), set[int](), np.inf
    for _ in range(ROUNDS):
        for base in bases:
            for candidate in surface.candidates(base):
                for kind in kinds(candidate[1]):
                    key = tuple(np.abs(candidate[1]).tolist())
                    best[kind].setdefault(key, candidate)
                    best[kind][key] = min(best[kind][key], candidate, key=lambda each: each[0])
        tried |= set(bases)
        chosen = [
            (kind, surface.loop(base, edge))
            for kind, found in best.items()
            for _, _, base, edge in _independent(found.values(), genus)
        ]
        total = sum(surface.length_of(loop) for _, loop in chosen)
        each = max(1, min(ON_LOOP, MOST_STEPS // len(surface.points) // max(1, len(chosen))))
        near = {int(v) for _, loop in chosen for v in loop[:: -(-len(loop) // each)]}
        if total > 0.999 * before or not (bases := sorted(near - tried)):
            break
        before = total
    return chosen


def _kinds(surface: _Surface, outward: float) -> Callable[[np.ndarray], list[str]]:
    """Return a function that says of a class (2g,) whether it is of handles or of holes, or neither."""
    size = surface.cocycles.shape[1]
    loops = _independent(surface.candidates(0), size)
    paths = [surface.loop(base, edge) for _, _, base, edge in loops]
    a, b, c = (surface.points[surface.faces[:, i]] for i in range(3))
    normal = np.zeros_like(surface.points)
    for i in range(3):
        np.add.at(normal, surface.faces[:, i], np.cross(b - a, c - a))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    shortest = np.full(len(surface.points), np.inf)
    for i in range(2):
        np.minimum.at(shortest, surface.edges[:, i], surface.lengths)
    pushed = surface.points + outward * PUSH * shortest[:, None] * normal
    linking = np.array(
        [[linking_number(pushed[one], surface.points[two]) for two in paths] for one in paths]
    )
    theta = np.rint(linking)
    turned = np.linalg.inv(np.array([each[1] for each in loops], dtype=np.float64)).T
    inside, outside = theta @ turned, theta.T @ turned
    ranks = [np.linalg.matrix_rank(each) for each in (inside, outside, np.concatenate([inside, outside]))]
    if np.abs(linking - theta).max() > 0.05 or ranks != [size // 2, size // 2, size]:
        raise InputError(
            "its inside and outside cannot be told apart along its loops; the surface crosses or touches "
            "itself there: make a shell of it first (python -m paper_artifact ingest)"
        )

    def kinds(which: np.ndarray) -> list[str]:
        zero = [np.abs(matrix @ which).max() < 0.25 / size for matrix in (inside, outside)]
        return [kind for kind, there in zip((HANDLE, HOLE), zero, strict=True) if there]

    return kinds


def _bases(surface: _Surface) -> list[int]:
    """Return the vertices to look for loops from: all, or some that are far from each other."""
    count = len(surface.points)
    if count <= ALL_BASES:
        return list(range(count))
    chosen, nearest = [0], surface.paths(0)[0]
    while len(chosen) < min(BASES, max(8, MOST_STEPS // count)):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, surface.paths(chosen[-1])[0])
    return chosen


def _independent(candidates: Iterable[tuple], count: int) -> list[tuple]:
    """Return the shortest `count` candidates whose classes are independent (modulo a large prime)."""
    basis: dict[int, list[int]] = {}
    kept = []
    for candidate in sorted(candidates, key=lambda each: each[0]):
        row = [int(x) % PRIME for x in candidate[1]]
        for pivot, other in sorted(basis.items()):
            if row[pivot]:
                factor = row[pivot]
                row = [(x - factor * y) % PRIME for x, y in zip(row, other, strict=True)]
        lead = next((i for i, x in enumerate(row) if x), None)
        if lead is not None:
            inverse = pow(row[lead], -1, PRIME)
            basis[lead] = [x * inverse % PRIME for x in row]
            kept.append(candidate)
            if len(kept) == count:
                break
    return kept


def find_voids(mesh: Mesh) -> tuple[Void, ...]:
    """Return what the components of a closed, consistently wound Mesh enclose, the largest first."""
    labels, volumes = _components(mesh)
    labels = labels[mesh.faces[:, 0]]
    voids = []
    for label, volume in enumerate(volumes.tolist()):
        faces = mesh.faces[labels == label]
        points, of_face, _ = sample_surface(mesh.vertices, faces, 8000, stream(0, "void"))
        a, b, c = (mesh.vertices[faces[of_face[:400], i]] for i in range(3))
        normal = np.cross(b - a, c - a) * np.sign(volume)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        away = points[:400, None] - points
        height = np.einsum("nmi,ni->nm", away, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            radii = np.where(height > 1e-9 * mesh.diagonal, (away**2).sum(axis=2) / (2 * height), np.inf)
        radius = radii.min(axis=1)
        best = int(np.where(np.isfinite(radius), radius, 0).argmax())
        voids.append(Void(points[best] - radius[best] * normal[best], float(radius[best]), volume))
    return tuple(sorted(voids, key=lambda each: -abs(each.volume)))


def cut_and_capped(mesh: Mesh, loop: Loop) -> Mesh:
    """Return the Mesh without the triangles along a loop, both rims closed by discs; float32 vertices.

    That cuts a handle, and fills a hole by a plate as thick as the triangles are wide. Raises InputError
    where a disc would cross the surface, as in a hole that is knotted or that something passes through.
    """
    vertices, faces, path = mesh.vertices, mesh.faces, loop.vertices
    band = path
    for _ in range(ATTEMPTS):
        rounded = vertices.astype(np.float32).astype(np.float64)
        removed = np.isin(faces, band).any(axis=1)
        whole, rims = faces[~removed], _rims(faces[~removed])
        if len(rims) == 2:
            for rim in rims:
                whole = np.concatenate([whole, cap]) if len(cap := _cap(rounded, whole, rim)) else whole[:0]
            if len(whole):
                return checked_mesh(*weld(rounded, whole), mesh.name)
            band = np.unique(faces[removed])  # rims farther from a crease have discs more often
        elif band is path:
            vertices, faces, path = _finer(vertices, faces, path)
            band = path
        else:
            break
    raise InputError(
        f"no disc closes this {loop.kind} without crossing the surface: something passes through it, or its "
        "loop is knotted or bent; choose another, or mend the mesh in a mesh editor"
    )


def _cap(vertices: np.ndarray, faces: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Return the triangles (n-2,3) of a disc that closes a rim (n,) of the faces and crosses none of them;
    none where no such disc is found."""
    if len(faces) == 0:
        return faces
    pairs = np.stack(np.meshgrid(rim, rim, indexing="ij"), axis=-1)
    edges = edges_of(faces, len(vertices))[0] @ (len(vertices), 1)
    taken = np.isin(np.sort(pairs, axis=-1) @ (len(vertices), 1), edges)
    apart = np.triu_indices(len(rim), 2)
    taken[apart] |= crossing_segments(vertices, faces, pairs[apart])
    near = np.isin(np.arange(len(vertices)), rim)
    for _ in range(TRIES):
        disc = _disc(vertices[rim], taken)
        crossing = crossing_faces(vertices, np.concatenate([faces, rim[disc]]), changed=near)[len(faces) :]
        if len(disc) and not crossing.any():
            return rim[disc]
        for i, k, j in disc[crossing].tolist():  # without its longest side, unless that is of the rim
            sides = [(a, b) for a, b in ((i, k), (k, j), (i, j)) if 1 < b - a < len(rim) - 1]
            if sides:
                taken[max(sides, key=lambda side: np.ptp(vertices[rim[list(side)]], axis=0).max())] = True
        if not len(disc):
            break
    return faces[:0]


def _rims(kept: np.ndarray) -> list[np.ndarray]:
    """Return the closed chains of vertices where faces are missing, in the direction that a disc there has;
    none where a chain meets itself or another one."""
    sides = np.concatenate([kept[:, [0, 1]], kept[:, [1, 2]], kept[:, [2, 0]]])
    base = int(kept.max()) + 1
    border = sides[~np.isin(sides @ (base, 1), sides @ (1, base))]
    after = dict(border[:, ::-1].tolist())
    rims: list[np.ndarray] = []
    if len(after) < len(border):
        return rims
    while after:
        rim = [next(iter(after))]
        while (step := after.pop(rim[-1])) != rim[0]:
            rim.append(step)
        rims.append(np.array(rim))
    return rims


def _finer(vertices: np.ndarray, faces: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return a mesh and a closed path with every edge halved, every triangle cut into four."""
    edges, sides = edges_of(faces, len(vertices))
    ab, bc, ca = (len(vertices) + sides).T
    a, b, c = faces.T
    four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    ends = np.sort(np.stack([path, np.roll(path, -1)], axis=1), axis=1) @ (len(vertices), 1)
    halves = len(vertices) + np.searchsorted(edges @ (len(vertices), 1), ends)
    return (
        np.concatenate([vertices, vertices[edges].mean(axis=1)]),
        np.concatenate([np.stack(each, axis=1) for each in four]),
        np.stack([path, halves], axis=1).reshape(-1),
    )


@njit(cache=True)
def _disc(points: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return the triangles (n-2,3) of a closed chain (n,3) that have the least area together, without the
    diagonals that are `taken` (n,n); none where there is no such disc (Barequet and Sharir 1995)."""
    n = len(points)
    cost, middle = np.zeros((n, n)), np.zeros((n, n), dtype=np.int64)
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            cost[i, j] = np.inf
            if taken[i, j] and span < n - 1:
                continue
            for k in range(i + 1, j):
                normal = np.cross(points[k] - points[i], points[j] - points[i])
                total = cost[i, k] + cost[k, j] + np.sqrt((normal * normal).sum())
                if total < cost[i, j]:
                    cost[i, j], middle[i, j] = total, k
    triangles = np.empty((n - 2 if np.isfinite(cost[0, n - 1]) else 0, 3), dtype=np.int64)
    if len(triangles) == 0:
        return triangles
    stack, count = [(0, n - 1)], 0
    while len(stack) > 0:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k = middle[i, j]
        triangles[count, 0], triangles[count, 1], triangles[count, 2] = i, k, j
        count += 1
        stack.append((i, k))
        stack.append((k, j))
    return triangles
