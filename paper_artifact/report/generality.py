"""The generality wave (Table 2, Table S7, Fig. S2): external meshes in two observable-class groups, from whatever runs are
recorded.

A tail is the bottleneck distance to the target in the shape's discriminating dimension, mean of the last three dumps, 20,000
samples, radius / bounding-box diagonal of the ground truth.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pandas as pd

from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import significant_counts
from paper_artifact.evaluate.scores import Target, make_target
from paper_artifact.evaluate.staircase import longest, measure
from paper_artifact.report.matrix import papers_tails
from paper_artifact.report.published import published, published_value
from paper_artifact.report.runs import Collected
from paper_artifact.scene.find import surface
from paper_artifact.study.tables import arm_text, counts_text, published_rows, seeds_text
from paper_artifact.study.verdict import Verdict, group_statistic, rows_of, verdict

# Pre-registered (App. G): the observable class that the staircase gave each shape.
GROUPS = {
    "loop group": ("bob", "rocker-arm", "eight"),
    "void group": ("spot", "fandisk", "pot", "armadillo", "horse"),
}
SHAPES = tuple(shape for members in GROUPS.values() for shape in members)
ARMS = ("C0", "C1", "C2")


def judged(collected: Collected) -> dict[str, Verdict]:
    """Return the verdict per shape; expected counts are the bundle's bars: what the protocol calls measurable."""
    return verdict(rows_of(collected.records))


def generality_table(collected: Collected) -> pd.DataFrame:
    """Return Table 2: a row per shape, per arm ours (mean ± sd (C0 / this), counts at the end seed by seed) beside the paper's;
    then a row per group with the mean ± sd of C0 / C1 over its members and how many pass, once all of them are recorded."""
    found, paper, rows = judged(collected), published("2"), {}
    printed = paper[paper["quantity"] == "tail_bottleneck"].set_index(["shape", "condition"])
    groups = paper[paper["quantity"] == "ratio_C0_over_C1"].set_index("shape")
    for group, members in GROUPS.items():
        for shape in members:
            row = {}
            for condition in ARMS:
                arm = found[shape].arms.get(condition) if shape in found else None
                shown = condition != "C0"
                row[condition, "ours"] = (
                    "not recorded"
                    if arm is None
                    else f"{arm_text(arm.mean, arm.sd, arm.ratio if shown else None)} [{counts_text(arm)}]"
                )
                mean, sd = printed.loc[(shape, condition), ["value", "sd"]]
                ratio = printed.loc[(shape, "C0"), "value"] / mean if shown else None
                row[condition, "paper"] = arm_text(mean, sd, ratio)
            row["verdict", "ours"] = found[shape].outcome if shape in found else "not recorded"
            rows[shape] = row
        try:
            mean, sd, passes = group_statistic(found, members)
            ours = f"{mean:.2f}× ± {sd:.2f}, {passes} of {len(members)} pass"
        except InputError:
            ours = "not all recorded"
        rows[group] = {
            ("C1", "ours"): ours,
            ("C1", "paper"): f"{groups['value'][group]:.2f}× ± {groups['sd'][group]:.2f}",
        }
    return pd.DataFrame.from_dict(rows, orient="index").fillna("")


def no_ramp_text(collected: Collected, shape: str = "bob") -> str:
    """Return one line: the tails without ramp (C3) and with it (C1) on the shape, ours beside those of the paper's text (§5.1)."""
    found = judged(collected)
    arms = found[shape].arms if shape in found else {}
    ours = [
        arm_text(arms[name].mean, arms[name].sd, None) if name in arms else "not recorded"
        for name in ("C3", "C1")
    ]
    theirs = [
        published_value(table, shape=shape, condition=name)
        for table, name in (("ablations", "C3"), ("2", "C1"))
    ]
    paper = [arm_text(*each, None) for each in theirs]
    return (
        f"no ramp (C3) on {shape}: ours {ours[0]} against C1 {ours[1]}; paper {paper[0]} against {paper[1]}"
    )


def verdict_lines(collected: Collected) -> pd.DataFrame:
    """Return per shape our verdict with its reason, that of the paper's per-seed tails (Table S7) by the same rule, Chamfer
    C1 / C0 and C2 / C0 beside the ratios that the paper's text gives, and C1's seeds with more or fewer bars than the bundle."""
    theirs, rows = verdict(published_rows(papers_tails())), {}
    printed = published("chamfer")
    printed = printed[printed["quantity"] == "chamfer_ratio_to_C0"].set_index(["shape", "condition"])["value"]
    for shape, each in judged(collected).items():
        row = {
            "verdict": each.outcome,
            "paper's tails give": theirs[shape].outcome if shape in theirs else "",
        }
        for condition in ("C1", "C2"):
            known = (
                {"C0", condition} <= set(each.arms)
                and each.arms["C0"].chamfer
                and each.arms[condition].chamfer
            )
            ours = f"{each.arms[condition].chamfer / each.arms['C0'].chamfer:.2f}" if known else ""
            paper = f" (paper {printed[shape, condition]:g})" if (shape, condition) in printed.index else ""
            row[f"Chamfer {condition} / C0"] = ours + paper
        row |= {
            "phantoms in C1, seeds": seeds_text(each.phantoms.get("C1")),
            "lost in C1, seeds": seeds_text(each.missing.get("C1")),
        }
        rows[shape] = row | {"reason": each.reason}
    return pd.DataFrame.from_dict(rows, orient="index")


@lru_cache(maxsize=None)
def expected_count(shape: str) -> int:
    """Return the bars of the shape's bundle in the discriminating dimension: what the clean surface shows at the density of the
    loss."""
    protocol = shape_row(shape)
    return significant_counts(*measure(surface(shape), protocol.samples, protocol.bundle_seed))[
        shape_row(shape).judged
    ]


def count_table(collected: Collected) -> pd.DataFrame:
    """Return per shape what a count is compared with: bars of the clean surface's bundle at the protocol's M, significant bars
    of the clean surface at 20,000 samples (the evaluation's own density), and the final counts of every arm, seed by seed; all
    in the discriminating dimension."""
    found, rows = judged(collected), {}
    for shape in SHAPES:
        arms = found[shape].arms if shape in found else {}
        rows[shape] = {
            "dimension": f"H{shape_row(shape).judged}",
            "clean surface, bundle": f"{expected_count(shape)} at M = {shape_row(shape).samples}",
            "clean surface, 20,000": _target(shape).counts[shape_row(shape).judged],
        } | {name: counts_text(arms[name]) if name in arms else "not recorded" for name in ARMS}
    return pd.DataFrame.from_dict(rows, orient="index")


def margin_table(collected: Collected) -> pd.DataFrame:
    """Return per shape and arm how far counts are from turning, seed by seed: the lifetime, over the floor of the same 20,000
    samples, of the last bar that the bundle expects (count turns at 1), on the clean surface and at step 2500 of every run."""
    rows = {}
    for shape in SHAPES:
        dimension, expected, target = shape_row(shape).judged, expected_count(shape), _target(shape)
        clean = _margin(target.diagram[dimension], expected, target.floor)
        row = {"bar": f"H{dimension}, {expected}. longest", "clean surface": clean}
        for name in ARMS:
            lasts = [record["dumps"][-1] for record in collected.of(shape, name)]
            margins = [
                _margin(np.array(last["bars"][dimension]).reshape(-1, 2), expected, last["floor"])
                for last in lasts
            ]
            row[name] = " / ".join(margins) or "not recorded"
        rows[shape] = row
    return pd.DataFrame.from_dict(rows, orient="index")


@lru_cache(maxsize=None)
def _target(shape: str) -> Target:
    return make_target(surface(shape), cache=None)


def _margin(bars: np.ndarray, rank: int, floor: float) -> str:
    return f"{longest(bars, rank)[rank - 1] / floor:.2f}"
