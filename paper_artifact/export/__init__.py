"""A trained soup as PLY, GLB, PNG and a self-contained HTML view."""
