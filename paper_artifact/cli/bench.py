"""`python -m paper_artifact bench [PART …]`: speed and memory, ratios from one process."""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.errors import InputError

PARTS = ("raster", "run", "persistence", "loss", "peers")  # the last one needs other libraries


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
        "--repetitions", type=int, default=7, help="turns of the part peers (default: %(default)s)"
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

    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        for part in arguments.parts or _default_parts():
            measure = {
                "raster": _raster,
                "run": _run,
                "persistence": _persistence,
                "loss": _loss,
                "peers": _peers,
            }[part]
            measure(Path(folder), arguments)
    return 0


def _default_parts() -> tuple[str, ...]:
    from paper_artifact.bench.peers import PEERS, installed

    return PARTS if any(installed(peer) for peer in PEERS) else PARTS[:-1]


def _raster(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.raster import raster_rows

    print(
        "Photometric step, C0 sphere after 300 steps, N = 1200, 200 px, batch 4; "
        "CPU ms, one thread, median of 15"
    )
    for row in raster_rows(folder):
        ratio = "" if row["ratio"] is None else f"   {row['ratio']:6.1f} × the trainer's"
        print(f"  {row['what']:42s} {row['ms']:9.2f}{ratio}")


def _run(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.run import run_row

    print(f"Whole runs of {arguments.steps} steps, training loop only (no compilation, scene or evaluation)")
    for threads in (1, 2):
        row = run_row("sphere", "C0", arguments.steps, threads, folder)
        stages = ", ".join(f"{name} {value:.1f} s" for name, value in sorted(row["seconds"].items()))
        print(
            f"  sphere C0, {threads} thread(s): {row['cpu']:6.1f} s of CPU = {row['cpu'] / threads:5.1f} s "
            f"per thread, wall {row['wall']:6.1f} s, peak memory {row['peak_mb']:.0f} MB ({stages})"
        )


def _persistence(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.persistence import growth_exponent, persistence_rows
    from paper_artifact.report.cost import CLOUDS

    print("Alpha persistence with birth and death simplices; CPU ms, one thread, medians of 7 in turn")
    for cloud, (what, draw) in CLOUDS.items():
        print(f"  {cloud}: {what}")
        rows = persistence_rows(repetitions=7, cloud=cloud, draw=draw)
        for row in rows:
            print(
                f"    M = {row['M']:6d}   ours {row['fast_ms']:8.1f}   gudhi safe {row['gudhi_ms']:8.1f}   "
                f"{row['ratio']:5.1f} ×"
            )
        print(
            f"    time grows as M^{growth_exponent(rows):.2f} (gudhi "
            f"M^{growth_exponent(rows, 'gudhi_ms'):.2f}, Delaunay tetrahedra "
            f"M^{growth_exponent(rows, 'tetrahedra'):.2f})"
        )
    paper = [f"{_paper('persistence_ms', samples)} ms at M = {samples}" for samples in (2048, 20_000)]
    print(f"  the paper's refresh (torus, its own machine): {', '.join(paper)}")


def _paper(quantity: str, samples: int | None = None) -> str:
    """Return the paper's number of that quantity, at M = `samples` where given, as it is printed."""
    from paper_artifact.report.kit.published import published

    rows = published("cost").query("quantity == @quantity")
    return (rows if samples is None else rows[rows["samples"] == samples])["printed"].item()


def _loss(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.run import run_row
    from paper_artifact.bench.topology import loss_rows, plan_rows

    print(
        "The loss on the sphere's soup after 300 steps, M = 2048; CPU ms, one thread, medians of 15 in turn"
    )
    for row in loss_rows(folder):
        print(f"  {row['what']:48s} {row['ms']:8.2f}   {row['ratio']:6.2f} × the refresh")
    print(
        "Plans of thousands of pulls: points in a cube, a low floor, three target bars; CPU ms, medians of 15"
    )
    for row in plan_rows():
        print(
            f"  M = {row['M']:5d}, {row['pulls']} pulls: refresh {row['refresh_ms']:6.1f} "
            f"(persistence {row['persistence_ms']:6.1f})   frozen step {row['frozen_ms']:6.2f}"
        )
    print(f"What the loss adds to {arguments.steps} steps (one thread, CPU seconds of the training loop)")
    base, with_loss = (
        run_row("sphere", condition, arguments.steps, 1, folder)["cpu"] for condition in ("C0", "C1")
    )
    print(
        f"  sphere C0 {base:.1f} s, C1 {with_loss:.1f} s: + {100 * (with_loss / base - 1):.0f} % "
        f"(paper: {_paper('loss_seconds_per_run')} s beside {_paper('photometric_seconds_low')} to "
        f"{_paper('photometric_seconds_high')} s)"
    )


def _peers(folder: Path, arguments: argparse.Namespace) -> None:
    from paper_artifact.bench.peers import peer_rows

    print(
        "Differentiable alpha diagrams: sum of squared lifetimes of dimension 1 (radii), forward and "
        f"backward to the points;\nCPU ms, one thread, medians of {arguments.repetitions} in turn; "
        "bars, gradient: distance from ours"
    )
    missing: list[str] = []
    for row in peer_rows(repetitions=arguments.repetitions, missing=missing):
        case = f"{row['cloud']:5s} M = {row['M']:5d}  {row['library']:17s}"
        forward = f"forward {row['forward_ms']:8.1f} ({row['forward_ratio']:6.1f} × ours)"
        both = f"backward {row['backward_ms']:8.1f}   both {row['ratio']:7.1f} × ours"
        agreement = f"bars {row['bar_difference']:.0e}   gradient {row['gradient_difference']:.0e}"
        print(f"  {case} {forward}   {both}   {agreement}   [{row['version']}: {row['note']}]", flush=True)
    for line in missing:
        print(f"  {line}")
