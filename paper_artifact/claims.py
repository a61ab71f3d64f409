"""The claims of the paper, checked one by one: what a notebook hands to the book.

    claims = Claims("06_c_matrix", profile)
    claims.add("Table 1", "sphere: C1 below C0", ours=".0078 of .0642", paper=".0156 of .0623", holds=True)
    claims.table()                 # last cell: shows them and writes results/claims/06_c_matrix.csv

An item is a table or figure of the paper (`results/published/items.csv`). The book counts the claims of each
item."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, write_text
from paper_artifact.results import PUBLISHED, RETRAINED
from paper_artifact.tables import read_table
from paper_artifact.verdict import short

FOLDER = REPOSITORY / "results" / "claims"  # committed
COLUMNS = ("item", "what", "ours", "paper", "holds")
LAST_DIGIT = 1.0001e-4  # of a tail as the paper prints it, radius / D
SIDES = {-1: "below", 0: "level with", 1: "above"}
MISSING = "not recorded"


def paper_items() -> pd.DataFrame:
    """Return the paper's items, one row each: item, title, notebooks, compared, reason; texts. Raises
    InputError when `items.csv` cannot be read."""
    names = ("item", "title", "notebooks", "compared", "reason")
    return read_table(PUBLISHED / "items.csv", *names, advice="restore it with git, or work in a checkout")


class Claims:
    """The claims of one notebook, in the order in which they were added."""

    def __init__(self, notebook: str, profile: str = "recorded") -> None:
        """notebook: its name without ".ipynb"; profile: "full" writes to results/retrained/claims instead."""
        self.path = (FOLDER if profile == "recorded" else RETRAINED / "claims") / f"{notebook}.csv"
        self.rows: list[dict[str, str]] = []
        self.items = set(paper_items()["item"])

    def add(self, item: str, what: str, ours: object, paper: object, holds: bool | None) -> bool | None:
        """Add one claim and return `holds`: whether ours says the same as the paper; None where ours is
        missing.

        what: the statement in a few words; ours, paper: both as texts or numbers. Raises InputError for an
        item that the paper does not have."""
        if item not in self.items:
            raise InputError(f"the paper has no item {item!r}; results/published/items.csv lists them")
        word = MISSING if holds is None else "yes" if holds else "no"
        self.rows.append(dict(zip(COLUMNS, (item, what, str(ours), str(paper), word), strict=True)))
        return holds

    def table(self) -> pd.DataFrame:
        """Return the claims, one row each, and write them to the notebook's CSV unless it says the same
        already."""
        frame = pd.DataFrame(self.rows, columns=list(COLUMNS))
        text = frame.to_csv(index=False, lineterminator="\n")
        if not self.path.is_file() or self.path.read_bytes() != text.encode():
            write_text(self.path, text)
        return frame


def read_claims(folder: Path = FOLDER) -> pd.DataFrame:
    """Return the claims of all notebooks, with the column notebook; as strings. An empty frame where there
    are none. Raises InputError for a CSV of something else."""
    frames = []
    for path in sorted(folder.glob("*.csv")):
        frame = read_table(path, advice="run the notebook again, or move the file")
        sound = isinstance(frame.index, pd.RangeIndex) and tuple(frame.columns) == COLUMNS
        if not sound or not frame["holds"].isin(["yes", "no", MISSING]).all():
            raise InputError(
                f"{path} is no table of claims ({', '.join(COLUMNS)}: yes, no or {MISSING}); run the "
                "notebook again, or move the file"
            )
        frames.append(frame.assign(notebook=path.stem))
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=[*COLUMNS, "notebook"])


def mean_text(value: float, sd: float) -> str:
    """Return ".0156±.0013", without the standard deviation where it is NaN."""
    return short(value) + ("" if pd.isna(sd) else f"±{short(sd)}")


def side(value: float, sd: float, other: float, other_sd: float) -> int:
    """Return -1 when a mean is below another by more than both standard deviations and the last printed digit
    together, 1 when it is above, else 0; a standard deviation that is NaN counts as zero."""
    apart = sum(0.0 if pd.isna(each) else each for each in (sd, other_sd)) + LAST_DIGIT
    return 0 if abs(value - other) <= apart else 1 if value > other else -1


def order_claims(
    ours: pd.DataFrame, paper: pd.DataFrame, pairs: Iterable[tuple[str, str]], variation: float | None = None
) -> list[tuple[str, str, str, bool | None]]:
    """Return (what, ours, paper, holds) for every shape and every pair (arm, other arm) of which the paper
    prints both means: does the arm's tail lie below, level with or above the other's (`side`), in ours as in
    the paper?

    ours: `verdict.arms` (index shape, condition; columns mean, sd). paper: rows of `results.published`
    (columns shape, condition, seed, value, sd); its B0 is our C0; rows of a single seed are left out; of
    several rows the first counts. Where the paper prints no standard deviation, `variation` of its mean
    stands in, or ours where that is None."""
    pairs, printed = list(pairs), _printed(paper)
    rows: list[tuple[str, str, str, bool | None]] = []
    for shape in ours.index.unique("shape"):
        for arm, other in pairs:
            keys = [(shape, arm), (shape, other)]
            if not all(key in printed.index for key in keys):
                continue
            theirs = printed.loc[keys, ["mean", "sd"]]
            own = ours.reindex(pd.MultiIndex.from_tuples(keys))[["mean", "sd"]]
            spread = own["sd"] if variation is None else variation * theirs["mean"]
            place, text = _side(theirs.assign(spread=theirs["sd"].fillna(spread)))
            if own["mean"].isna().any():
                rows.append((f"{shape}: {arm} to {other}", MISSING, text, None))
                continue
            found, ours_text = _side(own.assign(spread=own["sd"]))
            rows.append((f"{shape}: {arm} to {other}", ours_text, text, found == place))
    return rows


def size_claims(
    ours: pd.DataFrame, paper: pd.DataFrame, variation: float = 0.0
) -> list[tuple[str, str, str, bool | None]]:
    """Return (what, ours, paper, holds) for every mean tail that the paper prints: is ours within twice the
    larger of the two standard deviations and the last printed digit of it? Arguments as in `order_claims`."""
    rows: list[tuple[str, str, str, bool | None]] = []
    for (shape, arm), row in _printed(paper).iterrows():
        if shape not in ours.index.unique("shape"):
            continue
        what, theirs, spread = f"{shape}: size of {arm}", mean_text(row["mean"], row["sd"]), row["sd"]
        if (shape, arm) not in ours.index:
            rows.append((what, MISSING, theirs, None))
            continue
        own = ours.loc[(shape, arm)]
        widest = np.nanmax([variation * row["mean"] if pd.isna(spread) else spread, own["sd"], 0.0])
        holds = bool(abs(own["mean"] - row["mean"]) <= 2 * widest + LAST_DIGIT)
        rows.append((what, mean_text(own["mean"], own["sd"]), theirs, holds))
    return rows


def _printed(paper: pd.DataFrame) -> pd.DataFrame:
    """Return the paper's means: index shape, condition (its B0 is our C0); columns mean, sd."""
    seeds = paper[paper["seed"].isna()].replace({"condition": {"B0": "C0"}})
    printed = seeds.drop_duplicates(["shape", "condition"]).set_index(["shape", "condition"])
    return printed.rename(columns={"value": "mean"})[["mean", "sd"]]


def _side(two: pd.DataFrame) -> tuple[int, str]:
    (mean, sd, spread), (other, other_sd, other_spread) = two[["mean", "sd", "spread"]].to_numpy()
    place = side(mean, spread, other, other_spread)
    return place, f"{mean_text(mean, sd)} {SIDES[place]} {mean_text(other, other_sd)}"
