"""The loss on a trained soup: a refresh beside gudhi's persistence alone, and a step under a frozen plan."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np
import torch

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.bench.raster import sphere_case
from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.pipeline import make_run_term
from paper_artifact.randomness import stream
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.loss import TopologyLoss
from paper_artifact.topology.term import TopologyTerm, draw_samples, samples_stream


def loss_rows(results: Path, repetitions: int = 15, steps: int = 300) -> list[dict]:
    """Return rows {what, ms, ratio to the refresh}: CPU ms of one thread at M = 2048.

    Medians of interleaved repetitions. A refresh is samples, persistence and plan. results: where the soup,
    trained for `steps` steps, is built.
    """
    _, soup = sphere_case(results, steps)
    mesh = find_mesh("sphere")
    config = study_config("sphere", "C3")  # no ramp: active from the first step
    _, bundle = make_run_term(config, mesh)
    opacity = torch.sigmoid(soup.opacity.detach())
    times: dict[str, list[float]] = {
        "refresh: samples, persistence, plan": [],
        "gudhi safe: samples, persistence": [],
        "step under a frozen plan, forward + backward": [],
    }
    refresh, oracle, frozen = times
    for repetition in range(repetitions + 1):
        term = TopologyTerm(config.loss, bundle, config.steps, seed=repetition)
        begin = time.process_time()
        term.refresh(1, soup.vertices, opacity)
        times[refresh].append(time.process_time() - begin)
        term.value(1, soup.vertices, 1.0)  # sets the weight
        begin = time.process_time()
        term.value(1, soup.vertices, 1.0).backward()
        times[frozen].append(time.process_time() - begin)
        begin = time.process_time()
        samples = draw_samples(soup.vertices, opacity, bundle.samples, samples_stream(repetition, 0))
        alpha_persistence(samples.positions(soup.vertices.detach()).numpy(), method="gudhi")
        times[oracle].append(time.process_time() - begin)
    reference = median(times[refresh][1:])
    return [
        {"what": name, "ms": 1e3 * median(values[1:]), "ratio": median(values[1:]) / reference}
        for name, values in times.items()
    ]


def plan_rows(sizes: Sequence[int] = (2048, 8192), repetitions: int = 15) -> list[dict]:
    """Return rows {M, pulls, refresh_ms, persistence_ms, frozen_ms}: CPU ms of plans with thousands of pulls.

    M points in a cube against three target bars, with a floor so low that about one bar and a half per point
    is significant. Medians of interleaved repetitions; a refresh is persistence and plan; a frozen step is
    the loss and its gradient by the points. Raises InputError for fewer than one repetition.
    """
    if repetitions < 1:
        raise InputError("the benchmark needs at least one repetition")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return [_plan_row(size, repetitions) for size in sizes]
    finally:
        torch.set_num_threads(threads)


def _plan_row(size: int, repetitions: int) -> dict:
    points = stream(0, "plan benchmark", size).random((size, 3))
    loss = TopologyLoss(_crowded_bundle(size), refresh_every=0)
    live = torch.tensor(points, requires_grad=True)
    works = {
        "refresh_ms": lambda: loss.refresh(points),
        "persistence_ms": lambda: alpha_persistence(points),
        "frozen_ms": lambda: loss(live).backward(),
    }
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repetitions + 1):
        for name, work in works.items():
            begin = time.process_time()
            work()
            times[name].append(1e3 * (time.process_time() - begin))
    medians = {name: median(values[1:]) for name, values in times.items()}  # the first one warms up
    return {"M": size, "pulls": len(loss.plan), **medians}


def _crowded_bundle(samples: int) -> Bundle:
    """Return a handmade bundle of one bar per dimension, in units of the mean spacing of points in a cube."""
    spacing = samples ** (-1 / 3)
    bar = spacing * np.array([[0.0, 1.0]])
    return Bundle(
        bars=(bar, bar + spacing, bar + 2 * spacing),
        dimensions=(0, 1, 2),
        reasons=("", "", ""),
        samples=samples,
        seed=0,
        floor=0.06 * spacing,
        floor_multiplier=6.0,
        diagonal=1.0,
        shape="handmade",
        source="handmade",
    )
