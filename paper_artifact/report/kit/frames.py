"""Tidy frames with common keys: our runs, our arms and the paper's values, so that "ours beside the paper's"
is a join.

The keys are shape, condition and, where a row is one run, seed. Shapes and conditions come from the records,
in the catalogue's order. A tail is the bottleneck distance to the target in the shape's judged dimension,
mean of the last three dumps, radius over the bounding-box diagonal; Chamfer is the mean of both directions
over the diagonal; None and NaN mean unknown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import pandas as pd

from paper_artifact import catalogue
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import blank
from paper_artifact.report.starts import start_of
from paper_artifact.study.verdict import BASELINE, Verdict, rows_of, verdict

ARM = ["shape", "condition"]
TAILS = ("1", "2", "S10", "noise", "ablations", "S7")  # where the paper prints tails of the study's arms
RUN_COLUMNS = [*ARM, "seed", "dimension", "tail", "chamfer", "count", "expected"]
STATISTICS = ["mean", "sd", "ratio", "chamfer", "chamfer ratio"]
ARM_COLUMNS = [*ARM, "wanted", "dimension", "seeds", "tails", "counts", *STATISTICS]
PAPER_COLUMNS = [*ARM, "seed", "dimension", "samples", "value", "printed", "sd", "ratio", "note", "table"]


def shapes_in_order(names: Iterable[str]) -> list[str]:
    """Return each name once, in the catalogue's order of shapes; other meshes last, in the order given."""
    names = list(dict.fromkeys(names))
    known = [each.name for each in catalogue.SHAPES if each.name in names]
    return known + [name for name in names if name not in known]


def shapes(collected: Collected) -> list[str]:
    """Return the shapes that were asked for, recorded or not, in the catalogue's order."""
    return shapes_in_order(shape for shape, _, _ in collected.wanted)


def conditions(collected: Collected) -> list[str]:
    """Return the conditions that were asked for, recorded or not, in the catalogue's order."""
    return catalogue.in_order(list({condition for _, condition, _ in collected.wanted}))


def in_order(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the frame sorted by shape and condition in the catalogue's order, rows of one arm as they
    are."""
    orders = {
        "shape": shapes_in_order(frame["shape"]),
        "condition": catalogue.in_order(frame["condition"].unique()),
    }
    return frame.sort_values(
        ARM, key=lambda column: column.map(orders[column.name].index), kind="stable", ignore_index=True
    )


def runs(collected: Collected) -> pd.DataFrame:
    """Return one row per record: shape, condition, seed, dimension (judged), tail, chamfer, count
    (significant bars at the end in that dimension) and expected (see `study.verdict.rows_of`)."""
    return in_order(pd.DataFrame(rows_of(collected.records), columns=RUN_COLUMNS))


def verdicts(collected: Collected) -> dict[str, Verdict]:
    """Return the verdict of every recorded shape, in the catalogue's order."""
    return verdict(runs(collected))


def arms(collected: Collected) -> pd.DataFrame:
    """Return one row per shape and condition that was asked for: wanted (how many seeds), dimension, seeds,
    tails and counts (tuples, by seed), mean and sd (n - 1) of the tails, ratio (mean of C0 / mean; NaN for
    C0), chamfer (mean), chamfer ratio (to C0's).

    An arm without any record has no seeds, empty tuples and NaN.
    """
    judged, rows = verdicts(collected), []
    for (shape, condition), wanted in Counter(run[:2] for run in collected.wanted).items():
        row = {
            "shape": shape,
            "condition": condition,
            "wanted": wanted,
            "seeds": (),
            "tails": (),
            "counts": (),
        }
        if shape in judged and (arm := judged[shape].arms.get(condition)):
            names = ("seeds", "tails", "counts", "mean", "sd", "chamfer")
            row |= {name: getattr(arm, name) for name in names} | {"dimension": judged[shape].dimension}
            row["ratio"] = None if condition == BASELINE else arm.ratio
        rows.append(row)
    frame = in_order(pd.DataFrame(rows, columns=ARM_COLUMNS))
    baseline = frame[frame["condition"] == BASELINE].set_index("shape")["chamfer"].astype(float)
    frame["chamfer ratio"] = frame["chamfer"].astype(float) / frame["shape"].map(baseline)
    return frame.astype(dict.fromkeys(STATISTICS, float) | {"dimension": "Int64"})


def dumps(collected: Collected) -> pd.DataFrame:
    """Return one row per record and dump: shape, condition, seed, step, bottleneck (radius / D) and count
    in the judged dimension, Chamfer in percent of D; step 0, the start, where it is stored (`starts`)."""
    rows = []
    for record in collected.records:
        dimension, config = record["mesh"]["dimension"], record["config"]
        key = {name: config[name] for name in (*ARM, "seed")}
        if (start := start_of(config)) is not None:
            first = {"bottleneck": start["bottleneck"], "count": start["count"]}
            rows.append(key | {"step": 0} | first | {"chamfer %": 100 * start["chamfer"]})
        for dump in record["dumps"]:
            measured = {"bottleneck": dump["bottleneck"][dimension], "count": dump["counts"][dimension]}
            rows.append(key | {"step": dump["step"]} | measured | {"chamfer %": 100 * dump["chamfer"]})
    columns = [*ARM, "seed", "step", "bottleneck", "count", "chamfer %"]
    return in_order(pd.DataFrame(rows, columns=columns))


def paper(quantity: str = "tail_bottleneck", *tables: str) -> pd.DataFrame:
    """Return the paper's values of a quantity from these tables (default: TAILS), one row per row of the
    tables.

    Columns: shape, condition, seed and samples (NaN where the row is of no single one), dimension, value,
    printed (the same as a text with the paper's digits), sd (NaN where none is printed), ratio (C0 / this as
    printed, a text, "" where none is), note, table. Raises InputError for an unknown table.
    """
    frames = []
    for name in tables or TAILS:
        own = published(name)
        frames.append(own[own["quantity"] == quantity].assign(table=name).reindex(columns=PAPER_COLUMNS))
    frame = pd.concat(frames, ignore_index=True)
    return frame.assign(ratio=blank(frame["ratio"]), note=blank(frame["note"]))


def paper_arms(quantity: str = "tail_bottleneck", *tables: str) -> pd.DataFrame:
    """Return the rows of `paper` that are no single seed's: one per shape and condition, of the first
    table that has it."""
    frame = paper(quantity, *tables)
    return frame[frame["seed"].isna()].drop_duplicates(ARM)


def paper_verdicts(*tables: str) -> dict[str, Verdict]:
    """Return the verdicts that the paper's per-seed tails in these tables (default: TAILS) give by the
    study's rule."""
    frame = paper("tail_bottleneck", *tables)
    return verdict(frame[frame["seed"].notna()].rename(columns={"value": "tail"}))
