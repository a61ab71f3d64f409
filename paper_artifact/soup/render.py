"""A soup's images as an evaluation sees them: threshold .5 instead of draws, no randomness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from paper_artifact.raster.view import ViewRaster, make_camera
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup


def render_views(
    soup: Soup, scene: Scene, views: np.ndarray | Sequence[int], supersample: int = 1
) -> np.ndarray:
    """Return the soup's images (n,H,W,3) float32 in [0,1] of the scene's views (indices (n,)), rendered at
    the threshold .5; a pixel is the mean of supersample × supersample rays on a regular grid in it."""
    height, width = scene.images.shape[2:]
    drawn, raster = soup.drawn(), ViewRaster(height * supersample, width * supersample)
    cameras = [make_camera(scene.world_to_clip[view]) for view in views]
    colours = [_pixels(raster.render(drawn, camera, scene.background), supersample) for camera in cameras]
    return np.stack(colours).transpose(0, 2, 3, 1)


def _pixels(rays: np.ndarray, supersample: int) -> np.ndarray:
    """Return the means (3,H,W) of square blocks of rays (3,H·s,W·s), as an array of its own."""
    if supersample == 1:
        return rays.copy()
    channels, height, width = rays.shape
    blocks = rays.reshape(channels, height // supersample, supersample, width // supersample, supersample)
    return blocks.mean(axis=(2, 4), dtype=np.float32)
