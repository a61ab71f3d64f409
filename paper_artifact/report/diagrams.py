"""Notebook 06: Fig. S1, the live diagrams of one sphere seed over training, with every bar and the start.

Records keep the longest bars of a dump; these three runs are trained once more, and their diagrams kept, by
`python -m paper_artifact measure diagrams`. Births and deaths are radii / D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import in_order, study_config
from paper_artifact.config import RunConfig
from paper_artifact.evaluate.diagram import diagram_of
from paper_artifact.evaluate.scores import Target, soup_samples
from paper_artifact.files import RESULTS
from paper_artifact.pipeline import make_run_term, prepare_scene
from paper_artifact.plot import PAGE, draw_diagram, new_figure
from paper_artifact.randomness import stream
from paper_artifact.report.kit.figures import diagram_handles, legend_below
from paper_artifact.report.kit.records import target_of
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.state import Soup
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.train.loop import train

SHAPE, SEED, CONDITIONS = "sphere", 0, ("C0", "C1", "C2")  # "one sphere seed"; the paper does not say which
STEPS = (0, 200, 700, 1300, 2500)  # 0: the soup before training
SHORTEST = 0.001  # shorter bars are left out, radius / D: about a twentieth of the floor


def measure_diagrams(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return every bar longer than SHORTEST in the judged dimension, a row each: condition, step, floor (of
    the samples), birth, death. Trains three runs, two minutes of CPU."""
    tables = []
    for condition in CONDITIONS:
        tables.append(run_diagrams(study_config(SHAPE, condition, SEED), target_of(SHAPE), STEPS))
        if progress is not None:
            progress(condition)
    return pd.concat(tables, ignore_index=True)


def run_diagrams(
    config: RunConfig, target: Target, steps: Sequence[int] = STEPS, results: Path = RESULTS
) -> pd.DataFrame:
    """Return the bars of one configuration at these of its dump steps and at step 0, as `measure_diagrams`
    does; the run has the bits of `pipeline.run`, and nothing of it is written but its scene."""
    mesh, tables = find_mesh(config.shape), []
    scene, (term, _) = prepare_scene(config, mesh, results / "scenes"), make_run_term(config, mesh)

    def keep(soup: Soup, step: int) -> dict:
        if step in steps:
            tables.append(_bars(soup, step, config, target))
        return {"step": step}

    start = initial_soup(scene.points, max(2, round(config.initial_ratio * config.budget)), config.seed)
    keep(start, 0)
    train(scene, config, term=term, evaluate=keep)
    return pd.concat(tables, ignore_index=True)


def _bars(soup: Soup, step: int, config: RunConfig, target: Target) -> pd.DataFrame:
    """Return the long bars of one soup, from the samples that a dump of that step has."""
    generator = stream(config.seed, "evaluation samples", step)
    corners = soup.vertices.detach().numpy()
    points = soup_samples(corners, soup.corner_opacity(), len(target.samples), generator)
    bars = diagram_of(points, target.diagonal)[target.dimension]
    bars = bars[bars[:, 1] - bars[:, 0] > SHORTEST]
    order = np.lexsort((bars[:, 0], bars[:, 0] - bars[:, 1]))
    return pd.DataFrame(bars[order], columns=["birth", "death"]).assign(
        condition=config.condition, step=step, floor=measurement_floor(points, target.diagonal)
    )[["condition", "step", "floor", "birth", "death"]]


def diagram_figure(stored: pd.DataFrame) -> Figure:
    """Return Fig. S1: the live diagrams under each condition (rows) at the stored steps (columns); large
    dots: bars above the floor of their own samples (as counted), star: the target's significant bar."""
    conditions, steps = in_order(stored["condition"].unique()), sorted(stored["step"].unique())
    figure, axes = new_figure(len(conditions), len(steps), PAGE / len(steps), 1.5, sharex=True, sharey=True)
    target = target_of(SHAPE)
    stars = target.diagram[target.dimension]
    stars = stars[stars[:, 1] - stars[:, 0] > target.floor]
    limit = 1.15 * max(float(stars.max()), float(stored["death"].max()))
    groups = dict(list(stored.groupby(["condition", "step"])))
    for condition, line in zip(conditions, axes, strict=True):
        for step, axis in zip(steps, line, strict=True):
            own = groups[condition, step]
            title = f"{condition}, " + (f"step {step}" if step else "start")
            bars = own[["birth", "death"]].to_numpy()
            draw_diagram(axis, bars, own["floor"].iloc[0], limit, stars, title)
            axis.label_outer()
    for axis in axes[-1]:
        axis.set_xlabel("birth (r / D)")
    for axis in axes[:, 0]:
        axis.set_ylabel("death (r / D)")
    legend_below(figure, 4, diagram_handles())
    return figure


def diagram_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return the figure's numbers per condition and step: birth and death of the longest bar, the death that
    it lacks to the target's, how many bars are drawn, and how many of them are significant."""
    target = target_of(SHAPE)
    bars = target.diagram[target.dimension]
    death = bars[np.argmax(bars[:, 1] - bars[:, 0]), 1]
    rows = {}
    for (condition, step), own in stored.groupby(["condition", "step"]):
        first = own.iloc[(own["death"] - own["birth"]).argmax()]
        rows[condition, f"step {step}" if step else "start"] = {
            "longest bar": f"({first['birth']:.4f}, {first['death']:.4f})",
            "death short by": f"{death - first['death']:.4f}",
            "bars drawn": len(own),
            "significant": int((own["death"] - own["birth"] > own["floor"]).sum()),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["condition", "step"])
