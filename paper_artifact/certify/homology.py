"""A mesh as a simplicial complex: its parts, its homology over Z/2, and whether it is a surface.

Homology is exact, and independent of any alpha complex and of floating point: gudhi's, of the simplices.

`check_surface` counts open and non-manifold edges, pinched vertices and loops, on exactly welded vertices. It
counts the faces as given: a face given twice counts twice at its edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from paper_artifact.sampling import face_areas


@dataclass(frozen=True, eq=False)
class Complex:
    """The distinct simplices of a mesh whose vertices are all used: V vertices, E edges, F faces, C
    components.
    """

    faces: np.ndarray  # (F,3) int64 vertex indices, each row increasing, rows in lexicographic order
    edges: np.ndarray  # (E,2) int64 likewise
    component_of_vertex: np.ndarray  # (V,) int64, labels 0..C-1 in order of the first vertex

    @property
    def components(self) -> int:
        """C, the number of connected components."""
        return int(self.component_of_vertex.max()) + 1 if len(self.component_of_vertex) else 0

    def counts(self) -> np.ndarray:
        """Return (C,3) int64: vertices, edges and triangles of each component."""
        label = self.component_of_vertex
        owners = (label, label[self.edges[:, 0]], label[self.faces[:, 0]])
        return np.stack([np.bincount(owner, minlength=self.components) for owner in owners], axis=1)


def make_complex(faces: np.ndarray, vertex_count: int) -> Complex:
    """Return the Complex of `faces` (n,3), three different vertices each; repeated faces count once."""
    ordered = np.sort(np.asarray(faces, dtype=np.int64).reshape(-1, 3), axis=1)
    ordered = ordered[np.lexsort(ordered.T[::-1])]
    first = np.ones(len(ordered), dtype=bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    ordered = ordered[first]
    edges, _ = edges_of(ordered, vertex_count)
    return Complex(ordered, edges, labels_of_graph(edges[:, 0], edges[:, 1], vertex_count))


def edges_of(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct edges (E,2) of faces (F,3), and the edge (F,3) of each side 01, 12, 20; int64."""
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys, index = np.unique(sides[:, 0] * vertex_count + sides[:, 1], return_inverse=True)
    return np.stack([keys // max(vertex_count, 1), keys % max(vertex_count, 1)], axis=1), index.reshape(-1, 3)


def labels_of_graph(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    """Return the component (count,) int64 of each node of the graph with edges left[i]–right[i]."""
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    graph = coo_array((np.ones(len(left), dtype=np.int8), (left, right)), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def betti_numbers(simplices: Complex) -> np.ndarray:
    """Return (C,3) int64: b0, b1 and b2 over Z/2 of each component, by gudhi's persistent cohomology: the
    classes that never die of a filtration in which all enter at once."""
    import gudhi  # here: it takes .3 s

    tree = gudhi.SimplexTree()
    tree.insert_batch(simplices.faces.T, np.zeros(len(simplices.faces)))
    tree.compute_persistence(homology_coeff_field=2, persistence_dim_max=True)
    betti = np.zeros((simplices.components, 3), dtype=np.int64)
    _, lasting = tree.lower_star_persistence_generators()  # per dimension a vertex of each class
    for dimension, vertices in enumerate(lasting):
        owners = simplices.component_of_vertex[np.asarray(vertices, dtype=np.int64)]
        betti[:, dimension] = np.bincount(owners, minlength=len(betti))
    return betti


@dataclass(frozen=True, eq=False)
class SurfaceChecks:
    """What is wrong or open, attributed to the C components of the vertices."""

    open_edges: np.ndarray  # (C,) int64, edges with one face
    nonmanifold_edges: np.ndarray  # (C,) int64, edges with more than two faces
    boundary_loops: np.ndarray  # (C,) int64, closed chains of open edges
    pinched_vertices: np.ndarray  # (C,) int64, vertices whose faces form more than one fan
    reversed_edges: np.ndarray  # (C,) int64, edges whose two faces wind alike (wrongly)
    orientable: np.ndarray  # (C,) bool, a consistent winding exists
    volume: np.ndarray  # (C,) float64, cubic world units, positive for outward winding; of closed components
    duplicate_faces: np.ndarray  # (C,) int64, repeats of another face
    flat_faces: int  # of zero area


def check_surface(vertices: np.ndarray, faces: np.ndarray, component_of_vertex: np.ndarray) -> SurfaceChecks:
    """Return the SurfaceChecks of vertices (V,3) float64, world units, and faces (F,3) int64.

    Each face has three different vertices, and every vertex is used. component_of_vertex (V,) int64: the
    labels 0..C-1 that the counts are attributed to.
    """
    count = int(component_of_vertex.max()) + 1
    edges, face_edges = edges_of(faces, len(vertices))
    of_edge = component_of_vertex[edges[:, 0]]
    sides = face_edges.reshape(-1)  # side 3f+i runs from corner i to corner i+1 of face f
    degree = np.bincount(sides, minlength=len(edges))
    order = np.argsort(sides, kind="stable")
    start = np.concatenate([[0], np.cumsum(degree)])[:-1]

    forward = faces[:, [0, 1, 2]].reshape(-1) < faces[:, [1, 2, 0]].reshape(-1)
    first, second = order[start[degree == 2]], order[start[degree == 2] + 1]
    alike = forward[first] == forward[second]

    open_edge = degree == 1
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    repeated = np.delete(component_of_vertex[faces[:, 0]], once)
    return SurfaceChecks(
        open_edges=np.bincount(of_edge[open_edge], minlength=count),
        nonmanifold_edges=np.bincount(of_edge[degree > 2], minlength=count),
        boundary_loops=_chains(edges[open_edge], component_of_vertex, count),
        pinched_vertices=_pinched(faces, order, degree, component_of_vertex, count),
        reversed_edges=np.bincount(of_edge[degree == 2][alike], minlength=count),
        orientable=_orientable(
            len(faces), first // 3, second // 3, alike, component_of_vertex[faces[:, 0]], count
        ),
        volume=_volumes(vertices, faces, component_of_vertex[faces[:, 0]], count),
        duplicate_faces=np.bincount(repeated, minlength=count),
        flat_faces=int((face_areas(vertices, faces) == 0).sum()),
    )


def open_edge_count(faces: np.ndarray, vertex_count: int) -> int:
    """Return the number of edges with one face among faces (F,3) as indexed."""
    _, face_edges = edges_of(faces, vertex_count)
    return int((np.bincount(face_edges.reshape(-1)) == 1).sum())


def _chains(open_edges: np.ndarray, component_of_vertex: np.ndarray, count: int) -> np.ndarray:
    """Return the chains of open edges per component: the boundary loops where no vertex is pinched."""
    used, ends = np.unique(open_edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    chain = labels_of_graph(ends[:, 0], ends[:, 1], len(used))
    _, first = np.unique(chain, return_index=True)
    return np.bincount(component_of_vertex[used[first]], minlength=count)


def _pinched(
    faces: np.ndarray, order: np.ndarray, degree: np.ndarray, component_of_vertex: np.ndarray, count: int
) -> np.ndarray:
    """Return per component the number of vertices whose faces, joined across edges, form several fans."""
    # Consecutive sides of one edge in `order`; the corners of their faces at either end belong to one fan.
    same = np.ones(len(order), dtype=bool)
    same[0] = False
    same[np.cumsum(degree)[:-1]] = False
    later = np.flatnonzero(same)
    low, high = _corners(faces, order)
    left = np.concatenate([low[later - 1], high[later - 1]])
    right = np.concatenate([low[later], high[later]])
    fan = labels_of_graph(left, right, faces.size)
    _, first = np.unique(fan, return_index=True)
    fans = np.bincount(faces.reshape(-1)[first], minlength=len(component_of_vertex))
    return np.bincount(component_of_vertex[fans > 1], minlength=count)


def _corners(faces: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corner numbers 3f+i at the lower- and the higher-numbered vertex of each side."""
    begin, end = sides, sides - sides % 3 + (sides + 1) % 3
    flat = faces.reshape(-1)
    swap = flat[begin] > flat[end]
    return np.where(swap, end, begin), np.where(swap, begin, end)


def _orientable(
    face_count: int, first: np.ndarray, second: np.ndarray, alike: np.ndarray, of_face: np.ndarray, count: int
) -> np.ndarray:
    """Return which components are orientable: no face meets its own reverse in the double cover."""
    shift = np.where(alike, face_count, 0)
    left = np.concatenate([first, first + face_count])
    right = np.concatenate([second + shift, (second + face_count + shift) % (2 * face_count)])
    sheet = labels_of_graph(left, right, 2 * face_count)
    result = np.ones(count, dtype=bool)
    result[of_face[sheet[:face_count] == sheet[face_count:]]] = False
    return result


def _volumes(vertices: np.ndarray, faces: np.ndarray, of_face: np.ndarray, count: int) -> np.ndarray:
    centred = vertices - (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    a, b, c = (centred[faces[:, i]] for i in range(3))
    return np.bincount(of_face, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, minlength=count)
