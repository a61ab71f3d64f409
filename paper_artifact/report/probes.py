"""Notebook 02: the blindness probes (Table S1): what the metrics say of a right and of a wrong candidate."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.export.figures import PAGE, draw_diagram, new_figure
from paper_artifact.report.kit.figures import cloud_limits, diagram_handles, draw_cloud, legend_below
from paper_artifact.report.kit.published import published
from paper_artifact.study.blindness import (
    CASES,
    SAMPLES,
    BlindnessProbe,
    Reading,
    make_probe,
    noise_floor,
    read,
)

Measured = dict[tuple[str, int], tuple[BlindnessProbe, Reading, Reading]]
SHOWN = 5000  # points drawn of a cloud


def measure(seeds: Iterable[int], samples: int = SAMPLES) -> Measured:
    """Return (probe, reading of A, reading of B) by (case, seed) for every case: 4 s of CPU each at 40,000
    samples."""
    probes = {(name, seed): make_probe(name, seed, samples) for name in CASES for seed in seeds}
    return {key: (probe, *read(probe)) for key, probe in probes.items()}


def reading_table(measured: Measured) -> pd.DataFrame:
    """Return one line per case and seed: A's parameter, Chamfer (sum, %) of A, B and of a perfect surface,
    Hausdorff95 (%) and whom it prefers, bottleneck (significant bars, radius / D) of A and B and their ratio.
    """
    rows = {}
    for (name, seed), (probe, a, b) in measured.items():
        rows[name, seed] = {
            "dimension": f"H{probe.dimension}",
            "A's deformation": round(probe.parameter, 3),
            "Chamfer % A": round(100 * a.chamfer_sum, 3),
            "Chamfer % B": round(100 * b.chamfer_sum, 3),
            "perfect": round(100 * noise_floor(probe, seed), 3),
            "Hausdorff95 % A": round(100 * a.hausdorff95, 2),
            "Hausdorff95 % B": round(100 * b.hausdorff95, 2),
            "Hausdorff95 prefers": "A" if a.hausdorff95 < b.hausdorff95 else "B",
            "bottleneck A": round(a.bottleneck, 4),
            "bottleneck B": round(b.bottleneck, 4),
            "B / A": round(b.bottleneck / a.bottleneck, 1) if a.bottleneck > 0 else np.inf,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["case", "seed"])


def table_s1(readings: pd.DataFrame) -> pd.DataFrame:
    """Return Table S1 from a `reading_table`: ours (mean over seeds, ± sd) beside the paper's, per case."""
    paper = published("S1").set_index(["shape", "condition", "quantity"])["printed"]
    columns = {}
    for case, own in readings.groupby("case", sort=False):
        mean_a, mean_b, printed = own["bottleneck A"].mean(), own["bottleneck B"].mean(), paper[case]
        columns[case] = {
            "Chamfer % A = B": _mean_sd(own["Chamfer % B"], 3),
            "paper's Chamfer %": printed["A = B", "chamfer_sum_percent"],
            "bottleneck A": _mean_sd(own["bottleneck A"], 4),
            "paper's A": printed["A", "bottleneck"],
            "bottleneck B": _mean_sd(own["bottleneck B"], 4),
            "paper's B": printed["B", "bottleneck"],
            "B / A": f"{mean_b / mean_a:.1f}×" if mean_a > 0 else "—",
            "paper's B / A": f"{printed['B / A', 'ratio']}×" if ("B / A", "ratio") in printed else "—",
            "Hausdorff95 prefers": "/".join(own["Hausdorff95 prefers"]),
            "paper: prefers": "B" if printed["", "hausdorff95_prefers_B"] == "1" else "A",
        }
    return pd.DataFrame(columns).rename_axis(columns="case")


def picture(measured: Measured, seed: int) -> Figure:
    """Return one row per case: clouds of A and B from the side, on the same axes, and their diagrams in the
    discriminating dimension (stars: the ground truth's significant bars; dotted: the floor)."""
    cases = [case for case, each in measured if each == seed]
    figure, axes = new_figure(len(cases), 4, PAGE / 4, 1.8)
    for case, line in zip(cases, axes, strict=True):
        probe, a, b = measured[case, seed]
        limits = cloud_limits(probe.a, probe.b)
        for axis, cloud, which in ((line[0], probe.a, "A, right"), (line[1], probe.b, "B, wrong")):
            draw_cloud(axis, cloud[:SHOWN], f"{case}: {which}", limits=limits)
        limit = 1.2 * max(bars.max() for bars in (a.significant, b.significant, a.target) if len(bars))
        for axis, reading, which in ((line[2], a, "A"), (line[3], b, "B")):
            title = f"H{probe.dimension} of {which}"
            draw_diagram(axis, reading.bars, reading.floor, limit, reading.target, title)
        for axis in (line[1], line[3]):
            axis.set_ylabel("")
    legend_below(figure, 4, diagram_handles("ground truth's significant bar"))
    return figure


def _mean_sd(values: pd.Series, digits: int) -> str:
    sd = "" if len(values) == 1 else f" ± {values.std():.{digits}f}"
    return f"{values.mean():.{digits}f}{sd}"
