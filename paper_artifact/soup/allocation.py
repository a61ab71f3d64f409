"""A prior's two levers in the resampler (paper App. A): protection from pruning, and respawn where importance
is high.

Strict budget parity: whatever the prior does, a resampling ends with exactly as many triangles as DiffSoup's
own rule would leave of the same pruned soup.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from paper_artifact.config import AllocationConfig, RunConfig
from paper_artifact.errors import InputError
from paper_artifact.soup.resample import PruneWeight, Resampler, RespawnChoice, plain_resampler

Importance = Callable[[np.ndarray], np.ndarray]  # points (n,3), world → importance (n,) in [0, 1]
QUANTILE = 0.9  # of the visible-pixel counts: what importance 1 is worth, times λ


def protective_order(importance: Importance, protection: float) -> PruneWeight:
    """Return the prune order vis + λ · Q.9(vis) · importance at the triangles' centroids; protection: λ ≥
    0."""

    def order(corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
        worth = protection * np.quantile(counts, QUANTILE)
        return counts + worth * importance(corners.mean(axis=1))

    return order


def most_important(importance: Importance, count: int) -> RespawnChoice:
    """Return the choice of the `count` visible triangles of the highest importance at their centroids, ties
    by index."""

    def choice(corners: np.ndarray, visible: np.ndarray) -> np.ndarray:
        rows = np.flatnonzero(visible)
        values = importance(corners[rows].mean(axis=1))
        return np.sort(rows[np.argsort(-values, kind="stable")[:count]])

    return choice


def allocating_resampler(
    config: RunConfig, allocation: AllocationConfig, importance: Importance
) -> Resampler:
    """Return the run's resampler with both levers of its allocation.

    Raises InputError when the share that is subdivided is less than one triangle of the budget.
    """
    count = round(allocation.subdivided * config.budget)
    if allocation.subdivided > 0 and count < 1:
        raise InputError(
            f"the budget of {config.budget} triangles is smaller than the protected share "
            f"{allocation.subdivided} asks for; raise the budget or set subdivided to 0"
        )
    return replace(
        plain_resampler(config),
        prune_weight=protective_order(importance, allocation.protection),
        respawn=most_important(importance, count) if count else None,
    )
