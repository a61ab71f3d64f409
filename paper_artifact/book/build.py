"""Builds the book: one call writes every page, table and picture of it into one folder."""

from __future__ import annotations

import copy
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from paper_artifact import __version__
from paper_artifact.book import api, front
from paper_artifact.book.contents import write_figures, write_tables
from paper_artifact.book.items import Item, items, pair_frame, status_frame
from paper_artifact.book.pages import Pages, notebook_body
from paper_artifact.book.sources import Sources
from paper_artifact.book.views import write_views
from paper_artifact.files import RESULTS, write_text
from paper_artifact.report import deviations, errata
from paper_artifact.study.verdict import PARITY

BOOK = RESULTS / "book"
OWN = (
    "main_result.csv",
    "items.csv",
    "pairs.csv",
    "deviations.csv",
    "errors.csv",
)  # tables of the book's pages


def build(
    folder: Path = BOOK, sources: Sources | None = None, progress: Callable[[str], None] | None = None
) -> list[Item]:
    """Write the book into `folder` and return the paper's items with their verdicts.

    sources: records and notebooks (default: the committed records; the executed copies of the notebooks where
    they have today's code, else the committed ones). SVG pictures that `run-all` left in its folder figures
    are taken; pages and tables of an earlier book are overwritten, those of a notebook that is gone removed.
    progress: called with the name of each part before it is made. Raises InputError when something committed
    cannot be read or the folder cannot be written.
    """
    sources = sources or Sources.read()
    tell = progress or (lambda part: None)
    pages = Pages(folder)
    for part in ("notebooks", "tables", "soups"):  # figures: also `run-all` writes there
        for old in (folder / part).glob("*"):
            old.unlink()
    tell("front")
    write_text(folder / "figures" / "main_result.svg", front.picture_svg(sources))
    main = front.main_table(sources)
    tell("items")
    found = items(sources)
    deviating = deviations.deviation_table(sources.study("table1", "table2"), sources.measured("deviations"))
    wrong = errata.error_table()
    for name, table in zip(
        OWN,
        (
            main.reset_index(),
            status_frame(found),
            pair_frame(found),
            deviating.reset_index(),
            wrong.reset_index(),
        ),
        strict=True,
    ):
        write_text(folder / "tables" / name, table.to_csv(index=False, lineterminator="\n"))
    tell("soups")
    views = write_views(sources, folder / "soups")
    tell("notebooks")
    figures, tables = _write_chapters(sources, pages)
    tell("pages")
    counts = Counter(each.word for each in found)
    pages.write_style()
    pages.write(
        "index.html",
        "index.html",
        "Topology-aware triangle soups, reproduced",
        sentence=front.main_sentence(sources),
        main=main,
        parity=PARITY,
        items=found,
        counted=", ".join(f"{number} {word}" for word, number in counts.most_common()),
        views=views,
        made=f"Made by paper_artifact {__version__} from {_records(sources)} records; "
        "python -m paper_artifact book makes it again.",
    )
    pages.write("items.html", "items.html", f"The paper's {len(found)} items", items=found)
    pages.write(
        "differ.html", "differ.html", "Where we differ", deviations=deviating, errors=_linked(wrong, sources)
    )
    pages.write("soups.html", "soups.html", "Final soups in three dimensions", views=views)
    pages.write("figures.html", "figures.html", "Figures", groups=figures)
    pages.write("tables.html", "tables.html", "Tables", own=OWN, groups=tables)
    pages.write("notebooks.html", "notebooks.html", "Notebooks", chapters=list(sources.chapters.values()))
    pages.write("api.html", "api.html", "Python API", packages=api.packages())
    return found


def _write_chapters(sources: Sources, pages: Pages) -> tuple[list, list]:
    """Write the notebooks' pages, pictures and tables; return (chapter, files) of both for the lists."""
    figures, tables = [], []
    for chapter in sources.chapters.values():
        pictures = write_figures(chapter, pages.folder / "figures")
        names = write_tables(chapter, pages.folder / "tables")
        if pictures:
            figures.append((chapter, list(dict.fromkeys(pictures.values()))))
        if names:
            heads = [", ".join(filter(None, dict.fromkeys(rows[0])))[:90] for rows in chapter.tables]
            tables.append((chapter, list(zip(names, heads, strict=True))))
        pages.write(
            "notebook.html",
            f"notebooks/{chapter.name}.html",
            chapter.title,
            chapter=chapter,
            content=notebook_body(copy.deepcopy(chapter), pictures),
        )
    return figures, tables


def _linked(errors: pd.DataFrame, sources: Sources) -> pd.DataFrame:
    """The errors with, in place of the numbers of the notebooks that have our measurement, their names."""
    names = list(sources.chapters)
    found = (
        errors["ours"]
        .fillna("")
        .map(lambda text: [name for name in names if name[:2] in re.findall(r"\d\d", text)])
    )
    return errors.assign(ours=found)


def _records(sources: Sources) -> int:
    return len(list(sources.runs.glob("*.json")))
