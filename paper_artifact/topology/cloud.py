"""The live cloud as the loss sees it: checked, divided by the frame's diagonal, and with noise where a
condition asks for it.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream

FLAT = 1e-12  # smallest over largest singular value below which a cloud counts as coplanar


class Frame(Protocol):
    """What a loss acts towards, as far as the cloud is concerned: a bundle, or a statement in words."""

    @property
    def diagonal(self) -> float:
        """The unit of births and deaths, world units."""

    def require_density(self, samples: int) -> None:
        """Raise InputError unless the loss may sample this many points."""


def check_cloud(cloud: np.ndarray, frame: Frame) -> np.ndarray:
    """Return `cloud` (M,3), world units, as float64 divided by the frame's diagonal.

    Raises InputError for another density than the frame's, fewer than 4 points, coplanar points, or NaN.
    """
    cloud = np.asarray(cloud, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) < 4:
        raise InputError(
            f"the loss needs at least 4 points of shape (M, 3), got {cloud.shape}; draw more samples"
        )
    if not np.isfinite(cloud).all():
        raise InputError(
            "the live points hold a coordinate that is not finite; lower the learning rate or remove them"
        )
    frame.require_density(len(cloud))
    spread = np.linalg.svd(cloud - cloud.mean(axis=0), compute_uv=False)
    if spread[-1] <= FLAT * spread[0]:
        raise InputError(
            "all live points lie in one plane: no alpha complex in space; check the geometry they sample"
        )
    return cloud / frame.diagonal


def noisy(cloud: np.ndarray, noise: float, seed: int, counter: int) -> np.ndarray:
    """Return `cloud` (M,3), divided by the diagonal, plus Gaussian noise of deviation `noise`, a function of
    (seed, counter).
    """
    if noise == 0:
        return cloud
    return cloud + noise * stream(seed, "topology-noise", counter).standard_normal(cloud.shape)
