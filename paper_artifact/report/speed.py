"""Notebook 07: what a step of training costs against triangles and pixels, a law for it, and whole runs
beside the paper's on its GPU. All on one core, CPU time; a stored table names the machine.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.figure import Figure

from paper_artifact.bench.run import run_row
from paper_artifact.bench.speed import SIZES, TERMS, TRIANGLES, fit_law, law_columns, step_rows
from paper_artifact.catalogue import BASELINE, LOSS, study_config
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.plot import PAGE, new_figure
from paper_artifact.record.environment import host, packages
from paper_artifact.report.kit.figures import MARKS, label_axis, mark_value, plain_log
from paper_artifact.report.kit.published import published

NOT_MEASURED = "not measured: python -m paper_artifact measure speed"


def measure_speed(
    triangles: Sequence[int] = TRIANGLES,
    sizes: Sequence[int] = SIZES,
    repetitions: int = 7,
    runs: int = 3,
    steps: int = STEPS_OF_THE_STUDY,
    progress: Callable[[str], None] | None = None,
    case=None,
) -> pd.DataFrame:
    """Return a row per step (`what` "step": triangles N, image side `size`, views, medians ms and wall_ms of
    `repetitions`) and per condition C0 and C1 of whole runs (`what` "run": medians of `runs` in turn, ms per
    step of the training loop), with this machine's CPU, its load at the end and numba's version; about four
    minutes on an idle core. case: see `bench.speed.step_rows`."""
    told = progress or (lambda text: None)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for row in step_rows(folder, triangles, sizes, repetitions, case):
            rows.append({"what": "step", "repetitions": repetitions, **row})
            told(f"N = {row['N']}, {row['size']} px")
        config = study_config("sphere")
        taken: dict[str, list[dict]] = {BASELINE: [], LOSS: []}
        for turn in range(runs):
            for condition, found in taken.items():
                found.append(run_row("sphere", condition, steps, 1, folder))
                told(f"run {turn + 1} of {runs}, {condition}")
        for condition, found in taken.items():
            cpu, wall = (1e3 * np.median([run[key] for run in found]) / steps for key in ("cpu", "wall"))
            facts = {"N": config.budget, "size": config.size, "views": config.batch, "condition": condition}
            cost = {"steps": steps, "ms": cpu, "wall_ms": wall, "repetitions": runs}
            rows.append({"what": "run", **facts, **cost})
    return pd.DataFrame(rows).assign(
        cpu=host()["cpu"], load=round(os.getloadavg()[0]), numba=packages()["numba"]
    )


def machine(stored: pd.DataFrame) -> str:
    """Return the line that says where the stored times come from."""
    if stored.empty:
        return NOT_MEASURED
    row = stored.iloc[0]
    return (
        f"{row['cpu']}, load {row['load']}, one thread, numba {row['numba']}; medians of "
        f"{row['repetitions']} turns"
    )


def _steps(stored: pd.DataFrame) -> pd.DataFrame:
    return stored[stored["what"] == "step"] if len(stored) else stored


def step_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return CPU ms of a step, image sides down and numbers of triangles across."""
    own = _steps(stored)
    if own.empty:
        return pd.DataFrame({"ms a step": [NOT_MEASURED]}, index=["all sizes"])
    table = own.pivot(index="size", columns="N", values="ms").round(1)
    return table.rename(index="{} px".format, columns="N = {}".format).rename_axis(
        index="image side", columns="ms a step"
    )


def law_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return the constants of ms = a + b·P/1000 + c·N/1000 + d·√(N·P)/1000 (`bench.speed.fit_law`), how far
    it is off over all rows, and what it gives for a step of the study's sphere."""
    own = _steps(stored)
    if len(own) < len(TERMS):
        return pd.DataFrame({"value": [NOT_MEASURED]}, index=["law"])
    constants, residuals = fit_law(own.to_dict("records"))
    config = study_config("sphere")
    study = _predicted(constants, [config.budget], [config.size], [config.batch])
    rows = {
        "a: every step, ms": f"{constants['a']:.2f}",
        "b: ms per 1,000 pixels of the batch's views": f"{constants['b']:.4f}",
        "c: ms per 1,000 triangles": f"{constants['c']:.3f}",
        "d: ms per 1,000 of √(triangles · pixels)": f"{constants['d']:.3f}",
        "off by, root mean square": f"{100 * np.sqrt(np.mean(residuals**2)):.0f} %",
        "off by, at most": f"{100 * np.abs(residuals).max():.0f} %",
        f"a step at N = {config.budget}, {config.size} px": f"{study[0]:.1f} ms",
    }
    return pd.DataFrame({"value": rows})


def _predicted(constants: dict[str, float], triangles, sizes, views) -> np.ndarray:
    pixels = np.asarray(views) * np.asarray(sizes) ** 2
    return law_columns(np.asarray(triangles), pixels) @ [constants[name] for name in TERMS]


def run_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return seconds of whole runs of the sphere, 2,500 steps: ours on one core (training loop, CPU), the
    paper's on its GPU, and what the loss adds."""
    paper = published("cost").set_index("quantity")["printed"]
    ends = [paper[f"photometric_seconds_{end}"] for end in ("low", "high")]
    runs = stored[stored["what"] == "run"].set_index("condition") if len(stored) else stored
    seconds = {
        condition: runs["ms"][condition] * runs["steps"][condition] / 1e3
        for condition in (BASELINE, LOSS)
        if condition in runs.index
    }
    whole = {name: f"{value:.1f} s" for name, value in seconds.items()}
    added = f"{seconds[LOSS] - seconds[BASELINE]:.1f} s" if len(seconds) == 2 else NOT_MEASURED
    return pd.DataFrame(
        {
            "ours, one core": {
                BASELINE: whole.get(BASELINE, NOT_MEASURED),
                LOSS: whole.get(LOSS, NOT_MEASURED),
                "the loss adds": added,
            },
            "paper, GPU": {
                BASELINE: f"{'–'.join(ends)} s",
                LOSS: "",
                "the loss adds": f"{paper['loss_seconds_per_run']} s",
            },
        }
    ).rename_axis("2,500 steps")


def speed_figure(stored: pd.DataFrame) -> Figure:
    """Return a step's milliseconds against pixels (a line per N) and against N (a line per image side), both
    axes logarithmic: points measured, lines the law; dashed: the study's images and the sphere's budget."""
    figure, axes = new_figure(1, 2, PAGE / 2, 3.1)
    own, config = _steps(stored), study_config("sphere")
    if len(own) < len(TERMS):
        for axis in axes[0]:
            axis.set_axis_off()
        axes[0][0].text(0, 0.5, NOT_MEASURED)
        return figure
    constants, _ = fit_law(own.to_dict("records"))
    panels = ((axes[0][0], "size", "N", config.size), (axes[0][1], "N", "size", config.budget))
    for axis, x, line, studied in panels:
        groups = list(own.groupby(line))
        shades = colormaps["viridis"](np.linspace(0, 0.85, len(groups)))
        for number, (value, rows) in enumerate(groups):
            label = f"N = {value:,}" if line == "N" else f"{value} px"
            mark = MARKS[number % len(MARKS)]
            axis.plot(rows[x], rows["ms"], mark, color=shades[number], markersize=4, label=label)
            fine = rows.iloc[[0] * 50].assign(**{x: np.geomspace(rows[x].min(), rows[x].max(), 50)})
            law = _predicted(constants, fine["N"], fine["size"], fine["views"])
            axis.plot(fine[x], law, color=shades[number], linewidth=1)
        words = {"size": "side of the images (pixels)", "N": "triangles N"}
        label_axis(axis, "", words[x], "CPU ms per step (4 views)" if x == "size" else "")
        plain_log(axis)
        plain_log(axis, "x")
        ticks = [value for value in sorted(own[x].unique()) if value != TRIANGLES[-2]]  # too near the next
        axis.set_xticks(ticks, [f"{value:,}" for value in ticks])
        axis.minorticks_off()
        name = f"study: {studied} px" if x == "size" else f"budget N = {studied:,}"
        mark_value(axis, studied, upright=True).set_label(name)
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 3}  # above the data
        axis.legend(title="marks: measured, lines: law", **place)
    return figure
