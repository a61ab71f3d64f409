"""`InputError`, the refusal of what takes more memory than is available, and words quoted for a shell."""

from __future__ import annotations

import math
import os
import shlex
from pathlib import Path

# Control characters but tab and line feed, as terminals show them and as bash reads them in $'…'.
CONTROL = {code: f"\\u{code:04x}" for code in (*range(9), *range(11, 32), *range(127, 160))}


class InputError(ValueError):
    """Bad input. The message is one sentence that names the input and says what to do.

    The command line prints it without a trace and exits with code 1.
    """


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
    available = _available_memory()
    if size > available:
        raise InputError(
            f"{what} takes at least {size / 2**30:.3g} GiB of memory, {available / 2**30:.3g} GiB are "
            f"available; {advice}"
        )


def quoted(word: object) -> str:
    """Return a word as bash and zsh read it; one with control characters as $'…', with these escaped."""
    text = str(word)
    if not any(ord(each) in CONTROL for each in text):
        return shlex.quote(text)
    return "$'" + text.replace("\\", "\\\\").replace("'", "\\'").translate(CONTROL) + "'"
