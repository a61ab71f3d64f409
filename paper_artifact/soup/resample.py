"""Prune and split: the resampler, an object that the training loop calls and never looks into.

Every `interval` steps: if the soup exceeds its budget, the least visible triangles go; then triangles with
long screen-space edges are split (DiffSoup's resampling). Two hooks let an allocation prior (paper App. A)
enter without touching the loop: `prune_weight` turns the visible-pixel counts into the order of pruning,
`respawn` names triangles to halve at an unchanged final count. Strict budget parity: a resampling ends with
exactly as many triangles as DiffSoup's own rule would leave of the same pruned soup.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from paper_artifact.config import AllocationConfig, RunConfig
from paper_artifact.errors import InputError, require_memory
from paper_artifact.randomness import stream
from paper_artifact.raster.threads import run_jobs
from paper_artifact.raster.view import ViewRaster, to_clip
from paper_artifact.soup.split import bisected, least_pieces, split_long_edges
from paper_artifact.soup.state import Soup

# of a triangle that splitting makes: 33 floats, their gradients and moments, two copies
BYTES_PER_PIECE = 600
# (corners (T,3,3), visible pixels (T,)) → priority (T,): the lowest goes first
PruneWeight = Callable[[np.ndarray, np.ndarray], np.ndarray]
# (corners (T,3,3), visible (T,) bool) → indices (k,) of the triangles to halve
RespawnChoice = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _by_visibility(corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return DiffSoup's order of pruning: the visible-pixel counts themselves."""
    return counts


@dataclass(frozen=True)
class Resampler:
    """DiffSoup's prune-and-split."""

    budget: int  # triangles kept by pruning
    interval: int = 100  # steps between two resamplings
    prune_until: float = 0.955  # fraction of the run's steps after which nothing is resampled
    split_until: float = 0.95  # fraction of the run's steps after which nothing is split
    split_views: int = 20  # views in which long edges are looked for
    split_height: float = 0.2  # fraction of the image height above which an edge is long
    strict: bool = False  # what splitting makes beyond the budget goes too, the least visible first
    prune_weight: PruneWeight = _by_visibility  # hook: the order of pruning
    respawn: RespawnChoice | None = None  # hook: which are halved whatever their size; None: none

    def due(self, step: int, steps: int) -> bool:
        """Return whether `step` (1-based) of `steps` ends with a resampling."""
        return step % self.interval == 0 and step < self.prune_until * steps

    def resample(
        self, soup: Soup, world_to_clip: np.ndarray, height: int, width: int, seed: int, step: int, steps: int
    ) -> tuple[Soup, dict[str, int]]:
        """Return the resampled soup and its numbers of triangles: "before", "pruned" (after pruning) and
        "after" (splitting too); world_to_clip (n,4,4) are the training views, height and width their full
        size.

        Raises InputError for a split that would take more memory than is available.
        """
        before = len(soup)
        half = (max(height // 2, 1), max(width // 2, 1))
        soup = self._pruned(soup, self.budget, world_to_clip, *half)
        pruned = len(soup)
        if step < self.split_until * steps:
            views = stream(seed, "split-views", step).permutation(len(world_to_clip))[: self.split_views]
            split = self._split(soup, world_to_clip[views], *half)
            # the plain rule's count is the cap: halves displace the least worthy
            if self.respawn is not None:
                counts = visible_pixels(soup, world_to_clip, *half).sum(0)
                halves, origins = bisected(_corners(soup), self.respawn(_corners(soup), counts > 0))
                halved = soup.select(torch.from_numpy(origins), torch.from_numpy(halves))
                more = self._split(halved, world_to_clip[views], *half)
                if len(more) > len(split):
                    split = self._pruned(more, len(split), world_to_clip, *half)
            soup = self._pruned(split, self.budget, world_to_clip, *half) if self.strict else split
        return soup, {"before": before, "pruned": pruned, "after": len(soup)}

    def _pruned(self, soup: Soup, count: int, world_to_clip: np.ndarray, height: int, width: int) -> Soup:
        """Return the `count` triangles that the order of pruning puts last, in their own order."""
        if len(soup) <= count:
            return soup
        counts = visible_pixels(soup, world_to_clip, height, width).sum(0)
        order = np.argsort(self.prune_weight(_corners(soup), counts), kind="stable")
        return soup.select(torch.from_numpy(np.sort(order[len(soup) - count :])))

    def _split(self, soup: Soup, world_to_clip: np.ndarray, height: int, width: int) -> Soup:
        visible = visible_pixels(soup, world_to_clip, height, width) > 0
        corners = _corners(soup)
        origins = np.arange(len(corners))
        for matrix, wanted in zip(world_to_clip.astype(np.float64), visible, strict=True):
            where = (wanted[origins], matrix, width / height, 2 * self.split_height)
            require_memory(
                BYTES_PER_PIECE * least_pieces(corners, *where),
                f"splitting all edges longer than {self.split_height:g} of the image height",
                "give a larger split_height",
            )
            corners, origins = split_long_edges(corners, origins, *where)
        if len(corners) == len(soup):
            return soup
        return soup.select(torch.from_numpy(origins), torch.from_numpy(corners))


def _corners(soup: Soup) -> np.ndarray:
    return np.ascontiguousarray(soup.vertices.detach().cpu().numpy(), np.float32)


def plain_resampler(config: RunConfig, strict: bool = False) -> Resampler:
    """Return DiffSoup's own resampler with the run's settings. strict: see `Resampler`; in the study's scenes
    splitting exceeds the budget by 9 % at most, among photographs threefold (a triangle near a camera)."""
    return Resampler(
        config.budget,
        config.resample_every,
        split_views=config.split_views,
        split_height=config.split_height,
        strict=strict,
    )


def visible_pixels(soup: Soup, world_to_clip: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return per view and triangle the number of pixels (n,T) int64 in which it is visible at the threshold
    .5."""
    drawn = soup.drawn()

    def job(index: int) -> np.ndarray:
        view = ViewRaster(height, width)
        view.draw(to_clip(drawn.vertices, world_to_clip[index]), drawn.opacity, None)
        return view.visible_pixels(len(soup))

    return np.stack(run_jobs(job, len(world_to_clip)))


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
