"""The plan: the frozen combinatorics of one refresh, and the loss it stands for.

`build_plan` aims at a bundle's bars; `betti.build_betti_plan` makes its plan from the same parts. Everything
is divided by the diagonal of bundle or statement (births, deaths, targets, floor: radius / diagonal).

Which live bars are significant: lifetime > floor. The default floor is the BUNDLE's, 6 r_med(M) of the target
at the same M ("locked for all live evaluations", paper §3.1), so the objective is one function during a run
and a soup cannot change what counts by changing its own spacing. `floor_source="live"` takes the live cloud's
own 6 r_med instead; both are reported at every refresh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from paper_artifact.alpha.persistence import Pairs, alpha_persistence
from paper_artifact.alpha.radii import coface_of_value, passes_gate
from paper_artifact.config import LossConfig
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.curvature import pair_weights
from paper_artifact.topology.floor import measurement_floor, significant
from paper_artifact.topology.matching import match_bars, recruit
from paper_artifact.topology.pulls import (
    DIAGONAL,
    KINDS,
    MATCHED,
    NONE,
    RECRUITED,
    LossArrays,
    Pulls,
    compiled,
    join_pulls,
    loss_value,
    padded,
)


@dataclass(frozen=True, eq=False)
class Plan:
    """Frozen pulls of one refresh. `value` gives the loss at positions of the used samples."""

    pulls: Pulls
    samples: int  # M of the cloud
    report: dict  # JSON-able: counts and bars per dimension
    failing: tuple[tuple[int, ...], ...] = ()  # simplices that failed the gate
    used: Tensor = field(init=False)  # (u,) int64: the samples any pull touches
    _arrays: LossArrays = field(init=False)

    def __post_init__(self) -> None:
        used, arrays = compiled(self.pulls)
        object.__setattr__(self, "used", torch.from_numpy(used))
        object.__setattr__(self, "_arrays", arrays)

    def __len__(self) -> int:
        return len(self.pulls)

    def coordinates(self, positions: np.ndarray) -> np.ndarray:
        """Return live (births, deaths) (2,n) float64 of the pulls at `positions` (u,3) of the used samples.

        All divided by D. A pull that failed the gate, and a coordinate whose simplex has become flat since,
        keeps the refresh's value.
        """
        return self._arrays.radii(positions)[0].reshape(2, -1)

    def value(self, positions: Tensor) -> Tensor:
        """Return the paper's L_topo (scalar float64) at `positions` (u,3) float64 of the used samples, / D.

        Differentiable once, in closed form. An empty plan gives an exact 0 with a zero gradient.
        """
        return loss_value(positions, self._arrays)


BIRTHS, DEATHS = 0, 1  # columns of a bar


@dataclass(frozen=True, eq=False)
class Claims:
    """Which live bars of one dimension are pulled by what, n times."""

    rows: np.ndarray  # (n,) int64 into the live bars
    targets: np.ndarray  # (n,) int64 into the target bars, NONE for the diagonal
    kinds: np.ndarray  # (n,) int64: MATCHED, RECRUITED, DIAGONAL
    aims: np.ndarray  # (m,2) float64: the target bars
    free: int | None = None  # BIRTHS or DEATHS: those of target bars pull nothing
    report: dict = field(default_factory=dict)  # JSON-able: what is added to the report, or replaced in it


Claim = Callable[
    [int, np.ndarray], Claims
]  # (dimension, its live bars (k,2) float64) → what is pulled by what


def build_plan(cloud: np.ndarray, bundle: Bundle, config: LossConfig | None = None) -> Plan:
    """Return the plan of a live `cloud` (M,3) float64, divided by the bundle's diagonal.

    Persistence, matching, recruitment, gate; only the bundle's dimensions enter. config: None is the paper's.
    Raises what `alpha_persistence` raises for its points.
    """
    config = LossConfig() if config is None else config
    live_floor = measurement_floor(cloud, 1.0, bundle.floor_multiplier)
    floor = bundle.floor if config.floor_source == "bundle" else live_floor

    def claim(dimension: int, bars: np.ndarray) -> Claims:
        return _claims(bars, bundle.bars[dimension], floor, config.recruitment)

    return make_plan(cloud, bundle.dimensions, claim, floor, live_floor, config)


def make_plan(
    cloud: np.ndarray,
    dimensions: tuple[int, ...],
    claim: Claim,
    floor: float,
    live_floor: float,
    config: LossConfig,
) -> Plan:
    """Return the plan of `cloud` (M,3) float64, divided by its frame's diagonal.

    It holds what `claim` says of the bars of each of the `dimensions`, and whether that passes the gate.

    floor: lifetimes above it are significant, / D; live_floor: the cloud's own, for the report.
    """
    pairs = alpha_persistence(cloud, config.method, as_given=True)
    parts, failing, reports = [], [], {}
    for dimension in dimensions:
        part, failed, report = _plan_dimension(cloud, pairs[dimension], claim, floor, dimension, config)
        parts.append(part)
        failing += failed
        reports[str(dimension)] = report
    pulls = join_pulls(parts)
    if config.curvature_weighted and len(pulls):
        pulls = replace(pulls, weight=pair_weights(cloud, pulls.simplices.reshape(len(pulls), -1)))
    report = {"floor": floor, "live_floor": live_floor, "samples": len(cloud), "dimensions": reports}
    return Plan(pulls, len(cloud), report, tuple(failing))


def _plan_dimension(
    cloud: np.ndarray, pairs: Pairs, claim: Claim, floor: float, dimension: int, config: LossConfig
) -> tuple[Pulls, list[tuple[int, ...]], dict]:
    """Return (pulls, simplices that fail the gate, report) of one dimension."""
    dropped = 0
    if config.fallback == "drop":
        keep = np.asarray(_passes(cloud, pairs).all(axis=1))
        dropped = int((~keep & significant(pairs.diagram, floor)).sum())
        pairs = _chosen(pairs, keep)
    claims = claim(dimension, pairs.diagram)
    pulled = _chosen(pairs, claims.rows)
    passes = _passes(cloud, pulled)
    simplices = np.stack([padded(pulled.birth_simplices), padded(pulled.death_simplices)], axis=1)
    failing = [tuple(each[each != NONE].tolist()) for each in simplices[~passes]]
    failures = int((~passes.all(axis=1)).sum()) + dropped
    if config.fallback == "subgradient" and failing:
        simplices, passes = _with_cofaces(cloud, simplices, pulled.diagram, passes)
    aimed = claims.kinds != DIAGONAL
    target = np.zeros((len(claims.rows), 2))
    target[aimed] = claims.aims[claims.targets[aimed]]
    if claims.free is not None:
        simplices[aimed, claims.free] = NONE  # a coordinate without simplex keeps the refresh's value,
        target[aimed, claims.free] = pulled.diagram[aimed, claims.free]  # which is its target
    pulls = Pulls(
        dimension=np.full(len(claims.rows), dimension),
        kind=claims.kinds,
        values=pulled.diagram,
        simplices=simplices,
        target=target,
        sound=np.asarray(passes.all(axis=1)),
        weight=np.ones(len(claims.rows)),
    )
    return pulls, failing, _report(claims, pairs.diagram, floor, failures)


def _claims(bars: np.ndarray, target: np.ndarray, floor: float, recruitment: bool) -> Claims:
    """Return what pulls the live `bars` (k,2): matched ones, then recruited ones, then those of the
    diagonal.
    """
    is_significant = significant(bars, floor)
    live = np.flatnonzero(is_significant)
    matching = match_bars(bars[live], target)
    left, missing = live[matching.unmatched_live], matching.unmatched_target
    recruited = np.zeros((0, 2), dtype=np.int64)
    if recruitment and len(missing):
        pool = np.concatenate([left, np.flatnonzero(~is_significant)])
        places = recruit(bars[pool], target[missing])
        recruited = np.column_stack([pool[places[:, 0]], missing[places[:, 1]]])
        left = np.setdiff1d(left, recruited[:, 0])
    counts = (len(matching.matched), len(recruited), len(left))
    return Claims(
        rows=np.concatenate([live[matching.matched[:, 0]], recruited[:, 0], left]),
        targets=np.concatenate([matching.matched[:, 1], recruited[:, 1], np.full(len(left), NONE)]),
        kinds=np.repeat([MATCHED, RECRUITED, DIAGONAL], counts),
        aims=target,
    )


def _chosen(pairs: Pairs, rows: np.ndarray) -> Pairs:
    """Return the pairs of `rows` (indices or a mask)."""
    return Pairs(
        births=pairs.births[rows],
        deaths=pairs.deaths[rows],
        birth_simplices=pairs.birth_simplices[rows],
        death_simplices=pairs.death_simplices[rows],
    )


def _passes(cloud: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Return whether the birth and the death simplices pass the Gabriel gate, (k,2) bool."""
    births = passes_gate(cloud, pairs.birth_simplices, pairs.births)
    return np.column_stack([births, passes_gate(cloud, pairs.death_simplices, pairs.deaths)])


def _with_cofaces(
    cloud: np.ndarray, simplices: np.ndarray, values: np.ndarray, passes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (simplices (n,2,4), passes (n,2)): a failing simplex replaced by the coface that sets its
    value.
    """
    simplices, passes = simplices.copy(), passes.copy()
    for row, side in np.argwhere(~passes):  # rare: failures mean rounding or degenerate input
        simplex = simplices[row, side]
        coface = coface_of_value(cloud, simplex[simplex != NONE], float(values[row, side]))
        if coface is not None:
            simplices[row, side] = padded(coface[None])[0]
            passes[row, side] = True
    return simplices, passes


def _report(claims: Claims, bars: np.ndarray, floor: float, failures: int) -> dict:
    """Return the JSON-able report of one dimension: counts, and of each target bar what claims it."""
    owned, target = claims.targets != NONE, claims.aims
    lives: list[list[float] | None] = [None] * len(target)
    kinds = ["unreached"] * len(target)
    for j, live, kind in zip(
        claims.targets[owned].tolist(),
        bars[claims.rows[owned]].tolist(),
        claims.kinds[owned].tolist(),
        strict=True,
    ):
        lives[j], kinds[j] = live, KINDS[kind]
    counts = np.bincount(claims.kinds, minlength=len(KINDS)).tolist()
    return {
        "significant": int(significant(bars, floor).sum()),
        **dict(zip(KINDS, counts, strict=True)),
        "unreached": len(target) - int(owned.sum()),
        "gabriel_failures": failures,
        "targets": [
            {"target": bar, "live": live, "kind": kind}
            for bar, live, kind in zip(target.tolist(), lives, kinds, strict=True)
        ],
        **claims.report,
    }
