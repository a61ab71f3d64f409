"""What a notebook contributes to the book: its page, its tables as CSV, its figures as files."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import nbformat
from nbformat import NotebookNode

from paper_artifact.book.htmltable import Rows, csv_text, table_rows
from paper_artifact.errors import InputError
from paper_artifact.files import write_bytes, write_text
from paper_artifact.notebooks import notebook_files

SHOWN = re.compile(r'\bshow\(\s*"([\w-]+)"')  # the key of a figure, as `report.kit.figures.show` takes it


@dataclass(frozen=True, eq=False)
class Chapter:
    """One notebook with its outputs."""

    name: str  # "06_c_matrix"
    title: str  # its first heading, without the paper's items in parentheses
    notebook: NotebookNode
    executed: bool  # whether the outputs are this machine's; else the committed ones
    tables: list[Rows]  # in order of appearance

    @property
    def state(self) -> str:
        """Where its outputs are from, in words."""
        if self.executed:
            return "executed on this machine"
        shown = any(cell.get("outputs") for cell in self.notebook.cells)
        return "with its committed outputs" if shown else "not executed yet: what it reads is not recorded"


@dataclass(frozen=True)
class Figure:
    """One picture that a notebook shows."""

    chapter: str  # the notebook's name
    cell: int  # its place among the notebook's cells
    output: int  # its place among the cell's outputs
    name: str  # of the file, without suffix: <notebook>_<key> as `run-all` writes it, or by its cell


def chapters(notebooks: Path, executed: Path) -> list[Chapter]:
    """Return every notebook of the folder `notebooks` in order, with the outputs of its copy in `executed`
    where that has the same code and no error, else with its own.

    Raises InputError when there are none, or one cannot be read.
    """
    return [_chapter(path, executed / path.name) for path in notebook_files(notebooks)]


def _chapter(path: Path, copy: Path) -> Chapter:
    notebook = _read(path)
    ran = _read(copy) if copy.is_file() else None
    fresh = ran is not None and _code(ran) == _code(notebook) and not _failed(ran)
    if fresh and ran is not None:
        ran.cells = [each for each in ran.cells if "injected-parameters" not in _tags(each)]
        notebook = ran
    heading = next((each.source for each in notebook.cells if each.cell_type == "markdown"), path.stem)
    title = re.sub(r"\s*\(.*\)\s*$", "", heading.splitlines()[0].lstrip("# "))
    tables = [table for _, _, each in _data(notebook, "text/html") for table in table_rows(each)]
    return Chapter(path.stem, title, notebook, fresh, tables)


def _read(path: Path) -> NotebookNode:
    try:
        return nbformat.read(path, as_version=4)
    except Exception as error:  # nbformat raises many kinds
        raise InputError(f"cannot read the notebook {path.name}; restore it with git") from error


def _tags(cell: NotebookNode) -> Sequence[str]:
    return cell.metadata.get("tags", [])


def _code(notebook: NotebookNode) -> list[str]:
    """The sources but for the parameters, which a profile may change."""
    hidden = {"parameters", "injected-parameters"}
    return [cell.source for cell in notebook.cells if not hidden & set(_tags(cell))]


def _failed(notebook: NotebookNode) -> bool:
    outputs = [each for cell in notebook.cells for each in cell.get("outputs", [])]
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    return any(each.output_type == "error" for each in outputs) or None in counts


def _data(notebook: NotebookNode, kind: str) -> Iterator[tuple[int, int, str]]:
    """(cell, output, content) of the outputs that have this media type."""
    for number, cell in enumerate(notebook.cells):
        for place, output in enumerate(cell.get("outputs", [])):
            if kind in output.get("data", {}):
                yield number, place, output["data"][kind]


def figures(chapter: Chapter) -> list[Figure]:
    """Return the notebook's pictures in order. The n-th picture of a cell has the n-th key that the cell
    shows; where the numbers differ, its name says cell and place."""
    found: dict[int, list[int]] = {}
    for cell, output, _ in _data(chapter.notebook, "image/png"):
        found.setdefault(cell, []).append(output)
    made = []
    for cell, outputs in found.items():
        keys = SHOWN.findall(chapter.notebook.cells[cell].source)
        if len(keys) != len(outputs):
            keys = [f"cell{cell}_{place}" for place in range(len(outputs))]
        for key, output in zip(keys, outputs, strict=True):
            made.append(Figure(chapter.name, cell, output, f"{chapter.name}_{key}"))
    return made


def write_figures(chapter: Chapter, folder: Path) -> dict[tuple[int, int], str]:
    """Write the pictures that are not there as SVG to `folder` as PNG; return {(cell, output): file name}.

    SVG files are `run-all`'s. A PNG that an SVG has replaced is removed.
    """
    names = {}
    for figure in figures(chapter):
        picture = folder / f"{figure.name}.png"
        if (folder / f"{figure.name}.svg").is_file():
            picture.unlink(missing_ok=True)
            names[figure.cell, figure.output] = f"{figure.name}.svg"
            continue
        data = chapter.notebook.cells[figure.cell].outputs[figure.output]["data"]["image/png"]
        write_bytes(picture, base64.b64decode(data))
        names[figure.cell, figure.output] = picture.name
    return names


def write_tables(chapter: Chapter, folder: Path) -> list[str]:
    """Write the notebook's tables to `folder` as CSV; return their file names, <notebook>_table1.csv …"""
    names = []
    for number, rows in enumerate(chapter.tables, 1):
        names.append(f"{chapter.name}_table{number}.csv")
        write_text(folder / names[-1], csv_text(rows))
    return names
