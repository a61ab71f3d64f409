"""What is made of the records: `run-all` executes the notebooks, `book` makes pages of them."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from paper_artifact.cli.bars import bar
from paper_artifact.cli.options import Options, WrongUsage, words_of
from paper_artifact.cli.output import next_command, to_string
from paper_artifact.errors import quoted
from paper_artifact.files import RESULTS, write_text
from paper_artifact.notebooks import (
    EXECUTED,
    FIGURES,
    NOTEBOOKS,
    PROFILES,
    Execution,
    execute,
    notebook_files,
    own_kernel,
)

LONGEST_ERROR = 160  # characters of an error in the table
PARTS = 5  # that `book.build.build` names


@dataclass(frozen=True, kw_only=True)
class RunAll(Options):
    """Options of `run-all`.

    profile: recorded: read committed records, train only what is short (default); full: train everything
    only NAME: only the notebooks whose name starts with NAME; may be given several times
    refresh: also write outputs and counts back into the notebooks, without times and paths
    notebooks DIR: where they are
    out DIR: where executed copies go
    figures DIR: where the notebooks' figures go as SVG
    """

    profile: Annotated[str, PROFILES] = PROFILES[0]
    only: list[str] = field(default_factory=list)
    refresh: bool = False
    notebooks: Path = NOTEBOOKS
    out: Path = EXECUTED
    figures: Path = FIGURES


def run_all(options: RunAll) -> int:
    """Execute them all, the ones after a failing one too. Returns 0, or 1 if one failed."""
    files = notebook_files(options.notebooks, options.only)
    executions = []
    try:
        with own_kernel(), bar(files, desc="run-all", unit="notebook", disable=options.quiet) as line:
            for path in line:
                line.set_postfix_str(path.stem)
                executions.append(
                    execute(
                        path,
                        options.profile,
                        executed=options.out,
                        figures=options.figures,
                        refresh=options.refresh,
                        quiet=options.quiet,
                    )
                )
    finally:  # an interrupted run shows what it did finish
        print(execution_table(executions))
    failed = [each.name for each in executions if each.error]
    print(f"executed copies: {options.out}; figures: {options.figures}")
    if failed:
        print(
            f"paper_artifact: {len(failed)} of {len(executions)} notebooks failed: {', '.join(failed)}",
            file=sys.stderr,
        )
        return 1
    print(next_command("book", *words_of(Book(notebooks=options.notebooks, executed=options.out))))
    return 0


def execution_table(executions: list[Execution]) -> str:
    """Return the table notebook / time / status, one line per notebook."""
    rows = []
    for each in executions:
        minutes, seconds = divmod(round(each.seconds, 1), 60)
        short = len(each.error) <= LONGEST_ERROR
        error = each.error if short else each.error[: LONGEST_ERROR - 3] + "..."
        rows.append((each.name, f"{int(minutes):>3}:{seconds:04.1f}", f"FAILED: {error}" if error else "ok"))
    return to_string(("notebook", "  time", "status"), rows)


@dataclass(frozen=True, kw_only=True)
class Book(Options):
    """Options of `book`.

    out DIR: its folder
    notebooks DIR: where they are
    executed DIR: executed copies, taken where they have a notebook's code
    runs DIR: the records (default: results/runs; of `run-all --profile full`: results/retrained/runs)
    refresh: also write the README's picture, results/main_result.svg, from the committed records
    """

    out: Path = RESULTS / "book"
    notebooks: Path = NOTEBOOKS
    executed: Path = EXECUTED
    runs: Path = RESULTS / "runs"
    refresh: bool = False


def book(options: Book) -> int:
    """Build the book and print its path and the verdicts. Returns 0. Raises WrongUsage where --runs is a file
    or may not be read."""
    from paper_artifact import results
    from paper_artifact.book.build import build
    from paper_artifact.book.main_result import PICTURE, main_runs, picture_svg
    from paper_artifact.claims import MISSING

    there = options.runs.exists() or options.runs != RESULTS / "runs"
    if there and not (options.runs.is_dir() and os.access(options.runs, os.R_OK)):
        raise WrongUsage(
            f"--runs {options.runs} is no folder that can be read; give the folder of the records"
        )
    with bar(total=PARTS, desc="book", unit="part", disable=options.quiet) as line:

        def report(part: str) -> None:
            line.set_postfix_str(part)
            line.update()

        found = build(options.out, options.notebooks, options.executed, options.runs, report)
    if options.refresh:
        write_text(PICTURE, picture_svg(main_runs(results.load(folder=PICTURE.parent / "runs"))))
    for item in found:
        print(f"{item.name:<9} {item.word} ({item.tally})")
    print(f"book: {options.out / 'index.html'}")
    if options.runs == RESULTS / "runs" and any(item.word == MISSING for item in found):
        print(next_command("run-all"))
    else:
        print(f"next: python -m webbrowser {quoted(options.out / 'index.html')}")
    return 0
