"""Notebooks 01, 03, 04, 06, 07, 10, 14 to 19: long measurements, kept in `results/measured/NAME.csv`.

`python -m paper_artifact measure NAME` makes one.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, RESULTS, write_text

MEASURED = RESULTS / "measured"


# name: (function of the report's module of that name, "" where data_scripts/measure has the script; what it
# measures)
MEASUREMENTS = {
    "staircase": (
        "measure_analytic_shapes",
        "significant bars and floors of the analytic shapes, M = 512 … 20000, five seeds",
    ),
    "group_wave": (
        "measure_external_meshes",
        "staircases of the external shapes, M = 2048 … 20000, 40 seeds at 2048, five at the others",
    ),
    "windows": (
        "measure_windows",
        "margins of every bundle's features at the study's densities, 40 seeds, the torus's 200",
    ),
    "cost": ("", "time and memory of persistence against the number of samples, on this machine"),
    "diagrams": (
        "measure_diagrams",
        "every void bar of one sphere seed at the start and at four steps under C0, C1, C2 (trains them)",
    ),
    "deviations": (
        "measure_deviations",
        "the repair gate without decay, and soups sampled with another mean of their opacities",
    ),
    "perfect": (
        "",
        "the score of a perfect surface: the ground truth sampled again, against the target, 20 seeds",
    ),
    "starts": ("measure_starts", "the soups before training, judged like a dump, five seeds of every shape"),
    "speed": (
        "",
        "a training step against triangles and pixels, and whole runs, on one core of this (idle) machine",
    ),
    "photographs": (
        "",
        "the mug of data_scripts/mug from its photographs, C0 and T1, against its true surface (pycolmap)",
    ),
    "dirty": (
        "",
        "bars that noise, outliers and gaps bear in SfM clouds, and what cleaning does to them",
    ),
    "words_cost": (
        "",
        "CPU time of a refresh and a step of C1, T1 and T2 on committed soups, M = 2048 and 8192",
    ),
    "peers": (
        "",
        "differentiable diagrams beside oineus.diff and torch-topological, where installed",
    ),
    "peers_task": (
        "",
        "time until clouds have Betti numbers in words, beside oineus.diff, torch-topological, TopologyLayer",
    ),
    "solids": (
        "",
        "solids of the final soups by offset (--soups DIR, else trains what is missing): topology, Chamfer",
    ),
    "solid_peers": (
        "",
        "voxels with marching cubes, and Poisson (pymeshlab), on the soups in --soups DIR",
    ),
}
OF_SOUPS = ("solids", "solid_peers")  # they take a folder of soups and go on from the table that is there


def write(
    name: str,
    folder: Path | str = MEASURED,
    progress: Callable[[str], None] | None = None,
    soups: Path | None = None,
) -> Path:
    """Make the measurement `name`, write its CSV (6 significant digits) and return the path.

    soups: a folder of final soups, for the names OF_SOUPS. Raises InputError for another name, and for soups
    that it does not take.
    """
    if name not in MEASUREMENTS:
        raise InputError(f"no measurement is called {name!r}; there are {', '.join(MEASUREMENTS)}")
    if soups is not None and (name not in OF_SOUPS or not soups.is_dir()):
        raise InputError(
            f"--soups {soups} is no folder; name one with final soups"
            if name in OF_SOUPS
            else f"{name} takes no --soups; {' and '.join(OF_SOUPS)} do"
        )
    if not MEASUREMENTS[name][0]:
        script = REPOSITORY / "data_scripts" / "measure" / f"{name}.py"
        options = ["--out", str(folder), *(["--soups", str(soups)] if soups else [])]
        subprocess.run([sys.executable, str(script), *options], check=True)
        return Path(folder) / f"{name}.csv"
    module = importlib.import_module(f"paper_artifact.report.{name}")  # only what measures is loaded
    path = Path(folder) / f"{name}.csv"
    table = getattr(module, MEASUREMENTS[name][0])(progress=progress)
    write_text(path, table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))
    return path


def find(name: str, folder: Path | str = MEASURED) -> pd.DataFrame:
    """Return the stored measurement `name`, an empty table where it has not been made yet."""
    return read(name, folder) if (Path(folder) / f"{name}.csv").is_file() else pd.DataFrame()


def read(name: str, folder: Path | str = MEASURED) -> pd.DataFrame:
    """Return the stored measurement `name`. Raises InputError, with the command that makes it, when it cannot
    be read."""
    path = Path(folder) / f"{name}.csv"
    try:
        return pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot read the measurement {path.name} ({type(error).__name__}); "
            f"make it with `python -m paper_artifact measure {name}`"
        ) from error
