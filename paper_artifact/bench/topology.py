"""The loss on a trained soup: refresh (samples, persistence, plan) beside gudhi's persistence alone, and one step under a frozen
plan."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median

import torch

from paper_artifact.bench.raster import sphere_case
from paper_artifact.catalogue import get_condition
from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.topology.samples import draw_samples, samples_stream
from paper_artifact.topology.term import make_term
from paper_artifact.train.config import default_config
from paper_artifact.pipeline import find_mesh, make_run_term, with_condition


def loss_rows(results: Path, repetitions: int = 15, steps: int = 300) -> list[dict]:
    """Return rows {what, ms, ratio}: CPU ms of one thread at M = 2048, medians of interleaved repetitions; ratio is to the
    refresh."""
    _, soup = sphere_case(results, steps)
    mesh = find_mesh("sphere")
    config = with_condition(default_config("sphere", condition="C1"), mesh)
    _, bundle = make_run_term(config, mesh)
    opacity = torch.sigmoid(soup.opacity.detach())
    times: dict[str, list[float]] = {
        "refresh: samples, persistence, plan": [],
        "gudhi safe: samples, persistence": [],
        "step under a frozen plan, forward + backward": [],
    }
    refresh, oracle, frozen = times
    for repetition in range(repetitions + 1):
        term = make_term(
            get_condition("C3"), bundle, config.steps, seed=repetition
        )  # no ramp: active from the first step
        begin = time.process_time()
        term.refresh_if_due(0, soup.vertices, opacity, True)
        times[refresh].append(time.process_time() - begin)
        term.value(0, soup.vertices, 1.0)  # sets the weight
        begin = time.process_time()
        term.value(0, soup.vertices, 1.0).backward()
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
