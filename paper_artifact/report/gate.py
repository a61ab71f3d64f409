"""The repair gate (App. C, Fig. S5): the four probes of `topology.repair`, their pictures, and the paper's factors beside
ours."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from paper_artifact.report.figures import draw_cloud, new_figure
from paper_artifact.report.published import published
from paper_artifact.study.repair import RepairProbe, Trajectory, make_probe, repair

PROBES = ("T1", "T2", "T3", "T4", "T4d")
WHAT = {
    "T1": "punctured void closes",
    "T2": "spurious handle dies",
    "T3": "mis-spaced components separate",
    "T4": "bridged merge is severed",
    "T4d": "the same, dense bridge",
}
VIEW = {
    "T1": (0, 2),
    "T2": (0, 2),
    "T3": (0, 1),
    "T4": (0, 1),
    "T4d": (0, 1),
}  # coordinate axes of the picture
Runs = dict[str, tuple[RepairProbe, Trajectory]]


def run_gate(names: Iterable[str] = PROBES, seed: int = 0, record_every: int = 20) -> Runs:
    """Return (probe, trajectory) by name: the loss alone, Adam on the points; some 5 s of CPU each."""
    made = {}
    for name in names:
        probe = make_probe(name, seed)
        made[name] = (probe, repair(probe, record_every=record_every, seed=seed))
    return made


def gate_table(runs: Runs) -> pd.DataFrame:
    """Return per probe what does not depend on the last bit: the start's bottleneck, significant bars before and after against
    the target's, bars recruited at the start, the paper's factor and whether ours reaches it."""
    rows = []
    for name, (probe, run) in runs.items():
        paper = _paper(name)
        rows.append(
            {
                "probe": f"{name}: {WHAT[name]}",
                "dimension": f"H{probe.dimension}",
                "M": len(probe.start),
                "steps": int(run.steps[-1]),
                "bottleneck at start": round(float(run.bottleneck[0]), 4),
                "significant before": int(run.significant[0]),
                "after": int(run.significant[-1]),
                "target": len(probe.bundle.bars[probe.dimension]),
                "recruited at start": int(run.recruited[0]),
                "paper's factor": "dies" if np.isinf(paper) else f"{paper:g}×",
                "ours reaches it": bool(run.factor >= paper),
            }
        )
    return pd.DataFrame(rows).set_index("probe").T


def factor_table(runs: Runs) -> pd.DataFrame:
    """Return the measured end values and factors; a thousand steps of Adam amplify the last bit, so this is for a cell that is
    not compared."""
    rows = []
    for name, (_, run) in runs.items():
        end, paper = run.bottleneck[-1], _paper(name)
        rows.append(
            {
                "probe": name,
                "bottleneck at start": round(float(run.bottleneck[0]), 5),
                "at the end": "< 1e-12" if 0 < end < 1e-12 else f"{end:.2g}",
                "factor": "no significant bar left"
                if end == 0
                else f"{run.factor:.0f}×"
                if run.factor < 1e6
                else "> 1,000,000×",
                "paper's": "dies at the diagonal" if np.isinf(paper) else f"{paper:g}×",
            }
        )
    return pd.DataFrame(rows).set_index("probe")


def gate_figure(runs: Runs) -> Figure:
    """Return one row per probe: start, end, and the bottleneck to the target over the steps (log, cut at 1e-12; zero is drawn
    below the rest)."""
    figure, axes = new_figure(len(runs), 3, 3.0, 2.3)
    for (name, (probe, run)), line in zip(runs.items(), axes, strict=True):
        low = np.minimum(run.start.min(axis=0), run.final.min(axis=0)) - 0.1
        high = np.maximum(run.start.max(axis=0), run.final.max(axis=0)) + 0.1
        across, up = VIEW[name]
        limits = ((low[across], high[across]), (low[up], high[up]))
        draw_cloud(line[0], run.start, f"{name}: start", VIEW[name], limits)
        draw_cloud(line[1], run.final, f"{name}: after {run.steps[-1]} steps", VIEW[name], limits)
        lowest = 1e-12 if run.bottleneck[-1] > 0 else run.bottleneck[run.bottleneck > 0].min() / 3
        line[2].plot(run.steps, np.maximum(run.bottleneck, lowest), color="#1f5fbf", linewidth=1.3)
        line[2].set_yscale("log")
        line[2].set_title(f"{WHAT[name]}: bottleneck, radius / D", fontsize=8)
        line[2].tick_params(labelsize=6)
        line[2].grid(alpha=0.25)
    return figure


def component_sizes(points: np.ndarray, radius: float) -> np.ndarray:
    """Return the sizes, largest first, of the components of balls of this radius around points (n,3), same unit: those of H0 at
    that value."""
    pairs = cKDTree(points).query_pairs(2 * radius, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    return np.sort(np.bincount(connected_components(graph, directed=False)[1]))[::-1]


def severed_table(runs: Runs, names: Iterable[str] = ("T3", "T4", "T4d")) -> pd.DataFrame:
    """Return what the second component is at the end, just below the target's death radius: half of the shape, or a point torn
    off it."""
    rows = []
    for name in names:
        probe, run = runs[name]
        sizes = component_sizes(run.final, 0.9 * probe.bundle.bars[0][0, 1] * probe.bundle.diagonal)
        second = int(sizes[1]) if len(sizes) > 1 else 0
        rows.append(
            {
                "probe": f"{name}: {WHAT[name]}",
                "points": len(run.final),
                "components": len(sizes),
                "the second one": (
                    "a half"
                    if second > 0.4 * len(run.final)
                    else "a single point"
                    if second == 1
                    else f"{second} points"
                ),
            }
        )
    return pd.DataFrame(rows).set_index("probe")


def lemma_table(steps: int = 20, seed: int = 0) -> pd.DataFrame:
    """Return T4 with and without recruitment after a few steps: without it nothing moves (Lemma 1)."""
    probe = make_probe("T4", seed)
    rows = []
    for recruitment in (True, False):
        run = repair(probe, steps=steps, recruitment=recruitment, seed=seed)
        moved = np.linalg.norm(run.final - run.start, axis=1)
        rows.append(
            {
                "recruitment": recruitment,
                "significant live bars": int(run.significant[0]),
                "target bars": 1,
                "recruited": int(run.recruited[0]),
                "loss is zero": bool(run.loss[0] == 0),
                "points moved": bool(moved.max() > 0),
            }
        )
    return pd.DataFrame(rows).set_index("recruitment")


def _paper(name: str) -> float:
    """The paper's factor; inf where it only says that the bar dies."""
    gate = published("gate")
    row = gate[gate["shape"].str.startswith(name[:2])].iloc[0]
    return float(row["value"]) if row["quantity"] == "bottleneck_ratio_before_after" else float("inf")
