"""A dirty point cloud brought near to its surface, so that bars born of noise stay as short as on clean ones.

    cloud = cleaned(points)        # points of structure from motion or of a scanner

Without a ground truth: points far from their neighbours are left out, each other point is projected onto the
plane of its neighbours, and who is lonely now goes too. Gaps stay: only images can close them. Averaging over
neighbours instead draws the points together along the surface too: its floor falls, and noise-born bars reach
.7 of it (`data_scripts/measure/dirty.py`).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact.errors import InputError

LONELY = 3.0  # a point is left out where its neighbours are that many times as far as the median point's
NEAR, PLANE = 16, 32  # neighbours that say whether a point is lonely, and that span its plane


def trimmed(points: np.ndarray, neighbours: int = NEAR, factor: float = LONELY) -> np.ndarray:
    """Return the `points` (n,3) whose mean distance to their nearest `neighbours` is below `factor` times the
    median of all; any unit, order kept."""
    count = min(neighbours + 1, len(points))
    distance = cKDTree(points).query(points, k=count)[0][:, 1:].mean(axis=1)
    return points[distance <= factor * np.median(distance)]


def projected(points: np.ndarray, neighbours: int = PLANE) -> np.ndarray:
    """Return `points` (n,3), each moved onto the plane that fits its nearest `neighbours` best; any unit."""
    _, nearest = cKDTree(points).query(points, k=min(neighbours, len(points)))
    patches = points[nearest]
    centres = patches.mean(axis=1)
    patches = patches - centres[:, None]
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))
    normals = axes[:, :, 0]  # of the smallest extent
    height = ((points - centres) * normals).sum(axis=1)
    return points - height[:, None] * normals


def cleaned(points: np.ndarray) -> np.ndarray:
    """Return `points` (n,3) trimmed, projected, trimmed again: (m,3) float64, m <= n, in their own unit.

    Raises InputError for fewer than 4 points or a coordinate that is not finite.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
        raise InputError(f"cleaning needs at least 4 finite points of shape (n, 3), got {points.shape}")
    return trimmed(projected(trimmed(points)))
