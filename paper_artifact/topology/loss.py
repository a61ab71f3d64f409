"""The topology loss for a point tensor, usable alone.

    bundle = build_bundle(target_points, diagonal)
    loss = TopologyLoss(bundle)
    loss(points).backward()            # points (M,3), requires_grad; the plan is refreshed every 10 calls

Paper §3: L_topo of births and deaths (radius / diagonal, dimensionless) under a plan that is frozen between
refreshes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from paper_artifact.config import LossConfig, with_changes
from paper_artifact.errors import InputError
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.cloud import Frame, check_cloud, noisy
from paper_artifact.topology.plan import Plan, build_plan


class PlannedLoss(ABC):
    """A loss of M points whose plan is refreshed every few calls; what it aims at is a subclass's.

    defaults, settings: its LossConfig and what is changed in it; seed: of the noise that only the plan sees.
    Raises InputError for an unknown setting, one out of range, or the fallback "denser", which needs a
    surface.
    """

    def __init__(self, defaults: LossConfig, settings: Mapping[str, Any], seed: int) -> None:
        self.config, self.seed = with_changes(defaults, settings), seed
        if self.config.fallback == "denser":
            raise InputError(
                "the fallback 'denser' samples a surface again, and raw points have none; choose another"
            )
        self.plan: Plan | None = None
        self._calls = self._refreshes = 0

    @abstractmethod
    def frame(self, points: np.ndarray) -> Frame:
        """Return what the loss acts towards; points (M,3), world units, those of a refresh."""

    @abstractmethod
    def make(self, cloud: np.ndarray) -> Plan:
        """Return the plan of `cloud` (M,3), divided by the frame's diagonal."""

    def refresh(self, points: Tensor | np.ndarray) -> Plan:
        """Make the plan of `points` (M,3), world units, and return it.

        Raises InputError when M is not the bundle's, for fewer than 4 points, coplanar ones, or a coordinate
        that is not finite.
        """
        cloud = points.detach().cpu().numpy() if isinstance(points, Tensor) else np.asarray(points)
        frame = self.frame(cloud)
        seen = noisy(check_cloud(cloud, frame), self.config.noise, self.seed, self._refreshes)
        self.plan, self._diagonal = self.make(seen), frame.diagonal
        self._refreshes += 1
        self._calls = 0
        return self.plan

    def __call__(self, points: Tensor) -> Tensor:
        """Return the loss (scalar, dtype of `points`) at `points` (M,3) floating point, world units.

        Differentiable once. Raises InputError as `refresh` does, and when refresh_every is 0 and `refresh`
        was never called.
        """
        if not points.is_floating_point() or points.ndim != 2 or points.shape[1] != 3:
            raise InputError(
                "the loss needs floating-point points of shape (M, 3), "
                f"got {points.dtype} {tuple(points.shape)}"
            )
        every, plan = self.config.refresh_every, self.plan
        if plan is None and not every:
            raise InputError("no plan yet: call refresh(points) first, or give refresh_every > 0")
        if plan is None or (every and self._calls >= every):
            plan = self.refresh(points)
        self._calls += 1
        if len(points) != plan.samples:
            raise InputError(
                f"the plan was made on {plan.samples} points, got {len(points)}; call refresh(points)"
            )
        used = points[plan.used.to(points.device)].cpu().double() / self._diagonal
        return plan.value(used).to(device=points.device, dtype=points.dtype)


class TopologyLoss(PlannedLoss):
    """Matched persistence loss of M points against a bundle.

    seed: of the noise that only the plan sees; settings: fields of `paper_artifact.config.LossConfig`, for
    example refresh_every=0 (only `refresh` makes a plan) or noise=.005. Raises InputError for an unknown
    setting, one out of range, or the fallback "denser", which needs a surface.
    """

    def __init__(self, bundle: Bundle, *, seed: int = 0, **settings: Any) -> None:
        super().__init__(LossConfig(samples=bundle.samples), settings, seed)
        self.bundle = bundle

    def frame(self, points: np.ndarray) -> Bundle:
        """Return the bundle."""
        return self.bundle

    def make(self, cloud: np.ndarray) -> Plan:
        """Return the plan of `cloud` (M,3), divided by the bundle's diagonal."""
        return build_plan(cloud, self.bundle, self.config)
