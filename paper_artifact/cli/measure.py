"""`python -m paper_artifact measure NAME`: make a measurement that the notebooks read from
`results/measured/`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.report.measured import MEASURED, MEASUREMENTS, write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    summaries = "; ".join(f"{name}: {summary}" for name, (_, summary) in MEASUREMENTS.items())
    parser.add_argument("name", choices=tuple(MEASUREMENTS), help=summaries)
    parser.add_argument(
        "--out",
        type=Path,
        default=MEASURED,
        metavar="DIR",
        help="folder of NAME.csv (default: results/measured)",
    )
    parser.add_argument(
        "--soups",
        type=Path,
        metavar="DIR",
        help="solids, solid_peers: the folder of final soups, named like records; runs that it lacks are "
        "left out (default: results/retrained/soups; solids trains what is missing there)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Return 0 after the measurement is written to its CSV."""
    from paper_artifact.cli._progress import tqdm

    with tqdm(desc=f"measuring {arguments.name}", unit="part", disable=arguments.quiet) as bar:

        def progress(text: str) -> None:
            bar.set_postfix_str(text)
            bar.update()

        path = write(arguments.name, arguments.out, progress, arguments.soups)
    print(f"written: {path}")
    return 0
