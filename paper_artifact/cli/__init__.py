"""The command line: `python -m paper_artifact VERB …`.

Each verb is a module `paper_artifact/cli/<verb>.py` with

    add_arguments(parser: argparse.ArgumentParser) -> None
    run(arguments: argparse.Namespace) -> int            # the exit code

and a row in `VERBS`. A verb's module is imported only when that verb is asked for, so `--help` needs neither
torch nor numba. Verbs marked long carry `--quiet` (arguments.quiet: bool, no progress bar), added here.

Exit codes: 0 done; 1 failed (InputError: one line on stderr, no trace; Ctrl-C likewise); 2 wrong usage.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import NamedTuple

from paper_artifact import __version__
from paper_artifact.errors import InputError
from paper_artifact.files import DISK_BROKEN, DISK_FULL, write_failure

Runner = Callable[[argparse.Namespace], int | None]


class Verb(NamedTuple):
    """One verb of the command line."""

    module: str  # its name in this folder
    summary: str  # what it does, one line
    long: bool = True  # whether it takes long enough for a progress bar


VERBS: dict[str, Verb] = {
    "fetch": Verb(
        "fetch", "download the external meshes at their pinned commits, or read them from a mirror"
    ),
    "photos": Verb("photos", "register photographs (structure from motion) and make a COLMAP scene of them"),
    "scene": Verb(
        "scene", "make a COLMAP scene (views, cameras, SfM cloud) from a named shape or a mesh file"
    ),
    "train": Verb("train", "train a triangle soup on a scene and write its run record"),
    "evaluate": Verb(
        "evaluate", "measure a soup or mesh: diagrams, bottleneck, Chamfer, Hausdorff95, PSNR, SSIM"
    ),
    "export": Verb("export", "write a trained soup as PLY, GLB, PNG renders and a self-contained HTML view"),
    "run-all": Verb(
        "run_all", "execute every notebook in order and print a table of notebook, time and status"
    ),
    "book": Verb("book", "make the book: results, items, figures, tables, 3-D views and notebooks as pages"),
    "bench": Verb("bench", "measure speed and memory; every ratio is taken in one process"),
    "certify": Verb("certify", "certify a mesh's topology by exact simplicial homology"),
    "audit": Verb("audit", "audit one's own mesh: certificate, density staircase, bundle, HTML report"),
    "ingest": Verb("ingest", "turn raw open shells into one closed, certified surface"),
    "solidify": Verb("solidify", "turn a trained soup into one closed, certified, coloured mesh"),
    "sweep": Verb("sweep", "run a table of training runs, resuming what is missing"),
    "measure": Verb("measure", "make a measurement that the notebooks read from results/measured"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line on `argv` (default: the process's arguments) and return the exit code.

    Wrong usage and `--help` raise SystemExit (2 and 0), as argparse does.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    # Only the verb asked for is imported: the first word that is no option names it.
    asked = next((word for word in argv if not word.startswith("-")), None)
    try:
        parser, runners = _parser(asked)
        arguments = parser.parse_args(argv)
        code = int(runners[arguments.verb](arguments) or 0)
        sys.stdout.flush()
        return code
    except InputError as error:
        print(f"paper_artifact: {error}", file=sys.stderr)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("", "paper_artifact"):
            raise
        print(
            f"paper_artifact: the verb '{asked}' needs the Python package '{error.name}', which is not "
            "installed; in a checkout run `bash test.sh` and use .venv/bin/python, "
            "else `pip install '.[study]'`",
            file=sys.stderr,
        )
    except BrokenPipeError:  # the reader (head, less) has gone
        _silence_stdout()
    except OSError as error:
        if error.errno not in DISK_FULL | DISK_BROKEN:
            raise
        print(f"paper_artifact: {write_failure(error.filename or 'the output', error)}", file=sys.stderr)
        _silence_stdout()
    except KeyboardInterrupt:
        print(
            "paper_artifact: interrupted; finished files are complete and the same command can be run again",
            file=sys.stderr,
        )
    return 1


def _silence_stdout() -> None:
    """Point stdout at nothing where it takes nothing any more, so that the last flush is silent."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser(asked: str | None) -> tuple[argparse.ArgumentParser, dict[str, Runner]]:
    """Return the parser and {verb: its `run`}, the latter of the verb asked for alone."""
    parser = argparse.ArgumentParser(
        prog="python -m paper_artifact",
        description="Topology-aware differentiable triangle-soup reconstruction, piece by piece.",
        epilog="`python -m paper_artifact VERB --help` explains a verb. "
        "Exit codes: 0 done, 1 failed, 2 wrong usage.",
    )
    parser.add_argument("--version", action="version", version=f"paper_artifact {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    runners: dict[str, Runner] = {}
    for name, verb in VERBS.items():
        # "resolve": a verb may define --quiet again with words of its own.
        child = verbs.add_parser(
            name,
            help=verb.summary,
            description=verb.summary[0].upper() + verb.summary[1:] + ".",
            conflict_handler="resolve",
        )
        if verb.long:
            child.add_argument("--quiet", action="store_true", help="no progress bar, for logs")
        if name == asked:
            module = _load(name, verb)
            module.add_arguments(child)
            runners[name] = module.run
    return parser, runners


def _load(name: str, verb: Verb) -> ModuleType:
    path = f"paper_artifact.cli.{verb.module}"
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError as error:
        if error.name == path:
            raise InputError(
                f"the verb '{name}' is not part of this version ({__version__}); "
                "`python -m paper_artifact --help` lists the verbs"
            ) from None
        raise
