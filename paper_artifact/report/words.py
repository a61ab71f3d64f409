"""Notebook 16: Betti numbers in words (T1, T2) beside C0, C1 and the controls, by the paper's rule; ablations
and seconds.

Lies, the audit and realism stand in `report.words_hurt`. DEVISED are the shapes that T2 was devised on: they
are told apart, the others are the test. Every function works while runs are missing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import colour_of, marker_of, shape_row, tag_of
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.export.figures import PAGE, new_figure
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import label_axis, legend_below, mark_value, plain_log
from paper_artifact.report.kit.records import Collected, collect_study, joined, key
from paper_artifact.report.kit.text import (
    NOT_RECORDED,
    arm_text,
    blank,
    counts_text,
    range_text,
    seeds_text,
    tails_text,
)
from paper_artifact.study.verdict import BASELINE, CONTROLS, LOSS, Verdict, verdict

WORDS = ("T1", "T2")
DESIGNS = (LOSS, *WORDS)
DEVISED = ("double_torus", "eight")
BEYOND = 1.05  # of the target's death: what is longer in every seed went too far
STUDIES = ("table1", "table2", "bowls")  # whose C0, C1, C2 the words stand beside
# Seconds of topology per run that the design was to stay within: {(design, M): seconds}.
AIMS = {("T1", 2048): 7, ("T2", 2048): 12, ("T2", 8192): 30}


def collected(profile: str = "recorded") -> Collected:
    """Return the runs of the study words and those of the paper's tables that they are judged against."""
    usual = [collect_study(name, profile).only(BASELINE, LOSS, *CONTROLS) for name in STUDIES]
    return joined(*usual, collect_study("words", profile))


def designs(runs: Collected) -> list[str]:
    """Return the arms that are judged: C1, T1, T2, and those of changed settings behind their design."""
    return [arm for arm in frames.conditions(runs) if tag_of(arm) in DESIGNS]


def judged(runs: Collected, arm: str) -> dict[str, Verdict]:
    """Return the verdict on one arm for every shape, by the paper's rule, against C0 and the controls that
    the shape has."""
    return verdict(frames.runs(runs), CONTROLS, arm)


def outcome_table(runs: Collected) -> pd.DataFrame:
    """Return a row per shape: the words, M, the tails of C0 and C2 (mean ± sd), and of C1, T1 and T2 tail,
    C0 / tail and outcome of the rule ("—": not recorded); those of DEVISED last."""
    texts = frames.arms(runs).set_index(frames.ARM).apply(_arm, axis=1)
    verdicts = {arm: judged(runs, arm) for arm in DESIGNS}
    rows = {}
    for shape in sorted(frames.shapes(runs), key=lambda shape: shape in DEVISED):
        row = shape_row(shape)
        said = (row.features[0] + 1, *row.features[1:])
        name = f"{shape} (devised on)" if shape in DEVISED else shape
        rows[name] = {"words": ",".join(map(str, said)), "M": row.samples, "judged": f"H{row.judged}"}
        rows[name] |= {arm: texts.get((shape, arm), "—") for arm in (BASELINE, "C2")}
        for arm in DESIGNS:
            found = verdicts[arm].get(shape)
            known = found is not None and arm in found.arms
            rows[name] |= {
                arm: texts.get((shape, arm), "—"),
                f"{arm}: outcome": found.outcome if known else "—",
            }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def design_table(runs: Collected) -> pd.DataFrame:
    """Return a row per shape and judged arm, changed settings too: tails seed by seed, how their range lies
    to C1's, significant bars seed by seed, Chamfer over C0's, seeds with too many bars (phantoms) and too few
    (lost), outcome and reason."""
    arms, rows = frames.arms(runs).set_index(frames.ARM), {}
    verdicts = {arm: judged(runs, arm) for arm in designs(runs)}
    for shape, arm in arms.index:
        own, found = arms.loc[(shape, arm)], verdicts.get(arm, {}).get(shape)
        if found is None or not own["seeds"]:
            continue
        first = arms.loc[(shape, LOSS), "tails"] if (shape, LOSS) in arms.index else ()
        rows[shape, arm] = {
            "tails": tails_text(own["tails"]),
            "range to C1's": "" if arm == LOSS else range_text(own["tails"], first),
            "bars": counts_text(own["counts"]),
            "Chamfer / C0": own["chamfer ratio"],
            "phantoms": seeds_text(found.phantoms.get(arm)),
            "lost": seeds_text(found.missing.get(arm)),
            "outcome": found.outcome,
            "reason": found.reason,
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    if len(table):
        table.index = pd.MultiIndex.from_tuples(table.index, names=frames.ARM)
        table["Chamfer / C0"] = table["Chamfer / C0"].map("{:.2f}".format, "ignore")
    return blank(table)


def outcome_text(runs: Collected) -> str:
    """Return per design how many shapes pass, tie, have no effect and so on, of those that are the test and
    of those that T2 was devised on, and how its ranges lie to C1's."""
    arms, lines = frames.arms(runs).set_index(frames.ARM), []
    for arm in DESIGNS:
        verdicts = {shape: each for shape, each in judged(runs, arm).items() if arm in each.arms}
        for word, devised in (("the test", False), ("devised on", True)):
            own = {shape: each.outcome for shape, each in verdicts.items() if (shape in DEVISED) == devised}
            if not own:
                lines.append(f"{arm}, {word}: {NOT_RECORDED}")
                continue
            counts = Counter(own.values())
            parts = [
                f"{outcome} {count}"
                + ("" if outcome == "pass" else f" ({', '.join(s for s in own if own[s] == outcome)})")
                for outcome, count in counts.most_common()
            ]
            lines.append(f"{arm}, {word}: {'; '.join(parts)}; of {len(own)}")
        if arm != LOSS:
            places = Counter(
                range_text(arms.loc[(shape, arm), "tails"], arms.loc[(shape, LOSS), "tails"])
                for shape in verdicts
                if (shape, LOSS) in arms.index
            )
            said = ", ".join(f"{place} {places[place]}" for place in ("below", "overlaps", "above"))
            lines.append(f"{arm}'s range to C1's: {said}")
    return "\n".join(lines)


def outcome_figure(runs: Collected) -> Figure:
    """Return one picture of the study: per shape the mean tail over C0's of C1, T1 and T2 (1: no gain), with
    the range over the seeds."""
    arms, shapes = frames.arms(runs).set_index(frames.ARM), frames.shapes(runs)
    shapes = sorted(shapes, key=lambda shape: shape in DEVISED)
    figure, axes = new_figure(1, 1, PAGE, 2.9)
    axis = axes[0][0]
    for offset, arm in zip((-0.22, 0.0, 0.22), DESIGNS, strict=True):
        style = {"color": colour_of(arm), "marker": marker_of(arm), "markersize": 4.5}
        for place, shape in enumerate(shapes):
            own = arms.loc[(shape, arm)] if (shape, arm) in arms.index else None
            base = arms["mean"].get((shape, BASELINE), np.nan)
            if own is None or not own["tails"] or np.isnan(base):
                continue
            ends = [min(own["tails"]) / base, max(own["tails"]) / base]
            axis.plot([place + offset] * 2, ends, color=colour_of(arm))
            axis.plot(place + offset, own["mean"] / base, **style)
        axis.plot([], [], label=arm, **style)
    mark_value(axis, 1.0).set_label(BASELINE)
    label_axis(axis, "", "", "tail bottleneck ÷ C0's (no unit)")
    plain_log(axis)
    axis.set_yticks([0.1, 0.2, 0.5, 1, 2])
    axis.minorticks_off()
    axis.set_xticks(range(len(shapes)), shapes, rotation=40, ha="right")
    axis.set_xlim(-0.6, len(shapes) - 0.4)
    legend_below(figure)
    return figure


def reach_table(runs: Collected) -> pd.DataFrame:
    """Return per shape how far each arm's longest bar of the judged dimension reaches at the end: its death
    over that of the target's longest bar, seed by seed, and whether words go beyond what C1 aims at (1)."""
    rows: dict[str, dict[str, str]] = {}
    for shape in frames.shapes(runs):
        targets = [record for record in runs.of(shape, LOSS) if "bundle" in record]
        row = {}
        for arm in (BASELINE, *DESIGNS):
            reached = [_longest(r["dumps"][-1]["bars"], r) for r in runs.of(shape, arm) if r["dumps"]]
            if not targets or not reached:
                row[arm] = NOT_RECORDED
                continue
            aimed = _longest(targets[0]["bundle"]["bars"], targets[0])
            row[arm] = " ".join(f"{death / aimed:.2f}" for death in reached)
            if arm in WORDS and min(reached) > BEYOND * aimed:
                row["beyond"] = ", ".join(filter(None, (row.get("beyond", ""), arm)))
        rows[shape] = {"beyond": "", **row}
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")
    return table[[arm for arm in (BASELINE, *DESIGNS, "beyond") if arm in table]]


def _longest(bars: Sequence[Sequence[Sequence[float]]], record: Mapping) -> float:
    """Return the death of the longest bar of the record's judged dimension, / the diagonal."""
    own = bars[record["mesh"]["dimension"]]
    return max(own, key=lambda bar: bar[1] - bar[0])[1]


def ablation_table(runs: Collected, ablated: Collected) -> pd.DataFrame:
    """Return per arm and shape of the study words_ablation (`ablated`), and of C0, C1, T1, T2 of the same
    seeds in `runs`: mean tail, seed by seed, C0 / mean, Chamfer over C0's, bars at the end, each run's λ."""
    shapes, seeds = {run[0] for run in ablated.wanted}, {run[2] for run in ablated.wanted}
    usual = runs.only(BASELINE, *DESIGNS)
    chosen = Collected(
        (*(r for r in usual.records if key(r)[0] in shapes and key(r)[2] in seeds), *ablated.records),
        (*(run for run in usual.missing if run[0] in shapes and run[2] in seeds), *ablated.missing),
        runs.results,
    )
    rows = {}
    for arm in frames.arms(chosen).itertuples():
        peaks = [
            event["lambda_peak"]
            for record in chosen.of(arm.shape, arm.condition)
            for event in record.get("topology") or ()
            if event["event"] == "lambda"
        ]
        rows[arm.shape, arm.condition] = {
            "tail": NOT_RECORDED if not arm.seeds else arm_text(arm.mean, None, arm.ratio),
            "seed by seed": tails_text(arm.tails),
            "Chamfer / C0": "" if np.isnan(arm[-1]) else f"{arm[-1]:.2f}",
            "bars": counts_text(arm.counts),
            "λ": "/".join(f"{peak:.3g}" for peak in peaks) or ("none set" if arm.seeds else ""),
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.index = pd.MultiIndex.from_tuples(table.index, names=["shape", "arm"])
    return table


def seconds_table(runs: Collected) -> pd.DataFrame:
    """Return per design and M what the loss took in the recorded runs: wall seconds of its stage (the
    machine's load varied), median and range, its seconds over the photometric training's (percent, within a
    run), and what was aimed at."""
    rows: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for record in runs.records:
        loss, timings = record["config"]["loss"], record["timings"]
        if (
            tag_of(record["config"]["condition"]) not in DESIGNS
            or record["config"]["steps"] != STEPS_OF_THE_STUDY
        ):
            continue
        own = timings["topology"]
        rest = sum(timings.values()) - timings["evaluate"] - own
        samples = next((e["samples"] for e in record["topology"] if e["event"] == "refresh"), loss["samples"])
        rows.setdefault((tag_of(record["config"]["condition"]), samples), []).append((own, own / rest))
    table = {
        (design, samples): {
            "runs": len(each),
            "seconds": f"{np.median([own for own, _ in each]):.1f}",
            "least–most": f"{min(own for own, _ in each):.1f}–{max(own for own, _ in each):.1f}",
            "of training %": f"{100 * np.median([share for _, share in each]):.0f}",
            "aim": AIMS.get((design, samples), ""),
        }
        for (design, samples), each in sorted(rows.items())
    }
    return pd.DataFrame.from_dict(table, orient="index").rename_axis(["design", "M"])


def _arm(arm: pd.Series) -> str:
    return arm_text(arm["mean"], arm["sd"], arm["ratio"]) if arm["seeds"] else "—"
