"""OpenCV's lens distortion, taken out of pictures: the pinhole picture of the same camera, enlarged so far
that no corner stays empty.

https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html: radial k1, k2, k3, tangential p1, p2.
"""

from __future__ import annotations

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from paper_artifact.arithmetic import exp, log
from paper_artifact.scene.cameras import Camera

DISTORTION = ("k1", "k2", "k3", "p1", "p2")
MOST_ZOOM = 4.0
STEPS = 64  # along a side and along a ray, where a picture is checked


def bent(x: np.ndarray, y: np.ndarray, distortion: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return where the lens shows the rays (x, y, 1), in the same unit; distortion: as in DISTORTION."""
    k1, k2, k3, p1, p2 = distortion
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
    )


def least_zoom(lens: Camera, distortion: tuple[float, ...]) -> float | None:
    """Return the least enlargement, at least 1, whose undistorted picture the distorted one fills; None where
    the lens folds the picture, or more than MOST_ZOOM would be needed."""
    side = np.linspace(0, 1, STEPS + 1)
    u = np.concatenate([side, side, 0 * side, 0 * side + 1]) * lens.width
    v = np.concatenate([0 * side, 0 * side + 1, side, side]) * lens.height
    for zoom in exp(log(MOST_ZOOM) * np.arange(200) / 199).tolist():
        left, top = _source(lens, distortion, zoom, u, v)
        if min(left.min(), top.min()) < 0 or left.max() > lens.width or top.max() > lens.height:
            continue
        across = lens.centre_x + (u - lens.centre_x)[:, None] * side
        down = lens.centre_y + (v - lens.centre_y)[:, None] * side
        left, top = _source(lens, distortion, zoom, across, down)
        outward = np.diff((left - lens.centre_x) ** 2 + (top - lens.centre_y) ** 2, axis=1)
        return zoom if (outward >= 0).all() else None
    return None


def undistorted(
    image: Image.Image, lens: Camera, straight: Camera, distortion: tuple[float, ...]
) -> Image.Image:
    """Return the picture of the pinhole camera `straight`, of the same size, from that of the `lens`."""
    rows, columns = np.indices(image.size[::-1]) + 0.5
    left, top = _source(lens, distortion, straight.focal_x / lens.focal_x, columns, rows)
    pixels = np.asarray(image)
    channels = [
        map_coordinates(pixels[..., channel], (top - 0.5, left - 0.5), order=1, mode="nearest")
        for channel in range(pixels.shape[2])
    ]
    return Image.fromarray(np.stack(channels, axis=2))


def _source(
    lens: Camera, distortion: tuple[float, ...], zoom: float, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the distorted picture shows pixels (u, v) of the undistorted one, `zoom` times larger."""
    x, y = bent(
        (u - lens.centre_x) / (lens.focal_x * zoom), (v - lens.centre_y) / (lens.focal_y * zoom), distortion
    )
    return x * lens.focal_x + lens.centre_x, y * lens.focal_y + lens.centre_y
