"""`python -m paper_artifact train SHAPE|--scene DIR …`: scene → trained soup → record."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from paper_artifact.catalogue import BASELINE, CONDITIONS, shape_row, study_config
from paper_artifact.cli._scene_options import add_scene_arguments, given_of
from paper_artifact.config import STEPS_OF_THE_STUDY, RunConfig, parse_changes
from paper_artifact.errors import InputError
from paper_artifact.topology.statement import NAMES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "shape", nargs="?", help="an analytic shape, the key of an external mesh, or a mesh file"
    )
    add_scene_arguments(parser)
    parser.add_argument(
        "--condition",
        default=BASELINE,
        help="; ".join(f"{each.name}: {each.description}" for each in CONDITIONS).replace("%", "%%")
        + " (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--steps", type=int, default=STEPS_OF_THE_STUDY, help="(default: %(default)s)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="changes",
        help="change any other setting of the run, e.g. --set vertex_lr=0.006 --set budget=900",
    )
    parser.add_argument(
        "--loss",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a setting of the condition's loss, "
        "e.g. --loss rho=0.2 --loss samples=8192 --loss dimensions=1,2; samples=auto with --betti",
    )
    parser.add_argument(
        "--betti",
        metavar="B0,B1,B2",
        help="the shape's topology in words, for T1 and T2: components, loops, voids, e.g. 1,2,1 for a torus "
        "(default: the study's, for a shape of the study)",
    )
    parser.add_argument(
        "--strict", action="store_true", help="stop where the images contradict --betti, instead of a warning"
    )
    parser.add_argument(
        "--results",
        type=Path,
        help="folder for record, soup, scene and checkpoint (default: results/; for one's own mesh or scene "
        "results/own/, which git ignores)",
    )
    parser.add_argument("--device", default="auto", help="cpu, cuda or auto (default: %(default)s)")
    parser.add_argument(
        "--threads",
        type=int,
        default=1,
        help="CPU threads; the result does not depend on it (default: %(default)s)",
    )
    parser.add_argument(
        "--again", action="store_true", help="run even if there is a record of this configuration"
    )


def config_from_arguments(arguments: argparse.Namespace) -> RunConfig:
    """Return the configuration that the command line asks for.

    InputError for what is unknown or out of range.
    """
    given = given_of(arguments)
    if (arguments.shape is None) == (given is None):
        raise InputError("give either a shape (or a mesh file) or --scene DIR; see --help")
    changes = parse_changes(arguments.changes, "--set")
    for name in set(changes) & {"shape", "condition", "seed", "steps", "loss", "given"}:
        raise InputError(f"--set {name} is not taken, since {name} has an argument of its own; see --help")
    loss = parse_changes(arguments.loss, "--loss")
    if arguments.betti is not None:
        if "betti" in loss:
            raise InputError("--betti and --loss betti are one setting; give one of them")
        loss |= parse_changes([f"betti={arguments.betti}"], "--betti")
    config = study_config(
        arguments.scene or arguments.shape,
        arguments.condition,
        arguments.seed,
        loss=loss,
        steps=arguments.steps,
        **changes,
    )
    return replace(config, given=given)


def audited(config: RunConfig, given: Iterable[str]) -> RunConfig:
    """Return `config` with the M and the dimensions that the audit's rule finds for a mesh outside the study.

    Unchanged for a shape of the study, for a loss without a target bundle, and where samples or dimensions
    are among the loss settings `given`. Of a scene, its target's mesh decides; a bundle has both. Says why on
    stderr. Raises InputError when nothing is measurable.
    """
    loss, chosen = config.loss, {"samples", "dimensions"} & {*given}
    shape = config.shape if config.given is None else config.given.target
    if loss is None or loss.kind == "betti" or chosen or shape is None or shape.endswith(".json"):
        return config
    if shape_row(shape):
        return config
    from paper_artifact.audit.measure import audit_mesh
    from paper_artifact.audit.rule import WORKING
    from paper_artifact.scene.find import find_mesh

    mesh = find_mesh(shape, welded=False)
    decision = audit_mesh(mesh, densities=WORKING, first_seed=loss.bundle_seed).decision
    if decision.samples is None:
        why = next((each for each in decision.reasons if each.startswith("0 of")), decision.reasons[-1])
        raise InputError(
            f"nothing of {shape} is measurable at M = {' or '.join(map(str, WORKING))}: {why} "
            f"Train it with condition {BASELINE}, or give an M of your own with --loss samples=M"
        )
    print(*decision.reasons, sep="\n", file=sys.stderr)
    return replace(config, loss=replace(loss, samples=decision.samples, dimensions=decision.dimensions))


def run(arguments: argparse.Namespace) -> int:
    """Train (or find the record) and print the result. Returns 0; InputError goes to the caller."""
    import torch

    from paper_artifact.cli._progress import tqdm
    from paper_artifact.pipeline import audit_remarks, closing_notes, results_of
    from paper_artifact.pipeline import run as run_config
    from paper_artifact.raster.threads import set_thread_count
    from paper_artifact.record.store import config_of, record_path
    from paper_artifact.scene.given import called
    from paper_artifact.train.state import TrainingError

    config = config_from_arguments(arguments)
    if arguments.threads < 1:
        raise InputError(f"--threads must be at least 1, got {arguments.threads}")
    config = audited(config, parse_changes(arguments.loss, "--loss"))
    shown = called(config)
    set_thread_count(arguments.threads)
    torch.set_num_threads(1)
    with tqdm(
        total=config.steps,
        disable=arguments.quiet,
        desc=f"{shown} {config.condition}: compiling, scene",
        unit="step",
    ) as bar:

        def progress(step: int, text: str) -> None:
            bar.set_description(f"{shown} {config.condition}: {text}", refresh=False)
            bar.update(step - bar.n)

        try:
            record = run_config(
                config,
                results=arguments.results,
                progress=progress,
                device=arguments.device,
                again=arguments.again,
                strict=arguments.strict,
                tell=lambda text: bar.write(text, file=sys.stderr),
            )
        except TrainingError as error:
            raise InputError(str(error)) from error
    contradicted, notes = (audit_remarks(record, kind) for kind in ("warnings", "notes"))
    if contradicted and arguments.strict:  # of a run that is recorded, or was resumed behind its audit
        raise InputError(f"strict, and the record holds a warning: {contradicted[0]}")
    summary(record)
    for each in contradicted:
        print(f"warning: {each}")
    for each in notes:
        print(f"note, when the loss set in: {each}")
    for each in closing_notes(record):
        print(f"note, at the end: {each}")
    trained = config_of(record)
    results = arguments.results or results_of(trained)
    path = record_path(trained, results / "runs", record["defaults"])
    print(f"record: {path}")
    if arguments.scene is not None:
        said = "" if arguments.betti is None else f" --betti {arguments.betti}"
        soup, scene = (
            shlex.quote(str(each)) for each in (results / "soups" / f"{path.stem}.npz", arguments.scene)
        )
        print(f"next: python -m paper_artifact solidify {soup} --scene {scene}{said} --out mesh.ply")
    return 0


def summary(record: dict) -> None:
    """Print a record's main numbers, one line."""
    tails, images = record["tails"], record["images"]
    parts = [f"{record['config']['shape']} {record['config']['condition']} seed {record['config']['seed']}"]
    if tails and "mesh" not in record:
        parts.append(counts_text(record["dumps"][-1]))
    elif tails:
        dimension = record["mesh"]["dimension"]
        parts += [
            f"tail bottleneck H{dimension} {tails['bottleneck'][dimension]:.4f}",
            f"counts {tuple(tails['counts'])}",
            f"Chamfer {100 * tails['chamfer']:.3f} %",
        ]
    if "psnr" in images:
        parts.append(f"held-out PSNR {images['psnr']:.2f} dB, SSIM {images['ssim']:.4f}")
    parts += [f"{record['soup']['triangles']} triangles", f"{record['cpu_seconds']:.0f} s of CPU"]
    print("; ".join(parts))


def counts_text(dump: dict) -> str:
    """Return what a soup shows without a ground truth (`evaluate_alone`), in words: per dimension the bars
    beyond the floor, how many floors the shortest of them has, and the longest below."""
    parts = []
    for dimension, (count, margins) in enumerate(zip(dump["counts"], dump["margins"], strict=True)):
        number, (one, more) = count + (dimension == 0), NAMES[dimension]
        kept = [f"{margins[count - 1]:.2f} floors"] if 0 < count <= len(margins) else []
        kept += [f"next {margins[count]:.2f}"] if count < len(margins) else []
        parts.append(f"{number} {one if number == 1 else more} ({', '.join(kept) or 'many'})")
    return ", ".join(parts)
