"""What the command line prints, on any terminal: tables and next commands."""

from __future__ import annotations

import codecs
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from os.path import lexists
from typing import Any, TextIO

from paper_artifact.errors import CONTROL, quoted

# What a terminal that does not know the sign gets in its place.
PLAIN = {
    "×": "x", "–": "-", "—": "-", "…": "...", "←": "<-", "→": "->", "·": "*", "≥": ">=", "≤": "<=", "±": "+-",
    "α": "alpha", "β": "beta", "ε": "eps", "λ": "lambda", "ρ": "rho", "χ": "chi", "σ": "sigma", "′": "'",
}  # fmt: skip


def prepare_streams() -> None:
    """Make stdout and stderr take every text: a closed one takes it to nowhere, one of another encoding
    than UTF-8 gets plain letters for the signs that it lacks. Control characters, as the escape sequences
    that a file's name may hold, are shown as \\u001b, all but tab, line feed and a bar's carriage return.
    When the reader of a pipe goes, the work goes on and prints to nowhere.
    A warning is one line; numpy's, of numbers that are refused or masked afterwards, are not shown."""
    warnings.formatwarning = _one_line
    codecs.register_error("plain", _plain)
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream: Any = getattr(sys, name)
        if stream is None:
            _open_nowhere(number)  # for the programs that are started: a notebook's kernel needs both
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, open to the end
        elif hasattr(stream, "reconfigure") and "write" not in vars(stream):
            stream.reconfigure(errors="plain")
            stream.write = _shown_plainly(stream)


def _open_nowhere(number: int) -> None:
    """Let a descriptor that is closed take what is written to nowhere, also of programs that are started."""
    try:
        os.fstat(number)
    except OSError:
        opened = os.open(os.devnull, os.O_WRONLY)
        if opened != number:
            os.dup2(opened, number)
            os.close(opened)
        os.set_inheritable(number, True)


def to_nowhere(stream: TextIO) -> None:
    """Point a stream whose reader has gone at nothing, so that what is still printed is silent."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    return "" if issubclass(category, RuntimeWarning) else f"warning: {message}\n"


def _shown_plainly(stream: TextIO) -> Callable[[str], int]:
    write = stream.write

    def shown(text: str) -> int:
        bar = text.startswith("\r")
        try:
            return write("\r" * bar + text[bar:].translate(CONTROL))
        except BrokenPipeError:  # the reader (head, less) has gone; files are still to be written
            to_nowhere(stream)
            return len(text)

    return shown


def _plain(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    first = ord(error.object[error.start])
    if 0xDC80 <= first <= 0xDCFF:  # a byte of a file's name that is no text here: as it is
        return bytes([first - 0xDC00]), error.start + 1
    letters = error.object[error.start : error.end]
    texts = (PLAIN.get(each) or each.encode("ascii", "backslashreplace").decode() for each in letters)
    return "".join(texts), error.end


def to_string(heads: Sequence[str], rows: Sequence[Sequence[object]], indent: str = "") -> str:
    """Return a table as aligned text, a line a row below the heads; columns without a text are set right."""
    cells = [[str(cell) for cell in row] for row in (heads, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    right = [
        bool(rows) and not any(isinstance(row[place], str) for row in rows) for place in range(len(heads))
    ]
    return "\n".join(
        indent
        + "  ".join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(row, widths, right, strict=True)
        ).rstrip()
        for row in cells
    )


def next_command(*words: object) -> str:
    """Return the line `next: python -m paper_artifact …`, its words quoted for the shell."""
    return f"next: python -m paper_artifact {' '.join(map(quoted, words))}"


def next_mesh(*words: object) -> str:
    """Return `next_command` of a verb that makes a mesh, with an --out that takes no file's place."""
    return next_command(*words, "--out", free_name("mesh.ply"))


def free_name(name: str) -> str:
    """Return `name`, or else the first of STEM-2.ENDING, STEM-3.ENDING, … that the current folder lacks."""
    stem, dot, ending = name.rpartition(".")
    names = (name, *(f"{stem}-{number}{dot}{ending}" for number in range(2, 1000)))
    return next(each for each in names if not lexists(each))
