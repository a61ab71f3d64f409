"""Density staircases: which bars of a clean surface clear the measurement floor 6·r_med(M) at which sampling density (App. B,
§6).

Bars, lifetimes and floors are radii divided by the surface's bounding-box diagonal; a margin is a lifetime divided by the floor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.evaluate.staircase import KEPT, MULTIPLIER, longest, measure
from paper_artifact.mesh import Mesh, face_areas
from paper_artifact.report.figures import new_figure
from paper_artifact.report.published import published
from paper_artifact.scene.find import surface
from paper_artifact.scene.shapes import SHAPES
from paper_artifact.topology.floor import uniform_spacing

DENSITIES = (512, 1024, 2048, 4096, 8192, 20_000)
SEEDS = (0, 1, 2, 3, 4)


def staircase(mesh: Mesh, densities: Iterable[int], seeds: Iterable[int]) -> pd.DataFrame:
    """Return one line per density and seed: shape, samples, seed, floor, law (the closed form's floor for a uniform sample), and
    h0_1 … h2_4, the longest lifetimes per dimension."""
    area = float(face_areas(mesh.vertices, mesh.faces).sum())
    rows = []
    for samples in densities:
        law = MULTIPLIER * uniform_spacing(area, samples) / mesh.diagonal
        for seed in seeds:
            diagram, floor = measure(mesh, samples, seed)
            row = {"shape": mesh.name, "samples": samples, "seed": seed, "floor": floor, "law": law}
            for dimension in range(3):
                row |= {
                    f"h{dimension}_{rank + 1}": value
                    for rank, value in enumerate(longest(diagram[dimension]))
                }
            rows.append(row)
    return pd.DataFrame(rows)


def counts(table: pd.DataFrame, dimension: int, multiplier: float = MULTIPLIER) -> pd.Series:
    """Return the number of significant bars per line of a staircase (at most KEPT), for the floor multiplier·r_med."""
    lengths = table[[f"h{dimension}_{rank}" for rank in range(1, KEPT + 1)]].to_numpy()
    return pd.Series(
        (lengths > table["floor"].to_numpy()[:, None] * multiplier / MULTIPLIER).sum(axis=1),
        index=table.index,
    )


def signature_table(table: pd.DataFrame, columns: Sequence[str] = ("samples",)) -> pd.DataFrame:
    """Return per shape and density the significant counts (H0 with its infinite bar, H1, H2) of every seed, seeds that agree
    written once."""
    signs = [f"({1 + a},{b},{c})" for a, b, c in zip(counts(table, 0), counts(table, 1), counts(table, 2))]
    rows = table[["shape", *columns]].assign(signature=signs)
    grouped = rows.groupby(["shape", *columns], sort=False)["signature"]
    return grouped.agg(_agreeing).unstack("samples")


def _agreeing(values: pd.Series) -> str:
    """The value when all seeds agree, else each with how many seeds give it, the most frequent first."""
    if values.nunique() == 1:
        return values.iloc[0]
    return ", ".join(
        f"{name} {number}×"
        for name, number in values.value_counts()
        .sort_index()
        .sort_values(ascending=False, kind="stable")
        .items()
    )


def measure_all(
    shapes: Iterable[str] = SHAPES,
    densities: Iterable[int] = DENSITIES,
    seeds: Iterable[int] = SEEDS,
    progress: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Return the staircases of all shapes, concatenated; with the defaults about a minute of CPU. progress is called with each
    shape done."""
    tables = []
    for shape in shapes:
        tables.append(staircase(surface(shape), tuple(densities), tuple(seeds)))
        if progress is not None:
            progress(shape)
    return pd.concat(tables, ignore_index=True)


def agreement(table: pd.DataFrame, other: pd.DataFrame) -> tuple[int, float]:
    """Return (lines in both, largest difference of floors and lifetimes in units of the floor); lines are known by shape,
    samples, seed."""
    keys = ["shape", "samples", "seed"]
    left, right = (each.set_index(keys).sort_index() for each in (table, other))
    common = left.index.intersection(right.index)
    left, right = left.loc[common], right.loc[common][left.columns]
    return len(common), float((left.sub(right).abs().max(axis=1) / left["floor"]).max()) if len(
        common
    ) else float("nan")


def beside_paper(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S3: significant H1 / H2 per shape and density, ours (over the seeds) above the paper's (its seed 0)."""
    paper = published("S3")
    paper = (
        paper[paper["quantity"] == "significant_count"]
        .pivot(index="shape", columns=["samples", "dimension"], values="value")
        .astype(int)
    )
    densities = [
        each for each in dict.fromkeys(table["samples"]) if each in paper.columns.get_level_values(0)
    ]
    signs = table.assign(sign=[f"{b} / {c}" for b, c in zip(counts(table, 1), counts(table, 2))])
    rows = {}
    for shape in (each for each in dict.fromkeys(table["shape"]) if each in paper.index):
        own = signs[signs["shape"] == shape].groupby("samples")["sign"]
        rows[shape, "ours"] = {f"M = {each}": _agreeing(own.get_group(each)) for each in densities}
        rows[shape, "paper"] = {
            f"M = {each}": f"{paper.loc[shape, (each, 1)]} / {paper.loc[shape, (each, 2)]}"
            for each in densities
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def law_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return measured floor ÷ closed form per shape (rows) and density (columns), mean over seeds, and the largest deviation of
    one seed."""
    ratio = (
        (table["floor"] / table["law"])
        .groupby([table["shape"], table["samples"]], sort=False)
        .mean()
        .unstack("samples")
    )
    spread = (table["floor"] / table["law"] - 1).abs().groupby(table["shape"], sort=False).max()
    return ratio.round(3).assign(**{"largest deviation of a seed %": (100 * spread).round(1)})


def tracked(table: pd.DataFrame, shape: str, dimension: int, ranks: Sequence[int]) -> pd.DataFrame:
    """Return per density the mean (over seeds) lifetime of the shape's bars with these ranks, beside floor and law, radius /
    D."""
    own = table[table["shape"] == shape]
    chosen = ["floor", "law", *(f"h{dimension}_{rank}" for rank in ranks)]
    return own.groupby("samples")[chosen].mean()


def floor_figure(table: pd.DataFrame, follow: Mapping[str, tuple[int, Sequence[int], str]]) -> Figure:
    """Return Fig. S10: floors falling as M^(-1/2) and the lifetimes they fall below. follow: shape -> (dimension, ranks of bars,
    name)."""
    figure, axes = new_figure(1, len(follow), 3.8, 3.0)
    for axis, (shape, (dimension, ranks, name)) in zip(axes[0], follow.items(), strict=True):
        own = table[table["shape"] == shape]
        mean = tracked(table, shape, dimension, ranks)
        axis.plot(
            mean.index, mean["floor"], color="#c0392b", marker="o", markersize=3, label="floor, measured"
        )
        axis.plot(mean.index, mean["law"], color="black", linestyle=":", label="floor, closed form")
        for number, rank in enumerate(ranks):
            column = f"h{dimension}_{rank}"
            axis.plot(
                mean.index, mean[column], color=f"C{number}", marker="s", markersize=3, label=f"{name} {rank}"
            )
            axis.scatter(own["samples"], own[column], s=4, color=f"C{number}", alpha=0.5, linewidths=0)
        axis.set(xscale="log", yscale="log", xlabel="samples M")
        axis.set_xticks(list(mean.index), [str(each) for each in mean.index], rotation=45)
        axis.set_yticks([0.02, 0.03, 0.05, 0.1, 0.2], ["0.02", "0.03", "0.05", "0.1", "0.2"])
        axis.minorticks_off()
        axis.set_title(f"{shape}: radius / D", fontsize=9)
        axis.tick_params(labelsize=7)
        axis.legend(fontsize=6, loc="lower left")
    return figure


def crossing_table(table: pd.DataFrame, follow: Mapping[str, tuple[int, Sequence[int], str]]) -> pd.DataFrame:
    """Return the figure's numbers: per shape, bar and density the mean margin lifetime / floor, the lifetime at the largest
    density, and the M at which the margin passes 1 (interpolated on logarithmic axes)."""
    rows = []
    for shape, (dimension, ranks, name) in follow.items():
        mean = tracked(table, shape, dimension, ranks)
        for rank in ranks:
            margin = mean[f"h{dimension}_{rank}"] / mean["floor"]
            rows.append(
                {"shape": shape, "bar": f"{name} {rank}"}
                | {f"M = {samples}": round(value, 2) for samples, value in margin.items()}
                | {
                    "lifetime": round(mean[f"h{dimension}_{rank}"].iloc[-1], 4),
                    "clears the floor from M ≈": _crossing(margin),
                }
            )
    return pd.DataFrame(rows).set_index(["shape", "bar"])


def _crossing(margin: pd.Series) -> str:
    above = np.flatnonzero(margin.to_numpy() > 1)
    if not len(above):
        return f"> {margin.index[-1]}"
    if above[0] == 0:
        return f"≤ {margin.index[0]}"
    pair = margin.iloc[above[0] - 1 : above[0] + 1]
    return str(int(round(np.exp(np.interp(0.0, np.log(pair), np.log(pair.index.to_numpy(dtype=float)))), -1)))


def floor_table(
    table: pd.DataFrame,
    shapes: Sequence[str] = ("torus", "double_torus"),
    densities: Sequence[int] = (2048, 20_000),
) -> pd.DataFrame:
    """Return measured floors (mean over seeds, radius / D) of the shapes beside the floors and spacings that the paper's text
    prints."""
    paper = published("floor")
    rows = []
    for shape in shapes:
        for samples in densities:
            own = table[(table["shape"] == shape) & (table["samples"] == samples)]
            printed = paper[(paper["shape"] == shape) & (paper["samples"] == samples)].set_index("quantity")
            rows.append(
                {
                    "shape": shape,
                    "M": samples,
                    "floor": round(own["floor"].mean(), 4),
                    "closed form": round(own["law"].mean(), 4),
                    "r_med": round(own["floor"].mean() / MULTIPLIER, 4),
                    "paper's floor": printed["value"].get("floor"),
                    "paper's r_med": printed["value"].get("r_med"),
                }
            )
    return pd.DataFrame(rows).set_index(["shape", "M"])


def second_void_table(
    shape: str, densities: Iterable[int] = (2048, 4096, 8192, 20_000), seed: int = 0
) -> pd.DataFrame:
    """Return the two longest H2 bars of a clean surface against the density: significant count, margins (lifetime / floor), and
    half the second bar's lifetime, which is what leaving it unmatched costs in bottleneck distance."""
    table = staircase(surface(shape), densities, (seed,))
    return pd.DataFrame(
        {
            "samples": table["samples"],
            "significant H2": counts(table, 2),
            "first bar / floor": (table["h2_1"] / table["floor"]).round(2),
            "second bar / floor": (table["h2_2"] / table["floor"]).round(2),
            "half first bar": (table["h2_1"] / 2).round(4),
            "half second bar": (table["h2_2"] / 2).round(4),
        }
    ).set_index("samples")
