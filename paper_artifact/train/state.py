"""A run's state between two steps: soup, optimiser, history; and its learning rates as a function of the
step."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch

from paper_artifact.config import RunConfig
from paper_artifact.soup.adam import KernelOptimiser, TorchOptimiser, soup_optimiser
from paper_artifact.soup.state import Soup


class TrainingError(RuntimeError):
    """The run itself broke (a value that is not finite); the message names step, quantity and what to try."""


@dataclass
class TrainState:
    """What a run is after `step` steps, and what it leaves when it is done."""

    step: int  # steps taken: steps count from 1, 0 is the start
    soup: Soup  # on the backend's device while training, on the CPU at the end
    optimiser: KernelOptimiser | TorchOptimiser  # of the soup's tensors
    resampled: bool = True  # the soup was changed wholesale since the last step, as at the start
    losses: list[float] = field(default_factory=list)  # photometric loss of every step, dimensionless
    dumps: list[dict] = field(default_factory=list)  # evaluations
    resamplings: list[dict] = field(
        default_factory=list
    )  # step, triangles before, after pruning, after splitting
    seconds: dict[str, float] = field(default_factory=dict)  # wall time by stage
    resumed_at: int | None = None  # step of the checkpoint that this run went on from

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the wall time of the block to `seconds` of the stage."""
        begin = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin

    def replace_soup(self, soup: Soup) -> None:
        """Go on with another soup: a new optimiser, but the MLP's moments stay, since only its tensors may be
        new ones."""
        moments = self.optimiser.mlp_state()
        self.soup, self.optimiser, self.resampled = soup, soup_optimiser(soup), True
        self.optimiser.load_mlp_state(moments)

    def check_loss(self, loss: float, config: RunConfig) -> None:
        """Raise TrainingError unless the photometric loss of this step is finite."""
        if not np.isfinite(loss):
            self._broken(f"the loss of step {self.step} is {loss}", f"vertex_lr {config.vertex_lr}")

    def check_vertices(self, config: RunConfig) -> None:
        """Raise TrainingError unless all vertices are finite; the raster skips such corners, so no loss would
        ever tell."""
        if not torch.isfinite(self.soup.vertices.detach()).all():
            self._broken(f"vertices are not finite after step {self.step}", f"vertex_lr {config.vertex_lr}")

    def check_attributes(self, config: RunConfig) -> None:
        """Raise TrainingError unless features and opacity are finite."""
        if not all(
            torch.isfinite(tensor.detach()).all() for tensor in (self.soup.features, self.soup.opacity)
        ):
            rates = f"feature_lr {config.feature_lr}, opacity_lr {config.opacity_lr}"
            self._broken(f"features or opacity are not finite after step {self.step}", rates)

    def _broken(self, what: str, rates: str) -> None:
        raise TrainingError(f"{what}; lower the learning rates ({rates}) and run again")


def learning_rates(config: RunConfig, radius: float, step: int) -> dict[str, float]:
    """Return the learning rates at `step` (from 1) by what they move: exponential decay to `final_lr`.

    radius: the scene's, world units, which vertex_lr is per unit of.
    """
    decay = config.final_lr ** (step / config.steps)
    return {
        "vertices": config.vertex_lr * radius * decay,
        "features": config.feature_lr * decay,
        "opacity": config.opacity_lr * decay,
        "mlp": config.mlp_lr * decay,
    }
