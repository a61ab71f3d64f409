"""Notebook 04: for which multipliers k of the floor k·r_med every bundle decision of the study stays as it is (Table S13).

A shape's features are the classes that its surface has (or, for the bowls, that its samples show). At the study's density and
bundle seed each is IN (a bar above the floor in a dimension the loss acts on) or OUT. An IN bar leaves when k exceeds 6 times its
margin (lifetime / floor), an OUT one enters when k falls below 6 times its margin: those are the flip points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row
from paper_artifact.evaluate.staircase import MULTIPLIER
from paper_artifact.report.kit.figures import new_figure
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.staircase import BAR_NAMES, bar_name, bars, staircase
from paper_artifact.report.kit.text import span
from paper_artifact.scene.find import surface

FEATURE = ["shape", "M", "dimension", "rank", "acts"]


def margin_table(shapes: Iterable[str] = (), seeds: Iterable[int] = (0,)) -> pd.DataFrame:
    """Return one row per shape, seed and feature: shape, M, seed, dimension, rank, acts (whether the loss acts on the dimension),
    margin (lifetime / floor at k = 6), inside (IN), bundle (whether the seed is that of the study's bundle).

    shapes: of the catalogue; none: those of Table S13. Raises InputError for an external mesh that cannot be had.
    """
    found = []
    for shape in shapes or published("S13")["shape"].unique():
        if (row := shape_row(shape)) is None:
            continue  # the table's last rows are about all shapes
        own = bars(staircase(surface(shape), (row.samples,), seeds, kept=max(row.features)))
        own = own[own["rank"] <= own["dimension"].map(dict(enumerate(row.features)))]
        acts = own["dimension"].isin(range(3) if row.dimensions is None else row.dimensions)
        found.append(own.assign(acts=acts, bundle=own["seed"] == row.bundle_seed))
    table = pd.concat(found, ignore_index=True).rename(columns={"samples": "M"})
    return _decided(table[[*FEATURE[:2], "seed", *FEATURE[2:], "margin", "bundle"]])


def median_margins(margins: pd.DataFrame) -> pd.DataFrame:
    """Return a margin table with one row per feature, the median over the seeds."""
    return _decided(margins.groupby(FEATURE, sort=False)["margin"].median().reset_index())


def _decided(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(inside=table["acts"] & (table["margin"] > 1))


def _binding(margins: pd.DataFrame) -> tuple[pd.Series | None, pd.Series | None]:
    """The largest OUT and the tightest IN feature: (row or None, row or None)."""
    out, inside = margins.loc[~margins["inside"], "margin"], margins.loc[margins["inside"], "margin"]
    return (
        None if out.empty else margins.loc[out.idxmax()],
        None if inside.empty else margins.loc[inside.idxmin()],
    )


def table_s13(margins: pd.DataFrame) -> pd.DataFrame:
    """Return Table S13: tightest IN and largest OUT margin per shape (the bundle's seed, and the range over all), flip points k,
    beside the paper's."""
    paper = published("S13").set_index(["shape", "quantity"])["printed"]
    rows = {}
    for shape, own in margins.groupby("shape", sort=False):
        rows[shape] = {"M": own["M"].iloc[0]}
        seeds = [_binding(group) for _, group in own.groupby("seed")]
        for place, which, name in ((1, "IN", "tightest IN"), (0, "OUT", "largest OUT")):
            best = _binding(own[own["bundle"]])[place]
            over = [binding[place]["margin"] for binding in seeds if binding[place] is not None]
            quantity = f"{name.lower().replace(' ', '_')}_over_floor"
            rows[shape] |= {
                name: "—",
                f"{which}, seeds": span(over, 2) if over else "—",
                f"paper's {which}": paper.get((shape, quantity), "—"),
                f"k flips {which}": "—",
            }
            if best is not None:
                feature = bar_name(best["dimension"], best["rank"])
                rows[shape][name] = f"{best['margin']:.2f} ({feature})"
                rows[shape][f"k flips {which}"] = _bound(best)[0]
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def global_window(margins: pd.DataFrame, without: Sequence[tuple[str, int]] = ()) -> pd.DataFrame:
    """Return the interval of k in which no decision changes, with the two binding features: of the study's bundles, of the median
    margins, and of every seed; beside the paper's.

    without: (shape, dimension) features left out, to see what binds next.
    """
    kept = margins[~margins.set_index(["shape", "dimension"]).index.isin(without)]
    sources = {"ours, the bundles' seeds": kept[kept["bundle"]], "ours, median margins": median_margins(kept)}
    sources |= {f"ours, seed {seed}": group for seed, group in kept.groupby("seed")}
    rows = []
    for source, group in sources.items():
        low, high = _binding(group)
        rows.append([source, *_bound(low), *_bound(high)])
    paper, row = published("S13").set_index("quantity"), ["paper"]
    for end in ("window_low", "window_high"):
        row += [paper.loc[end, "printed"], paper.loc[end, "note"].removeprefix("bound by ")]
    columns = ["source", "k from", "bound by (OUT)", "k to", "bound by (IN)"]
    return pd.DataFrame([*rows, row], columns=columns).set_index("source")


def _bound(feature: pd.Series) -> tuple[str, str]:
    """The flip point of a feature, and its name."""
    name = bar_name(feature["dimension"], feature["rank"])
    return f"{MULTIPLIER * feature['margin']:.2f}", f"{feature['shape']} {name}"


def window_figure(margins: pd.DataFrame) -> Figure:
    """Return per shape its features' flip points 6·margin (medians over the seeds) on a common axis of k: filled IN, hollow OUT;
    the band is the window of k, small dots are single seeds."""
    figure, axes = new_figure(1, 1, 7.5, 4.2)
    axis, medians = axes[0][0], median_margins(margins)
    places = {shape: place for place, shape in enumerate(medians["shape"].unique())}
    for dimension, colour in enumerate(("#1e8449", "#1f5fbf", "#c0392b")):
        seeds, own = (each[each["dimension"] == dimension] for each in (margins, medians))
        axis.scatter(
            MULTIPLIER * seeds["margin"], seeds["shape"].map(places), s=3, color=colour, linewidths=0
        )
        for face, chosen in ((colour, own[own["inside"]]), ("none", own[~own["inside"]])):
            axis.scatter(
                MULTIPLIER * chosen["margin"],
                chosen["shape"].map(places),
                s=34,
                facecolor=face,
                edgecolor=colour,
                linewidths=1.1,
                zorder=3,
            )
        axis.scatter([], [], color=colour, s=34, label=BAR_NAMES[dimension])
    axis.scatter([], [], facecolor="none", edgecolor="black", s=34, label="OUT (hollow)")
    low, high = (MULTIPLIER * each["margin"] for each in _binding(medians))
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
