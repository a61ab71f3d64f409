"""The training loop, the only one: DiffSoup's photometric training with a place for one additive loss term
(paper §4).

Steps count from 1. Everything random is a function of (seed, step): a run resumed from a checkpoint gives the
same bits as one never stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from paper_artifact.arithmetic import length
from paper_artifact.config import RunConfig
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.scene.load import Scene
from paper_artifact.soup.adam import SoupOptimiser
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import Backend, backend_for
from paper_artifact.train.state import (
    TrainingError,
    TrainState,
    learning_rates,
    resumed_state,
    write_checkpoint,
)
from paper_artifact.train.watch import Watch

if TYPE_CHECKING:
    from paper_artifact.topology.term import TopologyTerm


def batch_views(train: np.ndarray, batch: int, seed: int, step: int) -> np.ndarray:
    """Return the scene's view indices of a step: each epoch is a fresh permutation of `train`, its last batch
    may be smaller."""
    per_epoch = -(-len(train) // batch)
    epoch, position = divmod(step - 1, per_epoch)
    order = stream(seed, "epoch", epoch).permutation(len(train))
    return train[order[position * batch : (position + 1) * batch]]


@one_torch_thread()
def train(
    scene: Scene,
    config: RunConfig,
    *,
    term: TopologyTerm | None = None,
    evaluate: Callable[[Soup, int], dict] | None = None,
    checkpoint: Path | None = None,
    progress: Callable[[int, str], None] | None = None,
    device: str = "auto",
    resampler: Resampler | None = None,
    importance: np.ndarray | None = None,
    tell: Callable[[str], None] | None = None,
) -> TrainState:
    """Train a soup on the scene's training views and return the state after the last step, the soup on the
    CPU.

    term: what is added to the photometric loss, None for nothing. evaluate(soup, step) gives one dump (a
    dict) at each of config.dump_steps. checkpoint: file that is written after each resampling and read at the
    start when it belongs to the same configuration. progress(step, text) is called after each step. device:
    "cpu", "cuda" or "auto" (cuda when there is one). resampler: None for DiffSoup's own. importance: of the
    scene's points (n,), for the choice of the first triangles. tell: called with what goes wrong on a scene
    of photographs, see `Watch`. Raises TrainingError when a loss or the soup stops being finite, at the
    latest ten steps later, InputError for a scene without training views or a foreign checkpoint.
    """
    if len(scene.train) == 0:
        raise InputError(f"{scene.path} has no training views")
    backend = backend_for(device, scene, scene.train)
    resampler = resampler or Resampler(config, strict=not scene.rendered)
    state = resumed_state(checkpoint, config, term, backend) or start_state(
        scene, config, backend, importance
    )
    watch = None if tell is None or scene.rendered else Watch(scene, config, tell)

    def photometric(step: int) -> float:
        views = batch_views(scene.train, config.batch, config.seed, step)
        keys = [view_key(config.seed, step, int(view)) for view in views]
        return backend.photometric_step(state.soup, views, keys)

    for step in range(state.step + 1, config.steps + 1):
        state.step = step
        with state.timed("photometric"):
            loss = photometric(step)
        state.losses.append(loss)
        with state.timed("topology"):
            if term is not None:
                _add_term(term, state, photometric)
        with state.timed("optimiser"):
            if state.resampled:  # as at the start
                units = scene.units(state.soup.vertices.detach().cpu().numpy())
            state.optimiser.step(learning_rates(config, float(scene.radius), step), units)
            state.check(loss, config)
        state.resampled = False
        if resampler.due(step):
            with state.timed("resample"):
                views_of_all = scene.world_to_clip[scene.train]
                height, width = scene.images.shape[2:]
                soup = backend.to_host(state.soup)
                if watch is not None:
                    watch.look(step, state.losses, soup)
                soup, report = resampler.resample(soup, views_of_all, height, width, step)
                state.replace_soup(backend.to_device(soup))
                state.resamplings.append({"step": step, **report})
        if evaluate is not None and step in config.dump_steps:
            with state.timed("evaluate"):
                state.dumps.append(evaluate(backend.to_host(state.soup), step))
        if state.resampled and checkpoint is not None:
            write_checkpoint(checkpoint, config, state, term, backend)
        if progress is not None:
            progress(step, f"loss {loss:.4f}, {len(state.soup)} triangles")
    state.soup = backend.to_host(state.soup)
    state.warnings = [] if watch is None else watch.sentences()
    return state


def start_state(
    scene: Scene, config: RunConfig, backend: Backend, importance: np.ndarray | None = None
) -> TrainState:
    """Return the state before the first step: a soup of `initial_ratio` times the budget on the SfM cloud."""
    count = max(2, round(config.initial_ratio * config.budget))
    soup = backend.to_device(initial_soup(scene.points, count, config.seed, importance))
    return TrainState(0, soup, SoupOptimiser(soup))


def _add_term(term: TopologyTerm, state: TrainState, photometric: Callable[[int], float]) -> None:
    """Add the term's gradient to that of the soup's vertices. Raises TrainingError unless it is finite.

    photometric(step) sets the soup's gradients to those of that step's batch.
    """
    soup = state.soup

    def photo_gradient_norm(batches: int = 1) -> float:
        own = [tensor.grad for tensor in soup.tensors()]
        norms = []
        for later in range(batches):
            if later > 0:
                photometric(state.step + later)
            gradient = soup.vertices.grad
            norms.append(0.0 if gradient is None else length(gradient.cpu().numpy()))
        for tensor, gradient in zip(soup.tensors(), own, strict=True):
            tensor.grad = gradient
        return sum(norms) / len(norms)

    if term.due(state.step, state.resampled):
        term.refresh(state.step, soup.vertices, torch.from_numpy(soup.corner_opacity()))
    extra = term.value(state.step, soup.vertices, photo_gradient_norm)
    if extra is None:
        return
    if not torch.isfinite(extra):
        raise TrainingError(
            f"the added loss term of step {state.step} is {extra.item()}; the term's log says what it met"
        )
    extra.backward()
