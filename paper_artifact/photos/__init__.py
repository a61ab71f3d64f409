"""Photographs → COLMAP scene, by structure from motion (pycolmap, the extra `photos`)."""
