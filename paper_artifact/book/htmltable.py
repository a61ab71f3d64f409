"""The tables that notebooks show, taken out of their HTML: rows of texts, and CSV files of them."""

from __future__ import annotations

import csv
import io
from html.parser import HTMLParser

Rows = list[list[str]]


def table_rows(html: str) -> list[Rows]:
    """Return the tables in a piece of HTML, each as rows of equal length: a cell that spans several rows or
    columns is repeated in each of them, its text stripped, an empty table left out."""
    parser = _Tables()
    parser.feed(html)
    parser.close()
    return [_filled(cells) for cells in parser.tables if any(cells)]


def csv_text(rows: Rows) -> str:
    """Return the rows as CSV, RFC 4180 but for its line ends, which are "\\n"."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()


def find_table(tables: list[Rows], *words: str) -> Rows | None:
    """Return the first table that has all these texts as cells, None where there is none."""
    for rows in tables:
        if set(words) <= {cell for row in rows for cell in row}:
            return rows
    return None


def column(rows: Rows, name: str) -> dict[str, str]:
    """Return {first cell: cell under the heading `name`} of the rows below the heading; empty without it.

    A heading stands in any row; the rows above it are left out.
    """
    for number, row in enumerate(rows):
        if name in row:
            place = row.index(name)
            return {each[0]: each[place] for each in rows[number + 1 :]}
    return {}


def _filled(cells: list[list[tuple[str, int, int]]]) -> Rows:
    """Rows of texts from rows of (text, rows spanned, columns spanned)."""
    grid: dict[tuple[int, int], str] = {}
    for y, row in enumerate(cells):
        x = 0
        for text, down, across in row:
            while (y, x) in grid:
                x += 1
            for dy in range(min(down, len(cells) - y)):
                for dx in range(across):
                    grid[y + dy, x + dx] = text
            x += across
    width = 1 + max(x for _, x in grid)
    return [[grid.get((y, x), "") for x in range(width)] for y in range(len(cells))]


class _Tables(HTMLParser):
    """Collects (text, rowspan, colspan) of every cell, table by table."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[tuple[str, int, int]]]] = []
        self._text: list[str] | None = None  # of the open cell
        self._spans = (1, 1)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr" and self.tables:
            self.tables[-1].append([])
        elif tag in ("td", "th") and self.tables and self.tables[-1]:
            given = dict(attributes)
            self._text = []
            self._spans = (int(given.get("rowspan") or 1), int(given.get("colspan") or 1))

    def handle_data(self, data: str) -> None:
        if self._text is not None:
            self._text.append(data)

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th") and self._text is not None:
            self.tables[-1][-1].append((" ".join("".join(self._text).split()), *self._spans))
            self._text = None
