"""Tables and figures of any study's arms, ours beside the paper's: the matrix, verdicts, per-seed tails,
trajectories.

Rows and columns are the shapes and conditions of the records, in the catalogue's order.
"""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import in_order
from paper_artifact.export.figures import new_figure
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import draw_bands, label_axis
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text, blank, counts_text, seeds_text, tails_text
from paper_artifact.study.verdict import BASELINE, LOSS

TITLES = {"bottleneck": "bottleneck to target", "count": "significant bars"}


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


def trajectory_figure(
    collected: Collected, shapes: Iterable[str] = (), value: str = "bottleneck", columns: int = 2
) -> Figure:
    """Return one axes per shape (default: all), `columns` in a row: a line (mean) and band (range of seeds)
    per condition.

    value: a column of `frames.dumps`; "count" has a dashed line at the expected count.
    """
    shapes = list(shapes) or frames.shapes(collected)
    table, runs = frames.dumps(collected), frames.runs(collected)
    size = (4.6, 3.2) if columns < 3 else (3.0, 2.4)
    figure, axes = new_figure(-(-len(shapes) // columns), min(columns, len(shapes)), *size)
    for axis in axes.flat[len(shapes) :]:
        axis.set_axis_off()
    for axis, shape in zip(axes.flat, shapes, strict=False):
        own = runs[runs["shape"] == shape]
        recorded = f", H{own['dimension'].iloc[0]}" if len(own) else ", no run recorded"
        label_axis(axis, f"{shape}: {TITLES.get(value, value)}{recorded}", "step", grid=True)
        draw_bands(axis, table[table["shape"] == shape], value)
        if value == "count" and own["expected"].notna().any():
            axis.axhline(own["expected"].max(), color="black", linestyle="--", linewidth=0.8)
        axis.set_ylim(bottom=0)
        if len(own):
            axis.legend(fontsize=7, ncols=2)
    return figure


def trajectory_table(collected: Collected, shape: str, value: str = "bottleneck") -> pd.DataFrame:
    """Return the figure's numbers for one shape: steps × conditions, mean over seeds."""
    table = frames.dumps(collected)
    means = table[table["shape"] == shape].groupby(["step", "condition"])[value].mean()
    means = means.round(2 if value == "count" else 4).unstack("condition")
    return means[in_order(means.columns)]
