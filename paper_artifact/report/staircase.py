"""Notebook 03: which bars of clean surfaces clear the floor 6·r_med(M), by density (Table S3, Fig. S10).

Notebook 01 follows spot's second void by `second_void_table`. Units as in `report.kit.staircase`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.evaluate.staircase import MULTIPLIER
from paper_artifact.export.figures import INK, PAGE, new_figure
from paper_artifact.report.kit.figures import MARKS, SERIES, label_axis, legend_below, plain_log
from paper_artifact.report.kit.frames import shapes_in_order
from paper_artifact.report.kit.published import published
from paper_artifact.scene.shapes import SHAPES
from paper_artifact.staircase import (
    DENSITIES,
    SEEDS,
    bars,
    beside_published,
    counts,
    published_counts,
    signatures,
    significant_counts,
    staircases,
)

ASIDE = 1.06  # times M: where every other bar of a shape is drawn
Followed = Mapping[str, Sequence[str]]  # shape: names of its bars, ("loop 1", "loop 2")


def measure_analytic_shapes(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return the staircases of all analytic shapes, M = 512 … 20,000, five seeds: about a minute of CPU."""
    return staircases(tuple(SHAPES), (512, 1024, *DENSITIES), SEEDS, progress)


def table_s3(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S3: significant H1 / H2 per shape and density, ours (over the seeds) above the paper's
    (its seed 0)."""
    found = significant_counts(table)
    ours = signatures(found[found["dimension"] > 0], "{} / {}")
    paper = signatures(published_counts("S3"), "{} / {}")
    return beside_published(ours.loc[ours.index.isin(paper.index), paper.columns], paper)


def law_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return measured floor ÷ closed form per shape and density, mean over seeds, and the largest deviation
    of one seed."""
    ratio = table.assign(ratio=table["floor"] / table["law"]).groupby(["shape", "samples"], sort=False)[
        "ratio"
    ]
    mean = ratio.mean().unstack("samples")
    deviation = ratio.agg(lambda each: (each - 1).abs().max()).groupby("shape").max()
    return mean.round(3).assign(**{"largest deviation of a seed %": (100 * deviation).round(1)})


def followed_bars(table: pd.DataFrame, follow: Followed) -> pd.DataFrame:
    """Return the rows of `bars` of the followed ones, shape by shape."""
    found = bars(table)
    chosen = [found[(found["shape"] == shape) & found["bar"].isin(names)] for shape, names in follow.items()]
    return pd.concat(chosen)


def floor_figure(table: pd.DataFrame, follow: Followed) -> Figure:
    """Return Fig. S10: floors falling as M^(-1/2) and the lifetimes of the followed bars that they fall
    below; bars of one shape stand a little beside one another, because two often have one length."""
    figure, axes = new_figure(1, len(follow), PAGE / max(len(follow), 2), 2.6, sharey=True)
    shapes = followed_bars(table, follow).groupby("shape", sort=False)
    colours: dict[str, tuple[str, str]] = {}
    for axis, (shape, own) in zip(axes[0], shapes, strict=True):
        floors = own.groupby("samples")[["floor", "law"]].mean()
        axis.plot(floors["floor"], color=INK, linewidth=1.6, label="floor, measured")
        axis.plot(floors["law"], color=INK, linestyle=":", linewidth=2.2, label="floor, closed form")
        for number, (name, bar) in enumerate(own.groupby("bar", sort=False)):
            free = list(zip(SERIES, MARKS, strict=True))
            colour, marker = colours.setdefault(str(name), free[len(colours) % len(free)])
            mean, aside = bar.groupby("samples")["lifetime"].mean(), ASIDE ** (number % 2)
            style = {"color": colour, "marker": marker, "markersize": 4.5, "linewidth": 0.9}
            axis.plot(mean.index * aside, mean, label=name, **style)
            axis.scatter(bar["samples"] * aside, bar["lifetime"], s=5, color=colour, alpha=0.6, linewidths=0)
        label_axis(axis, shape, "samples M")
        plain_log(axis, "x")
        plain_log(axis)
        axis.set_xticks(list(floors.index), [f"{each:,}" for each in floors.index], rotation=45)
        axis.set_yticks([0.02, 0.03, 0.05, 0.1, 0.2])
        axis.minorticks_off()
    axes[0][0].set_ylabel("floor, lifetime (radius / D)")
    legend_below(figure, 4)
    return figure


def crossing_table(table: pd.DataFrame, follow: Followed) -> pd.DataFrame:
    """Return the figure's numbers: per followed bar and density the mean margin lifetime / floor, the
    lifetime at the largest density, and the M at which the margin passes 1 (interpolated on logarithmic
    axes)."""
    rows = {}
    for key, own in followed_bars(table, follow).groupby(["shape", "bar"], sort=False):
        mean = own.groupby("samples")[["lifetime", "floor"]].mean()
        margin = mean["lifetime"] / mean["floor"]
        rows[key] = {f"M = {samples}": round(value, 2) for samples, value in margin.items()}
        rows[key]["lifetime"] = round(mean["lifetime"].iloc[-1], 4)
        rows[key]["clears the floor from M ≈"] = _crossing(margin)
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["shape", "bar"])


def _crossing(margin: pd.Series) -> str:
    above = np.flatnonzero(margin.to_numpy() > 1)
    if not len(above):
        return f"> {margin.index[-1]}"
    if above[0] == 0:
        return f"≤ {margin.index[0]}"
    pair = margin.iloc[above[0] - 1 : above[0] + 1]
    return str(int(round(np.exp(np.interp(0.0, np.log(pair), np.log(pair.index.to_numpy(dtype=float)))), -1)))


def floor_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return measured floors (mean over seeds, radius / D) and spacings of the shapes and densities of which
    the paper's text prints one, beside what it prints."""
    keys, paper = ["shape", "samples"], published("floor")
    paper = paper[paper["quantity"].isin(["floor", "r_med"])].set_index(["quantity", *keys])["printed"]
    shapes, densities = (paper.index.unique(key) for key in keys)
    floors = table.groupby(keys)[["floor", "law"]].mean()
    floors = floors.loc[[(s, m) for s in shapes_in_order(shapes) for m in sorted(densities)]]
    ours = floors.assign(r_med=floors["floor"] / MULTIPLIER).round(4).rename(columns={"law": "closed form"})
    for quantity in ("floor", "r_med"):
        ours = ours.join(paper[quantity].rename(f"paper's {quantity}"), on=keys)
    return ours.rename_axis(["shape", "M"]).fillna("")


def second_void_table(shape: str, densities: Iterable[int] = DENSITIES, seed: int = 0) -> pd.DataFrame:
    """Return the two longest H2 bars of a clean surface against the density: significant count, margins
    (lifetime / floor), and half their lifetimes, which is what leaving one unmatched costs in bottleneck
    distance."""
    table = staircases([shape], densities, [seed]).set_index("samples")
    columns = {"significant H2": counts(table, 2)}
    for name, bar in (("first", "h2_1"), ("second", "h2_2")):
        columns[f"{name} bar / floor"] = (table[bar] / table["floor"]).round(2)
    for name, bar in (("first", "h2_1"), ("second", "h2_2")):
        columns[f"half {name} bar"] = (table[bar] / 2).round(4)
    return pd.DataFrame(columns)
