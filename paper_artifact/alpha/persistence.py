"""Alpha persistence of a point cloud in space: births and deaths as radii, with the simplices that set them.

The alpha filtration gives a Delaunay simplex the squared radius of its smallest circumsphere when no other
point lies inside that sphere (a Gabriel simplex), and otherwise the smallest value among its cofaces
(Edelsbrunner & Mücke 1994; paper, Method). Two methods return the same diagrams: `fast` (our own Delaunay
triangulation, filtration and reduction) and `gudhi` (the oracle: gudhi's AlphaComplex at precision `safe`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from paper_artifact.errors import InputError

# Two squared radii closer than this, relative to the larger, are one value: both methods carry rounding of
# about 1e-15.
ROUNDING = 1e-12

STAGES = ("delaunay", "filtration", "reduction", "pairs")
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Pairs:
    """The k finite bars of one dimension d, in increasing order of birth, then of death."""

    births: np.ndarray  # (k,) float64 RADII: square roots of alpha², in the unit of the points
    deaths: np.ndarray  # (k,) float64 RADII, above the births
    birth_simplices: np.ndarray  # (k, d+1) int64 indices into the points, each row increasing
    death_simplices: np.ndarray  # (k, d+2) int64 indices into the points, each row increasing

    def __len__(self) -> int:
        return len(self.births)

    @property
    def diagram(self) -> np.ndarray:
        """Return births and deaths side by side, (k, 2) float64 radii."""
        return np.column_stack([self.births, self.deaths])


def alpha_persistence(
    points: np.ndarray, method: str = "fast", progress: Progress | None = None
) -> tuple[Pairs, Pairs, Pairs]:
    """Return the finite bars of positive length of the alpha filtration of `points`, dimensions 0, 1, 2.

    points: (n, 3) array, n >= 0, converted to float64; any unit. Births and deaths are radii in the same
    unit. method: "fast" or "gudhi". progress: called with the name of each of STAGES as it begins. A bar
    shorter than rounding (death² - birth² <= 1e-12 death²) counts as empty and is left out. The one connected
    component that never dies is left out as well; no other class is infinite. Exact duplicates of a point are
    one point of the filtration; a simplex names one of them. Small and flat clouds have the well-defined
    answer of their dimension: n = 0 and 1 no bars, 2 points or collinear ones H0 only, 3 points or coplanar
    ones H0 and H1 only. (`fast` hands clouds that span no tetrahedron to gudhi.)

    Raises InputError for another shape, NaN or infinite coordinates, or an unknown method.
    """
    points = check_points(points)
    if method == "fast":
        return fast_persistence(points, progress=progress)
    if method == "gudhi":
        return gudhi_persistence(points, progress=progress)
    raise InputError(f"unknown persistence method {method!r}; choose 'fast' or 'gudhi'")


def check_points(points: np.ndarray) -> np.ndarray:
    """Return `points` as a contiguous (n, 3) float64 array.

    Raises InputError for another shape or coordinates that are not finite.
    """
    try:
        points = np.ascontiguousarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the points are not numbers ({error}); give an (n, 3) array") from error
    if points.shape == (0,):
        points = points.reshape(0, 3)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"the points have shape {points.shape}; give an (n, 3) array")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"point {row} has a coordinate that is not finite; remove such points first")
    return points


def fast_persistence(
    points: np.ndarray, clock: dict[str, float] | None = None, progress: Progress | None = None
) -> tuple[Pairs, Pairs, Pairs]:
    """Return what alpha_persistence does, by our kernels, for points that it has checked.

    A cloud that spans no tetrahedron goes to gudhi. clock: when given, receives the CPU seconds of this
    process for each of STAGES.
    """
    from paper_artifact.alpha.fast import squared_pairs  # compiled code: loaded only where it is used

    stages = _Stages(progress)
    rows = squared_pairs(points, stages.begin)
    if rows is None:
        return gudhi_persistence(points, clock, progress=progress)
    components, loops, voids = (make_pairs(*each) for each in rows)
    stages.end(clock)
    return components, loops, voids


def gudhi_persistence(
    points: np.ndarray,
    clock: dict[str, float] | None = None,
    precision: str = "safe",
    progress: Progress | None = None,
) -> tuple[Pairs, Pairs, Pairs]:
    """Return what fast_persistence does, by gudhi's alpha complex and its pairs over Z/2.

    precision: gudhi's, "safe" or "exact"; predicates are exact in both. `safe` radii are exact to 1e-5
    relative in the worst case (nearly flat tetrahedra, as on a lattice with a jitter of 1e-10, where we saw
    4e-8); the fast path's agree with `exact` to 1e-9 there as well.
    """
    import gudhi  # the oracle, and the path of degenerate clouds: only when needed

    stages = _Stages(progress)
    stages.begin("delaunay")
    complex_ = gudhi.AlphaComplex(points=points, precision=precision)
    stages.begin("filtration")
    tree = complex_.create_simplex_tree()
    stages.begin("reduction")
    rows: tuple[list, list, list] = ([], [], [])
    if tree.num_simplices() > 0:
        tree.compute_persistence(homology_coeff_field=2, min_persistence=0)
        stages.begin("pairs")
        for birth, death in tree.persistence_pairs():
            if death and len(birth) <= 3:
                rows[len(birth) - 1].append((tree.filtration(birth), tree.filtration(death), birth, death))
    components, loops, voids = (_from_rows(rows[dimension], dimension) for dimension in range(3))
    stages.end(clock)
    return components, loops, voids


class _Stages:
    """Which stage runs since when, in CPU seconds of this process."""

    def __init__(self, progress: Progress | None) -> None:
        self.progress = progress
        self.begun: list[tuple[str, float]] = []

    def begin(self, stage: str) -> None:
        """Note that `stage` begins now, and say so."""
        if self.progress is not None:
            self.progress(stage)
        self.begun.append((stage, time.process_time()))

    def end(self, clock: dict[str, float] | None) -> None:
        """Write the seconds of each stage into `clock`, if there is one."""
        if clock is not None:
            ends = [begin for _, begin in self.begun[1:]] + [time.process_time()]
            for (stage, begin), end in zip(self.begun, ends, strict=True):
                clock[stage] = end - begin


def _empty(dimension: int) -> Pairs:
    return make_pairs(
        np.empty(0),
        np.empty(0),
        np.empty((0, dimension + 1), dtype=np.int64),
        np.empty((0, dimension + 2), dtype=np.int64),
    )


def _from_rows(rows: list, dimension: int) -> Pairs:
    if not rows:
        return _empty(dimension)
    births, deaths, birth_simplices, death_simplices = zip(*rows, strict=True)
    return make_pairs(
        np.array(births), np.array(deaths), np.array(birth_simplices), np.array(death_simplices)
    )


def make_pairs(
    births: np.ndarray, deaths: np.ndarray, birth_simplices: np.ndarray, death_simplices: np.ndarray
) -> Pairs:
    """Return the Pairs of SQUARED radii (k,) and simplices: empty bars dropped, rows sorted."""
    keep = np.flatnonzero(deaths - births > ROUNDING * deaths)
    order = keep[np.lexsort((deaths[keep], births[keep]))]
    return Pairs(
        births=np.sqrt(births[order]),
        deaths=np.sqrt(deaths[order]),
        birth_simplices=np.sort(birth_simplices[order].astype(np.int64), axis=1),
        death_simplices=np.sort(death_simplices[order].astype(np.int64), axis=1),
    )
