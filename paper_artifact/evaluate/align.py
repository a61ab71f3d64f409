"""Two frames of one scene: the similarity between them, from points that correspond."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from paper_artifact.errors import InputError


class Similarity(NamedTuple):
    """y = scale · rotation @ x + shift."""

    scale: float  # units of y per unit of x
    rotation: np.ndarray  # (3,3) float64, a proper rotation
    shift: np.ndarray  # (3,) float64, units of y

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Return points (…,3) of x's frame in y's frame, float64."""
        return self.scale * points @ self.rotation.T + self.shift


def similarity(x: np.ndarray, y: np.ndarray) -> Similarity:
    """Return the similarity that takes points x (n,3) to y (n,3) with the least sum of squared distances.

    Umeyama's closed form (PAMI 1991). Raises InputError for fewer than three pairs, or points on one line,
    which leave a turn open.
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if x.shape != y.shape or x.ndim != 2 or x.shape[1] != 3 or len(x) < 3:
        raise InputError(f"a similarity needs at least three pairs of points (n,3), got {x.shape}, {y.shape}")
    middle_x, middle_y = x.mean(0), y.mean(0)
    left, strength, right = np.linalg.svd((y - middle_y).T @ (x - middle_x) / len(x))
    if strength[1] <= 1e-9 * max(strength[0], np.finfo(float).tiny):
        raise InputError("the points lie on one line, so the turn about it is open; give others")
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = left @ np.diag(signs) @ right
    scale = float((strength * signs).sum() / ((x - middle_x) ** 2).sum(1).mean())
    return Similarity(scale, rotation, middle_y - scale * rotation @ middle_x)
