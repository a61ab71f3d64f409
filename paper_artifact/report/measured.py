"""Measurements that take too long for a notebook: made once by `python -m paper_artifact measure NAME`, kept in
`results/measured/NAME.csv`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS, write_text

MEASURED = RESULTS / "measured"


class Measurement(NamedTuple):
    """Where the function is (it takes `progress` and returns a DataFrame), and what it measures in one line."""

    module: str
    function: str
    summary: str


MEASUREMENTS = {
    "staircase": Measurement(
        "staircase",
        "measure_all",
        "significant bars and floors of the analytic shapes, M = 512 … 20000, five seeds",
    ),
    "group_wave": Measurement(
        "group_wave",
        "measure_all",
        "staircases of the external shapes, M = 2048 … 20000, 40 seeds at 2048, five at the others",
    ),
    "cost": Measurement(
        "cost", "measure_all", "time and memory of persistence against the number of samples, on this machine"
    ),
    "peers": Measurement(
        "peers",
        "measure_all",
        "differentiable diagrams beside oineus.diff and torch-topological, where installed",
    ),
}


def measure(name: str, folder: Path | str = MEASURED, progress: Callable[[str], None] | None = None) -> Path:
    """Make the measurement `name` and write its CSV (6 significant digits); return the path. Raises InputError for another
    name."""
    _known(name)
    measurement = MEASUREMENTS[name]
    function = getattr(
        importlib.import_module(f"paper_artifact.report.{measurement.module}"), measurement.function
    )
    path = Path(folder) / f"{name}.csv"
    write_text(
        path, function(progress=progress).to_csv(index=False, float_format="%.6g", lineterminator="\n")
    )
    return path


def read(name: str, folder: Path | str = MEASURED) -> pd.DataFrame:
    """Return the stored measurement `name`. Raises InputError, with the command that makes it, when it is missing or cannot be
    read."""
    _known(name)
    path = Path(folder) / f"{name}.csv"
    try:
        return pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot read the measurement {path.name} ({type(error).__name__}); "
            f"make it with `python -m paper_artifact measure {name}`"
        ) from error


def _known(name: str) -> None:
    if name not in MEASUREMENTS:
        raise InputError(f"no measurement is called {name!r}; there are {', '.join(MEASUREMENTS)}")
