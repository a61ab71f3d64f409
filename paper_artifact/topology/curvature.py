"""Curvature weights of the plan's pulls: condition C4, which the paper defers and leaves undefined.

The definition here is this artifact's own. The curvature of a sample is the surface variation of its 16
nearest samples, the smallest share λ0 / (λ0 + λ1 + λ2) of their covariance's eigenvalues (Pauly, Gross &
Kobbelt 2002); a pull's weight is the mean over the corners of its two simplices, divided by the mean over the
cloud and clipped to [1/4, 4]. Weights are frozen with the plan.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

NEIGHBOURS = 16  # samples that make a sample's curvature
CLIP = (0.25, 4.0)  # least and largest weight


def surface_variation(cloud: np.ndarray, indices: np.ndarray, neighbours: int = NEIGHBOURS) -> np.ndarray:
    """Return the surface variation (n,), in [0, 1/3], 0 on a plane, at rows `indices` (n,) of `cloud`
    (M,3).
    """
    _, near = cKDTree(cloud).query(cloud[indices], k=min(neighbours, len(cloud)))
    centred = cloud[near] - cloud[near].mean(axis=1, keepdims=True)
    eigenvalues = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", centred, centred))
    total = eigenvalues.sum(axis=1)
    return np.where(total > 0, np.maximum(eigenvalues[:, 0], 0.0) / np.where(total > 0, total, 1.0), 0.0)


def pair_weights(cloud: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the weights (n,) of pulls with corner samples `corners` (n,c) int64, negative where there is
    none.

    1 for each when the whole cloud is flat.
    """
    variation = surface_variation(cloud, np.arange(len(cloud)))
    mean = variation.mean()
    if mean <= 0:
        return np.ones(len(corners))
    present = corners >= 0
    total = np.zeros(len(corners))
    for column, there in zip(corners.T, present.T, strict=True):  # corner by corner: one order of summation
        total += np.where(there, variation[column], 0.0)
    return np.clip(total / present.sum(axis=1) / mean, *CLIP)
