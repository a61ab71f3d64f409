"""`bench [PART …]`: speed and memory, ratios from one process; `measure NAME`: a CSV for the notebooks."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from paper_artifact.cli.bars import bar
from paper_artifact.cli.options import Options, Positional, WrongUsage
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.report.measured import MEASURED, MEASUREMENTS, write

PARTS = ("raster", "run", "compile", "reach", "persistence", "loss", "gpu", "peers")  # peers: if installed
SUMMARIES = [f"{name} ({summary})" for name, (_, summary) in MEASUREMENTS.items()]


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
        raise WrongUsage(f"unknown part {unknown}; choose among {PARTS}")
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
    """Return 0 after the measurement is written to its CSV."""
    with bar(desc=f"measuring {options.name}", unit="part", disable=options.quiet) as line:

        def progress(text: str) -> None:
            line.set_postfix_str(text)
            line.update()

        path = write(options.name, options.out, progress, options.soups)
    print(f"written: {path}")
    return 0
