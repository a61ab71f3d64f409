"""What pictures say of a soup: PSNR and SSIM in double precision, data range 1; which points they show.

SSIM is that of `paper_artifact.ssim`, per colour channel, then the mean over windows and channels.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

from paper_artifact.arithmetic import log
from paper_artifact.errors import InputError, as_numbers
from paper_artifact.raster.view import ViewRaster, to_clip
from paper_artifact.sampling import sample_soup
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup, render_views
from paper_artifact.ssim import RADIUS, WINDOW, gaussian_window, similarity

LOWEST_MSE = 1e-10  # PSNR at most 100 dB, so that a record never holds an infinity
SEEN_IN = 3  # training views that must show a point of the surface; chosen in data_scripts/measure/seen.py
DRAWN = 8  # points that are drawn for each that is wanted: in the study a third to two thirds are seen


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Return the PSNR in dB of `image` against `truth`, both (H,W,3) float in [0,1]; 100 dB for equal images.

    Raises InputError when the shapes differ.
    """
    image, truth = _pair(image, truth)
    return float(-10 / log(10.0) * log(max(np.mean((image - truth) ** 2), LOWEST_MSE)))


def ssim(image: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean SSIM of `image` against `truth`, both (H,W,3) float in [0,1], H and W at least 11.

    Raises InputError when the shapes differ or a side is shorter than the window.
    """
    image, truth = _pair(image, truth)
    if min(image.shape[:2]) < WINDOW:
        raise InputError(
            f"SSIM needs images of at least {WINDOW} pixels a side, got {image.shape[1]}×{image.shape[0]}"
        )
    return float(np.mean(similarity(image, truth, _blur)))


def image_scores(images: np.ndarray, truth: np.ndarray) -> dict:
    """Return {"psnr", "ssim": means over views, "views": [[psnr, ssim], ...]} of (n,H,W,3) stacks in [0,1].

    The mean PSNR is the mean of the views' dB values, the habit of the radiance-field literature.
    Raises InputError for no views or differing shapes.
    """
    images, truth = (as_numbers(each, "the images", "give (n,H,W,3)") for each in (images, truth))
    if images.shape != truth.shape or images.ndim != 4 or not len(images):
        raise InputError(
            f"image stacks must be equal and (n,H,W,3) with n > 0, got {images.shape} and {truth.shape}"
        )
    views = [[psnr(one, other), ssim(one, other)] for one, other in zip(images, truth, strict=True)]
    means = np.mean(views, axis=0)
    return {"psnr": float(means[0]), "ssim": float(means[1]), "views": views}


def view_scores(soup: Soup, scene: Scene, views: np.ndarray, supersample: int = 1) -> dict:
    """Return `image_scores` of a soup's renders of the scene's `views` (indices), one view in memory at a
    time. supersample: see `render_views`.

    Raises InputError for no views.
    """
    if not len(views):
        raise InputError(f"{scene.path} holds no view out, so there is nothing to score")
    each = [
        image_scores(render_views(soup, scene, [view], supersample), scene.colours([view])) for view in views
    ]
    pairs = [pair for scores in each for pair in scores["views"]]
    means = np.mean(pairs, axis=0)
    return {"psnr": float(means[0]), "ssim": float(means[1]), "views": pairs}


def views_that_show(soup: Soup, scene: Scene, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return in how many training views each point on a soup is visible, (n,) int64.

    points (n,3) float, world units of the scene, each on the triangle (n,) int of the soup. A view shows a
    point where its triangle is the visible one at the point's pixel, at the threshold .5.
    """
    drawn, (height, width) = soup.drawn(), scene.images.shape[-2:]
    view, times = ViewRaster(height, width), np.zeros(len(points), np.int64)
    for matrix in scene.world_to_clip[scene.train]:
        view.draw(to_clip(drawn.vertices, matrix), drawn.opacity, None)
        clip = to_clip(points.astype(np.float32), matrix)
        ahead = np.flatnonzero(clip[:, 3] > 0)
        column, row = np.floor((clip[ahead, :2] / clip[ahead, 3:] + 1) / 2 * (width, height)).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        ahead, column, row = ahead[inside], column[inside].astype(int), row[inside].astype(int)
        times[ahead] += view.seen()[row, column] == triangles[ahead] + 1
    return times


def seen_samples(
    soup: Soup, opacity: np.ndarray, scene: Scene, count: int, generator: np.random.Generator
) -> np.ndarray:
    """Return `count` points (count,3) float64 of what the pictures show of a soup, world units of the scene.

    They are the first of DRAWN times as many from `sample_soup` with `opacity` (T,3), the soup's own or 0
    where nothing is wanted, that SEEN_IN training views show. No ground truth is asked; what lies hidden
    inside a body is left out. Raises InputError where fewer are seen.
    """
    points, triangles, _ = sample_soup(soup.vertices.detach().numpy(), opacity, DRAWN * count, generator)
    points = points[views_that_show(soup, scene, points, triangles) >= SEEN_IN]
    if len(points) < count:
        raise InputError(
            f"{len(points)} of {DRAWN * count} points of the soup are seen in {SEEN_IN} views of "
            f"{scene.path}; give the scene that the soup was trained on, train it further, or take more views"
        )
    return points[:count]


def _pair(image: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    image, truth = (
        as_numbers(each, "the images", "give (H,W,3)").astype(np.float64) for each in (image, truth)
    )
    if image.shape != truth.shape or image.ndim != 3:
        raise InputError(
            f"the two images must have one shape (H,W,channels), got {image.shape} and {truth.shape}"
        )
    return image, truth


def _blur(image: np.ndarray) -> np.ndarray:
    """Return the window means (H - WINDOW + 1, W - WINDOW + 1, channels) of (H,W,channels) float64."""
    for axis in (0, 1):
        image = correlate1d(image, gaussian_window(), axis=axis, mode="constant")
    return image[RADIUS:-RADIUS, RADIUS:-RADIUS]
