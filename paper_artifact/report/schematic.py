"""Notebook 05: Fig. S9, the system as boxes and arrows, each box with the module that is it; inset: the
sparse tug of recruitment (Lemma 1)."""

from __future__ import annotations

from typing import NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from paper_artifact.evaluate.diagram import diagram_of
from paper_artifact.export.figures import new_figure
from paper_artifact.study.repair import RepairProbe, Trajectory
from paper_artifact.topology.matching import match_bars, recruit

GREY, ORANGE, INK = "#d9d9d9", "#f6c48f", "#333333"
WIDTH, HEIGHT = 2.6, 1.25  # of a box


class Box(NamedTuple):
    """One box of the schematic."""

    text: str  # what happens
    module: str  # below `paper_artifact`
    x: float  # of its centre
    y: float
    topological: bool = False  # of the branch that the loss adds


BOXES = {
    "scene": Box("views, cameras,\nSfM cloud", "scene/build.py", 0, 2),
    "soup": Box("triangle soup:\nvertices V, α", "soup/state.py", 3.3, 2),
    "render": Box("rasterize with\nstochastic opacity", "raster/visibility.py", 6.6, 2),
    "photo": Box("photometric loss", "raster/photometric.py", 9.9, 2),
    "step": Box("optimiser step", "soup/adam.py", 9.9, 3.8),
    "resample": Box("resample every\n100 steps", "soup/resample.py", 3.3, 3.8),
    "samples": Box("M samples, α × area,\nfrozen weights", "topology/samples.py", 3.3, 0.1, True),
    "alpha": Box("exact alpha\npersistence", "alpha/persistence.py", 6.6, 0.1, True),
    "match": Box("match and recruit\n(every 10 steps)", "topology/matching.py", 9.9, 0.1, True),
    "bundle": Box("target bundle", "topology/bundle.py", 9.9, -1.8, True),
    "pull": Box("circumradii of the\nfrozen pairs", "alpha/circumradius.py", 13.2, 0.1, True),
    "weight": Box("λ(t), calibrated\nby ρ", "topology/schedule.py", 13.2, 2, True),
}
ARROWS = (
    ("scene", "soup"),
    ("soup", "render"),
    ("render", "photo"),
    ("photo", "step"),
    ("step", "resample"),
    ("resample", "soup"),
    ("soup", "samples"),
    ("samples", "alpha"),
    ("alpha", "match"),
    ("bundle", "match"),
    ("match", "pull"),
    ("pull", "weight"),
    ("weight", "step"),
)


def module_table() -> pd.DataFrame:
    """Return the figure's boxes: what each does, its module, and what it hands on to."""
    rows = {
        name: {
            "does": " ".join(box.text.split()),
            "module": f"paper_artifact/{box.module}",
            "branch": "topological" if box.topological else "photometric",
            "hands on to": ", ".join(end for start, end in ARROWS if start == name),
        }
        for name, box in BOXES.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("box")


def schematic_figure(probe: RepairProbe, run: Trajectory) -> Figure:
    """Return Fig. S9; the inset's diagram is the start of that probe of H0 (T4: one target, no significant
    live bar), the tug what recruitment claims there."""
    figure, axes = new_figure(1, 2, 6.2, 4.4, gridspec_kw={"width_ratios": [4.2, 1]})
    _draw_system(axes[0][0])
    _draw_tug(axes[0][1], probe, run)
    return figure


def _draw_system(axis: Axes) -> None:
    for start, end in ARROWS:
        a, b = BOXES[start], BOXES[end]
        colour = "#c96a10" if a.topological or b.topological else INK
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
        axis.annotate("", _border(b, a), _border(a, b), arrowprops=arrow)
    for box in BOXES.values():
        corner, face = (box.x - WIDTH / 2, box.y - HEIGHT / 2), ORANGE if box.topological else GREY
        axis.add_patch(
            FancyBboxPatch(
                corner,
                WIDTH,
                HEIGHT,
                boxstyle="round,pad=0,rounding_size=0.12",
                facecolor=face,
                edgecolor=INK,
            )
        )
        axis.text(box.x, box.y + 0.16, box.text, ha="center", va="center", fontsize=8, linespacing=1.05)
        axis.text(box.x, box.y - 0.42, box.module, ha="center", va="center", fontsize=7, style="italic")
    axis.set(xlim=(-1.5, 14.7), ylim=(-2.7, 4.5))
    axis.set_axis_off()


def _border(box: Box, other: Box) -> tuple[float, float]:
    """Return where the line to the other box leaves this one."""
    dx, dy = other.x - box.x, other.y - box.y
    scale = min(half / abs(way) for half, way in ((WIDTH / 2, dx), (HEIGHT / 2, dy)) if way)
    return box.x + scale * dx, box.y + scale * dy


def _draw_tug(axis: Axes, probe: RepairProbe, run: Trajectory) -> None:
    """Draw the start's longest component bars (deaths on a ray), the target's, and the recruiting pull."""
    bars = diagram_of(run.start, probe.bundle.diagonal)[0]
    bars = bars[bars[:, 1].argsort()[::-1][:40]]
    target, floor = probe.bundle.bars[0], probe.bundle.floor
    matched = match_bars(bars[bars[:, 1] > floor], target).matched
    claimed = recruit(bars, target) if not len(matched) else []
    axis.axhline(floor, color=INK, linestyle=":", linewidth=0.8)
    axis.scatter([0] * len(bars), bars[:, 1], s=12, color="#1f5fbf", label="live bars")
    axis.scatter([0] * len(target), target[:, 1], s=110, marker="*", color="#c0392b", label="target bar")
    for live, aim in claimed:
        tug = {"arrowstyle": "-|>", "color": "#c96a10", "linewidth": 1.4, "connectionstyle": "arc3,rad=-0.5"}
        axis.annotate("", (0, target[aim, 1]), (0, bars[live, 1]), arrowprops=tug)
    axis.text(0.02, floor, " floor", fontsize=7, va="bottom")
    axis.set(xlim=(-0.1, 0.1), xticks=[0])
    axis.set_xlabel("birth", fontsize=8)
    axis.set_ylabel("death (radius / D)", fontsize=8)
    axis.set_title(f"{probe.name}: recruitment's tug", fontsize=9)
    axis.tick_params(labelsize=7)
    axis.legend(fontsize=7, loc="center right")
