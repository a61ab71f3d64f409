"""Our alpha persistence beside gudhi's `safe` path, stage by stage, interleaved in one process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import Delaunay

from paper_artifact.alpha.persistence import STAGES, fast_persistence, gudhi_persistence
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream


def _torus(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n points on the torus of radii 1 and 0.4."""
    u, v = rng.random((2, n)) * 2 * np.pi
    return np.column_stack(
        [(1 + 0.4 * np.cos(v)) * np.cos(u), (1 + 0.4 * np.cos(v)) * np.sin(u), 0.4 * np.sin(v)]
    )


def _soup(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n uniform samples on 300 random triangles around the torus, of edge about 0.2: many coplanar."""
    corners = _torus(300, rng)[:, None] + 0.1 * rng.normal(size=(300, 3, 3))
    return np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], n), corners[rng.integers(0, 300, n)])


def _uniform(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n points in the unit cube."""
    return rng.random((n, 3))


Draw = Callable[[int, np.random.Generator], np.ndarray]
LARGE = 1_000_000  # points of the large cloud
CLOUDS: dict[str, Draw] = {"torus": _torus, "soup": _soup, "uniform": _uniform}


def persistence_rows(
    sizes: tuple[int, ...] = (2048, 4096, 8192, 20000),
    repetitions: int = 7,
    cloud: str = "torus",
    draw: Draw | None = None,
) -> list[dict]:
    """Return one row per cloud size M: CPU milliseconds of one process, and ratios.

    Times are medians over `repetitions` in which the two methods take turns.
    cloud: one of CLOUDS, or any name if `draw` is given: draw(M, generator) returns points (M,3) float64.
    Keys: cloud, M, tetrahedra (of the Delaunay triangulation: the size of what is computed; by scipy),
    gudhi_ms, fast_ms, ratio (gudhi / fast) for all of it, ratio_without_pairs (leaving out the last stage,
    which costs gudhi a Python loop over the pairs), and for each stage of delaunay, filtration, reduction,
    pairs: gudhi_STAGE_ms, fast_STAGE_ms, ratio_STAGE. gudhi's simplex tree is built within its filtration
    stage. Compilation is done before the clock starts.

    Raises InputError for an unknown cloud, a size below 100, or fewer than one repetition.
    """
    _check(cloud, draw, sizes, repetitions)
    fast_persistence(_uniform(100, stream(0, "persistence benchmark warm-up")))
    rows = []
    for size in sizes:
        points = (draw or CLOUDS[cloud])(size, stream(0, f"persistence benchmark {cloud}", size))
        clocks: dict[str, list[dict[str, float]]] = {"gudhi": [], "fast": []}
        for _ in range(repetitions):
            for name, persistence in (("gudhi", gudhi_persistence), ("fast", fast_persistence)):
                clock: dict[str, float] = {}
                start = time.process_time()
                persistence(points, clock)
                clock["total"] = time.process_time() - start
                clocks[name].append(clock)
        median = {
            k: {s: 1e3 * float(np.median([c[s] for c in v])) for s in (*STAGES, "total")}
            for k, v in clocks.items()
        }
        gudhi, fast = median["gudhi"], median["fast"]
        tetrahedra = len(Delaunay(points).simplices)
        row = {
            "cloud": cloud,
            "M": size,
            "tetrahedra": tetrahedra,
            "gudhi_ms": gudhi["total"],
            "fast_ms": fast["total"],
        }
        row["ratio"] = gudhi["total"] / fast["total"]
        row["ratio_without_pairs"] = (gudhi["total"] - gudhi["pairs"]) / (fast["total"] - fast["pairs"])
        for s in STAGES:
            row |= {
                f"gudhi_{s}_ms": gudhi[s],
                f"fast_{s}_ms": fast[s],
                f"ratio_{s}": gudhi[s] / max(fast[s], 1e-6),
            }
        rows.append(row)
    return rows


class Growth(NamedTuple):
    """A law time ~ M^exponent, fitted on logarithmic axes."""

    exponent: float
    error: float  # standard error of the exponent; nan for two rows, which leave nothing to judge by


def growth_exponent(rows: Sequence[Mapping], key: str = "fast_ms") -> Growth:
    """Return the exponent of row[key] ~ row["M"]^p by least squares over all rows, with its standard error.

    Raises InputError for fewer than two sizes.
    """
    if len({row["M"] for row in rows}) < 2:
        raise InputError("a growth exponent needs rows of at least two sizes")
    size, value = (np.log([row[name] for row in rows]) for name in ("M", key))
    size = size - size.mean()
    spread = (size**2).sum()
    exponent = (size * value).sum() / spread
    residual = value - value.mean() - exponent * size
    freedom = len(rows) - 2
    error = np.sqrt((residual**2).sum() / freedom / spread) if freedom else np.nan
    return Growth(float(exponent), float(error))


_CHILD = """
import json, resource, sys, time
from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.bench.persistence import CLOUDS
from paper_artifact.randomness import stream
cloud, size = json.loads(sys.argv[1])
draw = CLOUDS[cloud]
alpha_persistence(draw(100, stream(0, "persistence benchmark warm-up")))  # compiles or loads the kernels
points = draw(size, stream(0, f"persistence benchmark {cloud}", size))
start = time.process_time()
say = lambda stage: print(f"{time.process_time() - start:.1f} s {stage}", flush=True)
bars = alpha_persistence(points, progress=say)
seconds = time.process_time() - start
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"seconds": seconds, "peak_mb": peak, "bars": [len(each) for each in bars]}))
"""


def large_row(size: int = LARGE, cloud: str = "soup", progress: Callable[[str], None] | None = None) -> dict:
    """Return {cloud, M, seconds, peak_mb, bars} of one large cloud in a process of its own, CPU seconds and
    MiB.

    cloud: one of CLOUDS; progress: called with a line as each stage begins. Raises InputError for an unknown
    cloud or a size below 100, RuntimeError with the child's last line when it fails.
    """
    _check(cloud, None, (size,), 1)
    command = [sys.executable, "-c", _CHILD, json.dumps([cloud, size])]
    last = "no message"
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as child:
        for line in child.stdout or ():
            last = line.strip()
            if progress is not None and not last.startswith("{"):
                progress(f"{cloud}, M = {size}: {last}")
    if child.returncode:
        raise RuntimeError(f"the benchmark of a large cloud failed: {last}")
    return {"cloud": cloud, "M": size, **json.loads(last)}


def _check(cloud: str, draw: Draw | None, sizes: Sequence[int], repetitions: int) -> None:
    if draw is None and cloud not in CLOUDS:
        raise InputError(f"unknown cloud {cloud!r}; choose one of {', '.join(CLOUDS)}")
    if min(sizes, default=0) < 100 or repetitions < 1:
        raise InputError("the benchmark needs sizes of at least 100 points and at least one repetition")
