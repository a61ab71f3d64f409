"""Alpha persistence of a point cloud: births and deaths as radii, with the simplices that set them.

The alpha filtration gives a Delaunay simplex the squared radius of its smallest circumsphere when no other
point lies inside that sphere (a Gabriel simplex), and otherwise the smallest value among its cofaces
(Edelsbrunner & Mücke 1994; paper, Method). Two methods return the same diagrams: `fast` (our own Delaunay
triangulation, filtration and reduction) and `gudhi` (the oracle: gudhi's AlphaComplex at precision `safe`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import wraps
from typing import Any

import numpy as np

from paper_artifact.errors import InputError, as_numbers, real, whole

STAGES = ("delaunay", "filtration", "reduction", "pairs")
LARGEST = 2.0**1020  # of a coordinate: radii and their differences stay finite
NOBODY = -1  # the vertices of a death that does not happen


@dataclass(frozen=True)
class Pairs:
    """The k bars of one dimension d, in increasing order of birth, then of death."""

    births: np.ndarray  # (k,) float64 RADII: square roots of alpha², in the unit of the points
    deaths: np.ndarray  # (k,) float64 RADII, above the births; inf where the class never dies
    birth_simplices: np.ndarray  # (k, d+1) int64 indices into the points, each row increasing
    death_simplices: np.ndarray  # (k, d+2) int64 indices into the points, each row increasing; -1: no death

    def __len__(self) -> int:
        return len(self.births)

    @property
    def diagram(self) -> np.ndarray:
        """Return births and deaths side by side, (k, 2) float64 radii."""
        return np.column_stack([self.births, self.deaths])


def is_batch(points: Any) -> bool:
    """Return whether `points` are several clouds: an array or tensor (b, n, d), or a list of such (n, d)."""
    if isinstance(points, (list, tuple)):
        return any(getattr(each, "ndim", 0) == 2 for each in points)
    return getattr(points, "ndim", 0) == 3


def of_each(function: Callable) -> Any:
    """Return the function of one cloud as a function of a cloud, or of several: then a list, in threads."""

    @wraps(function)
    def call(points: Any, *arguments: Any, **options: Any) -> Any:
        if is_batch(points):
            with ThreadPoolExecutor(os.cpu_count()) as pool:  # the kernels hold no lock
                return list(pool.map(lambda cloud: function(cloud, *arguments, **options), points))
        return function(points, *arguments, **options)

    return call


@of_each
def alpha_persistence(
    points: Any,
    method: str = "fast",
    *,
    infinite: bool = False,
    squared: bool = False,
    max_dimension: int | None = None,
    max_radius: float = np.inf,
    as_given: bool = False,
) -> tuple[Pairs, ...]:
    """Return the bars of positive length of the alpha filtration of `points`, for dimensions 0, 1, 2.

    points: (n, 3) or (n, 2) numbers, n >= 0, converted to float64; any unit; a tensor's gradient is ignored
    (`alpha_diagrams` follows it). Clouds in the plane have the dimensions 0 and 1. A batch (b, n, d) or a
    list of clouds is computed in threads and gives a list of such tuples. method: "fast" or "gudhi".

    Births and deaths are radii in the points' unit, or with `squared` their squares (gudhi's alpha²). A bar
    shorter than rounding (death² - birth² <= 1e-12 death²) counts as empty and is left out. The one connected
    component that never dies is left out unless `infinite`; no other class is infinite. max_dimension: the
    highest dimension returned; 0 is several times faster. max_radius: the filtration ends there: what is born
    later is left out, what lives longer never dies. Exact duplicates of a point are one point of the
    filtration; a simplex names one. Collinear points have bars in H0 only, coplanar ones in H0 and H1 only.

    The same points in another order give the same bits. With `as_given` they are triangulated in the given
    order, which agrees up to rounding: recorded runs do so.

    Raises InputError for another shape, coordinates that are not finite real numbers of at most 2^1020, an
    unknown method or option, or squares beyond the range of float64.
    """
    points = check_points(points)
    top = points.shape[1] - 1
    top = top if max_dimension is None else whole("max_dimension", max_dimension, 0, top)
    for name, value in (("infinite", infinite), ("squared", squared), ("as_given", as_given)):
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"{name} is {value!r:.60}; give True or False")
    limit = real(max_radius)
    if not limit >= 0:
        raise InputError(f"max_radius is {max_radius!r:.60}; give a number of at least 0")
    if not isinstance(method, str) or method not in ("fast", "gudhi"):
        raise InputError(f"unknown persistence method {method!r:.30}; choose 'fast' or 'gudhi'")
    order = np.arange(len(points)) if as_given else canonical_order(points)
    by: Callable = fast_persistence if method == "fast" else gudhi_persistence
    found = by(points[order], top=top, squared=squared, names=order)
    if infinite:
        found = (_with_the_first_component(found[0], points), *found[1:])
    return tuple(_ended(pairs, infinite, limit * limit if squared else limit) for pairs in found)


def canonical_order(points: np.ndarray) -> np.ndarray:
    """Return the order (n,) int64 of `points` (n, d) by their coordinates: the same for every permutation."""
    from paper_artifact.alpha.ordering import sort_keys  # compiled code: loaded only where it is used

    bits = (points[:, 0] + 0.0).view(np.int64)  # of doubles: as integers they increase if not negative
    order = sort_keys((bits ^ (bits >> 63 | np.int64(-(2**63)))).view(np.uint64)).astype(np.int64)
    first = points[order, 0]
    equal = np.zeros(len(points) + 1, dtype=bool)
    equal[1:-1] = first[1:] == first[:-1]
    tied = np.flatnonzero(equal[1:] | equal[:-1])
    order[tied] = order[tied][np.lexsort(points[order[tied]].T[::-1])]
    return order


def check_points(points: Any) -> np.ndarray:
    """Return `points` as (n, 3) or (n, 2) float64, contiguous; raise InputError where they cannot be that."""
    advice = "give an (n, 3) or (n, 2) array of real numbers"
    points = as_numbers(points, "the points", advice)
    points = np.zeros((0, 3)) if points.shape == (0,) else points
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"the points have shape {points.shape}; {advice}")
    points = np.ascontiguousarray(points, dtype=np.float64)
    wrong = ~(np.abs(points) <= LARGEST).all(axis=1)
    if wrong.any():
        row = int(wrong.argmax())
        raise InputError(f"point {row} has a coordinate not finite or beyond 1e307; remove it, or scale all")
    return points


def _stages(clock: dict[str, float] | None) -> Callable[[str], None]:
    """Return begin(stage), which writes the CPU seconds of the stage before into `clock`."""
    running: list[tuple[str, float]] = []

    def begin(stage: str) -> None:
        now = time.process_time()
        if running and clock is not None:
            clock[running[-1][0]] = now - running[-1][1]
        running.append((stage, now))

    return begin


def fast_persistence(
    points: np.ndarray,
    clock: dict[str, float] | None = None,
    top: int = 2,
    squared: bool = False,
    names: np.ndarray | None = None,
) -> tuple[Pairs, ...]:
    """Return the finite bars of dimensions 0 to `top` by our kernels, for points that check_points returned.

    clock: when given, receives the CPU seconds of this process for each of STAGES. names (n,): what the
    simplices call the points.
    """
    from paper_artifact.alpha import complex as alpha_complex  # compiled code: loaded only where it is used

    begin = _stages(clock)
    made = alpha_complex.build(points, begin)
    begin("reduction")
    called = made.names if names is None else names[made.names].astype(np.int32)
    bars = alpha_complex.squared_bars(made, top, called)
    begin("pairs")
    found = [_pairs(each, made.exponent, squared) for each in bars]
    for dimension in range(len(found), top + 1):
        simplices = [np.empty((0, dimension + more), dtype=np.int64) for more in (1, 2)]
        found.append(Pairs(np.empty(0), np.empty(0), *simplices))
    begin("")
    return tuple(found)


def gudhi_persistence(
    points: np.ndarray,
    clock: dict[str, float] | None = None,
    precision: str = "safe",
    top: int = 2,
    squared: bool = False,
    names: np.ndarray | None = None,
) -> tuple[Pairs, ...]:
    """Return what fast_persistence does, by gudhi's alpha complex and its pairs over Z/2.

    precision: "safe" or "exact"; `safe` radii are right to 1e-5 relative at worst (nearly flat tetrahedra).
    """
    import gudhi  # the oracle: only when asked for

    from paper_artifact.alpha.complex import lasting, named

    begin = _stages(clock)
    begin("delaunay")
    exponent = int(np.frexp(np.abs(points).max(initial=0.0))[1])  # gudhi's squares would leave float64
    complex_ = gudhi.AlphaComplex(points=np.ldexp(points, -exponent), precision=precision)
    begin("filtration")
    tree = complex_.create_simplex_tree()
    begin("reduction")
    rows: tuple[list, list, list] = ([], [], [])
    if tree.num_simplices() > 0:
        tree.compute_persistence(homology_coeff_field=2, min_persistence=0)
        begin("pairs")
        for birth, death in tree.persistence_pairs():
            if death and len(birth) <= 3:
                rows[len(birth) - 1].append((tree.filtration(birth), tree.filtration(death), birth, death))
    called = (np.arange(len(points)) if names is None else names).astype(np.int32)
    found = []
    for dimension, each in enumerate(rows[: top + 1]):
        births, deaths, *simplices = zip(*each, strict=True) if each else ((), (), (), ())
        ends = np.array(births, dtype=float), np.array(deaths, dtype=float)
        keep = lasting(*ends)
        corners = (np.array(simplices[i], np.int32).reshape(-1, dimension + 1 + i)[keep] for i in (0, 1))
        bars = ends[0][keep], ends[1][keep], *(named(each, called) for each in corners)
        found.append(_pairs(bars, exponent, squared))
    begin("")
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Filtration:
    """The alpha complex of a cloud without duplicates: simplices of dimensions 0 to 3 and their radii."""

    simplices: tuple[np.ndarray, ...]  # of dimension d: (k, d+1) int64 indices into the points, increasing
    radii: tuple[np.ndarray, ...]  # of dimension d: (k,) float64, unit of the points; never above a coface's
    lengths: np.ndarray  # (e,) float64: of the edges

    def simplex_tree(self) -> Any:
        """Return gudhi's SimplexTree, with SQUARED radii (InputError beyond the range of float64)."""
        import gudhi

        tree = gudhi.SimplexTree()
        for simplices, radii in zip(self.simplices, self.radii, strict=True):
            exponent = int(np.frexp(radii.max(initial=0.0))[1])
            squares = _squares(np.ldexp(radii, -exponent) ** 2, exponent)
            tree.insert_batch(simplices.T.astype(np.int32), squares)
        return tree

    def shortest_loop(self, birth_simplex: np.ndarray) -> np.ndarray:
        """Return the vertices (k,) int64 of a shortest loop through an edge (2,) when that edge enters.

        For a bar of dimension 1 (`Pairs.birth_simplices`) a loop that represents its class when it is born:
        the edge and the shortest path between its ends over edges that entered before. Raises InputError
        where the edge is not in the complex or closes no loop.
        """
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        edges = self.simplices[1]
        u_v = np.sort(as_numbers(birth_simplex, "the vertices", "give an edge (2,)").ravel())
        place = np.flatnonzero((edges == u_v).all(axis=1)) if u_v.shape == (2,) else np.zeros(0, dtype=int)
        if not len(place):
            raise InputError(f"{u_v.tolist()} is no edge of the complex; give one of simplices[1]")
        u_v = u_v.astype(np.int64)  # whole numbers, as they equal an edge's
        before = self.radii[1] <= self.radii[1][place[0]]
        before[place[0]] = False
        count = int(edges.max()) + 1
        graph = csr_array((self.lengths[before], tuple(edges[before].T)), shape=(count, count))
        distance, previous = dijkstra(graph, directed=False, indices=u_v[0], return_predecessors=True)
        if not np.isfinite(distance[u_v[1]]):
            raise InputError(f"edge {u_v.tolist()} closes no loop; give the birth of a bar of dimension 1")
        path = [int(u_v[1])]
        while path[-1] != u_v[0]:
            path.append(int(previous[path[-1]]))
        return np.array(path)


def alpha_filtration(points: Any) -> Filtration:
    """Return the alpha filtration of `points` (n, 3) or (n, 2); raises InputError as alpha_persistence."""
    from paper_artifact.alpha import complex as alpha_complex

    points = check_points(points)
    order = canonical_order(points)
    made = alpha_complex.build(points[order], lambda stage: None)
    names = order[made.names].astype(np.int32)
    vertices, edges = made.simplices[:2]
    made.simplices[0] = np.unique(edges)[:, None] if len(edges) else vertices[:1]  # without duplicates
    made.values[0] = np.zeros(len(made.simplices[0]))
    simplices = tuple(alpha_complex.named(each, names) for each in made.simplices[: points.shape[1] + 1])
    with np.errstate(over="ignore"):  # of a nearly flat simplex near LARGEST
        radii = tuple(np.ldexp(np.sqrt(values), made.exponent) for values in made.values[: len(simplices)])
    ends = points[simplices[1]]
    return Filtration(simplices, radii, np.hypot.reduce(ends[:, 0] - ends[:, 1], axis=1))


def _pairs(rows: tuple, exponent: int, squared: bool) -> Pairs:
    """Return the Pairs of SQUARED radii in units of 2^(2 exponent) and simplices."""
    births, deaths, *simplices = rows
    if squared:
        return Pairs(_squares(births, exponent), _squares(deaths, exponent), *simplices)
    return Pairs(np.ldexp(np.sqrt(births), exponent), np.ldexp(np.sqrt(deaths), exponent), *simplices)


def _squares(values: np.ndarray, exponent: int) -> np.ndarray:
    """Return values · 4^exponent (k,); raise InputError where these leave the range of normal numbers."""
    with np.errstate(over="ignore"):
        squares = np.ldexp(values, 2 * exponent)
    if ((squares < np.finfo(float).tiny) != (values == 0)).any() or not np.isfinite(squares).all():
        raise InputError("the squared radii leave the range of float64; ask for radii or scale the points")
    return squares


def _with_the_first_component(pairs: Pairs, points: np.ndarray) -> Pairs:
    """Return the bars of dimension 0 with that of the component that never dies; of no points, none."""
    born = pairs.birth_simplices[:, 0]
    left = np.setdiff1d(np.arange(len(points)), born)
    if len(left) > 1:  # duplicates: the point that no other component starts at
        started = {point.tobytes() for point in points[born] + 0.0}
        left = np.array([row for row in left if (points[row] + 0.0).tobytes() not in started])
    first = left[:1, None]
    bar = np.zeros(len(first)), np.full(len(first), np.inf), first, np.full((len(first), 2), NOBODY)
    return Pairs(*(np.concatenate(each) for each in zip(vars(pairs).values(), bar, strict=True)))


def _ended(pairs: Pairs, infinite: bool, limit: float) -> Pairs:
    """Return the bars of a filtration that ends at `limit`, with those that never die if `infinite`."""
    if limit == np.inf:
        return pairs
    alive = pairs.deaths > limit
    keep = (pairs.births <= limit) & (infinite | ~alive)
    deaths = np.where(alive, np.inf, pairs.deaths)
    last = np.where(alive[:, None], NOBODY, pairs.death_simplices)
    return Pairs(pairs.births[keep], deaths[keep], pairs.birth_simplices[keep], last[keep])
