"""Notebook 16: CPU seconds of the loss of C1, T1 and T2 in a run, on committed soups, in one process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import torch

from paper_artifact.catalogue import study_config
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.record.environment import host
from paper_artifact.report.kit.records import collect, soup_path
from paper_artifact.report.words import AIMS, DESIGNS
from paper_artifact.scene.find import find_mesh
from paper_artifact.soup.state import Soup, load_soup
from paper_artifact.topology.bundle import build_from_mesh
from paper_artifact.topology.statement import Statement
from paper_artifact.topology.term import TopologyTerm

SHAPES, SAMPLES = ("bob", "eight"), (2048, 8192)  # whose soups are in the repository
REFRESHES, ACTIVE = 220, 2000  # of a run: every 10 of the active steps, and after a resampling
TURNS, BETWEEN = 5, 10  # refreshes that are timed, steps behind each


def measure_words_cost(
    shapes: Sequence[str] = SHAPES,
    samples: Sequence[int] = SAMPLES,
    progress: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Return per shape, M and design: CPU ms of a refresh (samples, diagram, plan) and of a step between two
    (value and gradient to the vertices), medians; bars that are pulled; one minute of CPU."""
    rows = []
    for shape in shapes:
        (record,) = collect([(shape, "C0", 0)]).records
        soup = load_soup(soup_path(record))
        for size in samples:
            for design in DESIGNS:
                refresh, step, pulled = _timed(_term(shape, design, size), soup)
                rows.append(
                    {
                        "shape": shape,
                        "M": size,
                        "design": design,
                        "refresh_ms": 1e3 * refresh,
                        "step_ms": 1e3 * step,
                        "pulled": pulled,
                        "cpu": host()["cpu"],
                    }
                )
                if progress is not None:
                    progress(f"{shape}, M = {size}: {design}")
    return pd.DataFrame(rows)


def cost_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return per M and design: ms of a refresh and of a step, bars pulled, and the seconds of a run of 2,500
    steps (REFRESHES, ACTIVE), each as the range over the shapes, beside what was aimed at."""
    rows = {}
    for (size, design), own in stored.groupby(["M", "design"]):
        seconds = (REFRESHES * own["refresh_ms"] + ACTIVE * own["step_ms"]) / 1e3
        rows[size, design] = {
            "refresh ms": _range(own["refresh_ms"], 0),
            "step ms": _range(own["step_ms"], 1),
            "bars pulled": _range(own["pulled"], 0),
            "seconds of a run": _range(seconds, 1),
            "aim": AIMS.get((design, size), ""),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["M", "design"])


def _term(shape: str, design: str, samples: int) -> TopologyTerm:
    loss, mesh = study_config(shape, design, loss={"samples": samples}).loss, find_mesh(shape)
    assert loss is not None
    if loss.kind == "betti":
        return TopologyTerm(loss, Statement(loss.betti or (), mesh.diagonal, samples), STEPS_OF_THE_STUDY, 0)
    given = {"shape": shape, "dimensions": loss.dimensions}
    bundle = build_from_mesh(mesh.vertices, mesh.faces, samples, loss.bundle_seed, **given)
    return TopologyTerm(loss, bundle, STEPS_OF_THE_STUDY, 0)


def _timed(term: TopologyTerm, soup: Soup) -> tuple[float, float, int]:
    """Return (CPU seconds of a refresh, of a step, bars pulled): medians, after one uncounted turn."""
    vertices, opacity = soup.vertices.detach().requires_grad_(True), torch.sigmoid(soup.opacity.detach())
    refreshes, steps, threads = [], [], torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for turn in range(TURNS + 1):
            step = STEPS_OF_THE_STUDY // 2 + BETWEEN * turn
            begin = time.process_time()
            term.refresh_if_due(step, vertices, opacity)
            refreshes.append(time.process_time() - begin)
            for each in range(BETWEEN):
                begin = time.process_time()
                value = term.value(step + each, vertices, 1.0)
                if value is not None:
                    value.backward()
                steps.append(time.process_time() - begin)
    finally:
        torch.set_num_threads(threads)
    pulled = term.log[-1]["dimensions"].values()
    count = sum(each["matched"] + each["recruited"] + each["diagonal"] for each in pulled)
    return float(np.median(refreshes[1:])), float(np.median(steps[BETWEEN:])), count


def _range(values: pd.Series, digits: int) -> str:
    low, high = f"{values.min():.{digits}f}", f"{values.max():.{digits}f}"
    return low if low == high else f"{low}–{high}"
