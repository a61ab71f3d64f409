"""What the parts of `bench` print: a function per part, which takes a folder for scenes and the verb's
arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

MIB = 2**20


@contextmanager
def told_in_place(what: str, arguments: Any) -> Iterator[Callable[[str], None]]:
    """Yield told(text), which shows what a long measurement is doing in one line that vanishes at the end."""
    from tqdm import tqdm

    with tqdm(desc=what, bar_format="{desc} [{elapsed}]", leave=False, disable=arguments.quiet) as bar:
        yield lambda text: bar.set_description(f"{what}: {text}")


def print_raster(folder: Path, arguments: Any) -> None:
    """Print the photometric step: the kernels, the twin, the stages."""
    from paper_artifact.bench.raster import raster_rows

    print(
        "Photometric step, C0 sphere after 300 steps, N = 1200, 200 px, batch 4; "
        "CPU ms, one thread, median of 15"
    )
    for row in raster_rows(folder):
        ratio = "" if row["ratio"] is None else f"   {row['ratio']:6.1f} × the trainer's"
        print(f"  {row['what']:42s} {row['ms']:9.2f}{ratio}")


def print_run(folder: Path, arguments: Any) -> None:
    """Print whole runs on one thread and two, and the step on one and two in turn."""
    from paper_artifact.bench.run import run_row
    from paper_artifact.bench.speed import thread_rows

    print(f"Whole runs of {arguments.steps} steps, training loop only (no compilation, scene or evaluation)")
    for threads in (1, 2):
        with told_in_place(f"sphere C0, {threads} thread(s)", arguments):
            row = run_row("sphere", "C0", arguments.steps, threads, folder)
        stages = ", ".join(f"{name} {value:.1f} s" for name, value in sorted(row["seconds"].items()))
        print(
            f"  sphere C0, {threads} thread(s): CPU {row['cpu']:6.1f} s, wall {row['wall']:6.1f} s, "
            f"peak memory {row['peak_mb']:.0f} MiB ({stages})"
        )
    paper = "–".join(_paper(f"photometric_seconds_{end}") for end in ("low", "high"))
    print(f"  the paper's, on its GPU: {paper} s")
    print("One step of the sphere after 300, in turn on one thread and two, one process; medians of 15, ms")
    for row in thread_rows(folder):
        print(
            f"  {row['size']:4d} px, {row['threads']} thread(s): wall {row['wall_ms']:8.2f}   "
            f"CPU {row['cpu_ms']:8.2f}   {row['speedup']:.2f} × as fast as one"
        )


def print_compile(folder: Path, arguments: Any) -> None:
    """Print what compilation costs, and that a second process compiles nothing."""
    from paper_artifact.bench.compilation import compilation_rows

    print("Every kernel used once, each line a process of its own (imports included); CPU and wall seconds")
    with told_in_place("compiling", arguments) as told:
        rows = compilation_rows(told)
    for row in rows:
        said = f", told {row['notices']} time(s)" if row["notices"] else ""
        print(
            f"  {row['what']:18s} CPU {row['cpu']:6.1f}   wall {row['wall']:6.1f}   {row['kernels']} kernels "
            f"kept, {row['compiled']} compilations, {row['loaded']} loaded{said}"
        )
    if rows[0]["unused"]:
        print(f"  not compiled here: {', '.join(rows[0]['unused'])}")
    print(f"  compilation alone, first less second: {rows[0]['cpu'] - rows[1]['cpu']:.1f} s of CPU")


def print_reach(folder: Path, arguments: Any) -> None:
    """Print peak memory with many photographs, and the cost of a step against triangles and pixels."""
    from paper_artifact.bench.reach import PHOTOGRAPHS, photographs_row
    from paper_artifact.bench.speed import fit_law, law_text, step_rows

    print("Peak memory of training on synthetic photographs, N = 15,000, one thread; MiB")
    for views, size, most in PHOTOGRAPHS:
        with told_in_place(f"{views} photographs of {size} px", arguments) as told:
            row = photographs_row(folder, views, size, told=told)
        print(
            f"  {views:3d} of {size:4d} px ({views * 3 * size**2 / MIB:4.0f} as bytes): "
            f"{row['loaded_mb']:5d} after loading, {row['peak_mb']:5d} at most (asked for: {most})"
        )
    print(
        f"One step (batch 4, optimisers included) of the sphere's soup cut to N triangles; "
        f"CPU ms, one thread, medians of {arguments.repetitions}"
    )
    rows = []
    for row in step_rows(folder, repetitions=arguments.repetitions):
        rows.append(row)
        print(f"  {row['size']:4d} px, N = {row['N']:6d}: {row['ms']:8.2f}", flush=True)
    print(f"  {law_text(*fit_law(rows))}")


def print_persistence(folder: Path, arguments: Any) -> None:
    """Print our persistence beside gudhi's, how both grow, and one large cloud."""
    from paper_artifact.bench.persistence import STUDY_CLOUDS, growth_text, persistence_rows
    from paper_artifact.bench.reach import large_row

    turns = arguments.repetitions
    print(f"Alpha persistence with birth and death simplices; CPU ms, one thread, medians of {turns} in turn")
    for cloud, (what, draw) in STUDY_CLOUDS.items():
        print(f"  {cloud}: {what}")
        rows = persistence_rows(repetitions=turns, cloud=cloud, draw=draw)
        for row in rows:
            print(
                f"    M = {row['M']:6d}   ours {row['fast_ms']:8.1f}   gudhi safe {row['gudhi_ms']:8.1f}   "
                f"{row['ratio']:5.1f} ×"
            )
        print(
            f"    time grows as M^p, p = {growth_text(rows)} (gudhi {growth_text(rows, 'gudhi_ms')}, "
            f"Delaunay tetrahedra {growth_text(rows, 'tetrahedra')}), fitted over all sizes"
        )
    paper = [f"{_paper('persistence_ms', samples)} ms at M = {samples}" for samples in (2048, 20_000)]
    print(f"  the paper's refresh (torus, its own machine): {', '.join(paper)}")
    with told_in_place("one million points", arguments) as told:
        row = large_row(told=told)
    print(
        f"  ours, {row['cloud']}, M = {row['M']}: CPU {row['cpu']:.1f} s, wall {row['wall']:.1f} s, "
        f"peak memory {row['peak_mb']} MiB"
    )


def _paper(quantity: str, samples: int | None = None) -> str:
    """Return the paper's number of that quantity, at M = `samples` where given, as it is printed."""
    from paper_artifact.results import published

    rows = published("cost").query("quantity == @quantity")
    return (rows if samples is None else rows[rows["samples"] == samples])["printed"].item()


def print_loss(folder: Path, arguments: Any) -> None:
    """Print a refresh, a frozen step, plans of thousands of pulls, and what the loss adds to a run."""
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


def print_gpu(folder: Path, arguments: Any) -> None:
    """Print the GPU memory of C0 and C1 on the torus beside the paper's, or that there is no GPU."""
    from paper_artifact.bench.gpu import gpu_is_here, memory_row
    from paper_artifact.results import published

    if not gpu_is_here():
        print("GPU memory (App. H): not measured, no NVIDIA GPU here")
        return
    printed = published("cost").query("quantity == 'gpu_memory_mib'").set_index("condition")["printed"]
    print(f"GPU memory in use on the torus, {arguments.steps} steps, every 400 ms; MiB")
    for condition in ("C0", "C1"):
        with told_in_place(f"torus {condition} on the GPU", arguments):
            row = memory_row(condition, folder, arguments.steps)
        print(
            f"  {condition}: {row['peak_mib']} at most, {row['before_mib']} before, "
            f"{row['allocated_mib']:.0f} allocated by torch (paper: {printed[condition]})"
        )


def print_peers(folder: Path, arguments: Any) -> None:
    """Print differentiable diagrams beside other libraries'."""
    from paper_artifact.bench.peers import peer_rows
    from paper_artifact.bench.words_task import task_rows

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
    print(
        "Betti numbers in words: CPU seconds of Adam's steps until the cloud has them (T2's loss, one thread)"
    )
    unable: list[str] = []
    for row in task_rows(missing=unable):
        reached = "not reached" if row["step"] is None else f"held from step {row['step']:3d}"
        ratio = "" if row["ratio"] is None else f"   {row['ratio']:6.1f} × BettiLoss"
        print(
            f"  {row['task']:17s} {row['library']:33s} {reached}   {row['seconds']:7.2f} s   "
            f"{row['ms']:7.1f} ms a step{ratio}",
            flush=True,
        )
    for line in dict.fromkeys(missing + unable):
        print(f"  {line}")
