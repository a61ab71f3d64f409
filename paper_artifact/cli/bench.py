"""`python -m paper_artifact bench [PART …]`: speed and memory, ratios from one process."""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.errors import InputError

PARTS = ("raster", "run", "compile", "reach", "persistence", "loss", "gpu", "peers")  # peers: if installed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "parts",
        nargs="*",
        metavar="PART",
        help=f"what to measure: {', '.join(PARTS)} (default: all; peers only where one is installed)",
    )
    parser.add_argument(
        "--steps", type=int, default=STEPS_OF_THE_STUDY, help="steps of the whole runs (default: %(default)s)"
    )
    parser.add_argument(
        "--repetitions",
        type=int,
        default=7,
        help="turns of the parts reach, persistence and peers (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the measurements. Returns 0; InputError for an unknown part, steps or repetitions below 1."""
    unknown = sorted(set(arguments.parts) - set(PARTS))
    if unknown:
        raise InputError(f"unknown part {', '.join(unknown)}; choose among {', '.join(PARTS)}")
    for name in ("steps", "repetitions"):
        if getattr(arguments, name) < 1:
            raise InputError(f"--{name} must be at least 1, got {getattr(arguments, name)}")
    os.environ["OMP_NUM_THREADS"] = "1"
    import torch

    from paper_artifact.bench.speed import machine_line
    from paper_artifact.cli import _bench_parts as bench_parts

    torch.set_num_threads(1)
    print(f"machine: {machine_line()}")
    with tempfile.TemporaryDirectory() as folder:
        for part in arguments.parts or _default_parts():
            getattr(bench_parts, f"print_{part}")(Path(folder), arguments)
    return 0


def _default_parts() -> tuple[str, ...]:
    from paper_artifact.bench.peers import PEERS, installed

    return PARTS if any(installed(peer) for peer in PEERS) else PARTS[:-1]
