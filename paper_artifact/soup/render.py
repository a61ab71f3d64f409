"""A soup's images as an evaluation sees them: threshold .5 instead of draws, no randomness."""

from __future__ import annotations

import numpy as np
import torch

from paper_artifact.raster import functions
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup


def render_views(soup: Soup, scene: Scene, views: np.ndarray) -> np.ndarray:
    """Return the soup's images (n,H,W,3) float32 in [0,1] of the scene's views (indices (n,)), rendered at the threshold .5."""
    height, width = scene.images.shape[1:3]
    images = []
    with torch.no_grad():
        for view in views:
            matrix = scene.world_to_clip[[view]]
            raster = functions.rasterize(
                soup.vertices, torch.sigmoid(soup.opacity), matrix, height, width, None
            )
            colour = functions.shade(torch.sigmoid(soup.features), soup.mlp, raster, scene.background)
            images.append(colour[0].permute(1, 2, 0).numpy())
    return np.stack(images)
