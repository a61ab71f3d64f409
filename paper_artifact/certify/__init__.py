"""Certificates: exact homology of a mesh's own triangles, and manifold checks (paper §4, suppl. G)."""
