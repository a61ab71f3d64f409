"""Notebooks 06 and 08: what the loss did during its runs, from the refresh logs (App. H, Fig. "pairstab"):
plans, residuals, λ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.export.figures import new_figure
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import label_axis
from paper_artifact.report.kit.records import Collected, key
from paper_artifact.report.kit.text import NOT_RECORDED

KINDS = {"matched": "#1f5fbf", "recruited": "#1e8449", "unreached": "#c0392b", "diagonal": "#b7950b"}
LAST = 20  # refreshes averaged for the residual at the end: the steps of the tail, 2300 to 2500

Panels = Sequence[tuple[str, str]]  # (shape, condition)


def refresh_table(record: Mapping) -> pd.DataFrame:
    """Return one line per refresh of a topology run: step, significant, matched, recruited, unreached,
    diagonal, gabriel_failures (sums over the loss's dimensions), targets, residual (largest |live −
    target| of births and deaths, radius / D; NaN when nothing is pulled); empty for a run without
    matching."""
    rows = []
    for event in record.get("topology") or ():
        if event["event"] != "refresh" or "dimensions" not in event:
            continue
        dimensions = event["dimensions"].values()
        targets = [bar for each in dimensions for bar in each["targets"]]
        pulled = [
            np.abs(np.subtract(bar["live"], bar["target"])).max()
            for bar in targets
            if bar["live"] is not None
        ]
        rows.append(
            {"step": event["step"]}
            | {
                name: sum(each[name] for each in dimensions)
                for name in ("significant", *KINDS, "gabriel_failures")
            }
            | {"targets": len(targets), "residual": max(pulled, default=np.nan)}
        )
    return pd.DataFrame(rows)


def plan_table(collected: Collected) -> pd.DataFrame:
    """Return per shape and condition that matches bars, over all recorded seeds: refreshes, the share with
    a recruited or an unreached target, Gabriel failures, λ's range over seeds, and the residual at the
    loss's own M over the tail's refreshes beside the 20,000-sample tail."""
    logs = {key(record): log for record in collected.records if len(log := refresh_table(record))}
    peaks = {
        key(record): event["lambda_peak"]
        for record in collected.records
        for event in record.get("topology") or ()
        if event["event"] == "lambda"
    }
    rows = {}
    for arm in frames.arms(collected).itertuples():
        runs = [run for seed in arm.seeds if (run := (arm.shape, arm.condition, seed)) in logs]
        if not runs:
            continue
        every = pd.concat([logs[run] for run in runs])
        rows[arm.shape, arm.condition] = {
            "seeds": len(runs),
            "refreshes": len(every),
            "recruiting %": round(100 * (every["recruited"] > 0).mean(), 1),
            "unreached %": round(100 * (every["unreached"] > 0).mean(), 1),
            "Gabriel failures": int(every["gabriel_failures"].sum()),
            "λ min": float(f"{min(peaks[run] for run in runs):.3g}"),
            "λ max": float(f"{max(peaks[run] for run in runs):.3g}"),
            "residual at M": round(
                float(np.nanmean([logs[run]["residual"].tail(LAST).mean() for run in runs])), 4
            ),
            "tail at 20,000": round(arm.mean, 4),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(
        ["shape", "condition"][: 2 if rows else 1]
    )


def plan_figure(collected: Collected, panels: Panels, seed: int = 0) -> Figure:
    """Return the plan composition per refresh of one seed, one axes per panel; dashed: the number of
    target bars."""
    figure, axes = new_figure(1, len(panels), 3.4, 2.5)
    for axis, (shape, condition) in zip(axes[0], panels, strict=True):
        log = _log(collected, shape, condition, seed)
        label_axis(
            axis, f"{shape} {condition}, seed {seed}" + ("" if len(log) else f": {NOT_RECORDED}"), "step"
        )
        if not len(log):
            continue
        for kind, colour in KINDS.items():
            if kind != "diagonal" or log[kind].any():
                axis.step(log["step"], log[kind], where="post", color=colour, label=kind, linewidth=1.1)
        axis.axhline(log["targets"].iloc[0], color="grey", linestyle="--", linewidth=0.8, label="targets")
        axis.set_ylim(-0.1, max(3, log["targets"].max() + 0.5))
        axis.legend(fontsize=6)
    return figure


def composition_table(collected: Collected, panels: Panels, seed: int = 0) -> pd.DataFrame:
    """Return the figure's numbers: how many refreshes of that seed had which (matched, recruited,
    unreached, diagonal)."""
    rows = []
    for shape, condition in panels:
        log = _log(collected, shape, condition, seed)
        if len(log):
            counted = log.groupby(list(KINDS)).size().rename("refreshes").reset_index()
            rows.append(counted.assign(shape=shape, condition=condition))
    columns = ["shape", "condition", *KINDS, "refreshes"]
    return pd.concat(rows, ignore_index=True)[columns] if rows else pd.DataFrame(columns=columns)


def _log(collected: Collected, shape: str, condition: str, seed: int) -> pd.DataFrame:
    return next(map(refresh_table, collected.of(shape, condition, seed)), pd.DataFrame())
