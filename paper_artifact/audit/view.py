"""A mesh made small enough for a page: vertices clustered on a grid."""

from __future__ import annotations

import numpy as np

from paper_artifact.mesh import Mesh, weld


def light_mesh(mesh: Mesh, most: int = 60_000) -> Mesh:
    """Return the mesh itself or, above `most` triangles, a coarser one for a picture only.

    Its vertices are those of each cell of a grid merged to their mean. The grid is coarsened until at most
    `most` triangles are left; the topology may change.
    """
    cells = 256
    vertices, faces = mesh.vertices, mesh.faces
    while len(faces) > most:
        keys = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / (mesh.diagonal / cells)).astype(
            np.int64
        )
        _, group = np.unique(keys @ (1 << np.array([0, 20, 40])), return_inverse=True)
        size = np.bincount(group)
        vertices = np.stack(
            [np.bincount(group, weights=mesh.vertices[:, axis]) / size for axis in range(3)], axis=1
        )
        vertices, faces = weld(vertices, group[mesh.faces])
        faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
        cells = cells * 3 // 4
    return Mesh(vertices, faces, mesh.name)
