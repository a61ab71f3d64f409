"""Notebook 04: for which multipliers k of the floor k·r_med no bundle decision changes (Table S13).

A shape's features are the classes that its surface has (or, for the bowls, that its samples show). At the
study's density and bundle seed each is IN (a bar above the floor in a dimension the loss acts on) or OUT. An
IN bar leaves when k exceeds 6 times its margin (lifetime / floor), an OUT one enters when k falls below 6
times its margin: those are the flip points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row
from paper_artifact.evaluate.staircase import MULTIPLIER
from paper_artifact.export.figures import INK, PAGE, new_figure
from paper_artifact.report.kit.figures import (
    DIMENSIONS,
    label_axis,
    legend_below,
    mark_value,
    mark_window,
    plain_log,
)
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.text import span
from paper_artifact.scene.find import surface
from paper_artifact.staircase import BAR_NAMES, bar_name, bars, staircase

FEATURE = ["shape", "M", "dimension", "bar", "acts"]
STATISTICS = {"least": "min", "median": "median", "largest": "max"}
SEEDS, TORUS_SEEDS = range(40), range(200)  # sampling seeds of the stored margins


def measure_windows(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return `margin_table` of all shapes over 40 seeds, of the torus over 200; some five minutes of CPU.

    Raises InputError for a mesh that cannot be had.
    """
    tables = []
    for shape in published("S13")["shape"].unique():
        if shape_row(shape) is not None:
            tables.append(margin_table((shape,), TORUS_SEEDS if shape == "torus" else SEEDS))
            if progress is not None:
                progress(shape)
    return pd.concat(tables, ignore_index=True)


def margin_table(shapes: Iterable[str] = (), seeds: Iterable[int] = (0,)) -> pd.DataFrame:
    """Return one row per shape, seed and feature: shape, M, seed, dimension, bar, acts (whether the loss acts
    on the dimension), floor (radius / D), margin (lifetime / floor at k = 6), bundle (whether the seed is
    that of the study's bundle), inside (IN).

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
    return _decided(table[[*FEATURE[:2], "seed", *FEATURE[2:], "floor", "margin", "bundle"]])


def median_margins(margins: pd.DataFrame) -> pd.DataFrame:
    """Return a margin table with one row per feature, the median over the seeds."""
    return _decided(margins.groupby(FEATURE, sort=False)["margin"].median().reset_index())


def _decided(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(inside=table["acts"] & (table["margin"] > 1))


def agreement_text(stored: pd.DataFrame, again: pd.DataFrame) -> str:
    """Return how many of the stored margins were measured again, and whether all agree."""
    keys = ["shape", "seed", "dimension", "bar"]
    both = stored.merge(again, on=keys, suffixes=("", ", again"))
    agree = len(both) == len(again) and ((both["margin"] - both["margin, again"]).abs() < 1e-4).all()
    return (
        f"{len(both)} of {len(stored)} stored margins measured again; all agree to 0.0001 of the floor: "
        f"{bool(agree)}"
    )


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
    """Return the interval of k in which no decision changes, with what binds it: of the study's bundles, of
    the median margins, and over the seeds that every shape has (least, median and largest end, each with the
    features that bind it and in how many seeds); beside the paper's.

    without: (shape, dimension) features left out, to see what binds next.
    """
    kept = margins[~margins.set_index(["shape", "dimension"]).index.isin(without)]
    common = kept.groupby("seed")["shape"].nunique() == kept["shape"].nunique()
    rows = {
        source: [text for each in binding(group) for text in (_flip(each), f"{each['shape']} {each['bar']}")]
        for source, group in (
            ("ours, the bundles' seeds", kept[kept["bundle"]]),
            ("ours, median margins", median_margins(kept)),
        )
    }
    ends = [binding(group) for seed, group in kept.groupby("seed") if common[seed]]
    seeds = [pd.DataFrame(side) for side in zip(*ends, strict=True)]
    rows[f"ours, {len(ends)} seeds: least–median–largest"] = [
        text for side in seeds for text in _spread(side)
    ]
    paper = published("S13").set_index("quantity").loc[["window_low", "window_high"]]
    paper = paper.assign(note=paper["note"].str.removeprefix("bound by "))
    rows["paper"] = paper[["printed", "note"]].to_numpy().ravel()
    columns = ["k from", "bound by (OUT)", "k to", "bound by (IN)"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("source")


def _flip(feature: pd.Series) -> str:
    return f"{MULTIPLIER * feature['margin']:.2f}"


def _spread(side: pd.DataFrame) -> tuple[str, str]:
    """Return the texts of one end of k over the seeds: its spread, and what binds how often."""
    k = MULTIPLIER * side["margin"]
    bound = (side["shape"] + " " + side["bar"]).value_counts()
    names = ", ".join(f"{name} {number}×" for name, number in bound.items())
    return f"{k.min():.2f}–{k.median():.2f}–{k.max():.2f}", names


def torus_table(margins: pd.DataFrame) -> pd.DataFrame:
    """Return what the paper prints of the torus at M = 2048 (floor, margins of loop 2 and void) beside ours
    over all seeds: least, median, largest; the seed that comes nearest to all three at once (largest relative
    difference), and in how many seeds each is as printed."""
    own = margins[margins["shape"] == "torus"]
    ours = own.pivot(index="seed", columns="bar", values="margin").assign(
        floor=own.groupby("seed")["floor"].first()
    )
    paper = pd.concat([published("floor"), published("S13")])
    paper = paper[paper["shape"] == "torus"].set_index("quantity")
    quantities = {"floor": "floor", "loop 2": "tightest_in_over_floor", "void 1": "largest_out_over_floor"}
    names = {name: paper.loc[quantity] for name, quantity in quantities.items()}
    values = pd.Series({name: row["value"] for name, row in names.items()})
    nearest = ((ours[list(values.index)] - values).abs() / values).max(axis=1).idxmin()
    digits = {"floor": 4, "loop 2": 2, "void 1": 2}
    rows = {}
    for name, row in names.items():
        column, places = ours[name], digits[name]
        rows[name + (" (radius / D)" if name == "floor" else " / floor")] = {
            "paper": row["printed"],
            **{word: f"{getattr(column, call)():.{places}f}" for word, call in STATISTICS.items()},
            f"seed {nearest}, the nearest": f"{column[nearest]:.{places}f}",
            "as printed": f"{(column.round(places) == row['value']).sum()} of {len(column)} seeds",
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("torus, M = 2048")


def window_figure(margins: pd.DataFrame) -> Figure:
    """Return per shape its features' flip points 6·margin (medians over the seeds) on a common axis of k:
    filled IN, hollow OUT, small dots single seeds; marked: the window of k and the study's k = 6."""
    medians = median_margins(margins)
    places = {shape: place for place, shape in enumerate(medians["shape"].unique())}
    figure, axes = new_figure(1, 1, PAGE, 1.1 + 0.19 * len(places))
    axis = axes[0][0]
    for dimension, (colour, marker) in DIMENSIONS.items():
        seeds, own = (each[each["dimension"] == dimension] for each in (margins, medians))
        if not len(own):
            continue
        axis.scatter(
            MULTIPLIER * seeds["margin"], seeds["shape"].map(places) + 0.3, s=3, color=colour, linewidths=0
        )
        heights = own["shape"].map(places) - (0.3 if dimension == 0 else 0)  # beside the void of its size
        style = {"s": 32, "marker": marker}
        for inside, paint in (
            (True, {"facecolor": colour, "edgecolor": "white", "linewidths": 0.6}),
            (False, {"facecolor": "white", "edgecolor": colour, "linewidths": 1.1}),
        ):
            chosen = own["inside"] == inside
            axis.scatter(MULTIPLIER * own["margin"][chosen], heights[chosen], zorder=3, **style, **paint)
        axis.scatter([], [], color=colour, label=f"H{dimension}, {BAR_NAMES[dimension]}", **style)
    axis.scatter([], [], facecolor="white", edgecolor=INK, s=30, label="hollow: OUT")
    axis.scatter([], [], color=INK, s=3, label="one seed")
    window = mark_window(axis, tuple(MULTIPLIER * each["margin"] for each in binding(medians)))
    window.set_label("window of k")
    mark_value(axis, MULTIPLIER, upright=True).set_label(f"k = {MULTIPLIER:g}")
    label_axis(axis, "", "k at which the decision flips: 6 × lifetime / floor")
    plain_log(axis, "x")
    axis.set_yticks(list(places.values()), list(places))
    axis.set_ylim(len(places) - 0.4, -0.6)
    axis.set_xticks([2, 3, 4, 5, 6, 8, 10, 15, 20, 30])
    axis.minorticks_off()
    legend_below(figure, 4, (window,))
    return figure
