"""`InputError`, and the refusal of what would take more memory than is available."""

from __future__ import annotations

import math
import os
from pathlib import Path


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
