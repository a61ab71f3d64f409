"""`python -m paper_artifact train SHAPE|--scene DIR …`: scene → trained soup → record."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from paper_artifact.catalogue import BASELINE, CONDITIONS, shape_row, study_config
from paper_artifact.config import STEPS_OF_THE_STUDY, GivenConfig, RunConfig, parse_changes, with_changes
from paper_artifact.errors import InputError


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


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say which scene of one's own is trained on, and how it is read."""
    group = parser.add_argument_group("one's own photographs, instead of a shape")
    group.add_argument(
        "--scene",
        metavar="DIR",
        help="a COLMAP scene: images/ (undistorted) and sparse/, as COLMAP and the verb scene write "
        "it; transparent pixels and masks/ (white: counts) are taken out",
    )
    group.add_argument(
        "--target",
        metavar="MESH|bundle.json",
        help="what C1 and C2 act towards: a mesh in the scene's own frame, which is also evaluated against, "
        "or a bundle of the verb audit in the scene's unit of length",
    )
    group.add_argument(
        "--downscale", type=float, metavar="F", help="make the photographs smaller by this factor"
    )
    group.add_argument(
        "--background",
        metavar="COLOUR",
        help="white, black, mean (of the photographs) or #rrggbb: where nothing is, as the sky; "
        "(default: the scene's, else white)",
    )
    group.add_argument(
        "--holdout",
        metavar="RULE",
        help="views to judge by: K (every K-th), none, names (a.jpg,b.jpg), or auto: one of about eight, the "
        "one that its neighbours surround most closely, since a walk's extreme views tell nothing "
        "(default: auto; every 8th for scenes of the verb scene)",
    )


def given_of(arguments: argparse.Namespace) -> GivenConfig | None:
    """Return what the options of `add_scene_arguments` say, None without --scene. InputError when they say it
    of no scene."""
    names = ("target", "downscale", "background", "holdout")
    said = {name: value for name in names if (value := getattr(arguments, name)) is not None}
    if arguments.scene is not None:
        return with_changes(GivenConfig(), said)
    if said:
        raise InputError(f"--{' and --'.join(said)} belong to --scene DIR; give the scene's folder too")
    return None


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
    from tqdm import tqdm

    from paper_artifact.pipeline import results_of
    from paper_artifact.pipeline import run as run_config
    from paper_artifact.raster.threads import set_thread_count
    from paper_artifact.record.store import config_of, record_path
    from paper_artifact.train.state import TrainingError

    config = config_from_arguments(arguments)
    if arguments.threads < 1:
        raise InputError(f"--threads must be at least 1, got {arguments.threads}")
    config = audited(config, parse_changes(arguments.loss, "--loss"))
    shown = Path(config.shape).name
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
    contradicted = warnings(record)
    if contradicted and arguments.strict:  # of a run that is recorded, or was resumed behind its audit
        raise InputError(f"strict, and the record holds a warning: {contradicted[0]}")
    summary(record)
    for each in contradicted:
        print(f"warning: {each}")
    trained = config_of(record)
    results = arguments.results or results_of(trained)
    print(f"record: {record_path(trained, results / 'runs', record['defaults'])}")
    return 0


def warnings(record: dict) -> list[str]:
    """Return what a record says against the words that its loss was given."""
    audits = [event for event in record.get("topology") or () if event["event"] == "audit"]
    return [each for event in audits for each in event["warnings"]]


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
    beyond the floor, the shortest of them, and the longest below, in floors."""
    words = ("components", "loops", "voids")
    parts = []
    for name, count, margins in zip(words, dump["counts"], dump["margins"], strict=True):
        last = f"{margins[count - 1]:.2f}" if count else "–"
        following = f"{margins[count]:.2f}" if len(margins) > count else "–"
        parts.append(f"{count + (name == 'components')} {name} (floors: {last}, next {following})")
    return ", ".join(parts)
