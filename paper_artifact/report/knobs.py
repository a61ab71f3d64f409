"""Notebook 14: what hangs on the settings: ρ and the ramp (Table S8), the double torus at a density that
shows all its loops, and the candidates for a C1 that is stronger than the paper's.

An arm of changed settings is called "C1, rho=0.03" (`report.kit.records`).
"""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from paper_artifact.catalogue import shape_row, tag_of
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected, target_of
from paper_artifact.report.kit.text import (
    NOT_RECORDED,
    arm_text,
    blank,
    counts_text,
    range_text,
    short,
    span,
    tails_text,
)
from paper_artifact.study.verdict import BASELINE, CONTROLS, LOSS, verdict

AS_IN_THE_STUDY = "as in the study"
NEAR = 0.15  # of the paper's value: what "comes out at the paper's" means here


def knob_arm(knob: str, setting: str) -> str:
    """Return our arm of a row of Table S8: "C1, rho=0.03", "C1, ramp=(0.1, 0.4)" for "10-40%", "C1" for the
    default."""
    default = {"rho": "0.1", "ramp": "20-50%"}
    if setting == default[knob]:
        return LOSS
    value = tuple(int(text) / 100 for text in re.findall(r"\d+", setting)) if knob == "ramp" else setting
    return f"{LOSS}, {knob}={value}"


def knob_table(collected: Collected) -> pd.DataFrame:
    """Return Table S8: per knob and setting ours as the paper reports it (ρ: seed 0; ramp: mean ± sd), the
    paper's, ours over all seeds, seed by seed, how that range lies to the default's, and Chamfer in percent
    (mean of both directions).

    collected: has the sphere's C1 and the study knobs.
    """
    arms, rows = frames.arms(collected).set_index(frames.ARM), {}
    for row in published("S8").itertuples():
        key = (row.shape, knob_arm(row.knob, row.setting))
        arm = arms.loc[key] if key in arms.index else None
        tails = dict(zip(arm["seeds"], arm["tails"], strict=True)) if arm is not None else {}
        ours = {0: tails[0]} if row.note == "seed 0" and 0 in tails else tails
        default = arms.loc[(row.shape, LOSS), "tails"] if (row.shape, LOSS) in arms.index else ()
        rows[row.knob, row.setting] = {
            "ours": _mean_text(ours.values()) or NOT_RECORDED,
            "paper": arm_text(row.value, row.sd).replace(short(row.value), row.printed),
            "all seeds": _mean_text(tails.values()),
            "seed by seed": tails_text(tails.values()),
            "range to the default's": "" if key[1] == LOSS else range_text(tails.values(), default),
            "Chamfer %": "" if not tails else f"{100 * arm['chamfer']:.3f}",
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["knob", "setting"])


def knob_text(collected: Collected) -> str:
    """Return how flat the response to ρ is (largest over smallest mean, ours and the paper's), and which
    settings' tails do not overlap the default's."""
    table, paper = knob_table(collected), published("S8").set_index(["knob", "setting"])
    absent = table.index[table["ours"] == NOT_RECORDED]
    if len(absent):
        return f"no runs of {', '.join(f'{knob} {setting}' for knob, setting in absent)}"
    means = table.loc["rho", "all seeds"].str.split("±").str[0].astype(float)
    printed = paper.loc["rho", "value"]
    apart = table.index[table["range to the default's"].isin(("below", "above"))]
    named = ", ".join(f"{knob} {setting}" for knob, setting in apart)
    return (
        f"largest / smallest mean over ρ = .03 … .3: {means.max() / means.min():.2f} "
        f"(paper, seed 0: {printed.max() / printed.min():.2f}); "
        f"settings whose seeds lie apart from the default's: {named or 'none'}"
    )


def dense_table(collected: Collected, shape: str = "double_torus") -> pd.DataFrame:
    """Return per arm of the double torus, at the study's M and at the denser one: tails (mean ± sd, seeds),
    final significant loops seed by seed, Chamfer over C0's, the study's verdict on each C1 against C0 and the
    control of the same setting, and the paper's tail.

    collected: has the shape's C0, C1, C2 and the study dense.
    """
    arms = frames.arms(collected)
    arms = arms[arms["shape"] == shape].set_index("condition")
    printed = frames.paper_arms("tail_bottleneck", "1").set_index(frames.ARM)["printed"]
    rows = {}
    for name, arm in arms.iterrows():
        judged = _judged_setting(collected, name).get(shape) if tag_of(name) == LOSS else None
        rows[name] = {
            "ours": f"{arm_text(arm['mean'], arm['sd'])}, {len(arm['seeds'])} seeds"
            if arm["seeds"]
            else NOT_RECORDED,
            "paper": printed.get((shape, name), ""),
            "loops": counts_text(arm["counts"]),
            "Chamfer / C0": arm["chamfer ratio"],
            "verdict": "" if judged is None else f"{judged.outcome}: {judged.reason}",
        }
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("arm")
    return blank(table.assign(**{"Chamfer / C0": table["Chamfer / C0"].map("{:.2f}".format, "ignore")}))


def dense_text(collected: Collected, shape: str = "double_torus") -> str:
    """Return, per setting of C1, whether its tails leave the unmatched bound (half of the longest bar that
    the study's bundle does not hold) and whether every seed ends with all loops: if so at the denser M, the
    ceiling is one of measurement, else of representation."""
    target, row = target_of(shape), shape_row(shape)
    lengths = np.sort(np.ptp(target.diagram[row.judged], axis=1))[::-1]
    shown = len(next((r["bundle"]["bars"][row.judged] for r in collected.of(shape, LOSS)), ()))
    bound, wanted = lengths[shown] / 2, row.features[row.judged]
    lines = [
        f"unmatched bound: {short(bound)}, half of loop {shown + 1} of the clean surface; all loops: {wanted}"
    ]
    arms = frames.arms(collected)
    for arm in arms[arms["shape"] == shape].itertuples():
        if tag_of(arm.condition) != LOSS:
            continue
        if not arm.seeds:
            lines.append(f"{arm.condition}: not recorded")
            continue
        free, whole = max(arm.tails) < bound * 0.99, all(count >= wanted for count in arm.counts)
        lines.append(
            f"{arm.condition}: tails {'below' if free else 'at'} the bound ({span(arm.tails, 4)}), "
            f"{'all' if whole else 'not all'} loops in every seed ({counts_text(arm.counts)})"
        )
    return "\n".join(lines)


def strength_table(collected: Collected) -> pd.DataFrame:
    """Return, per setting and shape, C1's mean tail and C0's, how many times the paper's C1 it is, how many
    times our own of the study it is, and λ's range; all over the seeds of the study strength.

    collected: has the study strength, and C0 and C1 of the same shapes and seeds.
    """
    arms = _strength_arms(collected)
    printed = frames.paper_arms().set_index(frames.ARM)
    rows = {}
    for (setting, shape), own in arms.groupby(["setting", "shape"], sort=False):
        means = own.set_index("tag")["mean"]
        paper = printed["value"].get((shape, LOSS), np.nan)
        usual = arms.query("setting == @AS_IN_THE_STUDY and shape == @shape and tag == @LOSS")["mean"]
        loss = means.get(LOSS, np.nan)
        rows[setting, shape] = {
            "C1": "" if np.isnan(loss) else short(loss),
            "C1, paper": printed["printed"].get((shape, LOSS), ""),
            "ours / paper": loss / paper,
            "/ as in the study": loss / usual.iloc[0] if len(usual) else np.nan,
            "C0": "" if np.isnan(means.get(BASELINE, np.nan)) else short(means[BASELINE]),
            "λ": _lambda_text(collected, shape, own.loc[own["tag"] == LOSS, "condition"]),
        }
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis(["setting", "shape"])
    for name in ("ours / paper", "/ as in the study"):
        table[name] = table[name].map("{:.2f}".format, "ignore")
    return blank(table)


def strength_text(collected: Collected) -> str:
    """Return which single candidates bring C1 to within NEAR of the paper's on every shape, or that it is
    none of these, and which could not be judged for want of runs."""
    arms = _strength_arms(collected).query("tag == @LOSS")
    paper = frames.paper_arms().set_index(frames.ARM)["value"]
    shapes = [shape for shape in arms["shape"].unique() if (shape, LOSS) in paper.index]
    explained, open_ = [], []
    for setting, own in arms.groupby("setting", sort=False):
        means = own.set_index("shape")["mean"].reindex(shapes)
        if setting == AS_IN_THE_STUDY:
            continue
        if means.isna().any():
            open_.append(setting)
        elif all(abs(means[shape] / paper[shape, LOSS] - 1) <= NEAR for shape in shapes):
            explained.append(setting)
    judged = len(arms["setting"].unique()) - 1 - len(open_)
    lines = [
        f"within {100 * NEAR:.0f} % of the paper's C1 on {', '.join(shapes)}: "
        f"{', '.join(explained) or f'none of the {judged} candidates with all runs'}"
    ]
    return "\n".join(lines + ([f"not all recorded: {', '.join(open_)}"] if open_ else []))


def _strength_arms(collected: Collected) -> pd.DataFrame:
    """The arms with their tag and setting, of the seeds that the settings share, the study's own first."""
    changed = [run for run in collected.wanted if tag_of(run[1]) != run[1]]
    shapes, seeds = {run[0] for run in changed}, {run[2] for run in changed}
    runs = frames.runs(collected)
    runs = runs[runs["shape"].isin(shapes) & runs["seed"].isin(seeds)]
    means = runs.groupby(frames.ARM, sort=False)["tail"].mean()
    wanted = dict.fromkeys(
        run[:2] for run in collected.wanted if run[0] in shapes and tag_of(run[1]) in (BASELINE, LOSS)
    )
    rows = [
        {
            "shape": shape,
            "condition": condition,
            "tag": tag_of(condition),
            "setting": condition.partition(", ")[2] or AS_IN_THE_STUDY,
            "mean": means.get((shape, condition), np.nan),
        }
        for shape, condition in wanted
    ]
    frame = pd.DataFrame(rows, columns=["shape", "condition", "tag", "setting", "mean"])
    return frame.sort_values(
        "setting", key=lambda column: column != AS_IN_THE_STUDY, kind="stable", ignore_index=True
    )


def _lambda_text(collected: Collected, shape: str, conditions: pd.Series) -> str:
    peaks = [
        event["lambda_peak"]
        for condition in conditions
        for record in collected.of(shape, condition)
        for event in record.get("topology") or ()
        if event["event"] == "lambda"
    ]
    return span(peaks, 3) if peaks else ""


def _judged_setting(collected: Collected, loss: str) -> dict:
    """The verdicts of a C1 arm against the baseline and the controls of the same setting."""
    controls = tuple(name + loss.removeprefix(LOSS) for name in CONTROLS)
    return verdict(frames.runs(collected), controls, loss)


def _mean_text(tails) -> str:
    tails = list(tails)
    return arm_text(np.mean(tails), np.std(tails, ddof=1) if len(tails) > 1 else None) if tails else ""
