"""`python -m paper_artifact sweep STUDY`: run a study's table of runs; what is recorded is not run again."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS
from paper_artifact.study.studies import STUDIES, study_configs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument("study", help=f"{', '.join(STUDIES)} (paper_artifact/study/studies.py)")
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
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder with runs/ (default: results/)")
    parser.add_argument("--device", default="cpu", help="cpu, cuda or auto (default: %(default)s)")
    parser.add_argument(
        "--executor", choices=("process", "dask"), default="process", help="(default: %(default)s)"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="of the Dask scheduler (tcp://host:8786), with --executor dask"
    )
    parser.add_argument("--list", action="store_true", help="only say what is recorded and what is missing")


def run(arguments: argparse.Namespace) -> int:
    """Run the sweep and report failures at the end.

    Returns 0, or 1 when a run failed; InputError goes to the caller.
    """
    from paper_artifact.cli._progress import tqdm
    from paper_artifact.study.sweep import missing, sweep

    if (arguments.executor == "dask") != bool(arguments.scheduler):
        raise InputError("--executor dask and --scheduler ADDRESS belong together; give both or neither")
    configs = study_configs(arguments.study, arguments.shape, arguments.condition, arguments.seed)
    if arguments.list:
        todo = missing(configs, arguments.results)
        for config in todo:
            print(f"missing: {config.shape} {config.condition} seed {config.seed}")
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
            arguments.results,
            workers=arguments.workers,
            device=arguments.device,
            scheduler=arguments.scheduler,
            report=report,
        )
    failures = [outcome for outcome in outcomes if outcome.failure]
    before = len(configs) - len(outcomes)
    print(f"{len(outcomes) - len(failures)} runs done, {before} were recorded before, {len(failures)} failed")
    for outcome in failures:
        config = outcome.config
        print(f"  {config.shape} {config.condition} seed {config.seed}: {outcome.failure}")
    return 1 if failures else 0
