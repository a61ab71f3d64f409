"""`python -m paper_artifact run-all`: execute every notebook in name order, then print a table of them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from paper_artifact.notebooks import EXECUTED, FIGURES, NOTEBOOKS, PROFILES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "--profile",
        choices=PROFILES,
        default=PROFILES[0],
        help="recorded: read committed records, train only what is short (default); full: train everything",
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help="only the notebooks whose name starts with NAME; may be given several times",
    )
    parser.add_argument(
        "--refresh",
        action="store_true",
        help="also write outputs and counts back into the notebooks, without times and paths",
    )
    parser.add_argument(
        "--notebooks", type=Path, default=NOTEBOOKS, metavar="DIR", help="where they are (default: notebooks)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=EXECUTED,
        metavar="DIR",
        help="where executed copies go (default: results/executed)",
    )
    parser.add_argument(
        "--figures",
        type=Path,
        default=FIGURES,
        metavar="DIR",
        help="where the notebooks' figures go as SVG (default: results/book/figures)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Execute them all, the ones after a failing one too. Returns 0, or 1 if one failed."""
    from tqdm import tqdm

    from paper_artifact.notebooks import execute, execution_table, notebook_files, own_kernel

    files = notebook_files(arguments.notebooks, arguments.only)
    executions = []
    try:
        with own_kernel(), tqdm(files, desc="run-all", unit="notebook", disable=arguments.quiet) as bar:
            for path in bar:
                bar.set_postfix_str(path.stem)
                executions.append(
                    execute(
                        path,
                        arguments.profile,
                        executed=arguments.out,
                        figures=arguments.figures,
                        refresh=arguments.refresh,
                        quiet=arguments.quiet,
                    )
                )
    finally:  # an interrupted run shows what it did finish
        print(execution_table(executions))
    failed = [each.name for each in executions if each.error]
    print(f"executed copies: {arguments.out}; figures: {arguments.figures}")
    if failed:
        print(
            f"paper_artifact: {len(failed)} of {len(executions)} notebooks failed: {', '.join(failed)}",
            file=sys.stderr,
        )
    return 1 if failed else 0
