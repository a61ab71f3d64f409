"""A soup's images as an evaluation sees them: threshold .5 instead of draws, no randomness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from paper_artifact.raster.view import ViewRaster, make_camera
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup


def render_views(soup: Soup, scene: Scene, views: np.ndarray | Sequence[int]) -> np.ndarray:
    """Return the soup's images (n,H,W,3) float32 in [0,1] of the scene's views (indices (n,)), rendered at
    the threshold .5."""
    height, width = scene.images.shape[2:]
    drawn, raster = soup.drawn(), ViewRaster(height, width)
    cameras = [make_camera(scene.world_to_clip[view]) for view in views]
    colours = [raster.render(drawn, camera, scene.background).copy() for camera in cameras]
    return np.stack(colours).transpose(0, 2, 3, 1)
