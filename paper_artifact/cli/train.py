"""`python -m paper_artifact train SHAPE …`: scene → trained soup → record."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.catalogue import BASELINE, CONDITIONS, study_config
from paper_artifact.config import STEPS_OF_THE_STUDY, RunConfig, parse_changes
from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument("shape", help="an analytic shape, the key of an external mesh, or a mesh file")
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
        "e.g. --loss rho=0.2 --loss samples=8192 --loss dimensions=1,2",
    )
    parser.add_argument(
        "--results",
        type=Path,
        default=RESULTS,
        help="folder for record, soup, scene and checkpoint (default: results/)",
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
    changes = parse_changes(arguments.changes, "--set")
    for name in set(changes) & {"shape", "condition", "seed", "steps", "loss"}:
        raise InputError(f"--set {name} is not taken, since {name} has an argument of its own; see --help")
    loss = parse_changes(arguments.loss, "--loss")
    return study_config(
        arguments.shape, arguments.condition, arguments.seed, loss=loss, steps=arguments.steps, **changes
    )


def run(arguments: argparse.Namespace) -> int:
    """Train (or find the record) and print the result. Returns 0; InputError goes to the caller."""
    import torch
    from tqdm import tqdm

    from paper_artifact.pipeline import run as run_config
    from paper_artifact.raster.threads import set_thread_count
    from paper_artifact.record.store import config_of, record_path
    from paper_artifact.train.state import TrainingError

    config = config_from_arguments(arguments)
    if arguments.threads < 1:
        raise InputError(f"--threads must be at least 1, got {arguments.threads}")
    set_thread_count(arguments.threads)
    torch.set_num_threads(1)
    with tqdm(
        total=config.steps,
        disable=arguments.quiet,
        desc=f"{arguments.shape} {config.condition}: compiling, scene",
        unit="step",
    ) as bar:

        def progress(step: int, text: str) -> None:
            bar.set_description(f"{arguments.shape} {config.condition}: {text}", refresh=False)
            bar.update(step - bar.n)

        try:
            record = run_config(
                config,
                results=arguments.results,
                progress=progress,
                device=arguments.device,
                again=arguments.again,
            )
        except TrainingError as error:
            raise InputError(str(error)) from error
    summary(record)
    print(f"record: {record_path(config_of(record), arguments.results / 'runs', record['defaults'])}")
    return 0


def summary(record: dict) -> None:
    """Print a record's main numbers, one line."""
    tails, images, dimension = record["tails"], record["images"], record["mesh"]["dimension"]
    parts = [f"{record['config']['shape']} {record['config']['condition']} seed {record['config']['seed']}"]
    if tails:
        parts += [
            f"tail bottleneck H{dimension} {tails['bottleneck'][dimension]:.4f}",
            f"counts {tuple(tails['counts'])}",
            f"Chamfer {100 * tails['chamfer']:.3f} %",
        ]
    parts += [
        f"held-out PSNR {images['psnr']:.2f} dB, SSIM {images['ssim']:.4f}",
        f"{record['soup']['triangles']} triangles",
        f"{record['cpu_seconds']:.0f} s of CPU",
    ]
    print("; ".join(parts))
