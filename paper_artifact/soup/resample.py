"""Prune and split: the resampler, an object that the training loop calls and never looks into.

Every `resample_every` steps: if the soup exceeds its budget, the least visible triangles go; then triangles
with long screen-space edges are split (DiffSoup's resampling). An allocation prior (paper App. A) changes the
order of pruning and names triangles to halve at an unchanged final count. Strict budget parity: a resampling
ends with exactly as many triangles as DiffSoup's own rule would leave of the same pruned soup.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
Importance = Callable[[np.ndarray], np.ndarray]  # points (n,3), world → importance (n,) in [0, 1]
QUANTILE = 0.9  # of the visible-pixel counts: what importance 1 is worth, times λ
PRUNE_UNTIL, SPLIT_UNTIL = 0.955, 0.95  # fractions of the run's steps after which neither is done


@dataclass(frozen=True)
class Resampler:
    """DiffSoup's prune-and-split with a run's settings.

    strict: what splitting makes beyond the budget goes too, the least visible first; in the study's scenes
    splitting exceeds the budget by 9 % at most, among photographs threefold (a triangle near a camera).
    importance: for both levers of the run's allocation; None for neither. Raises InputError when the share
    that is subdivided is less than one triangle of the budget.
    """

    config: RunConfig
    strict: bool = False
    importance: Importance | None = None

    def __post_init__(self) -> None:
        prior, budget = self.prior, self.config.budget
        if self.importance is not None and prior.subdivided > 0 and round(prior.subdivided * budget) < 1:
            raise InputError(
                f"the budget of {budget} triangles is smaller than the protected share "
                f"{prior.subdivided} asks for; raise the budget"
            )

    @property
    def prior(self) -> AllocationConfig:
        """The strengths of the levers."""
        return self.config.allocation or AllocationConfig()

    def due(self, step: int) -> bool:
        """Return whether `step` (1-based) ends with a resampling."""
        return step % self.config.resample_every == 0 and step < PRUNE_UNTIL * self.config.steps

    def order(self, corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return the order of pruning (T,), the lowest goes first: the visible-pixel `counts` (T,), plus λ ·
        Q.9(counts) · importance at the centroids of the `corners` (T,3,3)."""
        if self.importance is None:
            return counts
        worth = self.prior.protection * np.quantile(counts, QUANTILE)
        return counts + worth * self.importance(corners.mean(axis=1))

    def halved(self, corners: np.ndarray, visible: np.ndarray) -> np.ndarray:
        """Return the indices (k,) of the triangles to halve whatever their size: the `visible` (T,) bool ones
        of the highest importance at the centroids of their `corners` (T,3,3), ties by index, as far as it is
        at least `subdivided_from`."""
        assert self.importance is not None
        rows, count = np.flatnonzero(visible), round(self.prior.subdivided * self.config.budget)
        values = self.importance(corners[rows].mean(axis=1))
        first = np.argsort(-values, kind="stable")[:count]
        return np.sort(rows[first[values[first] >= self.prior.subdivided_from]])

    def resample(
        self, soup: Soup, world_to_clip: np.ndarray, height: int, width: int, step: int
    ) -> tuple[Soup, dict[str, int]]:
        """Return the resampled soup and its numbers of triangles: "before", "pruned" (after pruning) and
        "after" (splitting too); world_to_clip (n,4,4) are the training views, height and width their full
        size.

        Raises InputError for a split that would take more memory than is available.
        """
        config, before = self.config, len(soup)
        half = (max(height // 2, 1), max(width // 2, 1))
        soup = self._pruned(soup, config.budget, world_to_clip, *half)
        pruned = len(soup)
        if step < SPLIT_UNTIL * config.steps:
            draws = stream(config.seed, "split-views", step)
            views = draws.permutation(len(world_to_clip))[: config.split_views]
            split = self._split(soup, world_to_clip[views], *half)
            # the plain rule's count is the cap: halves displace the least worthy
            if self.importance is not None and self.prior.subdivided > 0:
                corners, counts = _corners(soup), visible_pixels(soup, world_to_clip, *half).sum(0)
                halves, origins = bisected(corners, self.halved(corners, counts > 0))
                halved = soup.select(torch.from_numpy(origins), torch.from_numpy(halves))
                more = self._split(halved, world_to_clip[views], *half)
                if len(more) > len(split):
                    split = self._pruned(more, len(split), world_to_clip, *half)
            soup = self._pruned(split, config.budget, world_to_clip, *half) if self.strict else split
        return soup, {"before": before, "pruned": pruned, "after": len(soup)}

    def _pruned(self, soup: Soup, count: int, world_to_clip: np.ndarray, height: int, width: int) -> Soup:
        """Return the `count` triangles that the order of pruning puts last, in their own order."""
        if len(soup) <= count:
            return soup
        counts = visible_pixels(soup, world_to_clip, height, width).sum(0)
        order = np.argsort(self.order(_corners(soup), counts), kind="stable")
        return soup.select(torch.from_numpy(np.sort(order[len(soup) - count :])))

    def _split(self, soup: Soup, world_to_clip: np.ndarray, height: int, width: int) -> Soup:
        visible = visible_pixels(soup, world_to_clip, height, width) > 0
        corners = _corners(soup)
        origins = np.arange(len(corners))
        for matrix, wanted in zip(world_to_clip.astype(np.float64), visible, strict=True):
            where = (wanted[origins], matrix, width / height, 2 * self.config.split_height)
            require_memory(
                BYTES_PER_PIECE * least_pieces(corners, *where),
                f"splitting all edges longer than {self.config.split_height:g} of the image height",
                "give a larger split_height",
            )
            corners, origins = split_long_edges(corners, origins, *where)
        if len(corners) == len(soup):
            return soup
        return soup.select(torch.from_numpy(origins), torch.from_numpy(corners))


def _corners(soup: Soup) -> np.ndarray:
    return np.ascontiguousarray(soup.vertices.detach().cpu().numpy(), np.float32)


def visible_pixels(soup: Soup, world_to_clip: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return per view and triangle the number of pixels (n,T) int64 in which it is visible at the threshold
    .5."""
    drawn = soup.drawn()

    def job(index: int) -> np.ndarray:
        view = ViewRaster(height, width)
        view.draw(to_clip(drawn.vertices, world_to_clip[index]), drawn.opacity, None)
        return view.visible_pixels(len(soup))

    return np.stack(run_jobs(job, len(world_to_clip)))
