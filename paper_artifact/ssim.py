"""The structural similarity index (SSIM): one definition for the twin's loss and for the evaluation.

Wang et al. 2004: an 11×11 Gaussian window of σ = 1.5 pixels, data range 1, over windows that lie inside the
image only. That is what pytorch-msssim computes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from paper_artifact.arithmetic import exp

WINDOW = 11  # side of the window, pixels
RADIUS = WINDOW // 2
SIGMA = 1.5  # pixels
C1, C2 = 0.01**2, 0.03**2  # (K L)² of the paper, at data range L = 1


def gaussian_window() -> list[float]:
    """Return the window's WINDOW weights along one axis, from the first to the last pixel; their sum is 1."""
    weights = exp([-((place - RADIUS) ** 2) / (2 * SIGMA**2) for place in range(WINDOW)]).tolist()
    return [weight / sum(weights) for weight in weights]


def similarity(x: Any, y: Any, blur: Callable[[Any], Any]) -> Any:
    """Return the SSIM of every window of two images in [0,1], numpy arrays or torch tensors of any one
    layout.

    blur: an image → its Gaussian-weighted mean over every window.
    """
    mean_x, mean_y = blur(x), blur(y)
    variance_x, variance_y = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    structure = (2 * covariance + C2) / (variance_x + variance_y + C2)
    return luminance * structure
