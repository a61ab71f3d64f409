"""The study's verdict rule on tidy frames (paper §4, Protocol).

C1 passes on a shape if its tails lie below C0's and below every norm-matched control's, at Chamfer parity:
mean Chamfer(C1) <= PARITY mean Chamfer(C0). The paper asks for ranges over three seeds that do not touch; of
two equal arms, one in LEVEL has that by chance. Five seeds would make the same rule thirteen times stricter,
so it is stated as that chance: one arm lies below another where its ranks are as low in at most one of LEVEL
arrangements of the tails (the exact one-sided rank-sum test), for three seeds the paper's rule. Ours too: a
pass lowers the mean at least LEAST_EFFECT times. Counts of bars are reported and decide nothing. Standard
deviations are those of a sample (n - 1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from paper_artifact.catalogue import BASELINE, CONTROLS, LOSS
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream

PARITY = 1.15
LEVEL = 20  # one arm lies below another by chance in one of LEVEL pairs of equal arms
LEAST_EFFECT = 1.1  # C0's mean tail over the loss's, of a pass
RESAMPLED = 2000  # draws of the bootstrap
WELCH_SEEDS = 5  # Welch's statistic is given where both arms have at least as many seeds


def arms(runs: pd.DataFrame) -> pd.DataFrame:
    """Return one row per arm, indexed by shape and condition: seeds (how many), mean, sd, low and high of
    the tails, chamfer (mean), and ratio (mean of the same shape's C0 / mean; NaN for C0 and where
    the shape has none).

    runs: `results.Results.runs` or rows of it; columns shape, condition, seed, tail, chamfer. Raises
    InputError when one of them but chamfer is missing.
    """
    runs = _with_columns(runs)
    grouped = runs.groupby(["shape", "condition"], observed=True)
    tails = grouped["tail"]
    table = tails.agg(seeds="size", mean="mean", sd="std", low="min", high="max")
    table["chamfer"] = grouped["chamfer"].mean() if "chamfer" in runs else np.nan
    baseline = runs[runs["condition"] == BASELINE].groupby("shape", observed=True)["tail"].mean()
    over = table.index.get_level_values("shape").map(baseline).astype(float)
    table["ratio"] = np.where(
        table.index.get_level_values("condition") == BASELINE, np.nan, over / table["mean"]
    )
    return table


def _with_columns(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the frame; where it has no rows, with the columns that are read."""
    missing = [name for name in ("shape", "condition", "seed", "tail") if name not in runs]
    if missing and len(runs):
        raise InputError(f"the frame of runs has no column {', '.join(missing)}; give rows of `results.load`")
    return runs.assign(**dict.fromkeys(missing))


def welch(a: Sequence[float], b: Sequence[float]) -> float:
    """Return Welch's statistic (mean a - mean b) / sqrt(var a / n + var b / m); NaN below WELCH_SEEDS seeds
    or without variance."""
    if min(len(a), len(b)) < WELCH_SEEDS:
        return math.nan
    variance = np.var(a, ddof=1) / len(a) + np.var(b, ddof=1) / len(b)
    return float((np.mean(a) - np.mean(b)) / math.sqrt(variance)) if variance > 0 else math.nan


def verdicts(runs: pd.DataFrame, loss: str = LOSS, controls: Sequence[str] = CONTROLS) -> pd.DataFrame:
    """Return the verdict on the condition `loss`, one row per shape, in the order of the catalogue.

    Columns: outcome ("pass", or why not: "saturated", every tail of baseline and loss is one value; "no
    effect", the loss overlaps the baseline; "worse"; "negligible", below LEAST_EFFECT; "parity failed"; "tied
    by control", overlaps a control; "beaten by control"; "incomplete", an arm is missing, has a tail that
    is not finite, or too few seeds to lie below another, or would pass with a Chamfer that is not finite),
    reason (one sentence), ratio (C0 / loss), ratio_low and ratio_high (its 95 % bootstrap interval over the
    seeds), chance (that of two equal arms the loss's ranks are as low), chamfer_ratio (loss / C0), welch
    (C0 - loss). A control without runs is passed over; without any control a shape is incomplete. Without a
    column chamfer, as in the paper's Table S7, tails alone decide, and the reason says "Chamfer unknown".
    Raises InputError when an arm has a seed twice, or a column is missing."""
    runs = _with_columns(runs)
    if runs.duplicated(["shape", "condition", "seed"]).any():
        twice = runs[runs.duplicated(["shape", "condition", "seed"])].iloc[0]
        raise InputError(
            f"{twice['shape']} {twice['condition']} has seed {twice['seed']} twice; keep one run of each"
        )
    rows: dict[Any, dict[str, Any]] = {}
    for shape, own in runs.groupby("shape", observed=True):
        groups = dict(iter(own.groupby("condition", observed=True)))
        tails = {name: group["tail"].to_numpy(float) for name, group in groups.items()}
        measured = groups if "chamfer" in own else {}
        chamfer = {name: group["chamfer"].to_numpy(float).mean() for name, group in measured.items()}
        parity = chamfer[loss] / chamfer[BASELINE] if {loss, BASELINE} <= {*chamfer} else None
        present = [name for name in controls if name in tails]
        absent = [name for name in (BASELINE, loss) if name not in tails] + ([] if present else [controls[0]])
        if absent:
            rows[shape] = {"outcome": "incomplete", "reason": f"no runs of {', '.join(absent)}"}
            continue
        own, baseline = tails[loss], tails[BASELINE]
        outcome, reason = _outcome(loss, tails, present, parity)
        low, high = ratio_interval(baseline, own, str(shape))
        rows[shape] = {"outcome": outcome, "reason": reason, "ratio": _ratio(baseline, own)}
        rows[shape] |= {"ratio_low": low, "ratio_high": high, "chance": chance_below(own, baseline)}
        known = math.nan if parity is None else parity
        rows[shape] |= {"chamfer_ratio": known, "welch": welch(baseline, own)}
    columns = ["outcome", "reason", "ratio", "ratio_low", "ratio_high", "chance", "chamfer_ratio", "welch"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("shape")


def chance_below(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of all arrangements of the values of a (n,) and b (m,) in which a's ranks sum to at
    most what they do: the exact one-sided p of the rank-sum test (equal values share their mean rank); NaN
    for values that are not finite."""
    values = np.concatenate([a, b])
    if not np.isfinite(values).all():
        return math.nan
    ranks = np.rint(2 * rankdata(values)).astype(int).tolist()
    most = sum(ranks[: len(a)])
    ways = np.zeros((len(a) + 1, most + 1), dtype=object)  # how many ranks, of which sum; whole numbers
    ways[0, 0] = 1
    for rank in ranks:
        if rank <= most:
            ways[1:, rank:] = ways[1:, rank:] + ways[:-1, : most + 1 - rank]
    return float(ways[-1].sum() / math.comb(len(ranks), len(a)))


def below(a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether arm a lies below arm b: one in LEVEL by chance."""
    return chance_below(a, b) <= 1 / LEVEL


def ratio_interval(baseline: np.ndarray, own: np.ndarray, name: str = "") -> tuple[float, float]:
    """Return the 95 % percentile interval of mean(baseline) / mean(own) over RESAMPLED bootstrap draws of the
    seeds of both; name: of the comparison, which names the draws."""
    draws = stream(0, f"bootstrap {name}")
    over, under = (each[draws.integers(len(each), size=(RESAMPLED, len(each)))] for each in (baseline, own))
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = np.percentile(over.mean(1) / under.mean(1), [2.5, 97.5])
    return float(low), float(high)


def _ratio(baseline: np.ndarray, own: np.ndarray) -> float:
    return baseline.mean() / own.mean() if own.mean() > 0 else math.inf


def _outcome(
    loss: str, tails: dict[str, np.ndarray], controls: Sequence[str], parity: float | None
) -> tuple[str, str]:
    own, baseline = tails[loss], tails[BASELINE]
    texts = {name: f"{name} {_range(values)}" for name, values in tails.items()}
    lost = [name for name in (BASELINE, loss, *controls) if not np.isfinite(tails[name]).all()]
    if lost:
        return "incomplete", f"{', '.join(lost)} has a tail that is not finite"
    if len({*own, *baseline}) == 1 and len(own) > 1:
        return "saturated", f"every tail of {BASELINE} and {loss} is {short(own.mean())}"
    if any(math.comb(len(own) + len(tails[name]), len(own)) < LEVEL for name in (BASELINE, *controls)):
        return "incomplete", f"{len(own)} seeds are too few to lie below others by less than chance"
    if below(baseline, own):
        return "worse", f"{texts[loss]} is above {texts[BASELINE]}"
    if not below(own, baseline):
        return "no effect", f"{texts[loss]} overlaps {texts[BASELINE]}"
    if _ratio(baseline, own) < LEAST_EFFECT:
        return "negligible", f"{texts[loss]} lies less than {LEAST_EFFECT} times below {texts[BASELINE]}"
    if parity is not None and parity > PARITY:
        return "parity failed", f"Chamfer of {loss} is {parity:.2f} times {BASELINE}'s, more than {PARITY}"
    for name in controls:
        if below(tails[name], own):
            return "beaten by control", f"{texts[name]} is below {texts[loss]}"
        if not below(own, tails[name]) or _ratio(tails[name], own) < LEAST_EFFECT:
            return "tied by control", f"{texts[loss]} overlaps {texts[name]}"
    if parity is not None and math.isnan(parity):
        return "incomplete", f"{BASELINE} or {loss} has a Chamfer that is not finite, so parity is not known"
    known = "Chamfer unknown" if parity is None else f"Chamfer {parity:.2f} times {BASELINE}'s"
    return "pass", f"{texts[loss]} is below {texts[BASELINE]} and {', '.join(controls)}, {known}"


def _range(values: np.ndarray) -> str:
    return f"{short(values.min())}-{short(values.max())}"


def short(value: float) -> str:
    """Return a length over the diagonal with four decimals as the paper prints it, ".0156"."""
    return f"{value:.4f}".removeprefix("0") if value < 1 else f"{value:.4f}"
