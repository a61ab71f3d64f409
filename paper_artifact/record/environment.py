"""What a run ran on: versions of the libraries it used and the machine, without names or paths."""

from __future__ import annotations

import os
import platform
import resource
import sys
from importlib import metadata
from pathlib import Path

import paper_artifact

LIBRARIES = ("numpy", "scipy", "numba", "torch", "gudhi", "trimesh", "pillow")


def packages() -> dict[str, str | None]:
    """Return the versions of Python, this package and the libraries that decide a run's numbers; None where
    absent."""
    versions: dict[str, str | None] = {
        "python": platform.python_version(),
        "paper_artifact": paper_artifact.__version__,
    }
    for name in LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return versions


def host() -> dict[str, str | int | None]:
    """Return CPU model, visible logical cores, threads the run used, system and peak memory (MiB) so far.

    Threads are those of the CPU kernels if they are loaded, else 1. (Asking numba itself would start its
    thread layer, which changes the number of OpenMP threads that torch uses from then on.)
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    kernels = sys.modules.get("paper_artifact.raster.threads")
    threads = kernels.thread_count() if kernels is not None else 1
    return {
        "cpu": cpu_model(),
        "cores": cores,
        "threads": threads,
        "system": f"{platform.system()} {platform.machine()}",
        "peak_memory_mib": peak_memory_mib(),
    }


def cpu_model() -> str:
    """Return the CPU's model name as the system tells it, else the architecture."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(errors="replace").splitlines() if cpuinfo.is_file() else []
    named = [line.partition(":")[2].strip() for line in lines if line.lower().startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def peak_memory_mib() -> int:
    """Return the process's largest resident size so far in MiB."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(size / (2**20 if sys.platform == "darwin" else 2**10))
