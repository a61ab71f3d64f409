"""Density staircases as frames: the longest bars of clean surfaces and their floors, density by density (App.
B, §6).

Lifetimes and floors are radii divided by the surface's bounding-box diagonal; a margin is a lifetime divided
by the floor. Bars are called by dimension and rank, the longest first: "loop 2". A staircase has one row per
shape, density and seed, as `results/measured/` keeps it; `bars` has one per bar, `significant_counts` one per
dimension, with the keys of the paper's tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pandas as pd

from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import KEPT, longest, measure
from paper_artifact.mesh import FEATURES, Mesh
from paper_artifact.results import published
from paper_artifact.sampling import face_areas
from paper_artifact.scene.shapes import surface
from paper_artifact.topology.floor import MULTIPLIER, uniform_spacing

KEYS = ["shape", "samples", "seed"]
DENSITIES = (2048, 4096, 8192, 20_000)  # of Tables S5, S9 and S11; the last is the evaluation's
SEEDS = range(5)  # sampling seeds


def staircase(mesh: Mesh, densities: Iterable[int], seeds: Iterable[int], kept: int = KEPT) -> pd.DataFrame:
    """Return one row per density and seed: shape, samples, seed, floor, law (the closed form's floor for a
    uniform sample), and h0_1 … h2_4, the `kept` longest lifetimes per dimension, filled up with 0."""
    area, seeds = float(face_areas(mesh.vertices, mesh.faces).sum()), tuple(seeds)
    rows = []
    for samples in densities:
        law = MULTIPLIER * uniform_spacing(area, samples) / mesh.diagonal
        for seed in seeds:
            diagram, floor = measure(mesh, samples, seed)
            row = {"shape": mesh.name, "samples": samples, "seed": seed, "floor": floor, "law": law}
            for dimension in range(3):
                for rank, lifetime in enumerate(longest(diagram[dimension], kept), 1):
                    row[f"h{dimension}_{rank}"] = lifetime
            rows.append(row)
    return pd.DataFrame(rows)


def staircases(
    shapes: Iterable[str],
    densities: Iterable[int] = DENSITIES,
    seeds: Iterable[int] = SEEDS,
    progress: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Return the staircases of the shapes, one after the other; progress is called with each shape done.

    Raises InputError for a mesh that cannot be had.
    """
    densities, seeds, tables = tuple(densities), tuple(seeds), []
    for shape in shapes:
        tables.append(staircase(surface(shape), densities, seeds))
        if progress is not None:
            progress(shape)
    return pd.concat(tables, ignore_index=True)


def bars(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row per bar: shape, samples, seed, floor, law, dimension, bar ("loop 2"), lifetime, margin."""
    columns = table.filter(regex=r"^h\d_\d+$").columns
    long = table.melt(table.columns.drop(columns), columns, "bar", "lifetime", ignore_index=False)
    long = long.sort_index(kind="stable")[lambda each: each["lifetime"] > 0].reset_index(drop=True)
    names = {name: bar_name(*map(int, name[1:].split("_"))) for name in columns}
    return long.assign(
        dimension=long["bar"].str[1].astype(int),
        bar=long["bar"].map(names),
        margin=long["lifetime"] / long["floor"],
    )


def bar_name(dimension: int, rank: int) -> str:
    """Return "loop 2" for (1, 2)."""
    return f"{FEATURES[dimension][0]} {rank}"


def counts(table: pd.DataFrame, dimension: int) -> pd.Series:
    """Return the number of significant finite bars per row of a staircase (at most as many as it keeps)."""
    return table.filter(regex=f"^h{dimension}_").gt(table["floor"], axis=0).sum(axis=1)


def significant_counts(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per row of a staircase and dimension: its keys, dimension, value (in dimension 0 with
    the infinite bar)."""
    each = [table[KEYS].assign(dimension=d, value=counts(table, d) + (d == 0)) for d in range(3)]
    return pd.concat(each, ignore_index=True)


def published_counts(name: str) -> pd.DataFrame:
    """Return the significant counts of one of the paper's tables, with the columns of `significant_counts`
    (its seed 0)."""
    paper = published(name)
    return paper[paper["quantity"] == "significant_count"].assign(seed=0)


def signatures(found: pd.DataFrame, form: str = "({},{},{})") -> pd.DataFrame:
    """Return the counts (`significant_counts`) as texts, shapes × densities; where seeds differ, how many
    give what.

    form: of one text, with a place per dimension that `found` has.
    """
    found = found.sort_values("dimension", kind="stable").groupby(KEYS, sort=False)["value"]
    texts = found.agg(lambda values: form.format(*map(int, values)))
    return texts.groupby(["shape", "samples"], sort=False).agg(_agreeing).unstack("samples")


def signature_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return the significant counts (H0 with its infinite bar, H1, H2) of a staircase per shape and density,
    over its seeds."""
    return signatures(significant_counts(table))


def beside_published(ours: pd.DataFrame, paper: pd.DataFrame) -> pd.DataFrame:
    """Return two tables of `signatures` in one, shape by shape: rows (shape, "ours" or "paper")."""
    both = pd.concat({"ours": ours, "paper": paper}, names=["whose"]).swaplevel()[ours.columns]
    rows = [
        (shape, whose) for shape in ours.index for whose in ("ours", "paper") if (shape, whose) in both.index
    ]
    return both.loc[rows].rename(columns="M = {}".format).rename_axis([None, None]).rename_axis(columns=None)


def agreement(stored: pd.DataFrame, again: pd.DataFrame) -> tuple[int, float]:
    """Return (rows in both staircases, largest difference of floors and lifetimes in units of the floor, NaN
    without any)."""
    left, right = (each.set_index(KEYS).sort_index() for each in (stored, again))
    common = left.index.intersection(right.index)
    left, right = left.loc[common], right.loc[common][left.columns]
    return len(common), float((left.sub(right).abs().max(axis=1) / left["floor"]).max())


def agreement_text(stored: pd.DataFrame, again: pd.DataFrame) -> str:
    """Return how many rows of a stored staircase were measured again, and whether all agree."""
    rows, difference = agreement(stored, again)
    agree = f"all agree to 0.0001 of the floor: {difference < 1e-4}"
    return f"{rows} of {len(stored)} stored lines measured again; {agree}"


def _agreeing(values: pd.Series) -> str:
    """The value when all seeds agree, else each with how many seeds give it, the most frequent first."""
    if values.nunique() == 1:
        return values.iloc[0]
    numbers = values.value_counts().sort_index().sort_values(ascending=False, kind="stable")
    return ", ".join(f"{name} {number}×" for name, number in numbers.items())


def bundle_margins(shapes: Iterable[str], seeds: Iterable[int]) -> pd.DataFrame:
    """Return one row per shape, seed and feature of the catalogue: shape, M, seed, dimension, bar, acts (the
    loss acts on the dimension), floor (radius / D), margin (lifetime / floor), bundle (the seed is that of
    the study's bundle), inside (acts, and above the floor).

    Raises InputError for a shape without a row in the catalogue and for a mesh that is not available.
    """
    found, seeds = [], tuple(seeds)
    for shape in shapes:
        row = shape_row(shape)
        if row is None:
            raise InputError(f"the catalogue has no shape {shape!r}; name one of its rows")
        own = bars(staircase(surface(shape), (row.samples,), seeds, kept=max(row.features)))
        features = [bar_name(d, rank + 1) for d, count in enumerate(row.features) for rank in range(count)]
        own = own[own["bar"].isin(features)]
        acts = own["dimension"].isin(range(3) if row.dimensions is None else row.dimensions)
        found.append(own.assign(acts=acts, bundle=own["seed"] == row.bundle_seed))
    table = pd.concat(found, ignore_index=True).rename(columns={"samples": "M"})
    columns = ["shape", "M", "seed", "dimension", "bar", "acts", "floor", "margin", "bundle"]
    return table[columns].assign(inside=table["acts"] & (table["margin"] > 1))
