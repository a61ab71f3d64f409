"""Visual hull: where a surface can be, as the outlines in many views allow (Laurentini, 1994); a cloud on
it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.scene.cameras import Camera

COARSE, FINE = (
    48,
    144,
)  # cells per side of the box that is carved: first to find the hull, then to find its skin


def hull_cloud(
    cameras: Sequence[Camera], masks: Sequence[np.ndarray], count: int, draws: np.random.Generator
) -> np.ndarray:
    """Return points (count,3) float64, world units, in the cells of the visual hull's skin.

    masks: one (H,W) bool per camera and of its size, True where the object may be; outside of a picture
    nothing is known, and what half of them do not show is left out. Every skin cell gets as many points as
    any other, up to one. Raises InputError when the outlines leave nothing, which a wrong pose or mask does.
    """
    centre, half = view_box(cameras)
    low, high = centre - half, centre + half
    for cells in (COARSE, FINE):
        step = (high - low) / cells
        inside = _carved(low, step, cells, cameras, masks, step.max() if cells == COARSE else 0.0)
        if not inside.any():
            raise InputError(
                "the outlines of the views leave no room for an object; check the poses and the images' "
                "transparency, or take --cloud random"
            )
        if cells == COARSE:
            taken = np.argwhere(inside)
            low, high = low + (taken.min(0) - 1) * step, low + (taken.max(0) + 2) * step
    padded = np.pad(inside, 1)
    buried = inside.copy()
    for axis in range(3):
        for turn in (-1, 1):
            buried &= np.roll(padded, turn, axis)[1:-1, 1:-1, 1:-1]
    skin = np.argwhere(inside & ~buried)
    rounds = -(-count // len(skin))
    chosen = np.concatenate([draws.permutation(len(skin)) for _ in range(rounds)])[:count]
    return low + (skin[chosen] + draws.random((count, 3))) * step


def view_box(cameras: Sequence[Camera]) -> tuple[np.ndarray, float]:
    """Return (centre (3,), half side) of a cube that holds what all the cameras look at, world units.

    The centre is nearest to all optical axes; the half side reaches to the edges of the widest view there.
    Raises InputError for parallel axes, which have no such point.
    """
    axes = np.stack([camera.rotation[2] for camera in cameras])
    positions = np.stack([camera.position for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    system = across.sum(0)
    if np.linalg.cond(system) > 1e6:
        raise InputError(
            "the cameras look along one direction, which leaves depth open; use views from around"
        )
    centre = np.linalg.solve(system, (across @ positions[:, :, None]).sum(0))[:, 0]
    reach = [
        np.linalg.norm(centre - position)
        * max(camera.width / camera.focal_x, camera.height / camera.focal_y)
        / 2
        for camera, position in zip(cameras, positions, strict=True)
    ]
    return centre, float(max(reach))


def _carved(
    low: np.ndarray,
    step: np.ndarray,
    cells: int,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    blur: float,
) -> np.ndarray:
    """Return which cells (cells,)*3 bool no view rules out and at least half of the views show.

    blur: distance (world units) that a cell's middle may miss an outline by.
    """
    index = np.indices((cells,) * 3).reshape(3, -1).T
    points = low + (index + 0.5) * step
    left = np.arange(len(points))
    shown = np.zeros(len(points), np.int64)
    for camera, mask in zip(cameras, masks, strict=True):
        seen = points[left] @ camera.rotation.T + np.asarray(camera.translation)
        depth = np.maximum(seen[:, 2], 1e-12)
        column = np.floor(camera.focal_x * seen[:, 0] / depth + camera.centre_x).astype(np.int64)
        row = np.floor(camera.focal_y * seen[:, 1] / depth + camera.centre_y).astype(np.int64)
        known = (
            (seen[:, 2] > 0) & (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        )
        wide = _grown(mask, int(np.ceil(blur * camera.focal_x / depth.min()))) if blur else mask
        shown[left] += known
        known[known] = ~wide[row[known], column[known]]
        left = left[~known]
    inside = np.zeros(cells**3, bool)
    inside[left[2 * shown[left] >= len(cameras)]] = True
    return inside.reshape((cells,) * 3)


def _grown(mask: np.ndarray, radius: int) -> np.ndarray:
    """Return the mask grown by a square of `radius` pixels."""
    from scipy.ndimage import maximum_filter

    return maximum_filter(mask, size=2 * min(radius, max(mask.shape)) + 1)
