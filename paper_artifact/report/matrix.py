"""The C-matrix (Table 1) and what stands around it: trajectories, per-seed tails, counts, diagrams; from whatever runs are
recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.evaluate.scores import make_target
from paper_artifact.files import RESULTS
from paper_artifact.report.figures import COLOURS, draw_band, draw_diagram, new_figure
from paper_artifact.report.published import published
from paper_artifact.report.runs import Collected, collect, dump_table
from paper_artifact.scene.find import surface
from paper_artifact.study.studies import study_configs
from paper_artifact.study.tables import arm_text, counts_text, published_rows, seeds_text, tails_text
from paper_artifact.study.verdict import rows_of, verdict, welch_sigma

CONDITIONS = ("C0", "C1", "C2", "C2g", "C3", "C5", "C6", "C7", "C7h")
NAMES = ("components", "loops", "voids")


def collect_study(
    name: str = "table1", profile: str = "recorded", folder: Path = RESULTS / "runs"
) -> Collected:
    """Return the records of a study's runs (see `study.studies`), and which are missing."""
    return collect([(each.shape, each.condition, each.seed) for each in study_configs(name)], profile, folder)


def papers_tails() -> pd.DataFrame:
    """Return everything the paper prints of tails: Tables 1, 2, S10 (bowls) and S7, the text's C2g, C7 and C7h."""
    frames = [published(name) for name in ("1", "2", "S10", "noise", "ablations", "S7")]
    return pd.concat(frames, ignore_index=True)


def matrix_table(collected: Collected) -> pd.DataFrame:
    """Return Table 1: a row per condition, two columns per shape, ours (mean ± sd, C0 / this, seeds) beside the paper's; "not
    recorded" where a study's cell has no run yet, with how many seeds of how many where some are missing."""
    judged = verdict(rows_of(collected.records))
    paper = papers_tails()
    paper = paper[paper["quantity"] == "tail_bottleneck"]
    wanted: dict[tuple[str, str], int] = {}
    for shape, condition in [(r["config"]["shape"], r["config"]["condition"]) for r in collected.records] + [
        run[:2] for run in collected.missing
    ]:
        wanted[shape, condition] = wanted.get((shape, condition), 0) + 1
    columns = {}
    for shape in dict.fromkeys(shape for shape, _ in wanted):
        ours, theirs = {}, {}
        printed = (
            paper[(paper["shape"] == shape) & paper["seed"].isna()]
            .drop_duplicates("condition")
            .set_index("condition")
        )
        for condition in CONDITIONS:
            arm = judged[shape].arms.get(condition) if shape in judged else None
            if arm is not None:
                total = wanted[shape, condition]
                seeds = (
                    f"{len(arm.seeds)} seeds"
                    if len(arm.seeds) == total
                    else f"{len(arm.seeds)} of {total} seeds"
                )
                ours[condition] = (
                    f"{arm_text(arm.mean, arm.sd, None if condition == 'C0' else arm.ratio)}, {seeds}"
                )
            else:
                ours[condition] = "not recorded" if (shape, condition) in wanted else ""
            if condition in printed.index:
                ratio = None if condition == "C0" else printed["value"]["C0"] / printed["value"][condition]
                theirs[condition] = arm_text(printed["value"][condition], printed["sd"][condition], ratio)
        columns[shape, "ours"], columns[shape, "paper"] = ours, theirs
    return pd.DataFrame(columns).reindex(CONDITIONS).dropna(how="all").fillna("")


def verdicts(collected: Collected) -> pd.DataFrame:
    """Return per shape the verdict of ours and, where the paper prints per-seed tails, of the paper's by the same rule; Chamfer
    of C1 / C0 (parity: at most 1.15), Welch's sigma C0 - C1 (five seeds each), seeds of C1 with phantoms or missing features."""
    theirs = verdict(published_rows(papers_tails()))
    rows = []
    for shape, judged in verdict(rows_of(collected.records)).items():
        rows.append(
            {
                "shape": shape,
                "verdict": judged.outcome,
                "paper's tails give": theirs[shape].outcome if shape in theirs else "",
                "Chamfer C1 / C0": "" if judged.parity_ratio is None else f"{judged.parity_ratio:.2f}",
                "Welch C0 − C1": f"{judged.welch['C0']:.1f}" if "C0" in judged.welch else "",
                "phantoms in C1, seeds": seeds_text(judged.phantoms.get("C1")),
                "lost in C1, seeds": seeds_text(judged.missing.get("C1")),
                "lost in C2, seeds": seeds_text(judged.missing.get("C2")),
            }
        )
    return pd.DataFrame(rows).set_index("shape") if rows else pd.DataFrame()


def reasons(collected: Collected) -> str:
    """Return one line per shape: the verdict and its reason; and the separations that the paper's text quotes, ours beside
    its."""
    judged = verdict(rows_of(collected.records))
    lines = [f"{shape}: {each.outcome}: {each.reason}" for shape, each in judged.items()]
    sigmas = published("ablations")
    for row in sigmas[sigmas["quantity"] == "welch_sigma"].itertuples():
        first, second = row.condition.split(" vs ")
        arms = judged[row.shape].arms if row.shape in judged else {}
        ours = (
            welch_sigma(arms[first].tails, arms[second].tails) if first in arms and second in arms else None
        )
        lines.append(
            f"Welch, {row.shape} {row.condition}: paper {row.value:.1f}; ours "
            + ("needs five recorded seeds of each" if ours is None else f"{abs(ours):.1f}")
        )
    return "\n".join(lines)


def chamfer_table(collected: Collected) -> pd.DataFrame:
    """Return mean Chamfer (both directions' mean, % of D) per shape and condition, ours beside the numbers that the paper's text
    gives."""
    rows = pd.DataFrame(rows_of(collected.records))
    if rows.empty:
        return rows
    ours = (
        (100 * rows.groupby(["shape", "condition"], sort=False)["chamfer"].mean())
        .round(3)
        .unstack("shape")
        .add_suffix(", ours")
    )
    paper = published("chamfer")
    paper = paper[(paper["quantity"] == "chamfer_percent") & paper["shape"].isin(rows["shape"])]
    theirs = paper.set_index(["condition", "shape"])["value"].unstack("shape").add_suffix(", paper")
    table = pd.concat([ours, theirs], axis=1).reindex([each for each in CONDITIONS if each in ours.index])
    order = [f"{shape}, {source}" for shape in dict.fromkeys(rows["shape"]) for source in ("ours", "paper")]
    return (
        table[[each for each in order if each in table]].astype(object).where(lambda frame: frame.notna(), "")
    )


def component_table(collected: Collected, shape: str = "two_spheres") -> pd.DataFrame:
    """Return what an H0 tail is made of, step 2500, means over seeds per condition: the merging bar's death beside the target's,
    and half of the next longest bar (the most isolated sample) beside the bottleneck distance; radius / D."""
    rows, target = {}, make_target(surface(shape), cache=None)
    for condition in CONDITIONS:
        lasts = [record["dumps"][-1] for record in collected.of(shape, condition)]
        if lasts:
            deaths = np.array([[bar[1] for bar in last["bars"][0][:2]] for last in lasts])
            rows[condition] = {
                "merging bar": deaths[:, 0].mean().round(4),
                "of the target": np.sort(target.diagram[0][:, 1])[-1].round(4),
                "half the next bar": (deaths[:, 1] / 2).mean().round(4),
                "bottleneck, H0": np.mean([last["bottleneck"][0] for last in lasts]).round(4),
            }
    return pd.DataFrame.from_dict(rows, orient="index")


def trajectory_figure(
    collected: Collected,
    shapes: Sequence[str] = ("sphere", "torus"),
    value: str = "bottleneck",
    columns: int = 2,
) -> Figure:
    """Return Figs. S6, S2 (value "bottleneck") or Fig. S4 ("count"): one axes per shape, `columns` in a row, a line (mean) and
    band (range of seeds) per condition."""
    size = (4.6, 3.2) if columns < 3 else (3.0, 2.4)
    figure, axes = new_figure(-(-len(shapes) // columns), min(columns, len(shapes)), *size)
    for axis in axes.flat[len(shapes) :]:
        axis.set_axis_off()
    for axis, shape in zip(axes.flat, shapes):
        records = collected.of(shape)
        table = dump_table(records)
        for condition in (each for each in CONDITIONS if (table["condition"] == each).any()):
            draw_band(axis, table[table["condition"] == condition], value, condition, COLOURS[condition])
        if value == "count" and records and records[0]["mesh"]["betti"]:
            axis.axhline(
                records[0]["mesh"]["betti"][records[0]["mesh"]["dimension"]],
                color="black",
                linestyle="--",
                linewidth=0.8,
            )
        title = f"{shape}: " + ("bottleneck to target" if value == "bottleneck" else "significant bars")
        axis.set_title(
            title + (f", H{records[0]['mesh']['dimension']}" if records else ", no run recorded"), fontsize=9
        )
        axis.set_xlabel("step")
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.25)
        axis.tick_params(labelsize=7)
        if records:
            axis.legend(fontsize=7, ncols=2)
    return figure


def trajectory_table(collected: Collected, shape: str, value: str = "bottleneck") -> pd.DataFrame:
    """Return the figure's numbers for one shape: steps × conditions, mean over seeds."""
    table = dump_table(collected.of(shape))
    means = (
        table.groupby(["step", "condition"])[value]
        .mean()
        .round(4 if value == "bottleneck" else 2)
        .unstack("condition")
    )
    return means[[each for each in CONDITIONS if each in means]]


def seed_table(collected: Collected) -> pd.DataFrame:
    """Return per shape and condition our tails seed by seed, beside Table S7's (which has the three-seed analytic shapes)."""
    paper = (
        pd.DataFrame(published_rows(published("S7"))).groupby(["shape", "condition"])["tail"].agg(tails_text)
    )
    rows = []
    for shape, judged in verdict(rows_of(collected.records)).items():
        for condition in (each for each in CONDITIONS if each in judged.arms):
            arm = judged.arms[condition]
            rows.append(
                {
                    "shape": shape,
                    "condition": condition,
                    "seeds": "/".join(map(str, arm.seeds)),
                    "our tails": tails_text(arm.tails),
                    "Table S7": paper.get((shape, condition), ""),
                    "counts": counts_text(arm),
                }
            )
    return pd.DataFrame(rows).set_index(["shape", "condition"]) if rows else pd.DataFrame()


def seed_figure(collected: Collected, shapes: Sequence[str] = ("sphere", "torus")) -> Figure:
    """Return Fig. S3: per-seed tails as dots and the arms' means as bars; crosses: the paper's means."""
    figure, axes = new_figure(1, len(shapes), 4.6, 2.8)
    paper = papers_tails()
    paper = paper[(paper["quantity"] == "tail_bottleneck") & paper["seed"].isna()].drop_duplicates(
        ["shape", "condition"]
    )
    judged = verdict(rows_of(collected.records))
    for axis, shape in zip(axes[0], shapes, strict=True):
        arms = {
            name: judged[shape].arms[name]
            for name in CONDITIONS
            if shape in judged and name in judged[shape].arms
        }
        for place, (name, arm) in enumerate(arms.items()):
            axis.bar(place, arm.mean, color=COLOURS[name], alpha=0.35, width=0.7)
            axis.scatter([place] * len(arm.tails), arm.tails, color=COLOURS[name], s=14, zorder=3)
            printed = paper[(paper["shape"] == shape) & (paper["condition"] == name)]["value"]
            axis.scatter(
                [place] * len(printed), printed, color="black", marker="x", s=26, linewidths=1, zorder=4
            )
        axis.set_xticks(range(len(arms)), list(arms), fontsize=8)
        axis.set_title(f"{shape}: tail bottleneck per seed (× the paper's mean)", fontsize=9)
        axis.tick_params(labelsize=7)
    return figure


def diagram_figure(
    collected: Collected,
    shape: str = "sphere",
    seed: int = 0,
    conditions: Sequence[str] = ("C0", "C1", "C2"),
    steps: Sequence[int] = (200, 700, 1300, 2500),
) -> Figure:
    """Return Fig. S1: the live diagrams' longest bars in the discriminating dimension (20,000 samples, radius / D) under each
    condition (rows) at four steps (columns); stars: the target's significant bars."""
    figure, axes = new_figure(len(conditions), len(steps), 2.1, 2.1)
    target = make_target(surface(shape), cache=None)
    stars = target.diagram[target.dimension]
    stars = stars[stars[:, 1] - stars[:, 0] > target.floor]
    limit = 1.15 * float(stars.max())
    for condition, line in zip(conditions, axes, strict=True):
        records = [record for record in collected.of(shape, condition) if record["config"]["seed"] == seed]
        for step, axis in zip(steps, line, strict=True):
            dumps = [dump for record in records for dump in record["dumps"] if dump["step"] == step]
            bars = np.asarray(dumps[0]["bars"][target.dimension] if dumps else [], dtype=float).reshape(-1, 2)
            draw_diagram(
                axis,
                bars,
                target.floor,
                limit,
                stars,
                f"{condition}, step {step}" + ("" if dumps else ": not recorded"),
            )
    return figure


def diagram_table(
    collected: Collected,
    shape: str = "sphere",
    seed: int = 0,
    conditions: Sequence[str] = ("C0", "C1", "C2"),
    steps: Sequence[int] = (200, 700, 1300, 2500),
) -> pd.DataFrame:
    """Return the figure's numbers: birth and death of the longest live bar per condition and step."""
    rows = {}
    for condition in conditions:
        for record in collected.of(shape, condition):
            if record["config"]["seed"] == seed:
                dimension = record["mesh"]["dimension"]
                bars = {
                    dump["step"]: dump["bars"][dimension][0]
                    for dump in record["dumps"]
                    if dump["bars"][dimension]
                }
                rows[condition] = {
                    f"step {step}": f"({bars[step][0]:.4f}, {bars[step][1]:.4f})"
                    for step in steps
                    if step in bars
                }
    return pd.DataFrame.from_dict(rows, orient="index")
