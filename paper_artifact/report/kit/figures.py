"""Figures shared by the reports. Each function returns a closed matplotlib Figure: shown once, wherever it
is displayed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_artifact.catalogue import colour_of, in_order, tag_of
from paper_artifact.export.figures import new_figure, svg
from paper_artifact.files import FIGURES_VARIABLE, write_bytes

BROKEN = ("--", ":", "-.")  # lines of a condition's changed settings, in turn


def show(key: str, figure: Figure) -> None:
    """Display a notebook's figure; where `run-all` executes the notebook, also write it to
    results/book/figures/<notebook>_<key>.svg."""
    from IPython.display import display

    if start := os.environ.get(FIGURES_VARIABLE):
        write_bytes(Path(f"{start}_{key}.svg"), svg(figure))
    display(figure)


def image_rows(rows: Sequence[tuple[str, Sequence[np.ndarray]]], size: float = 1.5) -> Figure:
    """Return a figure with one labelled row per entry: images (H,W,3) float in [0,1], all rows of equal
    length."""
    figure, axes = new_figure(len(rows), len(rows[0][1]), size, size)
    for (label, images), line in zip(rows, axes, strict=True):
        for image, axis in zip(images, line, strict=True):
            image_axis(axis, image)
        line[0].set_ylabel(label, fontsize=8)
    return figure


def image_axis(axis: Axes, image: np.ndarray, title: str = "") -> None:
    """Show one image (H,W,3), float in [0,1], without ticks and frame."""
    axis.imshow(np.clip(image, 0, 1), interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    axis.set_title(title, fontsize=8)
    for side in axis.spines.values():
        side.set_visible(False)


def label_axis(axis: Axes, title: str, x: str = "", grid: bool = False) -> None:
    """Write an axes' title and what its horizontal axis shows, with the small ticks of every figure, over
    a light grid or none."""
    axis.set_title(title, fontsize=9)
    axis.set_xlabel(x)
    axis.tick_params(labelsize=7)
    if grid:
        axis.grid(alpha=0.25)


def draw_bands(axis: Axes, table: pd.DataFrame, value: str) -> None:
    """Draw one band per arm of `table` in the catalogue's order and colours, a condition's changed settings
    with broken lines; columns as for `draw_band`, and "condition"."""
    broken = cycle(BROKEN)
    for arm in in_order(table["condition"].unique()):
        line = "-" if tag_of(arm) == arm else next(broken)
        draw_band(axis, table[table["condition"] == arm], value, arm, colour_of(arm), line)


def draw_band(axis: Axes, table: pd.DataFrame, value: str, label: str, colour: str, line: str = "-") -> None:
    """Draw the seeds' mean of `value` over "step" as a line and their range as a band; `table` has "seed",
    "step" and `value`."""
    group = table.groupby("step")[value]
    mean = group.mean()
    axis.plot(mean.index, mean, color=colour, label=label, linewidth=1.4, linestyle=line)
    axis.fill_between(mean.index, group.min(), group.max(), color=colour, alpha=0.18, linewidth=0)


def draw_cloud(
    axis: Axes, points: np.ndarray, title: str, axes: tuple[int, int] = (0, 2), limits: tuple | None = None
) -> None:
    """Draw points (n,3) projected on two coordinate axes, coloured by the third (dark: far)."""
    depth = ({0, 1, 2} - set(axes)).pop()
    order = np.argsort(-points[:, depth])
    chosen = points[order]
    axis.scatter(
        chosen[:, axes[0]], chosen[:, axes[1]], c=-chosen[:, depth], cmap="viridis", s=2.5, linewidths=0
    )
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=8)
    axis.tick_params(labelsize=6)
    if limits is not None:
        axis.set(xlim=limits[0], ylim=limits[1])
