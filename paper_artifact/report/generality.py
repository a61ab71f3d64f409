"""Notebook 08: the generality wave (Table 2): external meshes in two observable-class groups, and what counts
are held against.

Per-seed tails, verdicts and trajectories are those of every study (`report.kit.tables`).
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from paper_artifact.catalogue import shape_row, shapes_of
from paper_artifact.errors import InputError
from paper_artifact.evaluate.staircase import longest
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.records import Collected, target_of
from paper_artifact.report.kit.tables import beside, paper_texts
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text, blank, counts_text
from paper_artifact.study.verdict import LOSS, group_statistic


def generality_table(collected: Collected) -> pd.DataFrame:
    """Return Table 2: a row per shape, per condition ours (mean ± sd (C0 / this), counts at the end seed
    by seed) beside the paper's, and our verdict; then a row per group with the mean ± sd of C0 / C1 over
    its members and how many pass, once all of them are recorded."""
    arms = frames.arms(collected).set_index(frames.ARM)
    table = beside(arms.apply(_cell, axis=1), paper_texts(), across="condition")
    judged = frames.verdicts(collected)
    table["verdict", "ours"] = [
        judged[shape].outcome if shape in judged else NOT_RECORDED for shape in table.index
    ]
    parts = []
    for group in dict.fromkeys(map(_group, table.index)):
        parts.append(table[[_group(shape) == group for shape in table.index]])
        if len(shapes_of(group)) > 1:
            parts.append(_group_row(group, judged))
    return blank(pd.concat(parts))


def _cell(arm: pd.Series) -> str:
    if not arm["seeds"]:
        return NOT_RECORDED
    return f"{arm_text(arm['mean'], arm['sd'], arm['ratio'])} [{counts_text(arm['counts'])}]"


def _group(shape: str) -> str:
    row = shape_row(shape)
    return "" if row is None else row.group


def _group_row(group: str, judged: dict) -> pd.DataFrame:
    members, paper = shapes_of(group), frames.paper("ratio_C0_over_C1", "2").set_index("shape")
    try:
        mean, sd, passes = group_statistic(judged, members)
        row = {(LOSS, "ours"): f"{mean:.2f}× ± {sd:.2f}, {passes} of {len(members)} pass"}
    except InputError:
        row = {(LOSS, "ours"): "not all recorded"}
    if group in paper.index:
        row[LOSS, "paper"] = f"{paper['printed'][group]}× ± {paper['sd'][group]:.2f}"
    return pd.DataFrame.from_dict({group: row}, orient="index")


def count_table(collected: Collected) -> pd.DataFrame:
    """Return per shape what a count is compared with, all in the judged dimension: the expected count (see
    `study.verdict.rows_of`; of an external mesh the bars of its bundle, at its M), significant bars of the
    clean surface at 20,000 samples (the evaluation's own density), and the final counts of every arm, seed
    by seed."""
    arms = frames.arms(collected).set_index(frames.ARM)
    counts = arms["counts"].map(lambda counts: counts_text(counts) or NOT_RECORDED).unstack("condition")
    rows = {}
    for shape, expected in _expected(collected).items():
        row, target = shape_row(shape), target_of(shape)
        rows[shape] = {
            "dimension": f"H{target.dimension}",
            "clean surface, bundle": f"{expected} at M = {row.samples}",
            "clean surface, 20,000": target.counts[target.dimension],
        } | {name: counts[name][shape] for name in frames.conditions(collected)}
    return blank(pd.DataFrame.from_dict(rows, orient="index"))


def margin_table(collected: Collected) -> pd.DataFrame:
    """Return per shape and arm how far counts are from turning, seed by seed: the lifetime, over the floor
    of the same 20,000 samples, of the last expected bar (the count turns at 1), on the clean surface and
    at the last step of every run."""
    rows = {}
    for shape, rank in _expected(collected).items():
        target = target_of(shape)
        dimension = target.dimension
        rows[shape] = {
            "bar": f"H{dimension}, {rank}. longest",
            "clean surface": _margin(target.diagram[dimension], rank, target.floor),
        }
        for name in frames.conditions(collected):
            lasts = [record["dumps"][-1] for record in collected.of(shape, name)]
            bars = [np.array(last["bars"][dimension]).reshape(-1, 2) for last in lasts]
            margins = [_margin(own, rank, last["floor"]) for own, last in zip(bars, lasts, strict=True)]
            rows[shape][name] = " / ".join(margins)
    return pd.DataFrame.from_dict(rows, orient="index")


def _expected(collected: Collected) -> dict[str, int]:
    """Return {shape: expected count} of the shapes whose records know one."""
    runs = frames.runs(collected).dropna(subset="expected")
    return {shape: int(own["expected"].max()) for shape, own in runs.groupby("shape", sort=False)}


def _margin(bars: np.ndarray, rank: int, floor: float) -> str:
    return f"{longest(bars, rank)[rank - 1] / floor:.2f}"
