"""Notebooks 06 and 08: what the loss did during its runs, from the refresh logs (App. H, Fig. "pairstab"):
plans, residuals, λ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.alpha.radii import passes_gate
from paper_artifact.catalogue import LOSS, SHAPES
from paper_artifact.plot import PAGE, new_figure
from paper_artifact.randomness import stream
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import label_axis, legend_below, mark_value
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected, collect_study, key
from paper_artifact.report.kit.text import NOT_RECORDED, blank
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface
from paper_artifact.topology.floor import measurement_floor

# What becomes of a bar, with its colour and hatching.
KINDS = {
    "matched": ("#b9cfdc", ""),
    "recruited": ("#e0901a", ""),
    "unreached": ("#3a2c4d", "////"),
    "diagonal": ("#8f8f8f", ""),
}
LAST = 20  # refreshes averaged for the residual at the end: the steps of the tail, 2300 to 2500

Panels = Sequence[tuple[str, str] | tuple[str, str, int]]  # (shape, condition), or with a seed of its own


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


def total_table() -> pd.DataFrame:
    """Return over the committed records of the studies, and over all of them together, how many runs match
    bars, their refreshes, those under plan noise, and Gabriel failures; beside what the paper's text says."""
    rows = {name: _totals(collect_study(name).records) for name in ("table1", "table2", "bowls")}
    rows["all"] = {name: sum(row[name] for row in rows.values()) for name in rows["table1"]}
    table = {name: {key: str(each) for key, each in row.items()} for name, row in rows.items()}
    printed = published("plans").set_index("quantity")["printed"]
    table["paper, logged"] = {
        "refreshes": f"{printed['logged_refreshes']}+",
        "of them noisy": printed["noisy_refreshes"],
        "Gabriel failures": printed["gabriel_failures"],
    }
    return blank(pd.DataFrame.from_dict(table, orient="index"))


def _totals(records: Sequence[Mapping]) -> dict[str, int]:
    """Return runs with a matched loss, refreshes, refreshes under plan noise, Gabriel failures."""
    logs = [(record, log) for record in records if len(log := refresh_table(record))]
    noisy = [len(log) for record, log in logs if record["config"]["loss"]["noise"] > 0]
    return {
        "runs": len(logs),
        "refreshes": sum(len(log) for _, log in logs),
        "of them noisy": sum(noisy),
        "Gabriel failures": sum(int(log["gabriel_failures"].sum()) for _, log in logs),
    }


def gabriel_table() -> pd.DataFrame:
    """Return per clean cloud (the analytic shapes and the cylinder, at the study's M, seed 0) how many
    significant pairs there are and how many of them, and of all pairs, are Gabriel-exact in both simplices;
    and how many sample positions a pair pulls on, least to most, per dimension (a component only through its
    death edge). The last row is the paper's."""
    rows = {}
    for row in SHAPES:
        if row.group not in ("analytic", "allocation"):
            continue
        mesh, generator = surface(row.name), stream(0, "bundle-samples")
        points = sample_surface(mesh.vertices, mesh.faces, row.samples, generator)[0]
        floor = measurement_floor(points, 1.0)
        exact, significant, positions = [], [], {}
        for dimension, pairs in enumerate(alpha_persistence(points)):
            passing = passes_gate(points, pairs.death_simplices, pairs.deaths)
            if dimension:
                passing &= passes_gate(points, pairs.birth_simplices, pairs.births)
            exact.append(passing)
            significant.append(pairs.deaths - pairs.births > floor)
            touched = [pairs.birth_simplices, pairs.death_simplices][0 if dimension else 1 :]
            positions[f"positions, H{dimension}"] = _positions(np.hstack(touched))
        exact, significant = np.concatenate(exact), np.concatenate(significant)
        rows[row.name] = {
            "significant pairs": str(int(significant.sum())),
            "of them Gabriel": f"{100 * exact[significant].mean():.0f} %",
            "all pairs": str(len(exact)),
            "of them Gabriel ": f"{100 * exact.mean():.2f} %",
        } | positions
    printed = published("plans").set_index("quantity")["printed"]
    ends = (printed["positions_per_pair_least"], printed["positions_per_pair_most"])
    rows["paper"] = {
        "of them Gabriel": f"{printed['gabriel_percent']} %",
        "positions, H1": "{}–{} in all dimensions".format(*ends),
    }
    return blank(pd.DataFrame.from_dict(rows, orient="index", dtype=object))


def _positions(simplices: np.ndarray) -> str:
    """Return the least and the largest number of different samples per row of (k,m) indices."""
    ordered = np.sort(simplices, axis=1)
    numbers = 1 + (np.diff(ordered, axis=1) > 0).sum(axis=1)
    least, most = int(numbers.min()), int(numbers.max())
    return str(least) if least == most else f"{least}–{most}"


def handover_seed(collected: Collected, shape: str, condition: str = LOSS) -> int:
    """Return the seed of an arm in which recruitment hands its bars over to the matching most completely: the
    largest rise of the matched targets' number from the first quarter of its refreshes to the last; 0 where
    nothing is recorded."""
    rises = {}
    for record in collected.of(shape, condition):
        matched = refresh_table(record)["matched"].to_numpy()
        quarter = max(1, len(matched) // 4)
        rises[key(record)[2]] = matched[-quarter:].mean() - matched[:quarter].mean()
    return max(rises, key=lambda seed: (rises[seed], -seed), default=0)


def plan_figure(collected: Collected, panels: Panels, seed: int = 0) -> Figure:
    """Return the plan composition per refresh, one axes per panel, of the panel's seed or else of `seed`:
    the targets that are matched, recruited and unreached stacked on one another, a line for live bars that
    go to the diagonal; dashed: the number of target bars."""
    figure, axes = new_figure(1, len(panels), PAGE / len(panels), 2.0)
    for axis, (shape, condition, *own) in zip(axes[0], panels, strict=True):
        chosen = own[0] if own else seed
        log = _log(collected, shape, condition, chosen)
        title = f"{shape}, {condition}, seed {chosen}" + ("" if len(log) else f":\n{NOT_RECORDED}")
        label_axis(axis, title, "step", grid=False)
        if not len(log):
            continue
        steps = np.append(log["step"], log["step"].iloc[-1] + log["step"].diff().median())
        below = np.zeros(len(steps))
        for kind, (colour, hatch) in KINDS.items():
            counted = np.append(log[kind], log[kind].iloc[-1])
            if kind == "diagonal":
                if counted.any():
                    axis.step(steps, counted, where="post", color=colour, label=kind, linestyle="-.")
                continue
            style = {"facecolor": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0}
            axis.fill_between(steps, below, below + counted, step="post", label=kind, **style)
            below = below + counted
        mark_value(axis, log["targets"].iloc[0]).set_label("targets")
        axis.set_ylim(0, max(3, below.max() + 0.5))
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlim(0, steps[-1])
    axes[0][0].set_ylabel("target bars in the plan")
    legend_below(figure, 5)
    return figure


def composition_table(collected: Collected, panels: Panels, seed: int = 0) -> pd.DataFrame:
    """Return the figure's numbers: how many refreshes of a panel's seed had which (matched,
    recruited, unreached, diagonal)."""
    rows = []
    for shape, condition, *own in panels:
        log = _log(collected, shape, condition, own[0] if own else seed)
        if len(log):
            counted = log.groupby(list(KINDS)).size().rename("refreshes").reset_index()
            rows.append(counted.assign(shape=shape, condition=condition))
    columns = ["shape", "condition", *KINDS, "refreshes"]
    return pd.concat(rows, ignore_index=True)[columns] if rows else pd.DataFrame(columns=columns)


def _log(collected: Collected, shape: str, condition: str, seed: int) -> pd.DataFrame:
    return next(map(refresh_table, collected.of(shape, condition, seed)), pd.DataFrame())
