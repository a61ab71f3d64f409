"""CPU time of the loss of C1, T1 and T2 on committed soups.

One row per shape, M and design: milliseconds of a refresh (samples, diagram, plan) and of a step between two
(value and gradient to the vertices), medians, and the bars that are pulled. Notebook 16 reads it. One minute.
"""

from common import Clock, needed, options, write

import pandas as pd
import torch

from paper_artifact import results
from paper_artifact.catalogue import study_config
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.record.environment import cpu_model
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.state import Soup, load_soup
from paper_artifact.topology.bundle import build_from_mesh
from paper_artifact.topology.statement import Statement
from paper_artifact.topology.term import TopologyTerm

SHAPES, SAMPLES, DESIGNS = ("bob", "eight"), (2048, 8192), ("C1", "T1", "T2")  # their soups are committed
TURNS, BETWEEN = 5, 10  # refreshes that are timed, steps behind each


def term_of(shape: str, design: str, samples: int) -> TopologyTerm:
    """Return the loss of a run of the study, at M = samples."""
    loss, mesh = study_config(shape, design, loss={"samples": samples}).loss, find_mesh(shape)
    if loss.kind == "betti":
        return TopologyTerm(loss, Statement(loss.betti or (), mesh.diagonal, samples), STEPS_OF_THE_STUDY, 0)
    given = {"shape": shape, "dimensions": loss.dimensions}
    bundle = build_from_mesh(mesh.vertices, mesh.faces, samples, loss.bundle_seed, **given)
    return TopologyTerm(loss, bundle, STEPS_OF_THE_STUDY, 0)


def timed(term: TopologyTerm, soup: Soup) -> dict[str, float]:
    """Return refresh_ms, step_ms and pulled, after one uncounted turn."""
    vertices, opacity = soup.vertices.detach().requires_grad_(True), torch.sigmoid(soup.opacity.detach())
    refreshes, steps = [], []
    for turn in range(TURNS + 1):
        step = STEPS_OF_THE_STUDY // 2 + BETWEEN * turn
        with Clock() as clock:
            term.refresh(step, vertices, opacity)
        refreshes.append(clock.cpu)
        for each in range(BETWEEN):
            with Clock() as clock:
                value = term.value(step + each, vertices, 1.0)
                if value is not None:
                    value.backward()
            steps.append(clock.cpu)
    plan = term.log[-1]["dimensions"].values()
    pulled = sum(each["matched"] + each["recruited"] + each["diagonal"] for each in plan)
    medians = (1e3 * pd.Series(refreshes[1:]).median(), 1e3 * pd.Series(steps[BETWEEN:]).median())
    return {"refresh_ms": medians[0], "step_ms": medians[1], "pulled": pulled, "cpu": cpu_model()}


def measured() -> pd.DataFrame:
    """Return the table."""
    tables, rows = results.load(studies=["table2"]), []
    runs = tables.of("table2").query("condition == 'C0' and seed == 0").set_index("shape")["run"]
    for shape, run in needed(runs, SHAPES, "table2")[[*SHAPES]].items():
        soup = load_soup(tables.soup_path(run))
        for size in SAMPLES:
            for design in DESIGNS:
                key = {"shape": shape, "M": size, "design": design}
                rows.append(key | timed(term_of(shape, design, size), soup))
    return pd.DataFrame(rows)


if __name__ == "__main__":
    folder = options(__doc__).out
    with one_torch_thread():
        write(measured(), folder / "words_cost.csv")
