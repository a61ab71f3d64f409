"""The main result, tails of C0, C1 and C2 on every shape, as one frame and one picture."""

from __future__ import annotations

import html
import json
import re

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from paper_artifact import results
from paper_artifact.catalogue import BASELINE, CONTROLS, LOSS, colour_of
from paper_artifact.files import REPOSITORY
from paper_artifact.plot import new_figure, svg
from paper_artifact.verdict import arms, verdicts

ARMS = {BASELINE: "C0 photometric", LOSS: "C1 with the loss", CONTROLS[0]: "C2 control"}
PICTURE = REPOSITORY / "results" / "main_result.svg"  # committed; the README shows it
PAPER = ("1", "2", "S10")  # tables with the paper's means
NUMBERS = re.compile(r"<desc>(.*?)</desc>", re.DOTALL)  # where the picture keeps the numbers that it shows


def main_runs(tables: results.Results) -> pd.DataFrame:
    """Return the runs of C0, C1 and C2 of Tables 1, 2 and S10, columns of `results.Results.runs`."""
    runs = tables.of("table1", "table2", "bowls")
    return runs[runs["condition"].isin(list(ARMS))]


def main_frame(runs: pd.DataFrame) -> pd.DataFrame:
    """Return one row per shape: judged dimension, mean tail (radius / D) of each arm, C0 / C1, the paper's
    C0 / C1, Chamfer of C1 over C0's, and the verdict."""
    means = arms(runs)["mean"].unstack("condition").reindex(columns=[*ARMS])  # an arm may have no run
    paper = results.published(*PAPER, quantity="tail_bottleneck")
    paper = paper[(paper["condition"] == LOSS) & paper["seed"].isna()].set_index("shape")["ratio"]
    judged = verdicts(runs)
    frame = runs.groupby("shape", observed=True)[["group", "dimension"]].first().join(means)
    frame = frame.join(judged["ratio"].rename("C0 / C1")).join(paper.rename("paper's C0 / C1"))
    return frame.join(judged[["chamfer_ratio", "outcome"]].set_axis(["Chamfer C1 / C0", "verdict"], axis=1))


def picture(runs: pd.DataFrame) -> Figure:
    """Return the picture of `main_runs`: a line per shape, a dot per seed, a bar at the mean, an open diamond
    at the paper's mean, the verdict at the right edge; tails as radius / D, logarithmic."""
    judged, paper = verdicts(runs)["outcome"], _paper_means()
    shapes = list(judged.index)
    figure, axes = new_figure(1, 1, 5.2, 0.3 * len(shapes) + 1.4)
    axis = axes[0, 0]
    for place, shape in enumerate(reversed(shapes)):
        axis.axhline(place, color="#efefef", linewidth=6, zorder=0, solid_capstyle="butt")
        for arm, y in zip(ARMS, (place + 0.2, place, place - 0.2), strict=True):
            tails = runs[(runs["shape"] == shape) & (runs["condition"] == arm)]["tail"]
            mark = {"color": colour_of(arm), "linestyle": "none"}
            axis.plot(tails, [y] * len(tails), "o", markersize=3.2, alpha=0.65, markeredgewidth=0, **mark)
            axis.plot([tails.mean()] * 2, [y - 0.16, y + 0.16], color=colour_of(arm), linewidth=1.8)
            if (value := paper.get((shape, arm))) is not None:
                axis.plot([value], [y], "D", markerfacecolor="none", markersize=4.5, **mark)
        passed = judged[shape] == "pass"
        words = {"color": colour_of(LOSS), "fontweight": "bold"} if passed else {"color": "#555555"}
        right = axis.get_yaxis_transform()
        axis.text(1.015, place, judged[shape], transform=right, va="center", fontsize=9, **words)
    dimensions = runs.groupby("shape", observed=True)["dimension"].first()
    names = [f"{shape.replace('_', ' ')} H{dimensions[shape]}" for shape in reversed(shapes)]
    axis.set_yticks(range(len(shapes)), names, fontsize=9)
    axis.set(xscale="log", ylim=(-0.6, max(len(shapes), 1) - 0.4))
    axis.set_xticks([0.001, 0.003, 0.01, 0.03, 0.1], [".001", ".003", ".01", ".03", ".1"], fontsize=9)
    axis.minorticks_off()
    axis.set_xlabel("tail bottleneck to target (radius / diagonal)", fontsize=9)
    axis.grid(axis="x", alpha=0.3)
    axis.spines["left"].set_visible(False)
    axis.tick_params(axis="y", length=0)
    marks = [
        Line2D([], [], marker="o", ls="", color=colour_of(arm), label=name) for arm, name in ARMS.items()
    ]
    marks.append(Line2D([], [], marker="D", ls="", mfc="none", color="#333333", label="the paper's mean"))
    figure.legend(handles=marks, loc="outside upper center", ncols=2, fontsize=9, frameon=False)
    return figure


def _paper_means() -> dict:
    paper = results.published(*PAPER, quantity="tail_bottleneck")
    return paper[paper["seed"].isna()].set_index(["shape", "condition"])["value"].to_dict()


def numbers(runs: pd.DataFrame) -> dict[str, dict[str, list[float]]]:
    """Return what the picture shows: shape → arm → tails of the seeds, six digits."""
    rounded = runs.assign(tail=runs["tail"].map(lambda tail: float(f"{tail:.6g}")))
    shown: dict[str, dict[str, list[float]]] = {}
    for (shape, arm), tails in rounded.groupby(["shape", "condition"], observed=True)["tail"]:
        shown.setdefault(str(shape), {})[str(arm)] = tails.tolist()
    return shown


def picture_svg(runs: pd.DataFrame) -> str:
    """Return the picture as SVG text that also holds `numbers` as JSON in its description; the same text for
    the same records."""
    text = html.escape(json.dumps(numbers(runs), separators=(",", ":")))
    head, tail = svg(picture(runs)).decode("utf-8").split("<metadata>", 1)
    return f"{head}<title>Tails of C0, C1 and C2</title><desc>{text}</desc>\n <metadata>{tail}"


def picture_numbers() -> dict | None:
    """Return the numbers that the README's picture holds, None where it holds none."""
    found = NUMBERS.search(PICTURE.read_text(encoding="utf-8"))
    return json.loads(html.unescape(found[1])) if found else None
