"""Figures outside of notebooks: closed matplotlib Figures, and a persistence diagram drawn on axes."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

DPI = 90


def new_figure(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """Return a closed figure and its (rows, columns) array of axes; width and height of one in inches."""
    size = (width * columns, height * rows)
    figure, axes = plt.subplots(
        rows, columns, figsize=size, dpi=DPI, squeeze=False, layout="constrained", **options
    )
    plt.close(figure)  # a notebook shows what a cell returns; an open figure would be shown a second time
    return figure, axes


def svg(figure: Figure) -> bytes:
    """Return the figure as an SVG file, the same bytes for the same figure: no date, names from a fixed
    salt, letters as outlines (no font is needed to read it)."""
    data = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "paper_artifact", "svg.fonttype": "path"}):
        figure.savefig(data, format="svg", metadata={"Date": None})
    return data.getvalue()


def draw_diagram(
    axis: Axes,
    bars: np.ndarray,
    floor: float,
    limit: float,
    target: np.ndarray | None = None,
    title: str = "",
) -> None:
    """Draw the bars (k,2) (birth, death), the diagonal and the floor above it; significant bars are large
    dots.

    target (m,2): bars drawn as stars. All in one unit; the axes run to `limit`.
    """
    margin = 0.04 * limit
    axis.plot([0, limit], [0, limit], color="black", linewidth=0.7)
    axis.plot([0, limit], [floor, limit + floor], color="black", linewidth=0.6, linestyle=":")
    above = bars[:, 1] - bars[:, 0] > floor
    axis.scatter(*bars[~above].T, s=5, color="#7fa8dc", linewidths=0)
    axis.scatter(*bars[above].T, s=26, color="#1f5fbf", linewidths=0)
    if target is not None and len(target):
        axis.scatter(*target.T, marker="*", s=110, facecolor="none", edgecolor="#c0392b", linewidths=1)
    axis.set(xlim=(-margin, limit), ylim=(-margin, limit), aspect="equal")
    axis.set_title(title, fontsize=8)
    axis.tick_params(labelsize=6)
