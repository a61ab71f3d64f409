"""Notebook 05: Fig. S9, the system as boxes and arrows, each box with the module that is it; inset: the
sparse tug of recruitment (Lemma 1)."""

from __future__ import annotations

from typing import NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Patch

from paper_artifact.evaluate.diagram import diagram_of
from paper_artifact.export.figures import AIM, INK, PAGE, new_figure
from paper_artifact.report.kit.figures import label_axis, legend_below
from paper_artifact.study.repair import RepairProbe, Trajectory
from paper_artifact.topology.matching import match_bars, recruit

GREY, ORANGE, TUG = "#d9d9d9", "#f6c48f", "#b35900"
WIDTH, HEIGHT = 3.0, 1.8  # of a box


class Box(NamedTuple):
    """One box of the schematic."""

    text: str  # what happens
    module: str  # below `paper_artifact`
    x: float  # of its centre
    y: float
    topological: bool = False  # of the branch that the loss adds


BOXES = {
    "scene": Box("views, cameras,\nSfM cloud", "scene/build.py", 0, 2),
    "soup": Box("triangle soup:\nvertices V, α", "soup/state.py", 3.45, 2),
    "render": Box("rasterize with\nstochastic opacity", "raster/visibility.py", 6.9, 2),
    "photo": Box("photometric loss", "raster/photometric.py", 10.35, 2),
    "step": Box("optimiser step", "soup/adam.py", 10.35, 4.6),
    "resample": Box("resample every\n100 steps", "soup/resample.py", 3.45, 4.6),
    "samples": Box("M samples, α × area,\nfrozen weights", "topology/samples.py", 3.45, -0.6, True),
    "alpha": Box("exact alpha\npersistence", "alpha/persistence.py", 6.9, -0.6, True),
    "match": Box("match and recruit\n(every 10 steps)", "topology/matching.py", 10.35, -0.6, True),
    "bundle": Box("target bundle", "topology/bundle.py", 10.35, -3.2, True),
    "pull": Box("circumradii of the\nfrozen pairs", "alpha/circumradius.py", 13.8, -0.6, True),
    "weight": Box("λ(t), calibrated\nby ρ", "topology/schedule.py", 13.8, 2, True),
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
    figure, axes = new_figure(2, 1, PAGE, 2.7, gridspec_kw={"height_ratios": [3.6, 1]})
    _draw_system(axes[0][0])
    _draw_tug(axes[1][0], probe, run)
    handles = [Patch(facecolor=GREY, edgecolor=INK, label="photometric training")]
    handles.append(Patch(facecolor=ORANGE, edgecolor=INK, label="what the loss adds"))
    legend_below(figure, 5, handles)
    return figure


def _draw_system(axis: Axes) -> None:
    for start, end in ARROWS:
        a, b = BOXES[start], BOXES[end]
        colour = TUG if a.topological or b.topological else INK
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
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
        module = box.module.replace("/", "/\n")
        axis.text(box.x, box.y + 0.42, box.text, ha="center", va="center", linespacing=1.0)
        axis.text(box.x, box.y - 0.42, module, ha="center", va="center", style="italic", linespacing=1.0)
    axis.set(xlim=(-1.55, 15.35), ylim=(-4.2, 5.6))
    axis.set_axis_off()


def _border(box: Box, other: Box) -> tuple[float, float]:
    """Return where the line to the other box leaves this one."""
    dx, dy = other.x - box.x, other.y - box.y
    scale = min(half / abs(way) for half, way in ((WIDTH / 2, dx), (HEIGHT / 2, dy)) if way)
    return box.x + scale * dx, box.y + scale * dy


def _draw_tug(axis: Axes, probe: RepairProbe, run: Trajectory) -> None:
    """Draw the start's longest component bars (deaths to the right), the target's, the recruiting pull."""
    bars = diagram_of(run.start, probe.bundle.diagonal)[0]
    bars = bars[bars[:, 1].argsort()[::-1][:40]]
    target, floor = probe.bundle.bars[0], probe.bundle.floor
    matched = match_bars(bars[bars[:, 1] > floor], target).matched
    claimed = recruit(bars, target) if not len(matched) else []
    axis.axvline(floor, color=INK, linestyle=":", label="floor")
    style = {"zorder": 3, "clip_on": False}
    axis.scatter(bars[:, 1], [0] * len(bars), s=12, color=INK, label="live bars", linewidths=0, **style)
    star = {"s": 110, "marker": "*", "facecolor": "none", "edgecolor": AIM}
    axis.scatter(target[:, 1], [0] * len(target), label="target bar", **star, **style)
    for live, aim in claimed:
        tug = {"arrowstyle": "-|>", "color": TUG, "linewidth": 1.4, "connectionstyle": "arc3,rad=-0.25"}
        axis.annotate("", (target[aim, 1], 0), (bars[live, 1], 0), arrowprops=tug)
    axis.set(ylim=(0, 1), yticks=[0], xlim=(0, 1.1 * target[:, 1].max()))
    label_axis(axis, f"{probe.name}: recruitment's tug", "death (radius / D)", "birth", grid=False)
