"""The loss on a trained soup: a refresh beside gudhi's persistence alone, and a step under a frozen plan."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median

import torch

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.bench.raster import sphere_case
from paper_artifact.catalogue import study_config
from paper_artifact.pipeline import make_run_term
from paper_artifact.scene.find import find_mesh
from paper_artifact.topology.samples import draw_samples, samples_stream
from paper_artifact.topology.term import TopologyTerm


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
        term.refresh_if_due(1, soup.vertices, opacity, True)
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
