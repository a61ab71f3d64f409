"""Tables and pictures of the blindness probes (Table S1)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.report.figures import draw_cloud, draw_diagram, new_figure
from paper_artifact.report.published import published
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
    """Return (probe, reading of A, reading of B) by (case, seed) for every case: about 4 s of CPU each at 40,000 samples."""
    made = {}
    for name in CASES:
        for seed in seeds:
            probe = make_probe(name, seed, samples)
            made[name, seed] = (probe, *read(probe))
    return made


def reading_table(measured: Measured) -> pd.DataFrame:
    """Return one line per case and seed: A's parameter, Chamfer (sum, %) of A, B and of a perfect surface, Hausdorff95 (%) and
    whom it prefers, bottleneck (significant bars, radius / D) of A and B and their ratio."""
    rows = []
    for (name, seed), (probe, a, b) in measured.items():
        rows.append(
            {
                "case": name,
                "dimension": f"H{probe.dimension}",
                "seed": seed,
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
        )
    return pd.DataFrame(rows).set_index(["case", "seed"])


def beside_paper(readings: pd.DataFrame) -> pd.DataFrame:
    """Return Table S1 from a `reading_table`: ours (mean over seeds, ± sd) beside the paper's, per case."""
    table, paper = (
        readings.groupby("case", sort=False),
        published("S1").set_index(["shape", "condition", "quantity"])["value"],
    )
    chamfer, a, b = table["Chamfer % B"], table["bottleneck A"], table["bottleneck B"]
    rows = []
    for name in dict.fromkeys(case for case, _ in readings.index):
        mean_a, mean_b = a.mean()[name], b.mean()[name]
        prefers = table["Hausdorff95 prefers"].agg(lambda s: "/".join(s))[name]
        rows.append(
            {
                "case": name,
                "Chamfer % A = B": _mean_sd(chamfer, name, 3),
                "paper's Chamfer %": paper[name, "A = B", "chamfer_sum_percent"],
                "bottleneck A": _mean_sd(a, name, 4),
                "paper's A": paper[name, "A", "bottleneck"],
                "bottleneck B": _mean_sd(b, name, 4),
                "paper's B": paper[name, "B", "bottleneck"],
                "B / A": f"{mean_b / mean_a:.1f}×" if mean_a > 0 else "—",
                "paper's B / A": f"{paper[name, 'B / A', 'ratio']:.0f}×"
                if (name, "B / A", "ratio") in paper.index
                else "—",
                "Hausdorff95 prefers": prefers,
                "paper: prefers": "B" if paper[name, "", "hausdorff95_prefers_B"] else "A",
            }
        )
    return pd.DataFrame(rows).set_index("case").T


def picture(measured: Measured, seed: int) -> Figure:
    """Return one row per case: clouds of A and B from the side, and their diagrams in the discriminating dimension (stars: the
    ground truth's significant bars; dotted: the floor)."""
    cases = [case for case, each in measured if each == seed]
    figure, axes = new_figure(len(cases), 4, 2.5, 2.4)
    for case, line in zip(cases, axes, strict=True):
        probe, a, b = measured[case, seed]
        for axis, cloud, which in ((line[0], probe.a, "A, right"), (line[1], probe.b, "B, wrong")):
            draw_cloud(axis, cloud[:SHOWN], f"{case}: {which}")
        limit = 1.2 * max(bars.max() for bars in (a.significant, b.significant, a.target) if len(bars))
        for axis, reading, which in ((line[2], a, "A"), (line[3], b, "B")):
            draw_diagram(
                axis, reading.bars, reading.floor, limit, reading.target, f"H{probe.dimension} of {which}"
            )
    return figure


def _mean_sd(grouped, name: str, digits: int) -> str:
    mean, sd = grouped.mean()[name], grouped.std()[name]
    return f"{mean:.{digits}f}" + ("" if np.isnan(sd) else f" ± {sd:.{digits}f}")
