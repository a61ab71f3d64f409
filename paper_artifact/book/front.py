"""The main result: the tails of C0, C1 and C2 on every shape, as one table and one picture."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from paper_artifact.book.sources import Sources
from paper_artifact.catalogue import CONTROLS, colour_of, shape_row
from paper_artifact.export.figures import new_figure, svg
from paper_artifact.files import REPOSITORY, write_text
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text
from paper_artifact.study.verdict import BASELINE, LOSS

ARMS = (BASELINE, LOSS, CONTROLS[0])
STUDIES = ("table1", "table2", "bowls")
PICTURE = REPOSITORY / "results" / "main_result.svg"  # committed; the README's front shows it
WORDS = {BASELINE: "C0 photometric", LOSS: "C1 with the loss", CONTROLS[0]: "C2 control"}
NUMBERS = re.compile(r"<desc>(.*?)</desc>", re.DOTALL)  # where the picture keeps what it shows


def main_runs(sources: Sources) -> Collected:
    """Return the records of C0, C1 and C2 of Tables 1, 2 and S10."""
    return sources.study(*STUDIES).only(*ARMS)


def main_table(sources: Sources) -> pd.DataFrame:
    """Return one row per shape: its group, the judged dimension, the tails of the three arms (mean ± sd),
    C0 / C1, the paper's C0 / C1, Chamfer C1 / C0, and the verdict by the study's rule."""
    collected = main_runs(sources)
    arms = frames.arms(collected).set_index(frames.ARM)
    judged = frames.verdicts(collected)
    paper = frames.paper_arms().set_index(frames.ARM)["ratio"]
    rows = {}
    for shape in frames.shapes(collected):
        row = shape_row(shape)
        texts = {arm: _text(arms.loc[(shape, arm)]) for arm in ARMS}
        ratio, chamfer = arms.loc[(shape, LOSS), ["ratio", "chamfer ratio"]]
        rows[shape] = {
            "group": row.group,
            "judged": f"H{row.judged}",
            **texts,
            "C0 / C1": "" if pd.isna(ratio) else f"{ratio:.2f}",
            "paper's C0 / C1": paper.get((shape, LOSS), ""),
            "Chamfer C1 / C0": "" if pd.isna(chamfer) else f"{chamfer:.2f}",
            "verdict": judged[shape].outcome if shape in judged else NOT_RECORDED,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def _text(arm: pd.Series) -> str:
    return arm_text(arm["mean"], arm["sd"]) if len(arm["tails"]) else NOT_RECORDED


def main_sentence(sources: Sources) -> str:
    """Return what the table comes to, in one sentence."""
    judged = frames.verdicts(main_runs(sources))
    outcomes = pd.Series({shape: each.outcome for shape, each in judged.items()})
    passed = outcomes.index[outcomes == "pass"]
    ratios = sorted(judged[shape].arms[LOSS].ratio for shape in passed)
    others = "; ".join(
        f"{outcome} on {', '.join(names)}"
        for outcome, names in outcomes[outcomes != "pass"].groupby(outcomes).groups.items()
    )
    gain = (
        f", with tails {ratios[0]:.1f} to {ratios[-1]:.1f} times smaller than the baseline's"
        if ratios
        else ""
    )
    return (
        f"The persistence loss beats the photometric baseline and the norm-matched control on "
        f"{len(passed)} of {len(outcomes)} shapes{gain}" + (f" ({others})." if others else ".")
    )


def numbers(sources: Sources) -> dict[str, Any]:
    """Return what the picture shows: per shape its verdict, and per arm the tails of the seeds (6 digits) and
    the paper's mean (None where it prints none)."""
    collected = main_runs(sources)
    arms = frames.arms(collected).set_index(frames.ARM)
    paper = frames.paper_arms().set_index(frames.ARM)["value"]
    judged = frames.verdicts(collected)
    return {
        shape: {
            "verdict": judged[shape].outcome if shape in judged else NOT_RECORDED,
            "arms": {
                arm: {
                    "tails": [float(f"{tail:.6g}") for tail in arms.loc[(shape, arm), "tails"]],
                    "paper": float(paper[shape, arm]) if (shape, arm) in paper.index else None,
                }
                for arm in ARMS
            },
        }
        for shape in frames.shapes(collected)
    }


def picture(shown: dict[str, Any]) -> Figure:
    """Return the picture of `numbers`: a line per shape, a dot per seed, a bar at the mean, an open diamond
    at the paper's mean, and the verdict at the right edge; tails as radius / D, logarithmic."""
    figure, axes = new_figure(1, 1, 5.2, 0.3 * len(shown) + 1.4)
    axis = axes[0][0]
    for place, row in enumerate(shown.values()):
        y = len(shown) - 1 - place
        axis.axhline(y, color="#efefef", linewidth=6, zorder=0, solid_capstyle="butt")
        for arm, shift in zip(ARMS, (0.2, 0.0, -0.2), strict=True):
            _draw_arm(axis, row["arms"][arm], y + shift, colour_of(arm))
        passed = row["verdict"] == "pass"
        axis.text(
            1.015,
            y,
            row["verdict"],
            transform=axis.get_yaxis_transform(),
            va="center",
            fontsize=9,
            color=colour_of(LOSS) if passed else "#555555",
            fontweight="bold" if passed else "normal",
        )
    names = [f"{shape.replace('_', ' ')} H{shape_row(shape).judged}" for shape in shown]
    axis.set_yticks(range(len(shown))[::-1], names, fontsize=9)
    axis.set(xscale="log", ylim=(-0.6, len(shown) - 0.4))
    axis.set_xticks([0.001, 0.003, 0.01, 0.03, 0.1], [".001", ".003", ".01", ".03", ".1"], fontsize=9)
    axis.minorticks_off()
    axis.set_xlabel("tail bottleneck to target (radius / diagonal)", fontsize=9)
    axis.grid(axis="x", alpha=0.3)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.tick_params(axis="y", length=0)
    marks = [Line2D([], [], marker="o", ls="", color=colour_of(arm), ms=5, label=WORDS[arm]) for arm in ARMS]
    open_mark = Line2D([], [], marker="D", ls="", mfc="none", color="#333333", ms=5, label="the paper's mean")
    figure.legend(
        handles=[*marks, open_mark],
        loc="outside upper center",
        ncols=2,
        columnspacing=1.2,
        fontsize=9,
        frameon=False,
    )
    return figure


def _draw_arm(axis: Axes, arm: dict[str, Any], y: float, colour: str) -> None:
    tails = arm["tails"]
    if tails:
        axis.plot(tails, [y] * len(tails), "o", color=colour, markersize=3.2, alpha=0.65, markeredgewidth=0)
        mean = sum(tails) / len(tails)
        axis.plot([mean, mean], [y - 0.16, y + 0.16], color=colour, linewidth=1.8)
    if arm["paper"]:
        axis.plot(
            [arm["paper"]],
            [y],
            "D",
            color=colour,
            markerfacecolor="none",
            markersize=4.5,
            markeredgewidth=0.9,
        )


def picture_svg(sources: Sources) -> str:
    """Return the picture as SVG text that also holds `numbers`, as JSON in its description; the same text for
    the same records."""
    shown = numbers(sources)
    text = json.dumps(shown, separators=(",", ":"), ensure_ascii=True)
    head, tail = svg(picture(shown)).decode("utf-8").split("<metadata>", 1)
    return f"{head}<title>Tails of C0, C1 and C2</title><desc>{html.escape(text)}</desc>\n <metadata>{tail}"


def picture_numbers(svg: str) -> dict[str, Any] | None:
    """Return the numbers that a picture of `picture_svg` holds, None where it holds none."""
    found = NUMBERS.search(svg)
    return json.loads(html.unescape(found[1])) if found else None


def write_picture(sources: Sources, path: Path = PICTURE) -> None:
    """Write the picture to `path`. Raises InputError when that cannot be written."""
    write_text(path, picture_svg(sources))
