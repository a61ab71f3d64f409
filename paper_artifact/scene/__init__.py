"""From a mesh to a COLMAP scene and back: analytic shapes, cameras, texture, ground-truth images, files."""
