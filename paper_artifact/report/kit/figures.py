"""Figures shared by the reports, in one style: every figure is drawn in the size of its print (at most PAGE
inches wide, letters of TEXT points or more), legends stand outside of the axes, a condition has its colour
and marker everywhere. Each function returns a closed matplotlib Figure: shown once, wherever it is displayed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from paper_artifact.catalogue import colour_of, in_order, marker_of, tag_of
from paper_artifact.files import FIGURES_VARIABLE, write_bytes
from paper_artifact.plot import AIM, FAINT, INK, PAGE, new_figure, svg

BROKEN = ("--", ":", "-.")  # lines of a condition's changed settings, in turn
SERIES = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#d55e00",
)  # what is no condition (Okabe, Ito)
MARKS = ("o", "s", "^", "D", "v", "P")  # beside SERIES
DIMENSIONS = {
    0: ("#009e73", "^"),
    1: ("#0072b2", "o"),
    2: ("#d55e00", "s"),
}  # colour and marker of H0, H1, H2
WINDOW = "#f3ead2"  # of a stretch that is marked on an axis
THICK, THIN = 2.8, 1.1  # points: of an axes' first line and its last, so that lines on one another all show


def show(key: str, figure: Figure) -> None:
    """Display a notebook's figure; where `run-all` executes the notebook, also write it to
    results/book/figures/<notebook>_<key>.svg."""
    from IPython.display import display

    if start := os.environ.get(FIGURES_VARIABLE):
        write_bytes(Path(f"{start}_{key}.svg"), svg(figure))
    display(figure)


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


def image_axis(axis: Axes, image: np.ndarray, title: str = "") -> None:
    """Show one image (H,W,3), float in [0,1], without ticks and frame."""
    axis.imshow(np.clip(image, 0, 1), interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    axis.set_title(title)
    for side in axis.spines.values():
        side.set_visible(False)


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


def legend_below(figure: Figure, columns: int = 4, extra: Iterable[Artist] = (), title: str = "") -> None:
    """Write one legend for all axes of the figure below them, each label once, then the `extra` handles."""
    found: dict[str, Artist] = {}
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            found.setdefault(str(label), handle)
    for handle in extra:
        found.setdefault(str(handle.get_label()), handle)
    if found:
        place = {"loc": "outside lower center", "ncols": min(columns, len(found))}
        figure.legend(list(found.values()), list(found), title=title or None, **place)


def mark_window(axis: Axes, window: tuple[float, float]) -> Patch:
    """Mark a stretch of the horizontal axis behind the data. Returns its handle for a legend, unlabelled."""
    axis.axvspan(*window, color=WINDOW, linewidth=0, zorder=0)
    return Patch(facecolor=WINDOW, edgecolor="none")


def mark_value(axis: Axes, value: float, upright: bool = False) -> Line2D:
    """Draw a dashed line at a true or given value of the vertical axis (upright: of the horizontal one).
    Returns it, as a handle for a legend, unlabelled."""
    draw = axis.axvline if upright else axis.axhline
    return draw(value, color=INK, linestyle="--", linewidth=0.9, zorder=2.5)


def plain_log(axis: Axes, which: str = "y") -> None:
    """Make an axis logarithmic with ticks whose text has no small raised exponents: .01 as 0.01, 1e-7."""
    axis.set(**{f"{which}scale": "log"})
    side = axis.yaxis if which == "y" else axis.xaxis
    side.set_major_formatter(FuncFormatter(lambda value, _: log_text(value)))
    axis.minorticks_off()


def log_text(value: float) -> str:
    """Return a number as a tick shows it: plain from .001 to 10,000, else 1e-7."""
    return f"{value:g}" if 1e-3 <= value < 1e5 else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")


def arm_styles(arms: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return how each arm's line is drawn, in the catalogue's order: colour and marker of its condition,
    broken where a setting is changed; the first is the thickest, so that lines on one another all show, and
    markers stand at different dumps."""
    arms, broken = in_order(list(arms)), cycle(BROKEN)
    widths = np.linspace(THICK, THIN, len(arms)) if len(arms) > 1 else (THIN,)
    every = min(len(arms), 4)
    return {
        arm: {
            "color": colour_of(arm),
            "marker": marker_of(arm),
            "linestyle": "-" if tag_of(arm) == arm else next(broken),
            "gapcolor": None if tag_of(arm) == arm else "white",  # seen on the condition's own line, too
            "linewidth": width,
            "markevery": (place % every, every),
        }
        for place, (arm, width) in enumerate(zip(arms, widths, strict=True))
    }


def draw_bands(axis: Axes, table: pd.DataFrame, value: str, offset: float = 0.0) -> None:
    """Draw one band per arm of `table` in the catalogue's order and styles; columns as for `draw_band`, and
    "condition". offset: each arm is drawn that much higher than the one before, on both sides of zero, and
    equally thin: for counts, which would lie on one another."""
    styles = arm_styles(table["condition"].unique())
    for place, (arm, style) in enumerate(styles.items()):
        own = table[table["condition"] == arm]
        if offset:
            style["linewidth"] = THIN
        lift = offset * (place - len(styles) // 2 + 0.5)  # none at zero, where the true count is dashed
        draw_band(axis, own.assign(**{value: own[value] + lift}), value, arm, **style)


def draw_band(axis: Axes, table: pd.DataFrame, value: str, label: str, color: str, **style: Any) -> None:
    """Draw the seeds' mean of `value` over "step" as a line and their range as a band; `table` has "seed",
    "step" and `value`."""
    group = table.groupby("step")[value]
    mean = group.mean()
    style = {"markersize": 4.5, "markeredgecolor": "white", "markeredgewidth": 0.5} | style
    axis.plot(mean.index, mean, color=color, label=label, **style)
    axis.fill_between(mean.index, group.min(), group.max(), color=color, alpha=0.13, linewidth=0)


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
    axis.scatter(
        chosen[:, axes[0]],
        chosen[:, axes[1]],
        c=-chosen[:, depth],
        cmap="viridis",
        s=2.0,
        linewidths=0,
        rasterized=True,
    )
    axis.set_aspect("equal")
    x, y = ("xyz"[each] for each in axes)
    label_axis(axis, title, f"{x} (world units)", f"{y} (world units)", grid=False)
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    if limits is not None:
        axis.set(xlim=limits[0], ylim=limits[1])


def diagram_handles(target: str = "target's significant bar") -> list[Artist]:
    """Return the handles of a legend for figures of `plot.draw_diagram`."""
    dot: Mapping[str, Any] = {"linestyle": "none", "markeredgewidth": 0}
    return [
        Line2D([], [], marker="o", markersize=4.5, color=INK, label="significant bar", **dot),
        Line2D([], [], marker="o", markersize=2.5, color=FAINT, label="bar below the floor", **dot),
        Line2D(
            [],
            [],
            marker="*",
            markersize=10,
            color=AIM,
            markerfacecolor="none",
            linestyle="none",
            label=target,
        ),
        Line2D([], [], color=INK, linewidth=0.8, linestyle=":", label="floor"),
    ]
