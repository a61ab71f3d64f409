"""Ours beside the paper's, pair by pair, and the word that a list of pairs comes to."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import pandas as pd

from paper_artifact.report.kit import frames
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text

WORDS = (
    "agrees",
    "partly",
    "differs",
    NOT_RECORDED,
)  # what `word` gives, with "so far" where runs are missing
LAST_DIGIT = 1.0001e-4  # of a tail as the paper prints it, radius / D
SIDES = {-1: "below", 0: "level with", 1: "above"}


@dataclass(frozen=True)
class Pair:
    """One statement of the paper beside ours."""

    what: str  # what is compared
    ours: str  # as text; "not recorded" where there is no run
    paper: str  # as text
    holds: bool | None  # whether ours says the same; None: not recorded


def word(pairs: Sequence[Pair]) -> str:
    """Return "agrees" when every pair holds, "differs" when none does, else "partly"; "not recorded" when
    nothing is there to compare, and "…, so far" when some runs are missing."""
    known = [pair.holds for pair in pairs if pair.holds is not None]
    if not known:
        return NOT_RECORDED
    outcome = "agrees" if all(known) else "partly" if any(known) else "differs"
    return f"{outcome}, so far" if any(pair.ours == NOT_RECORDED for pair in pairs) else outcome


def tally(pairs: Sequence[Pair]) -> str:
    """Return "12 of 15", and how many are not recorded or could not be had."""
    absent = [pair.ours for pair in pairs if pair.holds is None]
    text = f"{sum(bool(pair.holds) for pair in pairs)} of {len(pairs) - len(absent)}"
    counted = (f"{absent.count(reason)} {reason}" for reason in dict.fromkeys(absent))
    return ", ".join([text, *counted])


def equal(what: str, ours: object, paper: object) -> Pair:
    """Return a pair that holds when both texts are the same; ours is "" or None where it is not recorded."""
    if ours is None or ours == "" or ours == NOT_RECORDED:
        return Pair(what, NOT_RECORDED, str(paper), None)
    return Pair(what, str(ours), str(paper), str(ours) == str(paper))


def within(what: str, paper: float, printed: str, ours: Iterable[float], digits: int = 2) -> Pair:
    """Return a pair that holds when the paper's value lies in the range of our seeds, to the digits that it
    prints."""
    values = sorted(ours)
    if not values:
        return Pair(what, NOT_RECORDED, printed, None)
    slack = 0.5 * 10**-digits
    text = f"{values[0]:.{digits}f}–{values[-1]:.{digits}f}"
    return Pair(what, text, printed, values[0] - slack <= paper <= values[-1] + slack)


def within_text(what: str, ours: str, paper: str) -> Pair:
    """Return a pair that holds when the paper's number lies in our range "1.20–1.25" (or is our one number)
    to its digits."""
    values = [float(text) for text in re.findall(r"\d*\.?\d+", ours)]
    digits = len(paper.partition(".")[2])
    return within(what, float(paper), paper, values, digits)


def one_of(what: str, ours: str, paper: str) -> Pair:
    """Return a pair that holds when the paper's text is what at least one of our seeds gives; ours as
    `kit.staircase.signatures` writes it, "(1,2,1) 4×, (1,2,0) 1×"."""
    found = [re.sub(r" \d+×$", "", text) for text in ours.split(", ")]
    return Pair(what, ours, paper, paper in found)


def side(value: float, sd: float, other: float, other_sd: float) -> int:
    """Return -1 when a mean is below another by more than both standard deviations and the last printed digit
    together, 1 when it is above, else 0; a standard deviation that is NaN counts as zero."""
    apart = sum(0.0 if pd.isna(each) else each for each in (sd, other_sd)) + LAST_DIGIT
    return 0 if abs(value - other) <= apart else 1 if value > other else -1


def sides(
    collected: Collected,
    tables: Sequence[str],
    against: Sequence[tuple[str, str]],
    variation: float | None = None,
) -> list[Pair]:
    """Return for every shape of the records and every (arm, other arm) for which the paper prints means in
    these tables whether the arm's tail lies below, level with or above the other's (`side`), in ours and in
    the paper. Shapes and conditions are those of the records; B0 of the paper is our C0. Where the paper
    prints no standard deviation, `variation` of the mean stands in, or, where that is None, ours."""
    ours = frames.arms(collected).set_index(frames.ARM)
    paper = frames.paper_arms("tail_bottleneck", *tables)
    paper = paper.assign(condition=paper["condition"].replace("B0", "C0")).set_index(frames.ARM)
    unprinted = ours["sd"] if variation is None else variation * paper["value"]
    paper["spread"] = paper["sd"].fillna(unprinted)
    ours["spread"] = ours["sd"]
    pairs = []
    for shape in frames.shapes(collected):
        for arm, other in against:
            if (shape, arm) not in paper.index or (shape, other) not in paper.index:
                continue
            printed = _side_text(paper, shape, arm, other)
            keys = [(shape, name) for name in (arm, other)]
            recorded = all(key in ours.index and len(ours.loc[key, "tails"]) for key in keys)
            what = f"{shape}: {arm} to {other}"
            if not recorded:
                pairs.append(Pair(what, NOT_RECORDED, printed[0], None))
                continue
            found = _side_text(ours.rename(columns={"mean": "value"}), shape, arm, other)
            pairs.append(Pair(what, found[0], printed[0], found[1] == printed[1]))
    return pairs


def _side_text(arms: pd.DataFrame, shape: str, arm: str, other: str) -> tuple[str, int]:
    left, right = arms.loc[(shape, arm)], arms.loc[(shape, other)]
    place = side(left["value"], left["spread"], right["value"], right["spread"])
    return f"{_mean(left)} {SIDES[place]} {_mean(right)}", place


def _mean(arm: pd.Series) -> str:
    return arm_text(float(arm["value"]), arm["sd"])
