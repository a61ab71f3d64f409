"""A training step against triangles and pixels, and whole runs of C0 and C1 in turn, on one core.

Rows "step": triangles N, image side `size`, views, CPU and wall milliseconds, medians. Rows "run": per
condition, milliseconds per step of the training loop, medians of RUNS runs. Notebook 07 reads it. Four
minutes on an idle core; a busy machine gives other numbers.
"""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from common import cpu_name, options, write

from paper_artifact.bench.run import run_row
from paper_artifact.bench.speed import step_rows
from paper_artifact.catalogue import study_config
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.record.environment import packages

TURNS, RUNS = 7, 3


def measured(folder: Path) -> pd.DataFrame:
    """Return the table; scenes are built in `folder`."""
    rows = [{"what": "step", "repetitions": TURNS, **row} for row in step_rows(folder, repetitions=TURNS)]
    taken: dict[str, list[dict]] = {"C0": [], "C1": []}
    for _ in range(RUNS):
        for condition, found in taken.items():
            found.append(run_row("sphere", condition, STEPS_OF_THE_STUDY, 1, folder))
    config = study_config("sphere")
    for condition, found in taken.items():
        seconds = (np.median([run[key] for run in found]) for key in ("cpu", "wall"))
        cpu, wall = (1e3 * each / STEPS_OF_THE_STUDY for each in seconds)
        facts = {"N": config.budget, "size": config.size, "views": config.batch, "condition": condition}
        cost = {"steps": STEPS_OF_THE_STUDY, "ms": cpu, "wall_ms": wall, "repetitions": RUNS}
        rows.append({"what": "run", **facts, **cost})
    machine = {"cpu": cpu_name(), "load": round(os.getloadavg()[0]), "numba": packages()["numba"]}
    return pd.DataFrame(rows).assign(**machine)


if __name__ == "__main__":
    out = options(__doc__).out
    with TemporaryDirectory() as name:
        write(measured(Path(name)), out / "speed.csv")
