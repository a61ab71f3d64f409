"""Tables and figures of any study's arms, ours beside the paper's: the matrix, verdicts, per-seed tails,
trajectories.

Rows and columns are the shapes and conditions of the records, in the catalogue's order.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from paper_artifact.catalogue import in_order
from paper_artifact.plot import PAGE, new_figure
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import (
    draw_bands,
    label_axis,
    label_outer,
    legend_below,
    mark_value,
    mark_window,
)
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text, blank, counts_text, seeds_text, tails_text
from paper_artifact.study.verdict import BASELINE, CONTROLS, LOSS

WORDS = {"bottleneck": "bottleneck (radius / D)", "count": "significant bars (arms offset)"}
TOGETHER, VARIANTS = 6, 4  # arms in one axes; of more, variants of the loss that stand beside it in one
LIFT = 0.06  # of a count's line above the arm before: all at the true count would lie on one another


def beside(ours: pd.Series, paper: pd.Series, across: str = "shape") -> pd.DataFrame:
    """Return ours beside the paper's: two columns, "ours" and "paper", per shape (conditions down) or per
    condition (shapes down).

    ours, paper: texts by (shape, condition); of the paper's, those of our shapes are taken. Empty where there
    is none.
    """
    joined = pd.concat({"ours": ours, "paper": paper}, axis=1)
    joined = joined[joined.index.isin(ours.index.unique("shape"), level="shape")]
    shapes = frames.shapes_in_order(joined.index.unique("shape"))
    conditions = in_order(list(joined.index.unique("condition")))
    down, over = (conditions, shapes) if across == "shape" else (shapes, conditions)
    columns = pd.MultiIndex.from_product([over, ("ours", "paper")])
    return blank(joined.unstack(across).swaplevel(axis=1).reindex(index=down, columns=columns))


def paper_texts(*tables: str) -> pd.Series:
    """Return the arms that the paper prints in these tables (default: all), "mean±sd (ratio×)" by (shape,
    condition)."""
    paper = frames.paper_arms("tail_bottleneck", *tables).set_index(frames.ARM)
    return paper.apply(lambda row: arm_text(row["value"], row["sd"], row["ratio"]), axis=1)


def matrix_table(collected: Collected) -> pd.DataFrame:
    """Return a row per condition, two columns per shape: ours (mean ± sd, C0 / this, seeds) beside the
    paper's; "not recorded" where an arm has no run yet, how many seeds of how many where some are missing."""
    return beside(frames.arms(collected).set_index(frames.ARM).apply(_cell, axis=1), paper_texts())


def _cell(arm: pd.Series) -> str:
    if not arm["seeds"]:
        return NOT_RECORDED
    found, wanted = len(arm["seeds"]), arm["wanted"]
    seeds = f"{found} seeds" if found == wanted else f"{found} of {wanted} seeds"
    return f"{arm_text(arm['mean'], arm['sd'], arm['ratio'])}, {seeds}"


def verdict_table(collected: Collected) -> pd.DataFrame:
    """Return per recorded shape the verdict of ours and, where the paper prints per-seed tails, of the
    paper's by the same rule; Chamfer of C1 / C0 (parity: at most 1.15), Welch's sigma C0 − C1 (five seeds
    each), per arm the seeds that end with more significant bars than expected (phantoms) or fewer (lost),
    and the reason."""
    theirs, rows = frames.paper_verdicts(), {}
    for shape, judged in frames.verdicts(collected).items():
        parity, sigma = judged.parity_ratio, judged.welch.get(BASELINE)
        rows[shape] = {
            "verdict": judged.outcome,
            "paper's tails give": theirs[shape].outcome if shape in theirs else "",
            f"Chamfer {LOSS} / {BASELINE}": "" if parity is None else f"{parity:.2f}",
            f"Welch {BASELINE} − {LOSS}": "" if sigma is None else f"{sigma:.1f}",
            "phantoms (seeds)": _wrong_seeds(judged.phantoms),
            "lost (seeds)": _wrong_seeds(judged.missing),
            "reason": judged.reason,
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def _wrong_seeds(seeds: dict[str, tuple[int, ...]]) -> str:
    """Return the arms that have any, "C0 (0, 2), C2 (1)", "none", or "unknown" without an expected count."""
    if not seeds:
        return seeds_text(None)
    wrong = [f"{name} ({seeds_text(seeds[name])})" for name in in_order(list(seeds)) if seeds[name]]
    return ", ".join(wrong) or "none"


def seed_table(collected: Collected, *tables: str) -> pd.DataFrame:
    """Return per shape and condition the tails seed by seed, ours beside the paper's (of these tables;
    default: all), our counts, and Chamfer relative to C0's, ours beside the paper's."""
    arms, paper = frames.arms(collected).set_index(frames.ARM), frames.paper("tail_bottleneck", *tables)
    paper = paper[paper["seed"].notna()].sort_values("seed", kind="stable")
    table = pd.DataFrame(
        {
            "seeds": arms["seeds"].map(lambda seeds: "/".join(map(str, seeds))),
            "our tails": arms["tails"].map(lambda tails: tails_text(tails) or NOT_RECORDED),
            "paper's tails": paper.groupby(frames.ARM)["value"].agg(tails_text),
            "counts": arms["counts"].map(counts_text),
            "Chamfer / C0": arms["chamfer ratio"].dropna().map("{:.2f}".format),
            "paper's": frames.paper_arms("chamfer_ratio_to_C0", "chamfer").set_index(frames.ARM)["printed"],
        }
    )
    return blank(table.reindex(arms.index))


def arm_groups(arms: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Return the arms (in the catalogue's order) as (words, arms of one axes): all in one, or, of more than
    TOGETHER, baseline, loss and controls first and then the loss beside VARIANTS of the others at a time."""
    main = [arm for arm in arms if arm in (BASELINE, LOSS, *CONTROLS)]
    others = [arm for arm in arms if arm not in main]
    if len(arms) <= TOGETHER or LOSS not in main:
        return [("", list(arms))]
    parts = np.array_split(others, -(-len(others) // VARIANTS))
    return [("baseline, loss, controls", main)] + [
        ("variants of the loss", in_order([LOSS, *part.tolist()])) for part in parts
    ]


def ramp_window(collected: Collected) -> tuple[float, float] | None:
    """Return the steps between which λ rises in the first record that has a ramp, None where none has."""
    for record in collected.records:
        config = record["config"]
        if ramp := (config["loss"] or {}).get("ramp"):
            return ramp[0] * config["steps"], ramp[1] * config["steps"]
    return None


def trajectory_figure(
    collected: Collected, shapes: Iterable[str] = (), value: str = "bottleneck", columns: int = 2
) -> Figure:
    """Return one axes per shape (default: all), `columns` in a row: a line (mean) and band (range of seeds)
    per condition; the first arm's line is the thickest, so that lines on one another all show. Of many arms
    a shape has several axes below one another (`arm_groups`). The ramp of λ is marked.

    value: a column of `frames.dumps`; of "count", dashed, the expected one, and each arm lies LIFT above the
    one before. Counts begin at the first dump: at the start, small scattered triangles, the floor is so low
    that hundreds of bars count, as the table says.
    """
    shapes = list(shapes) or frames.shapes(collected)
    table, runs = frames.dumps(collected), frames.runs(collected)
    groups, window = arm_groups(in_order(table["condition"].unique())), ramp_window(collected)
    columns, blocks = min(columns, len(shapes)), -(-len(shapes) // columns)
    height = 2.1 if columns < 3 else 1.75
    figure, axes = new_figure(blocks * len(groups), columns, PAGE / max(columns, 2), height)
    ramp, true, many = None, None, len(groups) > 1
    for block in range(blocks):
        for place, (words, arms) in enumerate(groups):
            line = axes[block * len(groups) + place]
            for number, axis in enumerate(line, block * columns):
                if number >= len(shapes):
                    axis.set_axis_off()
                    continue
                own = runs[runs["shape"] == shapes[number]]
                if not len(own):
                    axis.set_axis_off()
                    axis.set_title(f"{shapes[number]}: no run recorded")
                    continue
                dimension = f"{shapes[number]}, H{own['dimension'].iloc[0]}"
                label_axis(axis, f"{dimension}: {words}" if many else dimension)
                shown = table[(table["shape"] == shapes[number]) & table["condition"].isin(arms)]
                if value == "count":
                    shown = shown[shown["step"] > 0]
                draw_bands(axis, shown, value, LIFT if value == "count" else 0.0)
                if value == "count" and own["expected"].notna().any():
                    true = mark_value(axis, own["expected"].max())
                if window is not None:
                    ramp = mark_window(axis, window)
                axis.set_ylim(bottom=0)
                if value == "count":
                    axis.set_ylim(top=axis.get_ylim()[1] + 0.4)
                    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    label_outer(axes, "step", WORDS.get(value, value))
    extra = []
    for handle, label in ((true, "expected"), (ramp, "λ ramps up")):
        if handle is not None:
            handle.set_label(label)
            extra.append(handle)
    legend_below(figure, 6 if columns > 1 else 4, extra)
    return figure


def trajectory_table(collected: Collected, shape: str, value: str = "bottleneck") -> pd.DataFrame:
    """Return the figure's numbers for one shape: steps × conditions, mean over seeds."""
    table = frames.dumps(collected)
    means = table[table["shape"] == shape].groupby(["step", "condition"])[value].mean()
    means = means.round(2 if value == "count" else 4).unstack("condition")
    return means[in_order(means.columns)]
