"""`python -m paper_artifact book`: the study as one offline set of pages, results/book/index.html."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.files import RESULTS, write_text
from paper_artifact.notebooks import EXECUTED, NOTEBOOKS

PARTS = 5  # what `build` tells of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "--out", type=Path, default=RESULTS / "book", metavar="DIR", help="its folder (default: results/book)"
    )
    parser.add_argument(
        "--notebooks", type=Path, default=NOTEBOOKS, metavar="DIR", help="where they are (default: notebooks)"
    )
    parser.add_argument(
        "--executed",
        type=Path,
        default=EXECUTED,
        metavar="DIR",
        help="executed copies, taken where they have a notebook's code (default: results/executed)",
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=RESULTS / "runs",
        metavar="DIR",
        help="the records (default: results/runs; of `run-all --profile full`: results/retrained/runs)",
    )
    parser.add_argument(
        "--refresh",
        action="store_true",
        help="also write the README's picture, results/main_result.svg, from the committed records",
    )


def run(arguments: argparse.Namespace) -> int:
    """Build the book and print its path and the verdicts. Returns 0; InputError goes to the caller."""
    from tqdm import tqdm

    from paper_artifact import results
    from paper_artifact.book.build import build
    from paper_artifact.book.main_result import PICTURE, main_runs, picture_svg

    if arguments.refresh:
        write_text(PICTURE, picture_svg(main_runs(results.load())))
    with tqdm(total=PARTS, desc="book", unit="part", disable=arguments.quiet) as bar:

        def report(part: str) -> None:
            bar.set_postfix_str(part)
            bar.update()

        found = build(arguments.out, arguments.notebooks, arguments.executed, arguments.runs, report)
    for item in found:
        print(f"{item.name:<9} {item.word} ({item.tally})")
    print(f"book: {arguments.out / 'index.html'}")
    return 0
