"""The book's pages: Jinja templates of this folder, notebooks through nbconvert, one style sheet."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import nbformat
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from nbconvert import HTMLExporter

from paper_artifact.book import api
from paper_artifact.book.contents import Chapter
from paper_artifact.files import write_text

TEMPLATES = Path(__file__).with_name("templates")
MENU = (  # (name, file) of what every page leads to
    ("Result", "index.html"),
    ("28 items", "items.html"),
    ("Where we differ", "differ.html"),
    ("Soups in 3-D", "soups.html"),
    ("Figures", "figures.html"),
    ("Tables", "tables.html"),
    ("Notebooks", "notebooks.html"),
    ("Python API", "api.html"),
)


class Pages:
    """Writes pages into one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = Environment(
            loader=FileSystemLoader(TEMPLATES),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self.environment.filters |= {"blocks": api.blocks, "ticks": ticks}

    def write(self, template: str, file: str, title: str, **content: Any) -> None:
        """Write one page; `file` may lie one folder deeper. Raises InputError when it cannot be written."""
        root = "../" * file.count("/")
        text = self.environment.get_template(template).render(
            title=title, menu=MENU, here=file, root=root, **content
        )
        write_text(self.folder / file, text)

    def write_style(self) -> None:
        """Write the style sheet: the templates' own and the colours of code."""
        from pygments.formatters import HtmlFormatter

        own = (TEMPLATES / "style.css").read_text(encoding="utf-8")
        write_text(self.folder / "style.css", own + HtmlFormatter().get_style_defs(".highlight") + "\n")


@cache
def _exporter() -> HTMLExporter:
    """nbconvert's bare template: no page around it, nothing from the network; made once."""
    return HTMLExporter(template_name="basic", exclude_anchor_links=True)


def ticks(text: str) -> Markup:
    """Return the text with what stands between backquotes as code."""
    return Markup(re.sub(r"``?([^`]+)``?", r"<code>\1</code>", str(escape(text))))


def notebook_body(chapter: Chapter, pictures: Mapping[tuple[int, int], str]) -> Markup:
    """Return the notebook as HTML for the inside of a page one folder deep; pictures: {(cell, output): file
    in the folder figures}."""
    notebook = nbformat.from_dict(chapter.notebook)
    for (cell, output), file in pictures.items():
        shown = notebook.cells[cell].outputs[output]
        link = f"../figures/{file}"
        image = f'<a href="{link}"><img src="{link}" alt="{escape(file)}"></a>'
        shown["data"] = {"text/html": image}
    body, _ = _exporter().from_notebook_node(notebook)
    return Markup(re.sub(r"<style scoped[^>]*>.*?</style>", "", body, flags=re.DOTALL))
