"""Notebook 05: the repair gate (App. C, Fig. S5): what the loss alone makes of defective clouds."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from paper_artifact.catalogue import LOSS, colour_of
from paper_artifact.plot import PAGE, new_figure
from paper_artifact.report.kit.figures import (
    cloud_limits,
    draw_cloud,
    label_axis,
    legend_below,
    log_text,
    mark_value,
    plain_log,
)
from paper_artifact.report.kit.published import published
from paper_artifact.study.repair import RepairProbe, Trajectory, make_probe, repair

PROBES = {  # name: what happens, coordinate axes of its picture
    "T1": ("punctured void closes", (0, 2)),
    "T2": ("spurious handle dies", (0, 2)),
    "T3": ("mis-spaced components separate", (0, 1)),
    "T4": ("bridged merge is severed", (0, 1)),
    "T4d": ("the same, dense bridge", (0, 1)),
}
ZERO = 1e-12  # a bottleneck distance below it is rounding
Runs = dict[str, tuple[RepairProbe, Trajectory]]


def run_gate(names: Iterable[str] = tuple(PROBES), seed: int = 0, record_every: int = 20) -> Runs:
    """Return (probe, trajectory) by name: the loss alone, Adam on the points; some 5 s of CPU each."""
    probes = {name: make_probe(name, seed) for name in names}
    return {
        name: (probe, repair(probe, record_every=record_every, seed=seed)) for name, probe in probes.items()
    }


def published_factor(name: str) -> tuple[float, str]:
    """Return the paper's factor start / end of a probe, and its text; infinite where it only says that the
    bar dies."""
    gate = published("gate")
    row = gate[gate["shape"].str.startswith(name[:2])].iloc[0]  # T4d is the paper's T4
    if row["quantity"] == "bottleneck_ratio_before_after":
        return float(row["value"]), f"{row['printed']}×"
    return float("inf"), "dies at the diagonal"


def gate_table(runs: Runs) -> pd.DataFrame:
    """Return per probe what does not depend on the last bit: the start's bottleneck, significant bars before
    and after against the target's, and bars recruited at the start."""
    columns = {}
    for name, (probe, run) in runs.items():
        columns[_title(name)] = {
            "dimension": f"H{probe.dimension}",
            "M": len(probe.start),
            "steps": int(run.steps[-1]),
            "bottleneck at start": round(float(run.bottleneck[0]), 4),
            "significant before": int(run.significant[0]),
            "after": int(run.significant[-1]),
            "target": len(probe.bundle.bars[probe.dimension]),
            "recruited at start": int(run.recruited[0]),
        }
    return pd.DataFrame(columns).rename_axis(columns="probe")


def _title(name: str) -> str:
    return f"{name}: {PROBES[name][0]}"


def factor_table(runs: Runs) -> pd.DataFrame:
    """Return where the curve stands at the paper's factor: start, the paper's factor, the first recorded step
    that reaches it and the bottleneck there; then the end, whose factor says how long the optimiser ran.

    A thousand steps of Adam amplify the last bit, so this is for a cell that is not compared.
    """
    rows = {}
    for name, (_, run) in runs.items():
        factor, printed = published_factor(name)
        step, value = at_factor(run, factor)
        end = run.bottleneck[-1]
        rows[name] = {
            "bottleneck at start": round(float(run.bottleneck[0]), 5),
            "paper's factor": printed,
            "first at step": "never" if step is None else f"{step} of {run.steps[-1]}",
            "bottleneck there": "" if value is None else f"{value:.2g}",
            "at the end": f"< {ZERO:g}" if 0 < end < ZERO else f"{end:.2g}",
            "its factor": f"{run.factor:.3g}×" if np.isfinite(run.factor) else "—",
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("probe")


def at_factor(run: Trajectory, factor: float) -> tuple[int | None, float | None]:
    """Return the first recorded step at which the bottleneck is at most the start's divided by `factor` (for
    an infinite one: zero, no significant bar left), and the bottleneck there; (None, None) if none is."""
    reached = np.flatnonzero(run.bottleneck <= run.bottleneck[0] / factor)
    if not len(reached):
        return None, None
    return int(run.steps[reached[0]]), float(run.bottleneck[reached[0]])


def gate_figure(runs: Runs) -> Figure:
    """Return one row per probe: start and end on the same axes, and the bottleneck to the target over the
    steps (log, cut at 1e-12; zero is marked on a line of its own, labelled 0); dashed: the start divided by
    the paper's factor."""
    figure, axes = new_figure(len(runs), 3, PAGE / 3, 1.6)
    for (name, (_, run)), line in zip(runs.items(), axes, strict=True):
        view = PROBES[name][1]
        limits = cloud_limits(run.start, run.final, axes=view)
        draw_cloud(line[0], run.start, f"{name}: start", view, limits)
        draw_cloud(line[1], run.final, f"{name}: after {run.steps[-1]} steps", view, limits)
        line[1].set_ylabel("")
        _draw_curve(line[2], run, published_factor(name)[0])
        label_axis(line[2], PROBES[name][0], "step", "bottleneck (radius / D)")
    legend_below(figure)
    return figure


def _draw_curve(axis: Axes, run: Trajectory, factor: float) -> None:
    """Draw a bottleneck over the steps: values on a logarithmic axis, zeros on a line below it."""
    zero = run.bottleneck <= 0
    shown = np.where(zero, np.nan, np.maximum(run.bottleneck, ZERO))
    axis.plot(run.steps, shown, color=colour_of(LOSS), label="bottleneck to the target")
    plain_log(axis)
    if np.isfinite(factor):
        mark_value(axis, run.bottleneck[0] / factor).set_label("start / the paper's factor")
    if zero.any():
        lowest = np.floor(np.log10(np.nanmin(shown)))  # the decade of the least value; zero half a one below
        line, ticks = 10 ** (lowest - 0.5), 10.0 ** np.arange(lowest, np.log10(np.nanmax(shown)) + 1)
        style = {"color": colour_of(LOSS), "s": 9, "linewidths": 0, "label": "exactly zero"}
        axis.scatter(run.steps[zero], np.full(zero.sum(), line), **style)
        axis.set_yticks([line, *ticks], ["0", *map(log_text, ticks)])
        axis.minorticks_off()
        axis.set_ylim(line / 1.6, ticks[-1])


def component_sizes(points: np.ndarray, radius: float) -> np.ndarray:
    """Return the sizes, largest first, of the components of balls of this radius around points (n,3), same
    unit: those of H0 at that value."""
    pairs = cKDTree(points).query_pairs(2 * radius, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    return np.sort(np.bincount(connected_components(graph, directed=False)[1]))[::-1]


def severed_table(runs: Runs) -> pd.DataFrame:
    """Return for the probes of H0 what the second component is at the end, just below the target's death
    radius: half of the shape, or a point torn off it."""
    rows = {}
    for name, (probe, run) in runs.items():
        if probe.dimension != 0:
            continue
        sizes = component_sizes(run.final, 0.9 * probe.bundle.bars[0][0, 1] * probe.bundle.diagonal)
        second, points = int(sizes[1]) if len(sizes) > 1 else 0, len(run.final)
        share = "a single point" if second == 1 else f"{second} points"
        rows[_title(name)] = {
            "points": points,
            "components": len(sizes),
            "the second one": "a half" if second > 0.4 * points else share,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("probe")


def lemma_table(steps: int = 20, seed: int = 0) -> pd.DataFrame:
    """Return T4 with and without recruitment after a few steps: without it nothing moves (Lemma 1)."""
    probe = make_probe("T4", seed)
    rows = {}
    for recruitment in (True, False):
        run = repair(probe, steps=steps, recruitment=recruitment, seed=seed)
        rows[recruitment] = {
            "significant live bars": int(run.significant[0]),
            "target bars": len(probe.bundle.bars[0]),
            "recruited": int(run.recruited[0]),
            "loss is zero": bool(run.loss[0] == 0),
            "points moved": bool((run.final != run.start).any()),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("recruitment")
