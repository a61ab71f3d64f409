"""The book: the study as one offline set of pages, made from the claims and the executed notebooks.

A claim is a row of `results/claims/*.csv`, written by the notebook that checked it (`claims.Claims`). The
verdict of an item of the paper is a count of its claims. Notebooks become pages through nbconvert, which
removes every script of theirs; the reference of the Python API is pdoc's."""

from __future__ import annotations

import base64
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import nbformat
import numpy as np
import pandas as pd
from markupsafe import Markup, escape
from nbformat import NotebookNode

from paper_artifact import __version__, results
from paper_artifact.audit.marks import light_mesh
from paper_artifact.book.main_result import main_frame, main_runs, picture_svg
from paper_artifact.catalogue import shape_row
from paper_artifact.claims import FOLDER, MISSING, paper_items, read_claims
from paper_artifact.errors import InputError
from paper_artifact.export.models import mesh_triangles, soup_triangles
from paper_artifact.export.viewer import framing, html_page
from paper_artifact.files import RESULTS, plain, renewed_folder, write_bytes, write_text
from paper_artifact.mesh import FEATURES
from paper_artifact.notebooks import EXECUTED, NOTEBOOKS, notebook_files
from paper_artifact.pages import TEMPLATES, render
from paper_artifact.scene.shapes import surface
from paper_artifact.soup.state import load_soup
from paper_artifact.verdict import PARITY

BOOK = RESULTS / "book"
MENU = (  # (name, file) of what every page leads to
    ("Result", "index.html"),
    ("28 items", "items.html"),
    ("Where we differ", "differ.html"),
    ("Soups in 3-D", "soups.html"),
    ("Figures", "figures.html"),
    ("Notebooks", "notebooks.html"),
    ("Python API", "api/index.html"),
)
API = ("alpha", "topology", "results", "verdict", "claims", "plot", "mesh", "certify", "catalogue", "config")
SEED = 0  # whose soups are committed
MOST = 40_000  # triangles of a ground truth in a page
SHOWN = re.compile(r'\bshow\(\s*"([\w-]+)"')  # the key of a figure, as `plot.show` takes it


@dataclass(frozen=True)
class Item:
    """One table or figure of the paper, with its claims."""

    name: str  # "Table S2", "Fig. 1"
    title: str
    notebooks: tuple[str, ...]  # where it is, the main one first
    compared: str  # what is compared and by which rule
    reason: str  # why claims differ, "" where none does
    claims: pd.DataFrame  # columns of `claims.read_claims`

    @property
    def key(self) -> str:
        """A name for links: "table-s2"."""
        return self.name.lower().replace(". ", "-").replace(" ", "-")

    @property
    def word(self) -> str:
        """ "agrees" when every checked claim holds, "differs" when none does, else "partly"; "not recorded"
        without any."""
        known = self.claims["holds"][self.claims["holds"] != MISSING]
        if not len(known):
            return MISSING
        return "agrees" if (known == "yes").all() else "partly" if (known == "yes").any() else "differs"

    @property
    def tally(self) -> str:
        """How many of the checked claims hold, "12 of 15"."""
        counts = Counter(self.claims["holds"])
        missing = f", {counts[MISSING]} {MISSING}" if counts[MISSING] else ""
        return f"{counts['yes']} of {counts['yes'] + counts['no']}{missing}"


@dataclass(frozen=True)
class Chapter:
    """One notebook with its outputs."""

    name: str  # "06_c_matrix"
    title: str  # its first heading, without the paper's items in parentheses
    notebook: NotebookNode
    executed: bool  # whether the outputs were made on this machine; else they are the committed ones


@dataclass(frozen=True)
class View:
    """One page of soups."""

    shape: str
    file: str  # its name in the folder soups/
    arms: tuple[str, ...]  # "C1, 1 of 1 voids, tail .0071", in the order of the page
    note: str  # what is missing, "" for nothing


def build(
    folder: Path = BOOK,
    notebooks: Path = NOTEBOOKS,
    executed: Path = EXECUTED,
    runs: Path = RESULTS / "runs",
    progress: Callable[[str], None] = lambda part: None,
) -> list[Item]:
    """Write the book into `folder` and return the paper's items with their verdicts. Files of an earlier book
    there are replaced or removed, by its manifest; other files stay.

    notebooks, executed: the executed copies are taken where they have today's code. runs: the folder of the
    records. progress: called with the name of each part before it is made. SVG pictures that `run-all` left
    in the folder figures are taken. Raises InputError when something committed cannot be read, when the
    folder holds files and was no book before, or when it cannot be written."""
    with renewed_folder(folder, "book") as new:
        return _build(new, folder / "figures", notebooks, executed, runs, progress)


def _build(
    folder: Path, drawn: Path, notebooks: Path, executed: Path, runs: Path, progress: Callable[[str], None]
) -> list[Item]:
    tables = results.load(folder=runs)
    progress("claims")
    claims = read_claims(FOLDER if runs == RESULTS / "runs" else runs.parent / "claims")
    found = items(claims)
    chapters = [read_chapter(path, executed / path.name) for path in notebook_files(notebooks)]
    main = main_runs(tables) if len(tables.runs) else tables.runs
    if len(main):
        write_text(folder / "figures" / "main_result.svg", picture_svg(main))
    frames = {"items": _item_frame(found), "claims": claims, "runs": _scalars(tables.runs)}
    for name, frame in (frames | {"published": results.published()}).items():
        write_text(folder / "tables" / f"{name}.csv", csv_text(frame))
    progress("soups")
    views = write_views(tables, main, folder / "soups") if len(main) else []
    progress("notebooks")
    pages = Pages(folder, {chapter.name for chapter in chapters})
    figures = []
    for chapter in chapters:
        with told(chapter.name):
            pictures = write_figures(chapter, folder / "figures", drawn)
            content = pages.notebook_body(chapter, pictures)
        figures.append((chapter, list(dict.fromkeys(pictures.values()))))
        file = f"notebooks/{chapter.name}.html"
        pages.write(file, chapter.title, "notebook.html", chapter=chapter, content=content)
    progress("pages")
    no = claims[claims["holds"] == "no"]
    drawn_files = [file for _, files in figures for file in files]
    front: dict[str, Any] = {"items": found, "views": views, "runs": tables.runs, "version": __version__}
    front |= {"main": main_frame(main) if len(main) else None, "parity": PARITY}
    front |= {"words": Counter(item.word for item in found), "holds": Counter(claims["holds"])}
    front |= {"differing": Counter(no["item"]).most_common()}
    front["gallery"] = next((file for file in drawn_files if file.startswith("09_gallery_voids")), None)
    pages.write_style()
    pages.write("index.html", "Topology-aware triangle soups, reproduced", **front)
    pages.write("items.html", f"The paper's {len(found)} items", items=found)
    differing = [(item, no[no["item"] == item.name]) for item in found]
    pages.write("differ.html", "Where we differ", items=[each for each in differing if len(each[1])])
    pages.write("soups.html", "Final soups in three dimensions", views=views)
    pages.write("figures.html", "Figures", groups=[each for each in figures if each[1]])
    pages.write("notebooks.html", "Notebooks", chapters=chapters)
    progress("reference")
    _write_reference(folder / "api")
    return found


def items(claims: pd.DataFrame) -> list[Item]:
    """Return the paper's items in its order. Raises InputError when `items.csv` cannot be read."""
    table = paper_items()
    own = {name: claims[claims["item"] == name] for name in table["item"]}
    return [
        Item(row.item, row.title, tuple(row.notebooks.split()), row.compared, row.reason, own[row.item])
        for row in table.itertuples()
    ]


def _item_frame(found: Sequence[Item]) -> pd.DataFrame:
    """Return one row per item: item, title, verdict, holds ("12 of 15"), notebooks, compared, reason."""
    rows = [(i.name, i.title, i.word, i.tally, " ".join(i.notebooks), i.compared, i.reason) for i in found]
    columns = ["item", "title", "verdict", "holds", "notebooks", "compared", "reason"]
    return pd.DataFrame(rows, columns=columns)


def csv_text(frame: pd.DataFrame) -> str:
    """Return the frame as CSV in which no text can be taken for a formula by a spreadsheet: a text that
    begins with = + - @ or a tab is preceded by an apostrophe."""
    texts = frame.select_dtypes(include=["object", "string", "category"]).columns
    safe = frame.assign(**{name: frame[name].map(_no_formula) for name in texts})
    return safe.to_csv(index=False, lineterminator="\n")


def _no_formula(value: object) -> object:
    risky = isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r")
    return f"'{value}" if risky and not re.fullmatch(r"[+-]?[\d.]+", str(value)) else value


def _scalars(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the frame without the columns of lists and arrays."""
    lists = [name for name in runs if runs[name].map(lambda value: hasattr(value, "__len__")).any()]
    return runs.drop(columns=[name for name in lists if not runs[name].map(type).isin([str, float]).all()])


def read_chapter(path: Path, copy: Path) -> Chapter:
    """Return the notebook at `path`, with the outputs of its executed copy where that has the same code and
    no error. Raises InputError for a file that is no notebook."""
    with told(path.stem):
        notebook = nbformat.read(plain(path), as_version=4)
    with told(f"{path.stem} in its executed copy {copy}"):
        ran = nbformat.read(copy, as_version=4) if copy.is_file() else None
    with told(path.stem):
        fresh = ran is not None and _code(ran) == _code(notebook) and not _failed(ran)
        if fresh and ran is not None:
            hidden = "injected-parameters"
            ran.cells = [cell for cell in ran.cells if hidden not in cell.metadata.get("tags", [])]
            notebook = ran
        nbformat.validate(notebook)
        texts = [cell.source.strip() for cell in notebook.cells if cell.cell_type == "markdown"]
        heading = next((text for text in texts if text.strip("# ")), path.stem)
        title = re.sub(r"\s*\(.*\)\s*$", "", heading.splitlines()[0].lstrip("# ")) or path.stem
        return Chapter(path.stem, title, notebook, fresh)


@contextmanager
def told(name: str) -> Iterator[None]:
    """Say which notebook is damaged, whatever nbformat, nbconvert and base64 raise of it."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:90]
        raise InputError(f"cannot read the notebook {name} ({reason}); save it again") from error


def _code(notebook: NotebookNode) -> list[str]:
    """The sources without the parameters, which a profile may change."""
    hidden = {"parameters", "injected-parameters"}
    return [cell.source for cell in notebook.cells if not hidden & set(cell.metadata.get("tags", []))]


def _failed(notebook: NotebookNode) -> bool:
    outputs = [each for cell in notebook.cells for each in cell.get("outputs", [])]
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    return any(each.output_type == "error" for each in outputs) or None in counts


def write_figures(chapter: Chapter, folder: Path, drawn_before: Path) -> dict[tuple[int, int], str]:
    """Write the notebook's pictures to `folder` as <notebook>_<key>.png, unless its executed copy is shown
    and `run-all` left an SVG of that name in `drawn_before`; return {(cell, output): file name}. Without a
    key for each picture, cell and place name it."""
    names: dict[tuple[int, int], str] = {}
    for number, cell in enumerate(chapter.notebook.cells):
        drawn = [n for n, each in enumerate(cell.get("outputs", [])) if "image/png" in each.get("data", {})]
        keys = SHOWN.findall(cell.source)
        if len(keys) != len(drawn):
            keys = [f"cell{number}_{place}" for place in range(len(drawn))]
        for key, place in zip(keys, drawn, strict=True):
            name = f"{chapter.name}_{key}.svg"
            if not (chapter.executed and (drawn_before / name).is_file()):
                name = f"{chapter.name}_{key}.png"
                write_bytes(folder / name, base64.b64decode(cell.outputs[place]["data"]["image/png"]))
            names[number, place] = name
    return names


def write_views(tables: results.Results, runs: pd.DataFrame, folder: Path) -> list[View]:
    """Write a page for every shape of `runs` that has a soup of seed 0, and return them in the order of the
    catalogue. Where the ground truth is not available, the page shows the soups alone."""
    made = []
    for shape, own in runs[runs["seed"] == SEED].groupby("shape", observed=True):
        kept = own[own["run"].map(lambda run: tables.soup_path(run).is_file())].sort_values("condition")
        if not len(kept):
            continue
        parts, lines, note = {}, [], ""
        try:
            truth = surface(shape)
            parts["ground truth"] = mesh_triangles(light_mesh(truth, MOST))
            if len(truth.faces) > MOST:
                note = f"The ground truth has {len(truth.faces)} triangles; a coarser copy is shown."
        except InputError as error:
            note = f"The ground truth is not shown: {error}."
        for run in kept.itertuples():
            name = f"{run.condition}, {run.count:.0f} of {run.expected:.0f} {FEATURES[run.dimension][1]}"
            parts[name] = soup_triangles(load_soup(tables.soup_path(run.run)))
            lines.append(f"{name}, tail {run.tail:.4f}")
        missing = sorted(set(own["condition"]) - set(kept["condition"]))
        note += f" No soup of {', '.join(missing)} is kept." if missing else ""
        points = np.concatenate([each.visible().vertices.reshape(-1, 3) for each in parts.values()])
        row = shape_row(shape)
        view = None if row is None else framing(points, row.view, row.up)
        page = html_page(parts, shape, view, ("../soups.html", "← the book"))
        write_text(folder / f"{shape}.html", page)
        made.append(View(str(shape), f"{shape}.html", tuple(lines), note.strip()))
    return made


def _write_reference(folder: Path) -> None:
    """Write pdoc's pages of the modules `API` into `folder`."""
    import pdoc

    from paper_artifact import alpha

    for name in alpha.__all__:  # those that need more than numpy are imported when first asked for
        vars(alpha)[name] = getattr(alpha, name)

    pdoc.render.configure(docformat="markdown", show_source=True)
    pdoc.pdoc(*(f"paper_artifact.{name}" for name in API), output_directory=folder)


# What a notebook may bring into a page: text, tables and pictures, nothing that runs.
TAGS = [
    *("h1", "h2", "h3", "h4", "h5", "h6", "p", "br", "hr", "div", "span", "blockquote", "pre", "code"),
    *("a", "img", "b", "i", "em", "strong", "sub", "sup", "abbr", "ul", "ol", "li", "dl", "dt", "dd"),
    *("table", "caption", "thead", "tbody", "tfoot", "tr", "th", "td"),
]
ATTRIBUTES = {
    "*": ["class"],
    "a": ["href", "title"],
    "img": ["src", "alt"],
    "th": ["colspan", "rowspan"],
    "td": ["colspan", "rowspan"],
}


LINK = r'<a href="notebooks/([^"]+)\.html">(.*?)</a>'  # from a page of the book's top to a notebook's


class Pages:
    """Writes pages into one folder; links to notebooks other than the `chapters` become plain words."""

    def __init__(self, folder: Path, chapters: Collection[str]) -> None:
        from bleach import clean
        from nbconvert import HTMLExporter

        self.folder, self.chapters = folder, chapters
        self.exporter = HTMLExporter(
            template_name="basic",
            exclude_anchor_links=True,
            sanitize_html=True,
            filters={"clean_html": partial(clean, tags=TAGS, attributes=ATTRIBUTES, strip=True)},
        )

    def write(self, file: str, title: str, template: str = "", **content: Any) -> None:
        """Write one page; `file` may lie one folder deeper; template: where it is not called as the file.
        Raises InputError when it cannot be written."""
        page = {"title": title, "menu": MENU, "here": file, "root": "../" * file.count("/")}
        text = render(template or file, **page, **content)
        write_text(self.folder / file, re.sub(LINK, self._known, text))

    def _known(self, link: re.Match[str]) -> str:
        return link[0] if unquote(link[1]) in self.chapters else link[2]

    def write_style(self) -> None:
        """Write the style sheet: the templates' own and the colours of code."""
        from pygments.formatters import HtmlFormatter

        own = (TEMPLATES / "style.css").read_text(encoding="utf-8")
        write_text(self.folder / "style.css", own + HtmlFormatter().get_style_defs(".highlight") + "\n")

    def notebook_body(self, chapter: Chapter, pictures: dict[tuple[int, int], str]) -> Markup:
        """Return the notebook as HTML for the inside of a page one folder deep, without any script; pictures:
        {(cell, output): file in the folder figures}."""
        notebook = nbformat.from_dict(chapter.notebook)
        for (cell, output), file in pictures.items():
            link = f"../figures/{quote(file)}"
            image = f'<a href="{link}"><img src="{link}" alt="{escape(file)}"></a>'
            notebook.cells[cell].outputs[output]["data"] = {"text/html": image}
        for cell in notebook.cells:
            cell["metadata"] = {}  # and an output's: a template may write them into attributes as they are
            for each in cell.get("outputs", ()):
                if "metadata" in each:
                    each["metadata"] = {}
                if "text/html" in (data := each.get("data", {})):  # pandas' own style, scoped to nothing
                    text = "".join(data["text/html"])
                    data["text/html"] = re.sub(r"<style scoped>.*?</style>", "", text, flags=re.DOTALL)
        return Markup(self.exporter.from_notebook_node(notebook)[0])
