"""The simplicial complex of a triangle mesh: distinct vertices, edges and triangles, and who bounds whom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True, eq=False)
class Complex:
    """The distinct simplices of a mesh whose vertices are all used: V vertices, E edges, F faces, C
    components.
    """

    faces: np.ndarray  # (F,3) int64 vertex indices, each row increasing, rows in lexicographic order
    edges: np.ndarray  # (E,2) int64 likewise
    face_edges: np.ndarray  # (F,3) int64, the edges (01, 12, 02) of each face
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
    edges, face_edges = edges_of(ordered, vertex_count)
    labels = labels_of_graph(edges[:, 0], edges[:, 1], vertex_count)
    return Complex(ordered, edges, face_edges, labels)


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
