"""HTML pages from the Jinja templates of the folder `templates`: the book, the audit, the 3-D view."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

TEMPLATES = Path(__file__).with_name("templates")


@cache
def _environment() -> Environment:
    loader = FileSystemLoader(TEMPLATES)
    return Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )


def render(template: str, **content: Any) -> str:
    """Return the page that a template makes of its content; texts are escaped, `markupsafe.Markup` is not.

    Raises jinja2.UndefinedError when the template asks for more than `content`.
    """
    return _environment().get_template(template).render(content)
