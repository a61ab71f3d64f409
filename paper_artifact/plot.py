"""The style of all figures. A notebook draws with matplotlib in the open; this module gives sizes, colours
and a few marks.

    figure, axes = plot.new_figure(1, 2, width=3.3, height=2.1)       # inches of one axes
    axes[0, 0].plot(steps, tails, **plot.style("C1"), label="C1")
    plot.label_axis(axes[0, 0], "sphere", "step", "bottleneck (radius / D)")
    plot.mark_paper(axes[0, 0], .0156)                                # the paper's value
    plot.legend_below(figure)
    plot.show("trajectories", figure)                                 # `run-all` also writes an SVG

Figures are made in the size in which they are printed: none is wider than PAGE inches, no letter is smaller
than TEXT points."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from paper_artifact.catalogue import colour_of, marker_of
from paper_artifact.files import FIGURES_VARIABLE, write_bytes

COLUMN, PAGE = 3.3, 6.8  # inches: the width of one and of two columns of a paper
TEXT = 8.0  # points: the least size of letters
DPI = 140
STYLE: dict[Any, Any] = {
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
# for anything but conditions (Okabe, Ito)
SERIES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
MARKS = ("o", "s", "^", "D", "v", "P")  # beside SERIES
DIMENSIONS = {0: ("#009e73", "^"), 1: ("#0072b2", "o"), 2: ("#d55e00", "s")}  # of H0, H1, H2
WINDOW = "#f3ead2"  # of a marked stretch of an axis
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


def show(key: str, figure: Figure) -> None:
    """Display a notebook's figure; where `run-all` executes the notebook, also write it to
    results/book/figures/<notebook>_<key>.svg."""
    from IPython.display import display

    if start := os.environ.get(FIGURES_VARIABLE):
        write_bytes(Path(f"{start}_{key}.svg"), svg(figure))
    display(figure)


def style(condition: str) -> dict[str, Any]:
    """Return colour and marker of a condition, the same in every figure, as keywords for `Axes.plot`."""
    return {
        "color": colour_of(condition),
        "marker": marker_of(condition),
        "markeredgecolor": "white",
        "markeredgewidth": 0.5,
    }


def draw_band(axis: Axes, table: pd.DataFrame, x: str, y: str, label: str, **keywords: Any) -> None:
    """Draw the mean over the rows of each x as a line and their range as a band; keywords go to
    `Axes.plot`."""
    group = table.groupby(x)[y]
    mean = group.mean()
    line = axis.plot(mean.index, mean, label=label, **keywords)[0]
    axis.fill_between(mean.index, group.min(), group.max(), color=line.get_color(), alpha=0.13, linewidth=0)


def mark_paper(axis: Axes, value: float) -> Line2D:
    """Draw a dotted line at a value of the paper, labelled "paper" in the legend."""
    line = mark_value(axis, value)
    line.set(color=AIM, linestyle=":", label="paper")
    return line


def label_axis(axis: Axes, title: str, x: str = "", y: str = "", grid: bool = True) -> None:
    """Write an axes' title and what its axes show, with units, over a light grid or none."""
    axis.set_title(title)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    if grid:
        axis.grid(alpha=0.25, linewidth=0.5)


def label_outer(axes: np.ndarray, x: str = "", y: str = "") -> None:
    """Write what the axes of a (rows, columns) array share: x below the lowest visible one of each column, y
    at the left of each row."""
    for line in axes:
        line[0].set_ylabel(y)
    for column in axes.T:
        shown = [axis for axis in column if axis.axison]
        if shown:
            shown[-1].set_xlabel(x)


def legend_below(figure: Figure, columns: int = 4, extra: Iterable[Artist] = ()) -> None:
    """Write one legend for all axes of the figure below them, each label once, then the `extra` handles."""
    found: dict[str, Artist] = {}
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            found.setdefault(str(label), handle)
    for handle in extra:
        found.setdefault(str(handle.get_label()), handle)
    if found:
        ncols = min(columns, len(found))
        figure.legend(list(found.values()), list(found), loc="outside lower center", ncols=ncols)


def mark_value(axis: Axes, value: float, upright: bool = False) -> Line2D:
    """Draw a dashed line at a true or given value of the vertical axis (upright: of the horizontal one).
    Returns it, as a handle for a legend, unlabelled."""
    draw = axis.axvline if upright else axis.axhline
    return draw(value, color=INK, linestyle="--", linewidth=0.9, zorder=2.5)


def mark_window(axis: Axes, window: tuple[float, float]) -> Patch:
    """Mark a stretch of the horizontal axis behind the data. Returns its handle for a legend, unlabelled."""
    axis.axvspan(*window, color=WINDOW, linewidth=0, zorder=0)
    return Patch(facecolor=WINDOW, edgecolor="none")


def plain_log(axis: Axes, which: str = "y") -> None:
    """Make an axis logarithmic with ticks whose text has no small raised exponents: .01 as 0.01, 1e-7."""
    axis.set(**{f"{which}scale": "log"})
    side = axis.yaxis if which == "y" else axis.xaxis
    side.set_major_formatter(FuncFormatter(lambda value, _: _log_text(value)))
    axis.minorticks_off()


def _log_text(value: float) -> str:
    """Return a number as a tick shows it: plain from .001 to 10,000, else 1e-7."""
    return f"{value:g}" if 1e-3 <= value < 1e5 else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")


def image_axis(axis: Axes, image: np.ndarray, title: str = "") -> None:
    """Show one image (H,W,3), float in [0,1], without ticks and frame."""
    axis.imshow(np.clip(image, 0, 1), interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    axis.set_title(title)
    for side in axis.spines.values():
        side.set_visible(False)


def image_rows(rows: Sequence[tuple[str, Sequence[np.ndarray]]], size: float = 0.0) -> Figure:
    """Return a figure with one labelled row per entry: images (H,W,3) float in [0,1], all rows of equal
    length. size: of an image, inches (default: as many as fill a page's width, at most 2.2)."""
    columns = len(rows[0][1])
    size = size or min(2.2, PAGE / columns)
    figure, axes = new_figure(len(rows), columns, size, size)
    for (label, images), line in zip(rows, axes, strict=True):
        for image, axis in zip(images, line, strict=True):
            image_axis(axis, image)
        line[0].set_ylabel(label)
    return figure


def cloud_limits(*clouds: np.ndarray, axes: tuple[int, int] = (0, 2), margin: float = 0.1) -> tuple:
    """Return common limits of both axes of pictures of clouds (n,3), ((low, high), (low, high)), with a
    margin in world units."""
    every = np.concatenate(clouds)[:, list(axes)]
    low, high = every.min(axis=0) - margin, every.max(axis=0) + margin
    return (low[0], high[0]), (low[1], high[1])


def draw_cloud(
    axis: Axes, points: np.ndarray, title: str, axes: tuple[int, int] = (0, 2), limits: tuple | None = None
) -> None:
    """Draw points (n,3) projected on two coordinate axes, coloured by the third (dark: far)."""
    depth = ({0, 1, 2} - set(axes)).pop()
    order = np.argsort(-points[:, depth])
    chosen = points[order]
    dots: dict[str, Any] = {"cmap": "viridis", "s": 2.0, "linewidths": 0, "rasterized": True}
    axis.scatter(chosen[:, axes[0]], chosen[:, axes[1]], c=-chosen[:, depth], **dots)
    axis.set_aspect("equal")
    x, y = ("xyz"[each] for each in axes)
    label_axis(axis, title, f"{x} (world units)", f"{y} (world units)", grid=False)
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    if limits is not None:
        axis.set(xlim=limits[0], ylim=limits[1])


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
    axis.scatter(bars[~above, 0], bars[~above, 1], s=4, color=FAINT, linewidths=0, rasterized=True)
    axis.scatter(bars[above, 0], bars[above, 1], s=20, color=INK, linewidths=0, zorder=3)
    if target is not None and len(target):
        star: dict[str, Any] = {"marker": "*", "s": 110, "facecolor": "none", "edgecolor": AIM}
        axis.scatter(target[:, 0], target[:, 1], zorder=4, linewidths=1.1, **star)
    axis.set(xlim=(-margin, limit), ylim=(-margin, limit), aspect="equal", xlabel=BIRTH, ylabel=DEATH)
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(MaxNLocator(3))
    axis.set_title(title)


def diagram_handles(target: str = "target's significant bar") -> list[Artist]:
    """Return the handles of a legend for figures of `draw_diagram`."""
    dot: Mapping[str, Any] = {"linestyle": "none", "markeredgewidth": 0}
    return [
        Line2D([], [], marker="o", markersize=4.5, color=INK, label="significant bar", **dot),
        Line2D([], [], marker="o", markersize=2.5, color=FAINT, label="bar below the floor", **dot),
        Line2D([], [], marker="*", markersize=10, color=AIM, markerfacecolor="none", ls="none", label=target),
        Line2D([], [], color=INK, linewidth=0.8, linestyle=":", label="floor"),
    ]
