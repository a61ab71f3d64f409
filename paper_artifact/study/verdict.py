"""The study's verdict rule and its tables, as pure functions of plain rows (paper §4, Protocol: metrics and
verdict).

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
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from paper_artifact.catalogue import BASELINE, CONTROLS, LOSS
from paper_artifact.errors import InputError

PARITY = 1.15
WELCH_SEEDS = 5

Rows = Any  # an iterable of mappings, or a pandas DataFrame


@dataclass(frozen=True)
class Arm:
    """One shape's runs under one condition, in seed order."""

    condition: str
    seeds: tuple[int, ...]
    tails: tuple[float, ...]  # per seed, radius / diagonal
    counts: tuple[int | None, ...]  # significant bars per seed, None where unknown
    chamfer: float | None  # mean over the seeds, / diagonal; None where one is unknown
    ratio: float | None = None  # mean of C0 / this mean, None without C0, inf for a zero mean

    @property
    def mean(self) -> float:
        """The mean tail."""
        return float(np.mean(self.tails))

    @property
    def sd(self) -> float | None:
        """The sample standard deviation (n - 1) of the tails, None for one seed."""
        return float(np.std(self.tails, ddof=1)) if len(self.tails) > 1 else None


@dataclass(frozen=True)
class Verdict:
    """The rule applied to one shape and one loss arm.

    outcome: "pass", or why not: "saturated" (every tail of baseline and loss is one value), "no effect" (loss
    and baseline overlap), "worse" (loss above baseline), "parity failed", "tied by control" (overlaps a
    control), "beaten by control", "incomplete" (an arm is missing).
    """

    shape: str
    dimension: int | None  # the judged one
    outcome: str  # see above
    reason: str  # one sentence
    arms: dict[str, Arm]  # by condition
    loss: str = LOSS  # the condition that is judged
    below: dict[str, bool] = field(default_factory=dict)  # rival → is the loss's mean smaller
    disjoint: dict[str, bool] = field(default_factory=dict)  # rival → do the ranges not touch
    parity: bool | None = None  # of Chamfer; None where unknown
    parity_ratio: float | None = None  # mean Chamfer of the loss / of the baseline
    welch: dict[str, float] = field(default_factory=dict)  # rival → sigma, only for five-seed arms
    phantoms: dict[str, tuple[int, ...]] = field(default_factory=dict)  # condition → seeds with too many bars
    missing: dict[str, tuple[int, ...]] = field(default_factory=dict)  # condition → seeds with too few bars

    @property
    def passed(self) -> bool:
        """Whether the loss passes the rule."""
        return self.outcome == "pass"

    @property
    def ratio(self) -> float | None:
        """Mean of the baseline / mean of the loss, or None when an arm is missing."""
        return self.arms[self.loss].ratio if self.loss in self.arms else None


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


def verdict(rows: Rows, controls: Sequence[str] = CONTROLS, loss: str = LOSS) -> dict[str, Verdict]:
    """Return the verdict on the condition `loss` for every shape of `rows`, in order of appearance.

    `controls` without rows are not asked for.

    Raises InputError for a row without shape, condition, seed or a finite tail >= 0, for a seed that occurs
    twice in an arm, and for a shape with two dimensions.
    """
    return {shape: _judge(shape, group, controls, loss) for shape, group in _by_shape(rows).items()}


def welch_sigma(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Return Welch's statistic (mean a - mean b) / sqrt(var a / n + var b / m); None below five seeds or
    without variance."""
    if min(len(a), len(b)) < WELCH_SEEDS:
        return None
    variance = np.var(a, ddof=1) / len(a) + np.var(b, ddof=1) / len(b)
    return float((np.mean(a) - np.mean(b)) / math.sqrt(variance)) if variance > 0 else None


def group_statistic(verdicts: Mapping[str, Verdict], members: Sequence[str]) -> tuple[float, float, int]:
    """Return (mean, sample sd, passes) of the ratio C0/C1 over the shapes `members`: Table 2's pre-registered
    group rows.

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
    if hasattr(rows, "to_dict"):
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


def _judge(shape: str, group: list[dict], controls: Sequence[str], judged: str) -> Verdict:
    dimensions = {int(row["dimension"]) for row in group if row.get("dimension") is not None}
    if len(dimensions) > 1:
        raise InputError(
            f"the rows of {shape} have tails in dimensions {sorted(dimensions)}; a verdict needs one"
        )
    arms = _arms(group)
    expected = {row["condition"]: row["expected"] for row in group if row.get("expected") is not None}
    counted = {name: arm for name, arm in arms.items() if name in expected and None not in arm.counts}
    common: dict[str, Any] = {
        "shape": shape,
        "dimension": dimensions.pop() if dimensions else None,
        "arms": arms,
        "loss": judged,
        "phantoms": {
            name: _seeds(arm, lambda n, most=expected[name]: n > most) for name, arm in counted.items()
        },
        "missing": {
            name: _seeds(arm, lambda n, least=expected[name]: n < least) for name, arm in counted.items()
        },
    }
    present = [name for name in controls if name in arms]
    absent = [name for name in (BASELINE, judged) if name not in arms] + ([] if present else [controls[0]])
    if absent:
        return Verdict(**common, outcome="incomplete", reason=f"no runs of {', '.join(absent)}")
    loss, baseline = arms[judged], arms[BASELINE]
    rivals = [BASELINE, *present]
    sigmas = {name: welch_sigma(arms[name].tails, loss.tails) for name in rivals}
    ratio = loss.chamfer / baseline.chamfer if loss.chamfer is not None and baseline.chamfer else None
    outcome, reason = _outcome(loss, [arms[name] for name in rivals], ratio)
    return Verdict(
        **common,
        outcome=outcome,
        reason=reason,
        below={name: loss.mean < arms[name].mean for name in rivals},
        disjoint={name: _disjoint(loss, arms[name]) for name in rivals},
        parity=None if ratio is None else ratio <= PARITY,
        parity_ratio=ratio,
        welch={name: sigma for name, sigma in sigmas.items() if sigma is not None},
    )


def _seeds(arm: Arm, chosen: Callable[[int], bool]) -> tuple[int, ...]:
    return tuple(seed for seed, count in zip(arm.seeds, arm.counts, strict=True) if chosen(count))


def _disjoint(a: Arm, b: Arm) -> bool:
    return max(a.tails) < min(b.tails) or min(a.tails) > max(b.tails)


def _outcome(loss: Arm, rivals: Sequence[Arm], ratio: float | None) -> tuple[str, str]:
    """Return outcome and reason; rivals: the baseline first, then the controls; ratio: of the Chamfers."""
    name, (baseline, *controls) = loss.condition, rivals
    if len({*loss.tails, *baseline.tails}) == 1 and len(loss.tails) > 1:
        return "saturated", f"every tail of {BASELINE} and {name} is {_digits(loss.mean)}"
    if not _disjoint(loss, baseline):
        return "no effect", f"{name} {_range(loss)} overlaps {BASELINE} {_range(baseline)}"
    if not loss.mean < baseline.mean:
        return "worse", f"{name} {_range(loss)} is above {BASELINE} {_range(baseline)}"
    if ratio is not None and ratio > PARITY:
        return "parity failed", f"Chamfer of {name} is {ratio:.2f} times {BASELINE}'s, more than {PARITY}"
    for rival in controls:
        if not _disjoint(loss, rival):
            return "tied by control", f"{name} {_range(loss)} overlaps {rival.condition} {_range(rival)}"
        if not loss.mean < rival.mean:
            return "beaten by control", f"{rival.condition} {_range(rival)} is below {name} {_range(loss)}"
    chamfer = "Chamfer unknown" if ratio is None else f"Chamfer {ratio:.2f} times {BASELINE}'s"
    others = ", ".join(rival.condition for rival in controls)
    return "pass", f"{name} {_range(loss)} is below {BASELINE} {_range(baseline)} and {others}, {chamfer}"


def _digits(value: float) -> str:
    return f"{value:.4f}".removeprefix("0") if value < 1 else f"{value:.4f}"


def _range(arm: Arm) -> str:
    return f"{_digits(min(arm.tails))}-{_digits(max(arm.tails))}"
