"""Floor windows (Table S13): for which multipliers k of the floor k·r_med every bundle decision of the study stays as it is.

A shape's features are the classes that its surface has (or, for the bowls, that its samples show). At the protocol's density and
bundle seed each is IN (a bar above the floor in a dimension the loss acts on) or OUT. An IN bar leaves when k exceeds 6 times its
margin (lifetime / floor), an OUT one enters when k falls below 6 times its margin: those are the flip points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row
from paper_artifact.evaluate.diagram import lifetimes
from paper_artifact.evaluate.staircase import MULTIPLIER, measure
from paper_artifact.report.figures import new_figure
from paper_artifact.report.published import published
from paper_artifact.scene.find import surface

# Finite classes (H0, H1, H2) per shape. The external meshes' genera are certified; a bowl has no class of its own but reads as
# a void with a rim.
FEATURES = {
    "sphere": (0, 0, 1),
    "cube": (0, 0, 1),
    "torus": (0, 2, 1),
    "two_spheres": (1, 0, 2),
    "double_torus": (0, 4, 1),
    "spot": (0, 0, 1),
    "fandisk": (0, 0, 1),
    "bob": (0, 2, 1),
    "rocker-arm": (0, 2, 1),
    "eight": (0, 4, 1),
    "armadillo": (0, 0, 1),
    "horse": (0, 0, 1),
    "pot": (0, 6, 1),
    "bowl_narrow": (0, 1, 1),
    "bowl_wide": (0, 1, 1),
}
NAMES = ("component", "loop", "void")
BUNDLES, MEDIAN = -1, -2  # in the place of a seed: each shape's own bundle seed; the median over all seeds


def margin_table(shapes: Iterable[str] = tuple(FEATURES), seeds: Iterable[int] = (0,)) -> pd.DataFrame:
    """Return one line per shape, seed and feature: dimension, rank, margin (lifetime / floor at k = 6), whether it is IN, and
    whether the seed is that of the study's bundle.

    Raises InputError for an external mesh that cannot be had.
    """
    rows = []
    for shape in shapes:
        protocol = shape_row(shape)
        for seed in seeds:
            diagram, floor = measure(surface(shape), protocol.samples, seed)
            for dimension, count in enumerate(FEATURES[shape]):
                margins = np.sort(lifetimes(diagram[dimension]))[::-1][:count] / floor
                acts = protocol.dimensions is None or dimension in protocol.dimensions
                rows += [
                    {
                        "shape": shape,
                        "M": protocol.samples,
                        "seed": seed,
                        "dimension": dimension,
                        "rank": rank + 1,
                        "margin": margin,
                        "in": bool(acts and margin > 1),
                        "bundle": seed == protocol.bundle_seed,
                    }
                    for rank, margin in enumerate(margins)
                ]
    return pd.DataFrame(rows)


def window_table(margins: pd.DataFrame) -> pd.DataFrame:
    """Return Table S13: tightest IN and largest OUT margin per shape (the bundle's seed, and the range over all), flip points k,
    beside the paper's."""
    paper = published("S13").set_index(["shape", "quantity"])["value"]
    rows = []
    for shape, group in margins.groupby("shape", sort=False):
        row = {"shape": shape, "M": group["M"].iloc[0]}
        for which, inside, pick in (("IN", True, "min"), ("OUT", False, "max")):
            chosen = group[group["in"] == inside]
            best = _extreme(chosen[chosen["bundle"]], pick)
            key = "tightest_in_over_floor" if inside else "largest_out_over_floor"
            name = "tightest IN" if inside else "largest OUT"
            row[name] = (
                "—" if best is None else f"{best['margin']:.2f} ({NAMES[best['dimension']]} {best['rank']})"
            )
            extremes = chosen.groupby("seed")["margin"].agg(pick)
            row[f"{which}, seeds"] = "—" if extremes.empty else f"{extremes.min():.2f}–{extremes.max():.2f}"
            row[f"paper's {which}"] = _printed(paper, shape, key)
            row[f"k flips {which}"] = "—" if best is None else f"{MULTIPLIER * best['margin']:.2f}"
        rows.append(row)
    return pd.DataFrame(rows).set_index("shape")


def median_margins(margins: pd.DataFrame) -> pd.DataFrame:
    """Return a margin table with one line per feature, the median over the seeds; IN if that exceeds 1 where the loss acts
    ("seed" MEDIAN)."""
    keys = ["shape", "M", "dimension", "rank"]
    table = margins.groupby(keys, sort=False)["margin"].median().reset_index().assign(seed=MEDIAN)
    acts = [
        shape_row(shape).dimensions is None or dimension in shape_row(shape).dimensions
        for shape, dimension in zip(table["shape"], table["dimension"])
    ]
    return table.assign(**{"in": np.array(acts) & (table["margin"] > 1)})


def global_window(margins: pd.DataFrame, without: Sequence[tuple[str, int]] = ()) -> pd.DataFrame:
    """Return the interval of k in which no decision changes, with the two binding features: of the study's bundles, of the median
    margins, and of every seed; beside the paper's.

    without: (shape, dimension) features left out, to see what binds next.
    """
    left_out = [
        (shape, dimension) in without for shape, dimension in zip(margins["shape"], margins["dimension"])
    ]
    kept = margins[~np.array(left_out, dtype=bool)]
    rows = []
    bundles = kept[kept["bundle"]].assign(seed=BUNDLES)
    for seed, group in pd.concat([bundles, median_margins(kept), kept]).groupby("seed", sort=False):
        low, high = _extreme(group[~group["in"]], "max"), _extreme(group[group["in"]], "min")
        rows.append(
            {
                "source": {BUNDLES: "ours, the bundles' seeds", MEDIAN: "ours, median margins"}.get(
                    seed, f"ours, seed {seed}"
                ),
                "k from": round(MULTIPLIER * low["margin"], 2),
                "bound by (OUT)": _name(low),
                "k to": round(MULTIPLIER * high["margin"], 2),
                "bound by (IN)": _name(high),
            }
        )
    paper = published("S13").set_index("quantity")["value"]
    rows.append(
        {
            "source": "paper",
            "k from": paper["window_low"],
            "bound by (OUT)": "double_torus loop 3",
            "k to": paper["window_high"],
            "bound by (IN)": "bob void 1",
        }
    )
    return pd.DataFrame(rows).set_index("source")


def window_figure(margins: pd.DataFrame) -> Figure:
    """Return per shape its features' flip points 6·margin (medians over the seeds) on a common axis of k: filled IN, hollow OUT;
    the band is the window of k, small dots are single seeds."""
    figure, axes = new_figure(1, 1, 7.5, 4.2)
    axis, group = axes[0][0], median_margins(margins)
    shapes = list(dict.fromkeys(group["shape"]))
    colours = ("#1e8449", "#1f5fbf", "#c0392b")
    for row in group.itertuples():
        inside = group.loc[row.Index, "in"]
        axis.scatter(
            MULTIPLIER * row.margin,
            shapes.index(row.shape),
            s=34,
            facecolor=colours[row.dimension] if inside else "none",
            edgecolor=colours[row.dimension],
            linewidths=1.1,
            zorder=3,
        )
    axis.scatter(
        MULTIPLIER * margins["margin"],
        [shapes.index(each) for each in margins["shape"]],
        s=3,
        color=[colours[each] for each in margins["dimension"]],
        linewidths=0,
    )
    low = MULTIPLIER * group.loc[~group["in"], "margin"].max()
    high = MULTIPLIER * group.loc[group["in"], "margin"].min()
    axis.axvspan(low, high, color="#f5d76e", alpha=0.5, linewidth=0)
    axis.axvline(MULTIPLIER, color="black", linestyle="--", linewidth=0.8)
    for name, colour in zip(NAMES, colours):
        axis.scatter([], [], color=colour, s=34, label=name)
    axis.scatter([], [], facecolor="none", edgecolor="black", s=34, label="OUT (hollow)")
    axis.set_yticks(range(len(shapes)), shapes, fontsize=8)
    axis.invert_yaxis()
    axis.set(xscale="log", xlabel="k at which the decision flips (6 × margin)")
    axis.set_xticks(
        [2, 3, 4, 5, 6, 8, 10, 15, 20, 30], ["2", "3", "4", "5", "6", "8", "10", "15", "20", "30"]
    )
    axis.minorticks_off()
    axis.grid(alpha=0.25)
    axis.legend(fontsize=7, loc="lower right")
    return figure


def _extreme(group: pd.DataFrame, pick: str) -> pd.Series | None:
    if group.empty:
        return None
    return group.loc[group["margin"].idxmin() if pick == "min" else group["margin"].idxmax()]


def _name(feature: pd.Series) -> str:
    return f"{feature['shape']} {NAMES[feature['dimension']]} {feature['rank']}"


def _printed(paper: pd.Series, shape: str, key: str) -> str:
    return f"{paper[shape, key]:.2f}" if (shape, key) in paper.index else "—"
