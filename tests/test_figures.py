"""The style of the figures, on those that the committed records and stored tables give: letters, labels,
legends, colours."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from skimage.color import deltaE_ciede2000, rgb2lab

from paper_artifact.catalogue import CONDITIONS, colour_of, marker_of
from paper_artifact.export.figures import PAGE, TEXT, new_figure
from paper_artifact.report import baseline, cost, diagrams, matrix, plans, probes, speed, staircase, windows
from paper_artifact.report import measured as measured_tables
from paper_artifact.report.kit import records, tables
from paper_artifact.report.kit.figures import DIMENSIONS, SERIES
from paper_artifact.study.blindness import make_probe, read

# Machado, Oliveira, Fernandes 2009, severity 1, on linear RGB.
VISION = {
    "usual": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
APART = 12.0  # CIEDE2000; 2 is just noticeable side by side
ARMS = [each.name for each in CONDITIONS]
STUDIES = {  # arms that stand in one figure
    "table1": [name for name in ARMS if name.startswith("C")],
    "allocation": ["C0", *(name for name in ARMS if name.startswith("B"))],
    "words": ["C0", "C1", "C2", *(name for name in ARMS if name.startswith("T"))],
}


def seen(colours, vision):
    """Return CIELAB of colours as that kind of vision has them."""
    rgb = np.array([to_rgb(each) for each in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ np.transpose(VISION[vision]), 0, 1)
    return rgb2lab(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("study", STUDIES)
def test_conditions_of_one_figure_differ_in_every_kind_of_colour_vision(study, vision):
    arms = STUDIES[study]
    lab = seen([colour_of(arm) for arm in arms], vision)
    for a, b in combinations(range(len(arms)), 2):
        assert deltaE_ciede2000(lab[a], lab[b]) > APART, (arms[a], arms[b])
    assert len({marker_of(arm) for arm in arms}) == len(arms), "a second way to tell them apart"
    assert lab[:, 0].max() < 82, "seen on white paper"


@pytest.mark.parametrize("vision", ("usual", "protanopia", "deuteranopia"))
def test_dimensions_and_series_differ_too(vision):
    for colours in ([colour for colour, _ in DIMENSIONS.values()], SERIES[:4]):
        lab = seen(colours, vision)
        for a, b in combinations(range(len(colours)), 2):
            assert deltaE_ciede2000(lab[a], lab[b]) > APART, (colours[a], colours[b])


@pytest.fixture(scope="module")
def studies():
    return {name: records.collect_study(name) for name in ("baseline", "table1", "table2")}


FOLLOW = {"torus": ("loop 1", "loop 2"), "double_torus": ("loop 1", "loop 3"), "sphere": ("void 1",)}
FIGURES = {
    "baseline": lambda found: baseline.trajectory_figure(found["baseline"]),
    "trajectories": lambda found: tables.trajectory_figure(found["table1"], ("sphere", "torus")),
    "counts": lambda found: tables.trajectory_figure(found["table1"], ("torus", "sphere"), "count"),
    "generality": lambda found: tables.trajectory_figure(found["table2"], columns=3),
    "seeds": lambda found: matrix.seed_figure(found["table1"], ("sphere", "torus")),
    "plans": lambda found: plans.plan_figure(found["table2"], (("eight", "C1"), ("pot", "C1"))),
    "floors": lambda found: staircase.floor_figure(measured_tables.read("staircase"), FOLLOW),
    "windows": lambda found: windows.window_figure(measured_tables.read("windows")),
    "cost": lambda found: cost.cost_figure(measured_tables.read("cost")),
    "speed": lambda found: speed.speed_figure(measured_tables.find("speed")),
    "diagrams": lambda found: diagrams.diagram_figure(measured_tables.read("diagrams")),
}


@pytest.fixture(scope="module", params=FIGURES)
def drawn(request, studies):
    figure = FIGURES[request.param](studies)
    FigureCanvasAgg(figure).draw()
    return figure


def texts(figure):
    return [each for each in figure.findobj(Text) if each.get_visible() and each.get_text().strip()]


def shown_axes(figure):
    return [axis for axis in figure.axes if axis.axison]


def small_letters(figure):
    """Return texts below TEXT points; formulas count, because raised and lowered letters are smaller."""
    return [each.get_text() for each in texts(figure) if each.get_fontsize() < TEXT or "$" in each.get_text()]


def unlabelled(figure):
    """Return the axes without labels of their own, of the one below in their column, of the first in their
    row; names instead of numbers at a vertical axis need no label."""
    shown, bare = shown_axes(figure), []
    places = {axis: axis.get_subplotspec() for axis in shown}
    for axis in shown:
        row, column = places[axis].rowspan.start, places[axis].colspan.start
        below = [
            each
            for each in shown
            if places[each].colspan.start == column and places[each].rowspan.start >= row
        ]
        first = next(each for each in shown if places[each].rowspan.start == row)
        ticks = [text.get_text() for text in first.get_yticklabels()]
        named = ticks and not ticks[0].replace(".", "").isdigit()
        if not any(each.get_xlabel() for each in below) or not (
            axis.get_ylabel() or first.get_ylabel() or named
        ):
            bare.append(axis.get_title())
    return bare


def legends_over_data(figure):
    frames = [axis.get_window_extent() for axis in shown_axes(figure)]
    legends = [*figure.legends, *(axis.get_legend() for axis in figure.axes if axis.get_legend())]
    boxes = [legend.get_window_extent() for legend in legends]
    return [box for box in boxes if any(box.overlaps(frame) for frame in frames)]


def covered_letters(figure):
    """Return texts that run out of the figure, and pairs of texts that lie on one another."""
    ticks = {}
    for axis in shown_axes(figure):  # ticks outside of the view are texts, but not drawn
        for side in (axis.xaxis, axis.yaxis):
            low, high = sorted(side.get_view_interval())
            for tick in side.get_major_ticks():
                ticks[tick.label1] = low <= tick.get_loc() <= high
    boxes = [(each, each.get_window_extent()) for each in texts(figure) if ticks.get(each, True)]
    page, found = figure.bbox, []
    for each, box in boxes:
        if min(box.x0 - page.x0, page.x1 - box.x1, box.y0 - page.y0, page.y1 - box.y1) < -3:  # pixels
            found.append(each.get_text())
    for (one, a), (other, b) in combinations(boxes, 2):
        turned = one.get_rotation() % 90 or other.get_rotation() % 90  # their boxes hold corners without ink
        if min(a.x1, b.x1) - max(a.x0, b.x0) > 2 < min(a.y1, b.y1) - max(a.y0, b.y0) and not turned:
            found.append((one.get_text(), other.get_text()))
    return found


def test_letters_can_be_read_in_print(drawn):
    assert drawn.get_size_inches()[0] <= PAGE + 1e-9 and small_letters(drawn) == []


def test_axes_say_what_they_show(drawn):
    assert unlabelled(drawn) == []


def test_legends_and_letters_cover_nothing(drawn):
    assert legends_over_data(drawn) == [] and covered_letters(drawn) == []


def test_the_checks_find_what_is_wrong():
    figure, axes = new_figure(1, 2, 1.5, 1.5)
    axes[0][0].plot([1, 2], [1, 2], label="a line whose name is long")
    axes[0][0].legend()
    axes[0][1].set_title("too long a title for so narrow an axes")
    axes[0][1].set_xlabel("small", fontsize=6)
    axes[0][0].set_title("a title that meets it")
    FigureCanvasAgg(figure).draw()
    assert small_letters(figure) == ["small"] and len(unlabelled(figure)) == 2
    assert legends_over_data(figure) and len(covered_letters(figure)) >= 2


def test_lines_on_one_another_all_show(studies):
    """On the sphere C6 has C1's bits: the line drawn above is thinner, and its markers are its own."""
    figure = FIGURES["trajectories"](studies)
    for axis in figure.axes:
        widths = [line.get_linewidth() for line in axis.lines]
        assert all(np.diff(widths) < 0) and len({line.get_marker() for line in axis.lines}) == len(widths)
        assert axis.get_ylim()[0] == 0, "zero is shown as zero"
    lines = {line.get_label(): line for line in figure.axes[2].lines}
    assert (lines["C1"].get_ydata() == lines["C6"].get_ydata()).all()
    assert lines["C1"].get_markevery() != lines["C6"].get_markevery()
    assert {text.get_text() for text in figure.legends[0].get_texts()} >= {"C0", "C6", "λ ramps up"}
    for axis in figure.axes:
        colours = {line.get_label(): line.get_color() for line in axis.lines}
        assert all(colour == colour_of(arm) for arm, colour in colours.items())


def test_counts_have_the_true_one_dashed_and_the_plans_their_targets(studies):
    for name in ("counts", "plans"):
        figure = FIGURES[name](studies)
        for axis in figure.axes:
            dashed = [line for line in axis.lines if line.get_linestyle() == "--"]
            assert len(dashed) == 1 and len(set(dashed[0].get_ydata())) == 1
    counts = FIGURES["counts"](studies).axes[0]
    heights = [line.get_ydata()[0] for line in counts.lines if line.get_linestyle() == "-"]
    assert len(set(heights)) == len(heights), "arms at one count lie beside one another"


def test_right_and_wrong_are_drawn_on_the_same_axes():
    probe = make_probe("puncture", 0, 1500)
    line = probes.picture({("puncture", 0): (probe, *read(probe))}, 0).axes
    for a, b in ((line[0], line[1]), (line[2], line[3])):
        assert a.get_xlim() == b.get_xlim() and a.get_ylim() == b.get_ylim()


def test_the_style_holds_in_axes_made_later():
    axis = new_figure(1, 1, 2, 2)[1][0][0]
    axis.set(title="title", xlabel="x", xscale="log")
    sizes = {each.get_fontsize() for each in axis.findobj(Text)}
    assert sizes == {TEXT}
