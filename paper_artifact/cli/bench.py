"""`bench [PART …]`: speed and memory, ratios from one process; `measure NAME`: a CSV for the notebooks."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from paper_artifact.cli.options import Options, Positional, WrongUsage
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.results import MEASURED

PARTS = ("raster", "run", "compile", "reach", "persistence", "loss", "gpu", "peers")  # peers: if installed
# The scripts of data_scripts/measure, and what each measures.
MEASUREMENTS = {
    "staircase": "significant bars and floors of the analytic shapes, M = 512 … 20000, five seeds",
    "group_wave": "staircases of the external shapes, M = 2048 … 20000, 40 seeds at 2048, else five",
    "windows": "margins of every bundle's features at the study's densities, 40 seeds, the torus's 200",
    "cost": "time and memory of persistence against the number of samples, on this machine",
    "diagrams": "every void bar of one sphere seed at five steps under C0, C1, C2 (trains them)",
    "deviations": "the repair gate without decay; soups sampled by another mean of opacities",
    "perfect": "the score of a perfect surface: the ground truth sampled again, against the target, 20 seeds",
    "starts": "the soups before training, judged like a dump, five seeds of every shape",
    "speed": "a training step against triangles and pixels, and whole runs, on one core",
    "photographs": "the mug from its photographs, C0 and T1, against its true surface (pycolmap)",
    "dirty": "bars that noise, outliers and gaps bear in SfM clouds, and what cleaning does to them",
    "words_cost": "CPU time of a refresh and a step of C1, T1 and T2 on committed soups, M = 2048 and 8192",
    "peers": "differentiable diagrams beside oineus.diff and torch-topological, where installed",
    "peers_task": "time until clouds have stated Betti numbers, beside three other libraries",
    "solids": "solids of the final soups by offset (--soups DIR, else trains what is missing)",
    "solid_peers": "voxels with marching cubes, and Poisson (pymeshlab), on the soups in --soups DIR",
}
OF_SOUPS = ("solids", "solid_peers")  # they take a folder of soups
SUMMARIES = [f"{name} ({summary})" for name, summary in MEASUREMENTS.items()]


@dataclass(frozen=True, kw_only=True)
class Bench(Options):
    """Options of `bench`.

    parts PART: what to measure: {PARTS} (default: all; peers only where one is installed)
    steps: steps of the whole runs
    repetitions: turns of the parts reach, persistence and peers
    """

    parts: Positional[tuple[str, ...]] = ()
    steps: Annotated[int, 1] = STEPS_OF_THE_STUDY
    repetitions: Annotated[int, 1] = 7


def bench(options: Bench) -> int:
    """Print the measurements. Returns 0; WrongUsage for an unknown part."""
    unknown = sorted(set(options.parts) - set(PARTS))
    if unknown:
        raise WrongUsage(f"unknown part {', '.join(unknown)}; choose among {', '.join(PARTS)}")
    os.environ["OMP_NUM_THREADS"] = "1"
    import torch

    from paper_artifact.bench.speed import machine_line
    from paper_artifact.cli import _bench_parts as bench_parts

    torch.set_num_threads(1)
    print(f"machine: {machine_line()}")
    with tempfile.TemporaryDirectory() as folder:
        for part in options.parts or _default_parts():
            getattr(bench_parts, f"print_{part}")(Path(folder), options)
    return 0


def _default_parts() -> tuple[str, ...]:
    from paper_artifact.bench.peers import PEERS, installed

    return PARTS if any(installed(peer) for peer in PEERS) else PARTS[:-1]


@dataclass(frozen=True, kw_only=True)
class Measure(Options):
    """Options of `measure`.

    name: {SUMMARIES}
    out DIR: folder of NAME.csv
    soups DIR: solids, solid_peers: the folder of final soups, named like records; runs that it lacks are
        left out (default: results/retrained/soups; solids trains what is missing there)
    """

    name: Positional[Literal[*tuple(MEASUREMENTS)]]
    out: Path = MEASURED
    soups: Path | None = None


def measure(options: Measure) -> int:
    """Run data_scripts/measure/NAME.py, which writes the CSV. Returns its exit code; InputError outside a
    checkout, and for soups that the measurement does not take."""
    script = REPOSITORY / "data_scripts" / "measure" / f"{options.name}.py"
    if not script.is_file():
        raise InputError(f"{script} does not exist; measurements need a checkout of the repository")
    if options.soups is not None and options.name not in OF_SOUPS:
        raise InputError(f"{options.name} takes no --soups; {' and '.join(OF_SOUPS)} do")
    if options.soups is not None and not options.soups.is_dir():
        raise InputError(f"--soups {options.soups} is no folder; name one with final soups")
    soups = ["--soups", str(options.soups)] if options.soups else []
    return subprocess.run([sys.executable, str(script), "--out", str(options.out), *soups]).returncode
