"""A soup's start: one small triangle per chosen point of the SfM cloud (DiffSoup, initialisation)."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from paper_artifact import arithmetic
from paper_artifact.errors import InputError
from paper_artifact.kernel_cache import njit
from paper_artifact.randomness import stream
from paper_artifact.raster.arrays import FEATURES
from paper_artifact.soup.state import Soup, initial_mlp

RANDOM_PART = 1.0 / 3.0  # DiffSoup takes 10,000 farthest points and 5,000 random ones
RADIUS_OF_SPACING = 0.25  # a first triangle's circumradius ÷ mean spacing of the centres


@njit(cache=True, nogil=True)
def farthest_points(points, count, first):
    """Return `count` indices (int64) of points (n,3) float64, each farthest from those before it, starting at
    `first`."""
    chosen = np.empty(count, np.int64)
    distance = np.full(len(points), np.inf)
    current = first
    for k in range(count):
        chosen[k] = current
        best, best_distance = 0, -1.0
        for i in range(len(points)):
            d = (
                (points[i, 0] - points[current, 0]) ** 2
                + (points[i, 1] - points[current, 1]) ** 2
                + (points[i, 2] - points[current, 2]) ** 2
            )
            if d < distance[i]:
                distance[i] = d
            if distance[i] > best_distance:
                best, best_distance = i, distance[i]
        current = best
    return chosen


def initial_soup(points: np.ndarray, count: int, seed: int, importance: np.ndarray | None = None) -> Soup:
    """Return a soup of min(count, n) triangles on points (n,3), world frame.

    Two thirds of the points are a farthest-point subsample, one third is random among the rest: uniformly, or
    with probability proportional to `importance` (n,) >= 0 (arm B1 of the allocation study). Each triangle is
    equilateral with uniformly random orientation and circumradius .25 × the mean nearest-neighbour spacing of
    the chosen points; logits start at zero. Raises InputError for fewer than two points or triangles, points
    that are not finite, or points that all coincide.
    """
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError(
            f"the SfM cloud must hold at least two finite points, got shape {points.shape}; "
            "check the scene's points3D"
        )
    if count < 2:
        raise InputError(
            f"a soup starts with at least two triangles, got {count}; the spacing of one point is not defined"
        )
    count = min(count, len(points))
    draws = stream(seed, "initial-soup")
    chosen = farthest_points(points, count - int(count * RANDOM_PART), int(draws.integers(len(points))))
    rest = np.setdiff1d(np.arange(len(points)), chosen)
    if importance is None:
        others = draws.permutation(rest)[: count - len(chosen)]
    else:
        # Gumbel's trick: the largest log w + G are a draw without replacement with probabilities proportional
        # to w.
        gumbel = -arithmetic.log(-arithmetic.log(np.maximum(draws.random(len(rest)), 2.0**-53)))
        keys = arithmetic.log(np.maximum(importance[rest], np.finfo(np.float64).tiny)) + gumbel
        others = rest[np.argsort(-keys, kind="stable")[: count - len(chosen)]]
    chosen = np.concatenate([chosen, others])
    centres = points[chosen]
    spacing = cKDTree(centres).query(centres, k=2)[0][:, 1].mean()
    if not spacing > 0:
        raise InputError("all points of the SfM cloud coincide; check the scene's points3D")
    high = np.sqrt(0.75)
    base = np.array([[1.0, 0.0, 0.0], [-0.5, high, 0.0], [-0.5, -high, 0.0]]) * (RADIUS_OF_SPACING * spacing)
    rotation = arithmetic.quaternion_matrix(arithmetic.normals(draws, count, 4))
    corners = centres[:, None] + arithmetic.dot(rotation[:, None], base[:, None])
    return Soup(
        torch.from_numpy(corners.astype(np.float32)),
        torch.zeros(count, 3, FEATURES),
        torch.zeros(count, 3),
        initial_mlp(seed),
    ).trainable()
