"""Notebook 06: what the C-matrix (Table 1) is made of: separations, Chamfer, an H0 tail, seeds, diagrams.

The table itself, verdicts and trajectories are those of every study (`report.kit.tables`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.optimize import linear_sum_assignment

from paper_artifact.catalogue import colour_of, in_order
from paper_artifact.plot import FAINT, INK, PAGE, new_figure
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import label_axis, legend_below
from paper_artifact.report.kit.records import Collected, target_of
from paper_artifact.report.kit.tables import beside
from paper_artifact.report.kit.text import NOT_RECORDED, counts_text
from paper_artifact.study.verdict import BASELINE, LOSS, verdict, welch_sigma

COMPOSITION, PRIOR_ALONE = "C5", "B4"  # the loss with the spread prior, and that prior alone


def welch_table(collected: Collected) -> pd.DataFrame:
    """Return the separations of two arms that the paper's text quotes, in Welch's sigma: the paper's, and
    ours without sign."""
    judged, rows = frames.verdicts(collected), {}
    for quoted in frames.paper("welch_sigma", "ablations").itertuples():
        arms = judged[quoted.shape].arms if quoted.shape in judged else {}
        pair = [arms[name].tails for name in quoted.condition.split(" vs ") if name in arms]
        ours = welch_sigma(*pair) if len(pair) == 2 else None
        rows[quoted.shape, quoted.condition] = {
            "ours": "needs five recorded seeds of each" if ours is None else f"{abs(ours):.1f}",
            "paper": quoted.printed,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["shape", "arms"])


def chamfer_table(collected: Collected) -> pd.DataFrame:
    """Return mean Chamfer (both directions' mean, % of D) per condition and shape, ours beside what the
    paper's text gives."""
    ours = (100 * frames.arms(collected).set_index(frames.ARM)["chamfer"]).dropna().map("{:.3f}".format)
    return beside(ours, frames.paper_arms("chamfer_percent", "chamfer").set_index(frames.ARM)["printed"])


def composition_table(collected: Collected, shapes: Sequence[str] = ("sphere", "torus")) -> pd.DataFrame:
    """Return what the paper says of C5 (RH3), ours beside the paper's: how many times lower its tail is than
    the baseline's, the loss's and the prior's alone, the study's verdict against both channels alone, its
    Chamfer (%, mean of both directions), and that one's place among Table 1's arms.

    collected: has Table 1's arms and B4.
    """
    arms = frames.arms(collected).dropna(subset="mean").set_index(frames.ARM)
    quoted = frames.paper("tail_ratio", "ablations").set_index(frames.ARM)["printed"]
    printed = frames.paper_arms("tail_bottleneck", "1").set_index(frames.ARM)["ratio"]
    chamfers = frames.paper_arms("chamfer_percent", "chamfer").set_index(frames.ARM)["printed"]
    places = frames.paper("chamfer_place", "ablations").set_index(frames.ARM)["printed"]
    judged = verdict(frames.runs(collected), (LOSS, PRIOR_ALONE), COMPOSITION)
    rows = {}
    for shape in shapes:
        means = arms["mean"][shape] if shape in arms.index else pd.Series(dtype=float)
        for other in (BASELINE, LOSS, PRIOR_ALONE):
            known = {other, COMPOSITION} <= set(means.index)
            rows[shape, f"{other} / {COMPOSITION}"] = {
                "ours": f"{means[other] / means[COMPOSITION]:.1f}" if known else NOT_RECORDED,
                "paper": printed[shape, COMPOSITION]
                if other == BASELINE
                else quoted.get((shape, f"{COMPOSITION} vs {other}"), ""),
            }
        alone = f"below {LOSS} and {PRIOR_ALONE} alone, ranges apart, Chamfer at parity?"
        found = judged.get(shape)
        said = NOT_RECORDED if found is None else f"{found.outcome}: {found.reason}"
        rows[shape, alone] = {"ours": said, "paper": "best everywhere tested"}
        known = COMPOSITION in means.index
        own = arms["chamfer"][shape].drop(PRIOR_ALONE, errors="ignore").sort_values() if known else None
        rows[shape, f"Chamfer % of {COMPOSITION}"] = {
            "ours": f"{100 * own[COMPOSITION]:.3f}" if known else NOT_RECORDED,
            "paper": chamfers.get((shape, COMPOSITION), ""),
        }
        rows[shape, "place of that Chamfer, 1 the lowest"] = {
            "ours": f"{own.index.get_loc(COMPOSITION) + 1} ({', '.join(own.index)})"
            if known
            else NOT_RECORDED,
            "paper": places.get((shape, COMPOSITION), ""),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["shape", "RH3"])


def component_table(collected: Collected, shape: str) -> pd.DataFrame:
    """Return what an H0 tail is made of, last step, means over seeds per condition, radius / D.

    The merging bar's error (of its death, against the target's); what the next longest live bar (the most
    isolated sample) costs in either of its two ways: alone, half its death, or with the target's longest
    noise bar, their difference; seed by seed the lesser of the two, or the merging bar's error where that is
    larger; the bottleneck distance measured; and in how many seeds it is the merging bar's.
    """
    rows = {}
    merging, noise = np.sort(target_of(shape).diagram[0][:, 1])[::-1][:2]
    for condition in frames.conditions(collected):
        lasts = [record["dumps"][-1] for record in collected.of(shape, condition)]
        if lasts:
            first, following = np.array([[bar[1] for bar in last["bars"][0][:2]] for last in lasts]).T
            off = abs(first - merging)
            lesser = np.minimum(following / 2, following - noise)
            rows[condition] = {
                "merging bar off by": off.mean().round(4),
                "next bar alone": (following / 2).mean().round(4),
                "less the target's noise bar": (following - noise).mean().round(4),
                "what binds, per seed": np.maximum(lesser, off).mean().round(4),
                "bottleneck, H0": np.mean([last["bottleneck"][0] for last in lasts]).round(4),
                "by the merging bar": f"{(off > lesser).sum()} of {len(lasts)}",
            }
    return pd.DataFrame.from_dict(rows, orient="index")


def wasserstein_table(collected: Collected, shape: str) -> pd.DataFrame:
    """Return per condition the Wasserstein distance of order 1 to the target in the judged dimension, last
    step, means over seeds: significant bars only (each diagram above its own floor), maximum norm, a bar left
    alone at half its lifetime; radius / D. Split into what matched pairs and what bars left alone cost,
    beside the bottleneck distance, half the lifetimes that the target's unmatched bars have, and the paper's
    value."""
    target, rows = target_of(shape), {}
    paper = frames.paper("wasserstein", "ablations").set_index(frames.ARM)["note"]
    paper = paper.str.removeprefix("printed as ")
    aims = _significant(target.diagram[target.dimension], target.floor)
    for condition in frames.conditions(collected):
        lasts = [record["dumps"][-1] for record in collected.of(shape, condition)]
        if lasts:
            lives = [_significant(np.array(last["bars"][target.dimension]), last["floor"]) for last in lasts]
            paired, alone = np.mean([wasserstein_parts(live, aims) for live in lives], axis=0)
            rows[condition] = {
                "significant": counts_text(map(len, lives)),
                "W1": round(paired + alone, 4),
                "of it matched": round(paired, 4),
                "left alone": round(alone, 4),
                "bottleneck": np.mean([last["bottleneck"][target.dimension] for last in lasts]).round(4),
                "paper": paper.get((shape, condition), ""),
            }
    return pd.DataFrame.from_dict(rows, orient="index")


def _significant(bars: np.ndarray, floor: float) -> np.ndarray:
    bars = np.asarray(bars, dtype=float).reshape(-1, 2)
    return bars[bars[:, 1] - bars[:, 0] > floor]


def wasserstein_parts(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return what matched pairs and what bars left alone cost in the Wasserstein distance of order 1 of bars
    a (k,2) and b (l,2), maximum norm; their sum is the distance."""
    pairs = np.abs(a[:, None] - b[None]).max(axis=2)
    alone = [(bars[:, 1] - bars[:, 0]) / 2 for bars in (a, b)]
    rows, columns = linear_sum_assignment(np.minimum(pairs - alone[0][:, None] - alone[1], 0.0))
    joined = pairs[rows, columns] < alone[0][rows] + alone[1][columns]
    rows, columns = rows[joined], columns[joined]
    left = sum(half.sum() for half in alone) - alone[0][rows].sum() - alone[1][columns].sum()
    return float(pairs[rows, columns].sum()), float(left)


def seed_figure(collected: Collected, shapes: Sequence[str] = ()) -> Figure:
    """Return Fig. S3: per-seed tails as dots and the arms' means as bars from zero, per shape (default: all);
    crosses: the paper's means."""
    shapes = list(shapes) or frames.shapes(collected)
    arms = frames.arms(collected).dropna(subset="mean")
    arms = arms[arms["shape"].isin(shapes)]
    names = in_order(list(arms["condition"].unique()))
    figure, axes = new_figure(
        1, len(shapes), PAGE / max(len(shapes), 2), 0.9 + 0.21 * len(names), sharey=True
    )
    paper = frames.paper_arms().set_index(frames.ARM)["value"]
    for axis, shape in zip(axes[0], shapes, strict=True):
        for arm in arms[arms["shape"] == shape].itertuples():
            colour, place = colour_of(arm.condition), names.index(arm.condition)
            axis.barh(place, arm.mean, color=colour, alpha=0.35, height=0.72)
            dots = {"facecolor": colour, "edgecolor": "white", "linewidths": 0.5, "s": 20, "zorder": 3}
            axis.scatter(arm.tails, [place] * len(arm.tails), **dots)
            if (shape, arm.condition) in paper.index:
                cross = {"color": INK, "marker": "x", "s": 26, "linewidths": 1.1, "zorder": 4}
                axis.scatter(paper[shape, arm.condition], place, label="paper's mean", **cross)
        label_axis(axis, shape, "tail bottleneck (radius / D)")
        axis.grid(visible=False, axis="y")
        axis.set_yticks(range(len(names)), names)
    axes[0][0].set_ylim(len(names) - 0.4, -0.6)
    dot = Line2D([], [], marker="o", color=FAINT, linestyle="none", label="a seed")
    legend_below(figure, 3, (dot, Patch(facecolor=FAINT, alpha=0.5, label="mean of the seeds")))
    return figure
