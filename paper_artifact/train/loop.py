"""The training loop, the only one: DiffSoup's photometric training with a place for one additive loss term.

Steps count from 1. A step: a batch of views → raster → shade → photometric loss and opacity gradient → backward (edge gradient) →
the term's own backward → optimisers → resampling when due → evaluation when asked. Without a term, none of its code is imported
or run. Everything random is a function of (seed, step): a run resumed from a checkpoint gives the same bits as one never stopped.
"""

from __future__ import annotations

import time
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Iterator, Protocol

import numpy as np
import torch

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.scene.load import Scene
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.state import Soup
from paper_artifact.soup.vector_adam import VectorAdam
from paper_artifact.train.backend import backend_for
from paper_artifact.train.checkpoint import read_checkpoint, write_checkpoint
from paper_artifact.train.config import RunConfig


class LossTerm(Protocol):
    """An additive loss on the vertices; steps count from 0 here (see `paper_artifact.topology.term`)."""

    log: list[dict]

    def refresh_if_due(self, step: int, vertices: torch.Tensor, opacity, resampled: bool) -> bool: ...
    def value(self, step: int, vertices: torch.Tensor, photo_gradient_norm) -> torch.Tensor | None: ...
    def state(self) -> dict: ...
    def load_state(self, state: dict) -> None: ...


@dataclass
class TrainResult:
    """What a run leaves: the soup, the loss of every step, the evaluations, the resamplings, seconds by stage."""

    soup: Soup
    losses: list[float] = field(default_factory=list)
    dumps: list[dict] = field(default_factory=list)
    resamplings: list[dict] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    resumed_at: int | None = None


class TrainingError(RuntimeError):
    """The run itself broke (a value that is not finite); the message names step, quantity and what to try."""


def batch_views(train: np.ndarray, batch: int, seed: int, step: int) -> np.ndarray:
    """Return the scene's view indices of one 1-based step: each epoch is a fresh permutation of `train`, its last batch may be
    smaller."""
    per_epoch = -(-len(train) // batch)
    epoch, position = divmod(step - 1, per_epoch)
    order = stream(seed, "epoch", epoch).permutation(len(train))
    return train[order[position * batch : (position + 1) * batch]]


@one_torch_thread()
def train(
    scene: Scene,
    config: RunConfig,
    *,
    term: LossTerm | None = None,
    evaluate: Callable[[Soup, int], dict] | None = None,
    checkpoint: Path | None = None,
    progress: Callable[[int, str], None] | None = None,
    device: str = "auto",
    resampler: Resampler | None = None,
) -> TrainResult:
    """Train a soup on the scene's training views and return it with its history.

    evaluate(soup, step) gives one dump (a dict) at each of config.dump_steps. checkpoint: file that is written after each
    resampling and read at the start when it belongs to the same configuration. progress(step, text) is called after each step.
    device: "cpu", "cuda" or "auto" (cuda when there is one). Raises TrainingError when the loss or the vertices stop being
    finite, InputError for a scene without training views or a foreign checkpoint.
    """
    if len(scene.train) == 0:
        raise InputError(f"{scene.path} has no training views")
    backend = backend_for(device, scene, scene.train)
    height, width = scene.images.shape[1:3]
    resampler = resampler or Resampler(
        config.budget, config.resample_every, split_views=config.split_views, split_height=config.split_height
    )
    soup = initial_soup(scene.points, max(2, round(config.initial_ratio * config.budget)), config.seed)
    result = TrainResult(soup)
    seconds: dict[str, float] = defaultdict(float)
    start = 0
    shading_state = None
    saved = read_checkpoint(checkpoint, config) if checkpoint else None
    if saved is not None:
        start, soup, shading_state = saved.step, saved.soup, saved.shading_optimiser
        result.losses, result.dumps, result.resamplings = saved.losses, saved.dumps, saved.resamplings
        result.resumed_at = start
        seconds.update(saved.seconds)
        if term is not None:
            term.load_state(saved.term)
    soup = backend.to_device(soup)
    shading = torch.optim.Adam(soup.mlp, lr=config.mlp_lr)
    if shading_state is not None:
        shading.load_state_dict(shading_state)
    vertex_lr = config.vertex_lr * float(scene.radius)
    optimisers = _soup_optimisers(soup, config, vertex_lr)
    resampled = True
    for step in range(start + 1, config.steps + 1):
        with _timed(seconds, "optimiser"):
            decay = config.final_lr ** (step / config.steps)
            for optimiser, rates in (*optimisers, (shading, (config.mlp_lr,))):
                for group, rate in zip(optimiser.param_groups, rates):
                    group["lr"] = rate * decay
                optimiser.zero_grad(set_to_none=True)
        with _timed(seconds, "photometric"):
            views = batch_views(scene.train, config.batch, config.seed, step)
            loss = backend.photometric_step(
                soup, views, [view_key(config.seed, step, int(view)) for view in views]
            )
        if not np.isfinite(loss):
            raise TrainingError(
                f"the loss of step {step} is {loss}; lower the learning rates (vertex_lr {config.vertex_lr}) and run again"
            )
        result.losses.append(loss)
        if term is not None:
            with _timed(seconds, "topology"):
                term.refresh_if_due(step - 1, soup.vertices, torch.sigmoid(soup.opacity.detach()), resampled)
                extra = term.value(step - 1, soup.vertices, lambda: float(soup.vertices.grad.norm()))
                if extra is not None:
                    if not torch.isfinite(extra):
                        raise TrainingError(
                            f"the added loss term of step {step} is {extra.item()}; the term's log says what it met"
                        )
                    extra.backward()
        with _timed(seconds, "optimiser"):
            for optimiser, _ in optimisers:
                optimiser.step()
            shading.step()
            # The raster skips triangles with such corners, so the loss alone would never tell.
            if not torch.isfinite(soup.vertices.detach()).all():
                raise TrainingError(
                    f"vertices are not finite after step {step}; lower vertex_lr ({config.vertex_lr}) and run again"
                )
        resampled = resampler.due(step, config.steps)
        if resampled:
            with _timed(seconds, "resample"):
                soup, report = resampler.resample(
                    backend.to_host(soup),
                    scene.world_to_clip[scene.train],
                    height,
                    width,
                    config.seed,
                    step,
                    config.steps,
                )
                soup = backend.to_device(soup)
                shading = _moved(shading, soup, config)
                optimisers = _soup_optimisers(soup, config, vertex_lr)
                result.resamplings.append(
                    {"step": step, "before": report.before, "pruned": report.pruned, "after": report.after}
                )
        if evaluate is not None and step in config.dump_steps:
            with _timed(seconds, "evaluate"):
                result.dumps.append(evaluate(backend.to_host(soup), step))
        if resampled and checkpoint is not None:
            write_checkpoint(
                checkpoint,
                config,
                step,
                backend.to_host(soup),
                shading.state_dict(),
                result,
                dict(seconds),
                term.state() if term is not None else {},
            )
        if progress is not None:
            progress(step, f"loss {loss:.4f}, {len(soup)} triangles")
    result.soup = backend.to_host(soup)
    if not all(
        torch.isfinite(tensor).all()
        for tensor in (result.soup.vertices, result.soup.features, result.soup.opacity)
    ):
        raise TrainingError(
            f"features or opacity are not finite after step {config.steps}; lower feature_lr ({config.feature_lr}) or "
            f"opacity_lr ({config.opacity_lr}) and run again"
        )
    result.seconds = dict(seconds)
    return result


def _soup_optimisers(soup: Soup, config: RunConfig, vertex_lr: float):
    features = torch.optim.Adam([{"params": [soup.features]}, {"params": [soup.opacity]}])
    return (features, (config.feature_lr, config.opacity_lr)), (
        VectorAdam([soup.vertices], lr=vertex_lr),
        (vertex_lr,),
    )


def _moved(shading: torch.optim.Adam, soup: Soup, config: RunConfig) -> torch.optim.Adam:
    # The MLP's moments survive a resampling; only the tensors may be new ones (device copies).
    fresh = torch.optim.Adam(soup.mlp, lr=config.mlp_lr)
    fresh.load_state_dict(shading.state_dict())
    return fresh


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    begin = time.perf_counter()
    yield
    seconds[stage] += time.perf_counter() - begin
