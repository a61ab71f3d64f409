"""Image scores: PSNR and SSIM in double precision, data range 1.

SSIM follows Wang et al. 2004 with an 11×11 Gaussian window (σ = 1.5), C1 = .01², C2 = .03², per colour channel, over windows
that lie inside the image only ("valid": no padding, an (H-10)×(W-10) map), then the mean over map and channels. That is
what pytorch-msssim computes, and what the trainer's loss uses.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

from paper_artifact.errors import InputError

WINDOW = 11
SIGMA = 1.5
LOWEST_MSE = 1e-10  # PSNR at most 100 dB, so that a record never holds an infinity


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Return the PSNR in dB of `image` against `truth`, both (H,W,3) float in [0,1]; equal images give 100 dB.

    Raises InputError when the shapes differ.
    """
    image, truth = _pair(image, truth)
    return float(-10 * np.log10(max(np.mean((image - truth) ** 2), LOWEST_MSE)))


def ssim(image: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean SSIM of `image` against `truth`, both (H,W,3) float in [0,1], H and W at least 11.

    Raises InputError when the shapes differ or a side is shorter than the window.
    """
    image, truth = _pair(image, truth)
    if min(image.shape[:2]) < WINDOW:
        raise InputError(
            f"SSIM needs images of at least {WINDOW} pixels a side, got {image.shape[1]}×{image.shape[0]}"
        )
    mean_x, mean_y = _blur(image), _blur(truth)
    var_x = _blur(image * image) - mean_x**2
    var_y = _blur(truth * truth) - mean_y**2
    covariance = _blur(image * truth) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    structure = (2 * covariance + c2) / (var_x + var_y + c2)
    return float(np.mean(luminance * structure))


def image_scores(images: np.ndarray, truth: np.ndarray) -> dict:
    """Return {"psnr", "ssim": means over views, "views": [[psnr, ssim], ...]} of (n,H,W,3) stacks in [0,1].

    The mean PSNR is the mean of the views' dB values, the habit of the radiance-field literature.
    Raises InputError for no views or differing shapes.
    """
    images, truth = np.asarray(images), np.asarray(truth)
    if images.shape != truth.shape or images.ndim != 4 or not len(images):
        raise InputError(
            f"image stacks must be equal and (n,H,W,3) with n > 0, got {images.shape} and {truth.shape}"
        )
    views = [[psnr(one, other), ssim(one, other)] for one, other in zip(images, truth)]
    means = np.mean(views, axis=0)
    return {"psnr": float(means[0]), "ssim": float(means[1]), "views": views}


def _pair(image: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    image, truth = np.asarray(image, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if image.shape != truth.shape or image.ndim != 3:
        raise InputError(
            f"the two images must have one shape (H,W,channels), got {image.shape} and {truth.shape}"
        )
    return image, truth


def _blur(image: np.ndarray) -> np.ndarray:
    """Return the Gaussian window means (H-10, W-10, channels) of (H,W,channels) float64."""
    offsets = np.arange(WINDOW) - WINDOW // 2
    weights = np.exp(-(offsets**2) / (2 * SIGMA**2))
    weights /= weights.sum()
    half = WINDOW // 2
    for axis in (0, 1):
        image = correlate1d(image, weights, axis=axis, mode="constant")
    return image[half : image.shape[0] - half, half : image.shape[1] - half]
