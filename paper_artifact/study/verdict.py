"""The study's verdict rule, as pure functions of plain rows (paper §4, Protocol: metrics and verdict).

A row is one run: a mapping with "shape", "condition", "seed" and "tail" (bottleneck to the target in the
discriminating dimension, mean of the last three dumps, radius / diagonal), and where known "dimension",
"chamfer", "count" (significant bars at the end, in that dimension) and "expected" (the target's count). A
list of rows or a pandas DataFrame will do; None and NaN mean unknown.

The rule: C1 passes iff its tails lie below C0's and below every norm-matched control's (smaller mean,
disjoint per-seed ranges) at Chamfer parity, mean Chamfer(C1) <= 1.15 mean Chamfer(C0). Means come with the
sample standard deviation (n - 1). Welch's sigma is given only where both arms ran at least five seeds. Counts
(phantoms) are reported, they do not decide.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from paper_artifact.catalogue import BASELINE, CONTROLS, LOSS
from paper_artifact.errors import InputError

PARITY = 1.15
WELCH_SEEDS = 5

Rows = Iterable[Mapping] | pd.DataFrame


@dataclass(frozen=True)
class Arm:
    """One shape's runs under one condition."""

    condition: str
    seeds: tuple[int, ...]  # ascending; the next two are in this order
    tails: tuple[float, ...]  # radius / diagonal
    counts: tuple[int | None, ...]  # significant bars in the judged dimension, None where unknown
    chamfer: float | None  # mean over the seeds, divided by the diagonal; None where unknown
    ratio: float | None = None  # mean of C0 / this mean; None without C0, inf for a zero mean

    @property
    def mean(self) -> float:
        """Return the mean of the tails."""
        return float(np.mean(self.tails))

    @property
    def sd(self) -> float | None:
        """Return the sample standard deviation of the tails, None for one seed."""
        return float(np.std(self.tails, ddof=1)) if len(self.tails) > 1 else None


@dataclass(frozen=True)
class Verdict:
    """The rule applied to one shape. Every dict is by condition.

    Outcomes: "pass", or why not: "saturated" (every tail of C0 and C1 is one value), "no effect" (C1 and C0
    overlap), "worse" (C1 above C0), "parity failed", "tied by control" (overlaps a control), "beaten by
    control", "incomplete" (an arm is missing).
    """

    shape: str
    dimension: int | None  # the judged one
    outcome: str
    reason: str  # one sentence
    arms: dict[str, Arm]
    below: dict[str, bool] = field(default_factory=dict)  # is C1's mean smaller
    disjoint: dict[str, bool] = field(default_factory=dict)  # do the ranges of C1 and this arm not touch
    parity: bool | None = None  # None: Chamfer unknown
    parity_ratio: float | None = None  # Chamfer of C1 / of C0
    welch: dict[str, float] = field(default_factory=dict)  # sigma, of five-seed arms only
    phantoms: dict[str, tuple[int, ...]] = field(default_factory=dict)  # seeds with more bars than expected
    missing: dict[str, tuple[int, ...]] = field(default_factory=dict)  # seeds with fewer

    @property
    def passed(self) -> bool:
        """Return whether the outcome is "pass"."""
        return self.outcome == "pass"

    @property
    def ratio(self) -> float | None:
        """Return mean of C0 / mean of C1, None when an arm is missing."""
        return self.arms[LOSS].ratio if LOSS in self.arms else None


def rows_of(records: Iterable[Mapping]) -> list[dict]:
    """Return the rows of run records (`paper_artifact.record`); runs without a tail are left out.

    Expected counts, the same for every arm of a shape: the mesh's Betti number where known (finite bars: one
    component less in dimension 0), or the bars of the shape's bundle where they are more (a bowl is a disk,
    but its samples show a void) or alone.
    """
    records = [each for each in records if each.get("tails")]
    bundled: dict[str, int] = {}
    for record in records:
        if record.get("bundle"):
            bundled[record["config"]["shape"]] = len(record["bundle"]["bars"][record["mesh"]["dimension"]])
    rows = []
    for record in records:
        dimension, tails, mesh = record["mesh"]["dimension"], record["tails"], record["mesh"]
        known = [] if mesh.get("betti") is None else [mesh["betti"][dimension] - (dimension == 0)]
        known += [bundled[record["config"]["shape"]]] if record["config"]["shape"] in bundled else []
        rows.append(
            {
                **{name: record["config"][name] for name in ("shape", "condition", "seed")},
                "dimension": dimension,
                "tail": tails["bottleneck"][dimension],
                "chamfer": tails.get("chamfer"),
                "count": tails["counts"][dimension] if tails.get("counts") else None,
                "expected": max(known, default=None),
            }
        )
    return rows


def verdict(rows: Rows, controls: Sequence[str] = CONTROLS) -> dict[str, Verdict]:
    """Return the verdict of every shape of `rows`, in order of appearance; `controls` without rows are not
    asked for.

    Raises InputError for a row without shape, condition, seed or a finite tail >= 0, for a seed that occurs
    twice in an arm, and for a shape with two dimensions.
    """
    return {shape: _judge(shape, group, controls) for shape, group in _by_shape(rows).items()}


def welch_sigma(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Return Welch's statistic (mean a - mean b) / sqrt(var a / n + var b / m); None below five seeds or
    without variance."""
    if min(len(a), len(b)) < WELCH_SEEDS:
        return None
    variance = np.var(a, ddof=1) / len(a) + np.var(b, ddof=1) / len(b)
    return float((np.mean(a) - np.mean(b)) / math.sqrt(variance)) if variance > 0 else None


def group_statistic(verdicts: Mapping[str, Verdict], members: Sequence[str]) -> tuple[float, float, int]:
    """Return (mean, sample sd, passes) of the ratio C0/C1 over the shapes `members`: Table 2's group rows.

    Raises InputError when a member has no ratio.
    """
    absent = [name for name in members if name not in verdicts or verdicts[name].ratio is None]
    if absent or len(members) < 2:
        raise InputError(
            "a group needs at least two shapes with C0 and C1 each; "
            f"missing: {', '.join(absent) or 'a second member'}"
        )
    ratios = [verdicts[name].ratio for name in members]
    return (
        float(np.mean(ratios)),
        float(np.std(ratios, ddof=1)),
        sum(verdicts[name].passed for name in members),
    )


def _by_shape(rows: Rows) -> dict[str, list[dict]]:
    if isinstance(rows, pd.DataFrame):
        rows = rows.to_dict("records")
    shapes: dict[str, list[dict]] = {}
    seen = set()
    for given in rows:
        row = {name: None if _unknown(value) else value for name, value in given.items()}
        lacking = [name for name in ("shape", "condition", "seed", "tail") if row.get(name) is None]
        if lacking or not math.isfinite(row["tail"]) or row["tail"] < 0:
            raise InputError(
                f"a row of the verdict needs shape, condition, seed and a finite tail, got {dict(given)}"
            )
        key = (row["shape"], row["condition"], int(row["seed"]))
        if key in seen:
            raise InputError(f"{key[0]} {key[1]} has seed {key[2]} twice; keep one record of each run")
        seen.add(key)
        shapes.setdefault(row["shape"], []).append(row)
    return shapes


def _unknown(value) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def _arms(group: list[dict]) -> dict[str, Arm]:
    made = {}
    for condition in sorted({row["condition"] for row in group}):
        own = sorted((row for row in group if row["condition"] == condition), key=lambda row: row["seed"])
        chamfers = [row.get("chamfer") for row in own]
        made[condition] = {
            "condition": condition,
            "seeds": tuple(int(row["seed"]) for row in own),
            "tails": tuple(float(row["tail"]) for row in own),
            "counts": tuple(None if row.get("count") is None else int(row["count"]) for row in own),
            "chamfer": None if None in chamfers else float(np.mean(chamfers)),
        }
    baseline = float(np.mean(made[BASELINE]["tails"])) if BASELINE in made else None
    arms = {}
    for condition, fields in made.items():
        mean = float(np.mean(fields["tails"]))
        ratio = None if baseline is None else (baseline / mean if mean > 0 else math.inf)
        arms[condition] = Arm(**fields, ratio=ratio)
    return arms


def _judge(shape: str, group: list[dict], controls: Sequence[str]) -> Verdict:
    dimensions = {int(row["dimension"]) for row in group if row.get("dimension") is not None}
    if len(dimensions) > 1:
        raise InputError(
            f"the rows of {shape} have tails in dimensions {sorted(dimensions)}; a verdict needs one"
        )
    arms = _arms(group)
    expected = {row["condition"]: row["expected"] for row in group if row.get("expected") is not None}
    phantoms, missing = {}, {}
    for condition, arm in arms.items():
        if condition in expected and None not in arm.counts:
            phantoms[condition] = tuple(
                s for s, n in zip(arm.seeds, arm.counts, strict=True) if n > expected[condition]
            )
            missing[condition] = tuple(
                s for s, n in zip(arm.seeds, arm.counts, strict=True) if n < expected[condition]
            )
    common = {
        "shape": shape,
        "dimension": dimensions.pop() if dimensions else None,
        "arms": arms,
        "phantoms": phantoms,
        "missing": missing,
    }
    present = [name for name in controls if name in arms]
    absent = [name for name in (BASELINE, LOSS) if name not in arms] + ([] if present else [controls[0]])
    if absent:
        return Verdict(**common, outcome="incomplete", reason=f"no runs of {', '.join(absent)}")
    loss, baseline = arms[LOSS], arms[BASELINE]
    rivals = [BASELINE, *present]
    below = {name: loss.mean < arms[name].mean for name in rivals}
    disjoint = {
        name: max(loss.tails) < min(arms[name].tails) or min(loss.tails) > max(arms[name].tails)
        for name in rivals
    }
    sigmas = {name: welch_sigma(arms[name].tails, loss.tails) for name in rivals}
    ratio = None
    if loss.chamfer is not None and baseline.chamfer:
        ratio = loss.chamfer / baseline.chamfer
    parity = None if ratio is None else ratio <= PARITY
    outcome, reason = _outcome(arms, present, below, disjoint, parity, ratio)
    return Verdict(
        **common,
        outcome=outcome,
        reason=reason,
        below=below,
        disjoint=disjoint,
        parity=parity,
        parity_ratio=ratio,
        welch={name: sigma for name, sigma in sigmas.items() if sigma is not None},
    )


def _outcome(arms, controls, below, disjoint, parity, ratio) -> tuple[str, str]:
    loss, baseline = arms[LOSS], arms[BASELINE]
    if len({*loss.tails, *baseline.tails}) == 1 and len(loss.tails) > 1:
        return "saturated", f"every tail of C0 and C1 is {_digits(loss.mean)}"
    if not disjoint[BASELINE]:
        return "no effect", f"C1 {_range(loss)} overlaps C0 {_range(baseline)}"
    if not below[BASELINE]:
        return "worse", f"C1 {_range(loss)} is above C0 {_range(baseline)}"
    if parity is False:
        return "parity failed", f"Chamfer of C1 is {ratio:.2f} times C0's, more than {PARITY}"
    for name in controls:
        if not disjoint[name]:
            return "tied by control", f"C1 {_range(loss)} overlaps {name} {_range(arms[name])}"
        if not below[name]:
            return "beaten by control", f"{name} {_range(arms[name])} is below C1 {_range(loss)}"
    chamfer = "Chamfer unknown" if ratio is None else f"Chamfer {ratio:.2f} times C0's"
    return "pass", f"C1 {_range(loss)} is below C0 {_range(baseline)} and {', '.join(controls)}, {chamfer}"


def _digits(value: float) -> str:
    return f"{value:.4f}".removeprefix("0") if value < 1 else f"{value:.4f}"


def _range(arm: Arm) -> str:
    return f"{_digits(min(arm.tails))}-{_digits(max(arm.tails))}"
