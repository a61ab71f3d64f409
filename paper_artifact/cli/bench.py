"""`python -m paper_artifact bench [raster] [run] [persistence]`: speed and memory, ratios from one process."""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from paper_artifact.errors import InputError

PARTS = ("raster", "run", "persistence", "loss")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"what to measure: {', '.join(PARTS)} (default: all)")
    parser.add_argument("--steps", type=int, default=2500, help="steps of the whole runs (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Print the measurements. Returns 0; InputError for an unknown part or steps below 1."""
    unknown = sorted(set(arguments.parts) - set(PARTS))
    if unknown or arguments.steps < 1:
        raise InputError(f"unknown part {', '.join(unknown)}; choose among {', '.join(PARTS)}" if unknown else
                         f"--steps must be at least 1, got {arguments.steps}")
    os.environ["OMP_NUM_THREADS"] = "1"
    import torch

    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        for part in arguments.parts or PARTS:
            {"raster": _raster, "run": _run, "persistence": _persistence, "loss": _loss}[part](Path(folder), arguments)
    return 0


def _raster(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.raster import raster_rows

    print("Photometric step, C0 sphere after 300 steps, N = 1200, 200 px, batch 4; CPU ms, one thread, median of 15")
    for row in raster_rows(folder):
        ratio = "" if row["ratio"] is None else f"   {row['ratio']:6.1f} × the trainer's"
        print(f"  {row['what']:42s} {row['ms']:9.2f}{ratio}")


def _run(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.run import run_row

    print(f"Whole runs of {arguments.steps} steps, training loop only (no compilation, scene or evaluation)")
    for threads in (1, 2):
        row = run_row("sphere", "C0", arguments.steps, threads, folder)
        stages = ", ".join(f"{name} {value:.1f} s" for name, value in sorted(row["seconds"].items()))
        print(f"  sphere C0, {threads} thread(s): {row['cpu']:6.1f} s of CPU = {row['cpu'] / threads:5.1f} s per thread, "
              f"wall {row['wall']:6.1f} s, peak memory {row['peak_mb']:.0f} MB ({stages})")


def _persistence(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.topology.benchmark import growth_exponent, persistence_rows

    print("Alpha persistence with birth and death simplices; CPU ms, one thread, medians of 7 in turn")
    for cloud in ("torus", "soup"):
        rows = persistence_rows(repetitions=7, cloud=cloud)
        for row in rows:
            print(f"  {cloud:6s} M = {row['M']:6d}   ours {row['fast_ms']:8.1f}   gudhi safe {row['gudhi_ms']:8.1f}   {row['ratio']:5.1f} ×")
        print(f"  {cloud:6s} time grows as M^{growth_exponent(rows):.2f} (gudhi M^{growth_exponent(rows, 'gudhi_ms'):.2f}; "
              "paper 1.05 from 174 ms at 2048 and 1.92 s at 20000)")


def _loss(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.run import run_row
    from paper_artifact.bench.topology import loss_rows

    print("The loss on the sphere's soup after 300 steps, M = 2048; CPU ms, one thread, medians of 15 in turn")
    for row in loss_rows(folder):
        print(f"  {row['what']:48s} {row['ms']:8.2f}   {row['ratio']:6.2f} × the refresh")
    print(f"What the loss adds to a run of {arguments.steps} steps (one thread, CPU seconds of the training loop)")
    base, with_loss = (run_row("sphere", condition, arguments.steps, 1, folder)["cpu"] for condition in ("C0", "C1"))
    print(f"  sphere C0 {base:.1f} s, C1 {with_loss:.1f} s: + {100 * (with_loss / base - 1):.0f} % (paper: +110 to +140 %)")
