"""`InputError`, numbers as arguments, memory that is not available, and words quoted for a shell."""

from __future__ import annotations

import math
import operator
import os
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

# Control characters but tab and line feed, as terminals show them and as bash reads them in $'…'.
CONTROL = {code: f"\\u{code:04x}" for code in (*range(9), *range(11, 32), *range(127, 160))}


FLAG = re.compile(r"--[a-z-]+")  # an option of this program, as its next commands have it


class InputError(ValueError):
    """Bad input. The message is one sentence that names the input and says what to do.

    The command line prints it without a trace and exits with code 1.
    """


def whole(name: str, value: Any, low: int = 0, high: float = math.inf) -> int:
    """Return a whole number of any kind (Python's, numpy's, torch's) as an int.

    Raises InputError, naming it, for all else and for one that is not from `low` to `high`.
    """
    try:
        number = operator.index(value)
    except (TypeError, ValueError, RuntimeError):
        number = low - 1
    if not low <= number <= high:
        limits = f"of at least {low}" if high == math.inf else f"from {low} to {high}"
        raise InputError(f"{name} is {value!r:.60}; give a whole number {limits}")
    return number


def real(value: Any) -> float:
    """Return a number of any kind as a float, NaN for what is none: a range that the caller asks for."""
    try:
        return float(value) if hasattr(value, "__float__") else math.nan  # a text has no __float__
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return math.nan


def as_numbers(values: Any, what: str, advice: str) -> Any:
    """Return `values` as a numpy array of integers or floats, a tensor's without its gradient.

    Raises InputError, a sentence on `what` that ends with `advice`, for other kinds of values and masks.
    """
    import numpy as np

    if isinstance(values, np.ma.MaskedArray):
        raise InputError(f"the mask of {what} would be lost; {advice}, e.g. by np.ma.compress_rows")
    try:
        if hasattr(values, "detach"):
            values = values.detach().cpu()
            values = values.double().numpy() if values.is_floating_point() else values.numpy()
        values = np.asarray(values)
        mixed = values.dtype.kind == "O"
        if mixed and not any(
            isinstance(each, (str, bytes, complex, np.complexfloating)) for each in values.flat
        ):
            values = values.astype(np.float64)
    except (TypeError, ValueError, AttributeError, RuntimeError, OverflowError) as error:
        raise InputError(f"{what} are not numbers ({error}); {advice}") from error
    if values.size and values.dtype.kind not in "iuf":
        raise InputError(f"{what} are not numbers but {values.dtype}; {advice}")
    return values


def _available_memory() -> float:
    """Return the bytes that this process may still take: of the machine, its container and its own limit;
    infinity where the system does not say."""
    found = [math.inf]
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                found.append(1024.0 * int(line.split()[1]))
        most, used = (Path(f"/sys/fs/cgroup/memory.{name}").read_text() for name in ("max", "current"))
        found.append(float(most) - float(used) if most.strip() != "max" else math.inf)
    except (OSError, ValueError, IndexError):
        pass
    try:
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        if limit != resource.RLIM_INFINITY:
            found.append(float(limit - pages * os.sysconf("SC_PAGE_SIZE")))
    except (ImportError, OSError, ValueError):
        pass
    return min(found)


def require_memory(size: float, what: str, advice: str) -> None:
    """Raise InputError when `what` takes at least `size` bytes and fewer are available."""
    available, size = _available_memory(), min(size, 1e300)  # beyond what a float holds, too
    if size > available:
        raise InputError(
            f"{what} takes at least {size / 2**30:.3g} GiB of memory, {available / 2**30:.3g} GiB are "
            f"available; {advice}"
        )


def require_disk(size: int, folder: Path) -> None:
    """Raise InputError when the disk of a folder has less than `size` bytes left, since C libraries that fill
    it end the process."""
    if (free := shutil.disk_usage(folder).free) < size:
        raise InputError(
            f"the disk of {folder} has {free / 2**20:.3g} MiB left, this may take {size / 2**20:.3g}; "
            "free some space, or choose another folder"
        )


def quoted(word: object) -> str:
    """Return a word as bash and zsh read it; one with control characters as $'…', with these escaped. A
    file's name that begins with a dash is given as ./-x, which no program takes for an option."""
    text = str(word)
    if text.startswith("-") and not FLAG.fullmatch(text):
        text = f"./{text}"
    if not any(ord(each) in CONTROL for each in text):
        return shlex.quote(text)
    return "$'" + text.replace("\\", "\\\\").replace("'", "\\'").translate(CONTROL) + "'"
