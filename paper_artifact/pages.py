"""HTML pages from the Jinja templates of the folder `templates`: the book, the audit, the 3-D view."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

TEMPLATES = Path(__file__).with_name("templates")


@cache
def script_policy() -> str:
    """Return the Content-Security-Policy of a page with a 3-D view: no script but the templates' own, which
    hold no content, and nothing from elsewhere. A view inside another page is bound by that page's too."""
    scripts = [
        script
        for file in sorted(TEMPLATES.glob("*.html"))
        for script in re.findall(r"<script>(.*?)</script>", file.read_text(encoding="utf-8"), re.DOTALL)
    ]
    hashes = (base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts)
    return (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
        "script-src " + " ".join(f"'sha256-{each}'" for each in hashes)
    )


@cache
def _environment() -> Environment:
    loader = FileSystemLoader(TEMPLATES)
    made = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    made.globals["script_policy"] = script_policy
    return made


def render(template: str, **content: Any) -> str:
    """Return the page that a template makes of its content; texts are escaped, `markupsafe.Markup` is not.

    Raises jinja2.UndefinedError when the template asks for more than `content`.
    """
    return _environment().get_template(template).render(content)
