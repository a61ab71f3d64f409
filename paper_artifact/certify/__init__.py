"""Certificates: exact simplicial homology of a mesh's own triangles, with the manifold checks beside it (paper §4, suppl. G)."""
