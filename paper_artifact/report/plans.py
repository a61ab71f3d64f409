"""What the loss did during its runs, from the refresh logs: plan composition (App. H, Fig. "pairstab"), residuals at M, λ,
Gabriel failures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.report.figures import new_figure
from paper_artifact.report.runs import Collected

KINDS = {"matched": "#1f5fbf", "recruited": "#1e8449", "unreached": "#c0392b", "diagonal": "#b7950b"}
LAST = 20  # refreshes averaged for the residual at the end: the steps of the tail, 2300 to 2500


def refresh_table(record: Mapping) -> pd.DataFrame:
    """Return one line per refresh of a topology run: step, significant, matched, recruited, unreached, diagonal, gabriel_failures
    (sums over the loss's dimensions), targets, residual (largest |live − target| of births and deaths, radius / D; NaN when
    nothing is pulled)."""
    rows = []
    for event in record.get("topology", ()):
        if event.get("event") != "refresh" or "dimensions" not in event:
            continue
        dimensions = event["dimensions"].values()
        names = ("significant", *KINDS, "gabriel_failures")
        row = {"step": event["step"]} | {name: sum(each[name] for each in dimensions) for name in names}
        pulled = [
            np.abs(np.subtract(bar["live"], bar["target"])).max()
            for each in dimensions
            for bar in each["targets"]
            if bar["live"] is not None
        ]
        rows.append(
            row
            | {
                "targets": sum(len(each["targets"]) for each in dimensions),
                "residual": max(pulled) if pulled else np.nan,
            }
        )
    return pd.DataFrame(rows)


def plan_table(
    collected: Collected, conditions: Sequence[str] = ("C1", "C3", "C6", "C7", "C7h")
) -> pd.DataFrame:
    """Return per shape and condition, over all recorded seeds: refreshes, the share with a recruited or an unreached target,
    Gabriel failures, λ's range over seeds, and the residual at the loss's own M over the tail's refreshes beside the
    20,000-sample tail."""
    groups: dict[tuple[str, str], list[Mapping]] = {}
    for record in collected.records:
        if record["config"]["condition"] in conditions and record.get("topology"):
            groups.setdefault((record["config"]["shape"], record["config"]["condition"]), []).append(record)
    rows = []
    for (shape, condition), records in groups.items():
        logs = [refresh_table(record) for record in records]
        every = pd.concat(logs)
        peaks = [
            event["lambda_peak"]
            for record in records
            for event in record["topology"]
            if event["event"] == "lambda"
        ]
        dimension = records[0]["mesh"]["dimension"]
        rows.append(
            {
                "shape": shape,
                "condition": condition,
                "seeds": len(records),
                "refreshes": len(every),
                "recruiting %": round(100 * (every["recruited"] > 0).mean(), 1),
                "unreached %": round(100 * (every["unreached"] > 0).mean(), 1),
                "Gabriel failures": int(every["gabriel_failures"].sum()),
                "λ min": float(f"{min(peaks):.3g}"),
                "λ max": float(f"{max(peaks):.3g}"),
                "residual at M": round(
                    float(np.nanmean([log["residual"].tail(LAST).mean() for log in logs])), 4
                ),
                "tail at 20,000": round(
                    float(np.mean([record["tails"]["bottleneck"][dimension] for record in records])), 4
                ),
            }
        )
    return pd.DataFrame(rows).set_index(["shape", "condition"]) if rows else pd.DataFrame()


def plan_figure(
    collected: Collected,
    panels: Iterable[tuple[str, str]] = (("torus", "C6"), ("torus", "C1"), ("sphere", "C1")),
    seed: int = 0,
) -> Figure:
    """Return the plan composition per refresh of one seed, one axes per (shape, condition); dashed: the number of target bars."""
    panels = tuple(panels)
    figure, axes = new_figure(1, len(panels), 3.4, 2.5)
    for axis, (shape, condition) in zip(axes[0], panels, strict=True):
        records = [record for record in collected.of(shape, condition) if record["config"]["seed"] == seed]
        log = refresh_table(records[0]) if records else pd.DataFrame()
        axis.set_title(
            f"{shape} {condition}, seed {seed}" + ("" if len(log) else ": not recorded"), fontsize=9
        )
        axis.set_xlabel("step")
        axis.tick_params(labelsize=7)
        if not len(log):
            continue
        for kind, colour in KINDS.items():
            if kind != "diagonal" or log[kind].any():
                axis.plot(
                    log["step"], log[kind], color=colour, label=kind, linewidth=1.1, drawstyle="steps-post"
                )
        axis.axhline(log["targets"].iloc[0], color="grey", linestyle="--", linewidth=0.8, label="targets")
        axis.set_ylim(-0.1, max(3, log["targets"].max() + 0.5))
        axis.legend(fontsize=6)
    return figure


def composition_table(
    collected: Collected,
    panels: Iterable[tuple[str, str]] = (("torus", "C6"), ("torus", "C1"), ("sphere", "C1")),
    seed: int = 0,
) -> pd.DataFrame:
    """Return the figure's numbers: how many refreshes of that seed had which (matched, recruited, unreached, diagonal)."""
    rows = []
    for shape, condition in panels:
        for record in collected.of(shape, condition):
            if record["config"]["seed"] == seed:
                counted = refresh_table(record).groupby(list(KINDS)).size()
                rows += [
                    {"shape": shape, "condition": condition} | dict(zip(KINDS, key)) | {"refreshes": count}
                    for key, count in counted.items()
                ]
    return pd.DataFrame(rows, columns=["shape", "condition", *KINDS, "refreshes"])
