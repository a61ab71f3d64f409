"""The paper's 28 items, each with its notebook, its pairs and the word they come to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from paper_artifact.book.figure_pairs import FIGURES
from paper_artifact.book.pairs import Pair, tally, word
from paper_artifact.book.sources import Sources
from paper_artifact.book.table_pairs import TABLES
from paper_artifact.errors import InputError
from paper_artifact.report.kit.published import PUBLISHED

PAIRS = {**TABLES, **FIGURES}


@dataclass(frozen=True)
class Listed:
    """One table or figure of the paper, as `results/published/items.csv` lists it."""

    item: str  # "Table S2", "Fig. 1"
    label: str  # in paper.tex
    title: str  # in a few words
    notebooks: tuple[str, ...]  # where it is, the main one first
    compared: str  # what is compared and by which rule, in words


@dataclass(frozen=True)
class Item:
    """A listed item with what was found."""

    listed: Listed
    pairs: tuple[Pair, ...]  # ours beside the paper's

    @property
    def word(self) -> str:
        """The verdict (`pairs.word`)."""
        return word(self.pairs)

    @property
    def tally(self) -> str:
        """How many pairs hold, "12 of 15"."""
        return tally(self.pairs)

    @property
    def key(self) -> str:
        """A name for links: "table-s2"."""
        return self.listed.item.lower().replace(". ", "-").replace(" ", "-")


def listed(folder: Path = PUBLISHED) -> list[Listed]:
    """Return the items in the file's order. Raises InputError when the file cannot be read."""
    try:
        table = pd.read_csv(folder / "items.csv", dtype=str, keep_default_na=False)
    except OSError as error:
        raise InputError(f"there is no items.csv in {folder}; work in a checkout") from error
    return [
        Listed(row.item, row.label, row.title, tuple(row.notebooks.split()), row.compared)
        for row in table.itertuples()
    ]


def items(sources: Sources) -> list[Item]:
    """Return the items with their pairs, computed from records, measurements and executed notebooks."""
    return [Item(each, tuple(PAIRS[each.item](sources))) for each in listed()]


def status_frame(found: Sequence[Item]) -> pd.DataFrame:
    """Return one row per item: item, title, verdict, holds ("12 of 15"), notebooks, compared."""
    return pd.DataFrame(
        {
            "item": each.listed.item,
            "title": each.listed.title,
            "verdict": each.word,
            "holds": each.tally,
            "notebooks": " ".join(each.listed.notebooks),
            "compared": each.listed.compared,
        }
        for each in found
    )


def pair_frame(found: Sequence[Item]) -> pd.DataFrame:
    """Return one row per pair: item, what, ours, paper, holds ("yes", "no", "" where ours is missing)."""
    said = {None: "", True: "yes", False: "no"}
    rows = [
        (
            each.listed.item,
            pair.what,
            pair.ours,
            pair.paper,
            said[None if pair.holds is None else bool(pair.holds)],
        )
        for each in found
        for pair in each.pairs
    ]
    return pd.DataFrame(rows, columns=["item", "what", "ours", "paper", "holds"])
