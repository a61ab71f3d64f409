"""The style of all figures: closed matplotlib Figures, the same as SVG, and a persistence diagram on axes.

Figures are made in the size in which they are printed: none is wider than PAGE, and no letter is smaller than
TEXT points.
"""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

COLUMN, PAGE = 3.3, 6.8  # inches: the width of one and of two columns of a paper
TEXT = 8.0  # points: the least size of letters
DPI = 140
STYLE = {
    "font.size": TEXT,
    "axes.titlesize": TEXT,
    "axes.labelsize": TEXT,
    "xtick.labelsize": TEXT,
    "ytick.labelsize": TEXT,
    "legend.fontsize": TEXT,
    "legend.title_fontsize": TEXT,
    "figure.titlesize": TEXT,
    "axes.titlepad": 4.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.columnspacing": 1.4,
    "legend.labelspacing": 0.35,
}
INK, AIM = "#222222", "#d55e00"  # live bars and lines of reference; what they are held against
FAINT = "#8a8a8a"  # bars below the floor
BIRTH, DEATH = "birth (radius / D)", "death (radius / D)"


def new_figure(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """Return a closed figure in the project's style and its (rows, columns) array of axes; width and height
    of one in inches. The style is set for all later figures of the process, too."""
    matplotlib.rcParams.update(STYLE)
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
    """Draw the bars (k,2) (birth, death), the diagonal and the floor above it (dotted); significant bars are
    large dots, those below the floor small grey ones.

    target (m,2): bars drawn as hollow stars. All in one unit, radius / D for the labels; the axes run to
    `limit`.
    """
    margin = 0.05 * limit
    axis.plot([0, limit], [0, limit], color=INK, linewidth=0.7)
    axis.plot([0, limit], [floor, limit + floor], color=INK, linewidth=0.8, linestyle=":")
    above = bars[:, 1] - bars[:, 0] > floor
    axis.scatter(*bars[~above].T, s=4, color=FAINT, linewidths=0, rasterized=True)
    axis.scatter(*bars[above].T, s=20, color=INK, linewidths=0, zorder=3)
    if target is not None and len(target):
        axis.scatter(*target.T, marker="*", s=110, facecolor="none", edgecolor=AIM, linewidths=1.1, zorder=4)
    axis.set(xlim=(-margin, limit), ylim=(-margin, limit), aspect="equal", xlabel=BIRTH, ylabel=DEATH)
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(MaxNLocator(3))
    axis.set_title(title)
