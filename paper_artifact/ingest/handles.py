"""Where the handles, holes and voids of a closed surface are.

A surface of genus g in space has g independent loops that bound inside of it and g that bound outside. A loop
that bounds in the material goes around a handle: along it the handle is cut. A loop that bounds outside goes
around a hole (a tunnel): along it the hole is filled (`ingest.surgery`). Which is which is exact, without
rays: c⁺ is loop c pushed off the surface outwards, and θ(c, d) the linking number of c⁺ and d; d bounds
inside where θ(·, d) = 0 and outside where θ(d, ·) = 0 (Alexander duality).

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

from paper_artifact.certify.homology import edges_of, labels_of_graph
from paper_artifact.errors import InputError
from paper_artifact.kernel_cache import njit
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface

HANDLE, HOLE = "handle", "hole"
ALL_BASES, BASES = 1500, 48  # vertices of a small mesh; bases of others
MOST_STEPS = 4_000_000  # bases × vertices
ROUNDS = 4  # of the search from the loops' own vertices
ON_LOOP = 12  # of these, on each loop
PUSH = 0.01  # of a vertex's shortest edge
PRIME = 2**25 - 39  # sums of 2,000 products stay in int64
MOST_HANDLES = 150  # of a component; the search takes minutes there


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
        order, before = breadth_first_order(self.graph, 0, directed=False)
        tree = np.zeros(len(self.edges), dtype=bool)
        tree[self.between(before[order[1:]], order[1:])[0]] = True
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
        common = next((i for i, (a, b) in enumerate(zip(*ways, strict=False)) if a != b), min(map(len, ways)))
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

    The mesh must be closed, orientable and a manifold, as a certificate says. A component that lies in no
    other is a body however it is wound; one that lies in a body is a cavity where it is wound the other way.
    Raises InputError where inside and outside cannot be told apart, as in a surface that crosses itself, and
    for a component of more than MOST_HANDLES handles.
    """
    stage = progress or (lambda name: None)
    labels, volumes = _components(mesh)
    found: list[Loop] = []
    for label in range(len(volumes)):
        own = np.flatnonzero(labels == label)
        faces = np.searchsorted(own, mesh.faces[labels[mesh.faces[:, 0]] == label])
        if len(own) - len(faces) // 2 == 2:
            continue
        if (genus := 1 - (len(own) - len(faces) // 2) // 2) > MOST_HANDLES:
            raise InputError(
                f"component {label + 1} has {genus:,} handles; loops are looked for up to {MOST_HANDLES}, as "
                "more take hours: cut a part out of the mesh"
            )
        stage(f"loops of component {label + 1} of {len(volumes)}, {genus} handles")
        surface = _Surface(mesh.vertices[own], faces)
        for kind, vertices in _loops_of(surface, _outward(mesh, labels, volumes, label)):
            found.append(Loop(kind, own[vertices], surface.length_of(vertices)))
    return tuple(sorted(found, key=lambda each: (each.kind != HANDLE, each.length)))


def _components(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the component of each vertex (V,) and the signed volume of each component (C,)."""
    edges, _ = edges_of(mesh.faces, len(mesh.vertices))
    labels = labels_of_graph(edges[:, 0], edges[:, 1], len(mesh.vertices))
    a, b, c = ((mesh.vertices - mesh.centre)[mesh.faces[:, i]] for i in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return labels, np.bincount(labels[mesh.faces[:, 0]], weights=volumes)


def _outward(mesh: Mesh, labels: np.ndarray, volumes: np.ndarray, label: int) -> float:
    """Return 1.0 where the outermost component that one component lies in, or itself, is wound outwards, else
    -1.0: the solid angle of every component is asked at one of its vertices."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces] - mesh.vertices[np.argmax(labels == label)], 1, 0)
    x, y, z = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", *each) for each in ((a, b), (b, c), (c, a)))
    half = np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), x * y * z + ab * z + bc * x + ca * y)
    angles = np.bincount(labels[mesh.faces[:, 0]], half, len(volumes))  # van Oosterom and Strackee 1983
    around = np.abs(angles) > np.pi
    around[label] = True
    return 1.0 if volumes[np.where(around, np.abs(volumes), 0.0).argmax()] > 0 else -1.0


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
    linking = np.array([[linking_number(pushed[one], surface.points[two]) for two in paths] for one in paths])
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
    kept: list[tuple] = []
    pivots: list[int] = []
    basis = np.zeros((0, 0), dtype=np.int64)  # rows that are 1 at their own pivot, 0 at the others'
    for candidate in sorted(candidates, key=lambda each: each[0]):
        row = candidate[1] % PRIME
        if kept:
            row = (row - row[pivots] @ basis) % PRIME
        if not row.any():
            continue
        lead = int(np.flatnonzero(row)[0])
        row = row * pow(int(row[lead]), -1, PRIME) % PRIME
        basis = (basis - basis[:, lead, None] * row) % PRIME if kept else basis.reshape(0, len(row))
        basis, pivots = np.vstack([basis, row]), [*pivots, lead]
        kept.append(candidate)
        if len(kept) == count:
            break
    return kept


def find_voids(mesh: Mesh) -> tuple[Void, ...]:
    """Return what the components of a closed, consistently wound Mesh enclose, the largest first. A component
    in which no ball fits, as one that is flat, encloses nothing."""
    labels, volumes = _components(mesh)
    labels = labels[mesh.faces[:, 0]]
    voids = []
    for label, volume in enumerate(volumes.tolist()):
        faces = mesh.faces[labels == label]
        points, of_face, _ = sample_surface(mesh.vertices, faces, 8000, stream(0, "void"))
        a, b, c = (mesh.vertices[faces[of_face[:400], i]] for i in range(3))
        normal = np.cross(b - a, c - a) * np.sign(volume)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        away = points[:400, None] - points
        height = np.einsum("nmi,ni->nm", away, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            radii = np.where(height > 1e-9 * mesh.diagonal, (away**2).sum(axis=2) / (2 * height), np.inf)
        radius = radii.min(axis=1)
        radius[~np.isfinite(radius)] = 0.0
        centres = points[:400] - radius[:, None] * normal
        low, high = (limit(mesh.vertices[faces], axis=(0, 1)) for limit in (np.min, np.max))
        radius[((centres < low) | (centres > high)).any(axis=1)] = 0.0  # no ball of this component
        best = int(radius.argmax())
        if radius[best] > 0:
            voids.append(Void(centres[best], float(radius[best]), volume))
    return tuple(sorted(voids, key=lambda each: -abs(each.volume)))
