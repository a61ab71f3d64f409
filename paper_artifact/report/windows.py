"""Notebook 04: for which multipliers k of the floor k·r_med no bundle decision changes (Table S13).

A shape's features are the classes that its surface has (or, for the bowls, that its samples show). At the
study's density and bundle seed each is IN (a bar above the floor in a dimension the loss acts on) or OUT. An
IN bar leaves when k exceeds 6 times its margin (lifetime / floor), an OUT one enters when k falls below 6
times its margin: those are the flip points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row
from paper_artifact.evaluate.staircase import MULTIPLIER
from paper_artifact.export.figures import new_figure
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.staircase import BAR_NAMES, bar_name, bars, staircase
from paper_artifact.report.kit.text import span
from paper_artifact.scene.find import surface

FEATURE = ["shape", "M", "dimension", "bar", "acts"]


def margin_table(shapes: Iterable[str] = (), seeds: Iterable[int] = (0,)) -> pd.DataFrame:
    """Return one row per shape, seed and feature: shape, M, seed, dimension, bar, acts (whether the loss acts
    on the dimension), margin (lifetime / floor at k = 6), inside (IN), bundle (whether the seed is that of
    the study's bundle).

    shapes: of the catalogue; none: those of Table S13. Raises InputError for an external mesh that cannot be
    had.
    """
    found = []
    for shape in shapes or published("S13")["shape"].unique():
        if (row := shape_row(shape)) is None:
            continue  # the table's last rows are about all shapes
        own = bars(staircase(surface(shape), (row.samples,), seeds, kept=max(row.features)))
        features = [bar_name(d, rank + 1) for d, count in enumerate(row.features) for rank in range(count)]
        own = own[own["bar"].isin(features)]
        acts = own["dimension"].isin(range(3) if row.dimensions is None else row.dimensions)
        found.append(own.assign(acts=acts, bundle=own["seed"] == row.bundle_seed))
    table = pd.concat(found, ignore_index=True).rename(columns={"samples": "M"})
    return _decided(table[[*FEATURE[:2], "seed", *FEATURE[2:], "margin", "bundle"]])


def median_margins(margins: pd.DataFrame) -> pd.DataFrame:
    """Return a margin table with one row per feature, the median over the seeds."""
    return _decided(margins.groupby(FEATURE, sort=False)["margin"].median().reset_index())


def _decided(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(inside=table["acts"] & (table["margin"] > 1))


def table_s13(margins: pd.DataFrame) -> pd.DataFrame:
    """Return Table S13: tightest IN and largest OUT margin per shape (the bundle's seed, and the range over
    all), flip points k, beside the paper's."""
    paper = published("S13").pivot(index="shape", columns="quantity", values="printed")
    table = margins.groupby("shape", sort=False)[["M"]].first()
    for which, name, pick in (("IN", "tightest IN", "first"), ("OUT", "largest OUT", "last")):
        own = margins[margins["inside"] == (which == "IN")].sort_values("margin")
        bundle = own[own["bundle"]].groupby("shape")[["margin", "bar"]].agg(pick)
        seeds = own.groupby(["shape", "seed"])["margin"].agg(pick)
        table[name] = bundle["margin"].map("{:.2f}".format) + " (" + bundle["bar"] + ")"
        table[f"{which}, seeds"] = seeds.groupby("shape").agg(span, 2)
        table[f"paper's {which}"] = paper[f"{name.lower().replace(' ', '_')}_over_floor"]
        table[f"k flips {which}"] = (MULTIPLIER * bundle["margin"]).map("{:.2f}".format)
    return table.fillna("—")


def binding(margins: pd.DataFrame) -> list[pd.Series]:
    """Return the largest OUT and the tightest IN feature: the rows between whose flip points k may lie."""
    ordered = margins.sort_values("margin")
    return [ordered[~ordered["inside"]].iloc[-1], ordered[ordered["inside"]].iloc[0]]


def global_window(margins: pd.DataFrame, without: Sequence[tuple[str, int]] = ()) -> pd.DataFrame:
    """Return the interval of k in which no decision changes, with the two binding features: of the study's
    bundles, of the median margins, and of every seed; beside the paper's.

    without: (shape, dimension) features left out, to see what binds next.
    """
    kept = margins[~margins.set_index(["shape", "dimension"]).index.isin(without)]
    sources = {"ours, the bundles' seeds": kept[kept["bundle"]], "ours, median margins": median_margins(kept)}
    sources |= {f"ours, seed {seed}": group for seed, group in kept.groupby("seed")}
    rows = {}
    for source, group in sources.items():
        ends = [
            (f"{MULTIPLIER * each['margin']:.2f}", f"{each['shape']} {each['bar']}")
            for each in binding(group)
        ]
        rows[source] = [*ends[0], *ends[1]]
    paper = published("S13").set_index("quantity").loc[["window_low", "window_high"]]
    paper = paper.assign(note=paper["note"].str.removeprefix("bound by "))
    rows["paper"] = paper[["printed", "note"]].to_numpy().ravel()
    columns = ["k from", "bound by (OUT)", "k to", "bound by (IN)"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("source")


def window_figure(margins: pd.DataFrame) -> Figure:
    """Return per shape its features' flip points 6·margin (medians over the seeds) on a common axis of k:
    filled IN, hollow OUT; the band is the window of k, small dots are single seeds."""
    figure, axes = new_figure(1, 1, 7.5, 4.2)
    axis, medians = axes[0][0], median_margins(margins)
    places = {shape: place for place, shape in enumerate(medians["shape"].unique())}
    for dimension, colour in enumerate(("#1e8449", "#1f5fbf", "#c0392b")):
        seeds, own = (each[each["dimension"] == dimension] for each in (margins, medians))
        axis.scatter(
            MULTIPLIER * seeds["margin"], seeds["shape"].map(places), s=3, color=colour, linewidths=0
        )
        faces, heights = own["inside"].map({True: colour, False: "none"}), own["shape"].map(places)
        axis.scatter(MULTIPLIER * own["margin"], heights, s=34, c=faces, edgecolor=colour, zorder=3)
        axis.scatter([], [], color=colour, s=34, label=BAR_NAMES[dimension])
    axis.scatter([], [], facecolor="none", edgecolor="black", s=34, label="OUT (hollow)")
    low, high = (MULTIPLIER * each["margin"] for each in binding(medians))
    axis.axvspan(low, high, color="#f5d76e", alpha=0.5, linewidth=0)
    axis.axvline(MULTIPLIER, color="black", linestyle="--", linewidth=0.8)
    axis.set_yticks(list(places.values()), list(places), fontsize=8)
    axis.invert_yaxis()
    axis.set(xscale="log", xlabel="k at which the decision flips (6 × margin)")
    ticks = [2, 3, 4, 5, 6, 8, 10, 15, 20, 30]
    axis.set_xticks(ticks, list(map(str, ticks)))
    axis.minorticks_off()
    axis.grid(alpha=0.25)
    axis.legend(fontsize=7, loc="lower right")
    return figure
