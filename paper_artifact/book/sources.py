"""What the book is made from: records by study, stored measurements, the notebooks' tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from paper_artifact.book.contents import Chapter, chapters
from paper_artifact.book.htmltable import Rows, column, find_table
from paper_artifact.files import RESULTS
from paper_artifact.notebooks import EXECUTED, NOTEBOOKS
from paper_artifact.report import measured
from paper_artifact.report.kit.records import Collected, collect_study, joined


@dataclass(frozen=True, eq=False)
class Sources:
    """The committed records and measurements, and the notebooks as they were executed."""

    chapters: Mapping[str, Chapter]  # by the notebook's name, in order
    runs: Path = RESULTS / "runs"  # the folder of the records
    _studies: dict[str, Collected] = field(default_factory=dict)  # what was asked for already

    @classmethod
    def read(
        cls, notebooks: Path = NOTEBOOKS, executed: Path = EXECUTED, runs: Path = RESULTS / "runs"
    ) -> Sources:
        """Return the sources; raises InputError as `contents.chapters` does."""
        return cls({each.name: each for each in chapters(notebooks, executed)}, runs)

    def study(self, *names: str) -> Collected:
        """Return the records of these studies, and which of their runs are missing."""
        for name in names:
            if name not in self._studies:
                self._studies[name] = collect_study(name, folder=self.runs)
        return joined(*(self._studies[name] for name in names))

    def measured(self, name: str) -> pd.DataFrame:
        """Return the stored measurement of that name, an empty table where it has not been made."""
        return measured.find(name)

    def table(self, notebook: str, *words: str) -> Rows:
        """Return the notebook's first table with all these cells, an empty one where there is none."""
        return find_table(self.chapters[notebook].tables, *words) or []

    def cells(self, notebook: str, heading: str, *words: str) -> dict[str, str]:
        """Return {first cell: cell under `heading`} of that table; empty where there is none."""
        return column(self.table(notebook, heading, *words), heading)
