# PYTHON_ARGCOMPLETE_OK
"""The command line: `python -m paper_artifact VERB …`.

A verb is a row of `VERBS`: a function of its options, a dataclass (see `options`), in one of this folder's
modules, which is imported only when the verb is asked for: `--help` needs neither torch nor numba. The
function returns its exit code or, for a verb with --json, (exit code, what is written there).

Exit codes: 0 done; 1 failed (InputError: one line on stderr, no trace; Ctrl-C likewise); 2 wrong usage.
Tab completion: `eval "$(register-python-argcomplete paper-artifact)"`.
"""

from __future__ import annotations

import argparse
import atexit
import errno
import importlib
import json
import logging
import os
import sys
import typing
from collections.abc import Callable, Sequence
from contextlib import ExitStack, redirect_stdout, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from paper_artifact import __version__
from paper_artifact.cli.interrupts import listening
from paper_artifact.cli.options import Options, WrongUsage, add_options, read_options
from paper_artifact.cli.output import prepare_streams, to_nowhere
from paper_artifact.errors import InputError, require_memory
from paper_artifact.files import DISK_BROKEN, DISK_FULL, check_writable, write_failure, write_json

Runner = Callable[[Any], Any]
LEAST_MEMORY = 2.0**28  # bytes; the libraries of a verb take a little more
NO_MEMORY = ("failed to map segment", "allocate memory")  # what a library's import says


VERBS: dict[str, tuple[str, str]] = {  # name: (module.function in this folder, what it does)
    "fetch": (
        "scenes.fetch",
        "download the external meshes at their pinned commits, or read them from a mirror",
    ),
    "photos": (
        "scenes.photos",
        "register photographs (structure from motion) and make a COLMAP scene of them",
    ),
    "reconstruct": (
        "reconstruct.reconstruct",
        "photos, train, export and solidify in one: from photographs to a certified mesh",
    ),
    "scene": (
        "scenes.scene",
        "make a COLMAP scene (views, cameras, SfM cloud) from a named shape or a mesh file",
    ),
    "train": ("runs.train", "train a triangle soup on a scene and write its run record"),
    "evaluate": (
        "soups.evaluate",
        "measure a soup or mesh: diagrams, bottleneck, Chamfer, Hausdorff95, PSNR, SSIM",
    ),
    "export": (
        "soups.export",
        "write a trained soup as PLY, GLB, PNG renders and a self-contained HTML view",
    ),
    "run-all": (
        "notebooks.run_all",
        "execute every notebook in order and print a table of notebook, time and status",
    ),
    "book": (
        "notebooks.book",
        "make the book: results, items, figures, tables, 3-D views and notebooks as pages",
    ),
    "certify": ("meshes.certify", "certify a mesh's topology by exact simplicial homology"),
    "audit": ("meshes.audit", "audit one's own mesh: certificate, density staircase, bundle, HTML report"),
    "ingest": ("solids.ingest", "turn raw open shells into one closed, certified surface"),
    "solidify": ("solids.solidify", "turn a trained soup into one closed, certified, coloured mesh"),
    "sweep": ("runs.sweep", "run a table of training runs, resuming what is missing"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line on `argv` (default: the process's arguments) and return the exit code.

    What argparse refuses, and `--help`, raise SystemExit (2 and 0).
    """
    prepare_streams()
    argv = list(sys.argv[1:] if argv is None else argv)
    asked = _asked(argv)
    with listening() as interrupted:
        try:
            code = _run(argv, asked)
            sys.stdout.flush()
            return code
        except BrokenPipeError:  # the reader (head, less) has gone
            _silence_stdout()
            return 1
        except (Exception, KeyboardInterrupt) as error:
            cause = KeyboardInterrupt() if interrupted else error  # libraries raise another error from it
            text = sentence(cause, asked)
            if text is None:
                raise
            with suppress(BrokenPipeError):
                print(f"paper_artifact: {text}", file=sys.stderr)
            if isinstance(error, OSError):
                _silence_stdout()
            return 2 if isinstance(error, WrongUsage) else 1


def as_script() -> None:
    """Let the script that calls this, from here to its end, end as a verb does: an interrupt and bad input
    are one sentence. To be called before the imports that take long."""
    stack, name = ExitStack(), Path(sys.argv[0]).name
    interrupted = stack.enter_context(listening())
    atexit.register(stack.close)

    def say(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        text = sentence(KeyboardInterrupt() if interrupted else error, name)
        text = text or (str(error) if isinstance(error, OSError) else None)
        if text is None:
            sys.__excepthook__(kind, error, trace)
        else:
            print(f"{name}: {text}", file=sys.stderr)

    sys.excepthook = say


def _run(argv: list[str], asked: str | None) -> int:
    """Run the verb and write what belongs to --json. Returns the exit code."""
    try:
        os.getcwd()
    except FileNotFoundError as error:
        raise InputError("the current folder was deleted; change to one that exists") from error
    if sys.flags.optimize > 1:
        raise WrongUsage("python -OO removes the texts that the options are read from; leave -OO out")
    for name in [*os.environ]:  # kind of window, look of bars: a value that cannot be read ends in a trace
        if name == "MPLBACKEND" or name.startswith("TQDM_"):
            del os.environ[name]
    for name in ("matplotlib", "papermill"):  # of a home that cannot be written, of parameters not declared
        logging.getLogger(name).setLevel(logging.ERROR)
    threads = os.environ.get("NUMBA_NUM_THREADS", "1").strip()
    if threads.lstrip("+-").isdecimal() and int(threads) < 1:
        raise WrongUsage(f"NUMBA_NUM_THREADS is {threads}; unset it, or set it to 1 or more")
    if asked is not None:  # OpenBLAS asks again without end where there is less
        advice = "raise the limit (ulimit -v), or use a larger machine"
        require_memory(LEAST_MEMORY, f"the verb '{asked}'", advice)
    for word in argv:  # argparse makes an empty list of it
        if word.startswith("-") and word.partition("=")[2] == "--":
            raise WrongUsage(f"{word} gives no value; write one behind the =")
    parser, runner = _parser(asked)
    with suppress(ImportError):
        import argcomplete

        argcomplete.autocomplete(parser)  # returns at once unless a shell asks for proposals
    try:
        namespace = parser.parse_args(argv)
    finally:  # --help ends there, and argparse does not say what it could not write
        sys.stdout.flush()
    assert runner is not None  # else argparse refused the verb
    options = read_options(_options_of(runner), namespace)
    file = getattr(options, "json", None)
    if file is not None and str(file) != "-":
        check_writable(file)
    on_stdout = file == Path("-")  # then the text goes to stderr
    with redirect_stdout(sys.stderr if on_stdout else sys.stdout):
        code, value = runner(options) if hasattr(options, "json") else (runner(options), None)
    if on_stdout:
        print(json.dumps(value, indent=1, sort_keys=True, allow_nan=False))
    elif file is not None:
        write_json(file, value)
    return int(code or 0)


def sentence(error: BaseException, asked: str | None) -> str | None:
    """Return what is said of an error of the verb `asked`, None for a fault of this program, which keeps its
    trace."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; finished files are complete and the same command can be run again"
    texts = f"{error} {error.__cause__} {error.__context__}"
    if isinstance(error, MemoryError) or any(words in texts for words in NO_MEMORY):
        return f"the verb '{asked}' needs more memory than there is; ask for less, or use a larger machine"
    if isinstance(error, ModuleNotFoundError):
        if (error.name or "").partition(".")[0] in ("", "paper_artifact"):
            return None
        return (
            f"the verb '{asked}' needs the Python package '{error.name}', which is not installed; in a "
            "checkout run `bash test.sh` and use .venv/bin/python, else `pip install '.[study]'` there"
        )
    if isinstance(error, RuntimeError) and "Symlink loop" in texts:  # pathlib's
        return f"{error}; give a path without it"
    if not isinstance(error, OSError):
        return None
    if error.errno in {*DISK_FULL, *DISK_BROKEN}:
        return str(write_failure(error.filename or "the output", error))
    if error.errno == errno.ENAMETOOLONG:
        return f"the name {str(error.filename)[:60]}… is too long for a file system; give a shorter one"
    if isinstance(error, PermissionError) and error.filename:
        return f"{error.filename}: {error.strerror}; check the rights on it and on the folders above"
    return None


def _silence_stdout() -> None:
    """Point stdout at nothing where it takes nothing any more, so that the last flush is silent."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        to_nowhere(sys.stdout)


def _asked(argv: Sequence[str]) -> str | None:
    """Return the verb that is asked for, or that a shell wants proposals for: the first word that is no
    option."""
    if "_ARGCOMPLETE" in os.environ:
        argv = [word for word in os.environ.get("COMP_LINE", "").split() if word in VERBS]
    return next((word for word in argv if not word.startswith("-")), None)


def _parser(asked: str | None) -> tuple[argparse.ArgumentParser, Runner | None]:
    """Return the parser and the function of the verb that is asked for, whose options alone it knows."""
    parser = argparse.ArgumentParser(
        prog="python -m paper_artifact",
        description="Topology-aware differentiable triangle-soup reconstruction, piece by piece.",
        epilog="`python -m paper_artifact VERB --help` explains a verb. "
        "Exit codes: 0 done, 1 failed, 2 wrong usage.",
    )
    parser.add_argument("--version", action="version", version=f"paper_artifact {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    runner = None
    for name, (place, summary) in VERBS.items():
        child = verbs.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if name == asked:
            module, _, function = place.partition(".")
            runner = getattr(importlib.import_module(f"paper_artifact.cli.{module}"), function)
            add_options(child, _options_of(runner))
    return parser, runner


def _options_of(runner: Runner) -> type[Options]:
    """Return the dataclass of a verb's options: the type of its function's argument."""
    return typing.get_type_hints(runner)["options"]
