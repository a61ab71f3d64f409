"""The topology loss for a point tensor, usable alone.

    bundle = build_bundle(target_points, diagonal)
    loss = TopologyLoss(bundle)
    loss(points).backward()            # points (M,3), requires_grad; the plan is refreshed every 10 calls

Paper §3: L_topo of births and deaths (radius / diagonal, dimensionless) under a plan that is frozen between refreshes.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.plan import Plan, PlanOptions, build_plan


class TopologyLoss:
    """Matched persistence loss of M points against a bundle.

    refresh_every: calls between two refreshes of the plan (the paper's K = 10; 0: only `refresh` makes one). noise: standard
    deviation, as a fraction of the diagonal, of the Gaussian noise that only the plan sees (C7: .005, C7h: .01). seed: of that
    noise. Further options: `PlanOptions`. Raises InputError for an unknown option or fallback "denser", which needs a surface.
    """

    def __init__(
        self, bundle: Bundle, *, refresh_every: int = 10, noise: float = 0.0, seed: int = 0, **options
    ) -> None:
        self.bundle = bundle
        self.options = PlanOptions(**options)
        if self.options.fallback == "denser":
            raise InputError(
                "the fallback 'denser' samples a surface again, and raw points have none; choose another fallback"
            )
        if not noise >= 0 or refresh_every < 0:
            raise InputError(f"noise and refresh_every must not be negative, got {noise} and {refresh_every}")
        self.refresh_every, self.noise, self.seed = refresh_every, noise, seed
        self.plan: Plan | None = None
        self._calls = self._refreshes = 0

    def refresh(self, points: Tensor | np.ndarray) -> Plan:
        """Make the plan of `points` (M,3), world units, and return it.

        Raises InputError when M is not the bundle's, for fewer than 4 points, or for a coordinate that is not finite.
        """
        cloud = points.detach().cpu().numpy() if isinstance(points, Tensor) else points
        cloud = check_cloud(cloud, self.bundle)
        self.plan = build_plan(
            noisy(cloud, self.noise, self.seed, self._refreshes), self.bundle, self.options
        )
        self._refreshes += 1
        self._calls = 0
        return self.plan

    def __call__(self, points: Tensor) -> Tensor:
        """Return the loss (scalar, dtype of `points`) at `points` (M,3) floating point, world units; differentiable once.

        Raises InputError as `refresh` does, and when refresh_every is 0 and `refresh` was never called.
        """
        if not points.is_floating_point() or points.ndim != 2 or points.shape[1] != 3:
            raise InputError(
                f"the loss needs floating-point points of shape (M, 3), got {points.dtype} {tuple(points.shape)}"
            )
        if self.plan is None or (self.refresh_every and self._calls >= self.refresh_every):
            if self.plan is None and not self.refresh_every:
                raise InputError("no plan yet: call refresh(points) first, or give refresh_every > 0")
            self.refresh(points)
        self._calls += 1
        if len(points) != self.plan.samples:
            raise InputError(
                f"the plan was made on {self.plan.samples} points, got {len(points)}; call refresh(points)"
            )
        used = points[self.plan.used.to(points.device)].cpu().double() / self.bundle.diagonal
        return self.plan.value(used).to(device=points.device, dtype=points.dtype)


def check_cloud(cloud: np.ndarray, bundle: Bundle) -> np.ndarray:
    """Return `cloud` (M,3), world units, as float64 divided by the bundle's diagonal.

    Raises InputError for another density than the bundle's, fewer than 4 points, coplanar points, or NaN.
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
    bundle.require_density(len(cloud))
    spread = np.linalg.svd(cloud - cloud.mean(axis=0), compute_uv=False)
    if spread[-1] <= 1e-12 * spread[0]:
        raise InputError(
            "all live points lie in one plane: no alpha complex in space; check the geometry the samples come from"
        )
    return cloud / bundle.diagonal


def noisy(cloud: np.ndarray, noise: float, seed: int, counter: int) -> np.ndarray:
    """Return `cloud` (M,3), divided by the diagonal, plus Gaussian noise of deviation `noise`, a function of (seed, counter)."""
    if noise == 0:
        return cloud
    return cloud + noise * stream(seed, "topology-noise", counter).standard_normal(cloud.shape)
