"""`python -m paper_artifact sweep STUDY|--scene DIR`: runs a table; what is recorded is not run again."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from paper_artifact.catalogue import BASELINE, get_condition, study_config
from paper_artifact.cli._scene_options import add_scene_arguments, given_of
from paper_artifact.cli.train import audited
from paper_artifact.config import RunConfig, parse_changes
from paper_artifact.errors import InputError
from paper_artifact.files import OWN, RESULTS
from paper_artifact.study.studies import STUDIES, study_configs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "study", nargs="?", help=f"{', '.join(STUDIES)} (paper_artifact/study/studies.py); or --scene"
    )
    parser.add_argument("--shape", action="append", help="only this shape (may be given several times)")
    parser.add_argument(
        "--condition", action="append", help="only this condition (may be given several times)"
    )
    parser.add_argument(
        "--seed", action="append", type=int, help="only this seed (may be given several times)"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help="runs at the same time, one process and one thread each (default: %(default)s)",
    )
    parser.add_argument(
        "--results", type=Path, help="folder with runs/ (default: results/, results/own/ for --scene)"
    )
    parser.add_argument("--device", default="cpu", help="cpu, cuda or auto (default: %(default)s)")
    parser.add_argument(
        "--executor", choices=("process", "dask"), default="process", help="(default: %(default)s)"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="of the Dask scheduler (tcp://host:8786), with --executor dask"
    )
    add_scene_arguments(parser)
    parser.add_argument("--steps", type=int, help="of each run, with --scene")
    parser.add_argument("--betti", metavar="B0,B1,B2", help="for T1 and T2, with --scene")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="changes",
        help="change any other setting, with --scene",
    )
    parser.add_argument("--list", action="store_true", help="only say what is recorded and what is missing")


def configs_from_arguments(arguments: argparse.Namespace) -> list[RunConfig]:
    """Return the runs of a study, or of one scene: every condition with every seed.

    InputError for what is unknown, out of range or belongs to the other.
    """
    given = given_of(arguments)
    if (arguments.study is None) == (given is None):
        raise InputError("give either a study or --scene DIR; see --help")
    if given is None:
        if arguments.steps is not None or arguments.betti is not None or arguments.changes:
            raise InputError("--steps, --betti and --set go with --scene; a study's rows have its settings")
        return study_configs(arguments.study, arguments.shape, arguments.condition, arguments.seed)
    if arguments.shape:
        raise InputError("--shape restricts a study; with --scene leave it out")
    changes = parse_changes(arguments.changes, "--set")
    if arguments.steps is not None:
        changes["steps"] = arguments.steps
    words = {} if arguments.betti is None else parse_changes([f"betti={arguments.betti}"], "--betti")
    found = []
    for seed in arguments.seed or [0]:
        for name in arguments.condition or [BASELINE]:
            loss = get_condition(name).loss
            said = words if loss is not None and loss.kind == "betti" else {}
            config = study_config(arguments.scene, name, seed, loss=said, **changes)
            found.append(audited(replace(config, given=given), ()))
    return found


def run(arguments: argparse.Namespace) -> int:
    """Run the sweep and report failures at the end.

    Returns 0, or 1 when a run failed; InputError goes to the caller.
    """
    from paper_artifact.cli._progress import tqdm
    from paper_artifact.scene.given import is_own
    from paper_artifact.study.estimate import run_name
    from paper_artifact.study.sweep import missing, sweep

    if (arguments.executor == "dask") != bool(arguments.scheduler):
        raise InputError("--executor dask and --scheduler ADDRESS belong together; give both or neither")
    configs = configs_from_arguments(arguments)
    results = arguments.results or (OWN if all(map(is_own, configs)) else RESULTS)
    if arguments.list:
        todo = missing(configs, results)
        for config in todo:
            print(f"missing: {run_name(config)}")
        print(f"{len(configs) - len(todo)} of {len(configs)} runs recorded")
        return 0
    # Without tqdm's own time left, which knows nothing of the steps.
    layout = "{desc} |{bar:20}| {n_fmt}/{total_fmt} runs [{elapsed}]"
    with tqdm(total=1, disable=arguments.quiet, bar_format=layout) as bar:

        def report(text: str, ended: int, total: int) -> None:
            bar.total = total
            bar.set_description(text, refresh=False)
            bar.update(ended - bar.n)
            bar.refresh()

        outcomes = sweep(
            configs,
            results,
            workers=arguments.workers,
            device=arguments.device,
            scheduler=arguments.scheduler,
            report=report,
        )
    failures = [outcome for outcome in outcomes if outcome.failure]
    before = len(configs) - len(outcomes)
    print(f"{len(outcomes) - len(failures)} runs done, {before} were recorded before, {len(failures)} failed")
    for outcome in failures:
        print(f"  {run_name(outcome.config)}: {outcome.failure}")
    return 1 if failures else 0
