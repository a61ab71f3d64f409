"""A 3-D view in one HTML file: WebGL, the triangles inside as base64, no network, no library."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.export.triangles import Triangles
from paper_artifact.export.viewer_page import PAGE
from paper_artifact.export.viewpoint import Viewpoint, framing
from paper_artifact.files import write_text

MOST_TRIANGLES = 400_000  # about 25 MB of HTML


def write_html(
    path: Path | str,
    parts: Mapping[str, Triangles],
    title: str,
    viewpoint: Viewpoint | None = None,
    back: tuple[str, str] | None = None,
) -> None:
    """Write a page that shows `parts` (name → triangles, world units) side by side, turning together, or one
    of them alone.

    viewpoint: where it is first seen from (default: all of it, from above one side, z upwards); back:
    address and words of a link to where the page belongs. Drag to orbit, wheel or pinch to zoom, double click
    to reset; "light" is a headlight, "colours" shows the triangles' own instead of one grey. Triangles of
    mean opacity below .5 are left out. Raises InputError for no parts, a part that is empty or not finite,
    more triangles than a page can hold, or a path that is not writable.
    """
    write_text(path, html_page(parts, title, viewpoint, back))


def html_page(
    parts: Mapping[str, Triangles],
    title: str,
    viewpoint: Viewpoint | None = None,
    back: tuple[str, str] | None = None,
) -> str:
    """Return the page of `write_html` as text."""
    shown = {name: triangles.visible() for name, triangles in parts.items()}
    if not shown:
        raise InputError("a 3-D view needs at least one set of triangles")
    count = sum(len(triangles) for triangles in shown.values())
    if count > MOST_TRIANGLES:
        raise InputError(
            f"{count} triangles are too many for one page (at most {MOST_TRIANGLES}); simplify the mesh first"
        )
    points = np.concatenate([triangles.vertices.reshape(-1, 3) for triangles in shown.values()])
    if not np.isfinite(points).all():
        raise InputError(
            "the triangles hold coordinates that are not finite; the run that made them has diverged"
        )
    low, high = points.min(axis=0), points.max(axis=0)
    seen = viewpoint or framing(points)
    data = {
        "centre": [float(x) for x in (low + high) / 2],
        "radius": float(np.linalg.norm(high - low) / 2) or 1.0,
        "eye": seen.eye,
        "target": seen.target,
        "up": seen.up,
        "parts": [
            {
                "name": name,
                "count": len(triangles),
                "positions": _base64(triangles.vertices.astype("<f4")),
                "colours": _base64(np.rint(triangles.colours * 255).astype(np.uint8)),
            }
            for name, triangles in shown.items()
        ],
    }
    # "<" escaped: no name can end the script element.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    link = "" if back is None else f'<a href="{html.escape(back[0])}">{html.escape(back[1])}</a>'
    return PAGE.replace("@BACK@", link).replace("@TITLE@", html.escape(title)).replace("@DATA@", text)


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
