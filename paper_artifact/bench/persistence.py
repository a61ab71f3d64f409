"""Our alpha persistence beside gudhi's `safe` path, stage by stage, interleaved in one process."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay

from paper_artifact.alpha.persistence import STAGES, fast_persistence, gudhi_persistence
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface


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
CLOUDS: dict[str, Draw] = {"torus": _torus, "soup": _soup, "uniform": _uniform}


def _study_torus(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n area-weighted samples of the study's torus mesh, world units, as targets and bundles are."""
    mesh = surface("torus")
    return sample_surface(mesh.vertices, mesh.faces, n, rng)[0]


STUDY_CLOUDS: dict[str, tuple[str, Draw]] = {  # what notebook 07 shows: name, what it is, how it is drawn
    "torus": ("samples of the study's torus mesh", _study_torus),
    "soup": ("samples of 300 triangles around a torus, as the loss sees them", _soup),
    "smooth torus": ("points of an exact torus", _torus),
}


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
    if draw is None and cloud not in CLOUDS:
        raise InputError(f"unknown cloud {cloud!r}; choose one of {', '.join(CLOUDS)}")
    if min(sizes, default=0) < 100 or repetitions < 1:
        raise InputError("the benchmark needs sizes of at least 100 points and at least one repetition")
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


def growth(rows: list[dict], key: str = "fast_ms") -> tuple[float, float]:
    """Return (p, its standard error) of time ~ M^p: least squares of the logarithms over all rows.

    The error is nan for two rows, which any power fits. Raises InputError for fewer than two sizes.
    """
    if len({row["M"] for row in rows}) < 2:
        raise InputError("a growth exponent needs rows of at least two sizes")
    x, y = (np.log([row[name] for row in rows]) for name in ("M", key))
    x, y = x - x.mean(), y - y.mean()
    exponent = (x @ y) / (x @ x)
    spread = np.square(y - exponent * x).sum() / (len(rows) - 2) / (x @ x) if len(rows) > 2 else np.nan
    return float(exponent), float(np.sqrt(spread))


def growth_text(rows: list[dict], key: str = "fast_ms") -> str:
    """Return `growth` as "0.98 ± 0.05", without the error where there is none."""
    exponent, spread = growth(rows, key)
    return f"{exponent:.2f}" if np.isnan(spread) else f"{exponent:.2f} ± {spread:.2f}"
