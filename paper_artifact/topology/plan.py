"""The plan: the frozen combinatorics of one refresh, and the loss it stands for.

Everything is divided by the bundle's diagonal (births, deaths, targets, floor: radius / diagonal). A term is
one bar of the live cloud with its birth and death simplex and what pulls it: a target bar (matched or
recruited) or the diagonal (paper §3.3).

Which live bars are significant: lifetime > floor. The default floor is the BUNDLE's, 6 r_med(M) of the target
at the same M ("locked for all live evaluations", paper §3.1), so the objective is one function during a run
and a soup cannot change what counts by changing its own spacing. `floor_source="live"` takes the live cloud's
own 6 r_med instead; both are reported at every refresh.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from paper_artifact.alpha.circumradius import radius_and_gradient
from paper_artifact.alpha.gabriel import coface_of_value, passes_gate
from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.config import LossConfig
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.curvature import pair_weights
from paper_artifact.topology.floor import measurement_floor, significant
from paper_artifact.topology.matching import match_bars, recruit

KINDS = ("matched", "recruited", "diagonal")


@dataclass(frozen=True)
class Term:
    """One bar and its pull. birth, death: filtration values of the cloud the plan saw; birth_simplex,
    death_simplex: sample indices; target (2,) or None for the diagonal; sound: passed the Gabriel gate (else
    value only, no gradient).
    """

    dimension: int
    kind: str
    birth: float
    death: float
    birth_simplex: tuple[int, ...]
    death_simplex: tuple[int, ...]
    target: tuple[float, float] | None
    sound: bool
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class Plan:
    """Frozen terms of one refresh.

    samples: M of the cloud; used (u,) int64 tensor: the samples any term touches; report: JSON-able counts
    and bars per dimension; failing: the simplices that failed the gate. `value` gives the loss at positions
    of the used samples.
    """

    terms: tuple[Term, ...]
    samples: int
    report: dict
    failing: tuple[tuple[int, ...], ...] = ()
    used: Tensor = field(init=False)
    _arrays: _Arrays = field(init=False)

    def __post_init__(self) -> None:
        used, arrays = _compile(self.terms)
        object.__setattr__(self, "used", torch.from_numpy(used))
        object.__setattr__(self, "_arrays", arrays)

    def __len__(self) -> int:
        return len(self.terms)

    def coordinates(self, positions: np.ndarray) -> np.ndarray:
        """Return live (births, deaths) (2,n) float64 of the terms at `positions` (u,3) float64 of the used
        samples, divided by D.

        A term that failed the gate, and a coordinate whose simplex has become flat since, keeps the refresh's
        value.
        """
        return self._arrays.radii(positions)[0].reshape(2, -1)

    def value(self, positions: Tensor) -> Tensor:
        """Return the paper's L_topo (scalar float64) at `positions` (u,3) float64 of the used samples,
        divided by D.

        Differentiable once, in closed form. An empty plan gives an exact 0 with a zero gradient.
        """
        return _PlanValue.apply(positions, self._arrays)


@dataclass(frozen=True, eq=False)
class _Arrays:
    """A plan's terms as arrays: simplices grouped by their number of corners, into the used samples.

    groups: (rows (r,), corners (r,k)) with rows into the 2n coordinates (births, then deaths); frozen, sound
    (2n,); target (2,n); diagonal (n,) bool; weight (n,).
    """

    groups: tuple[tuple[np.ndarray, np.ndarray], ...]
    frozen: np.ndarray
    sound: np.ndarray
    target: np.ndarray
    diagonal: np.ndarray
    weight: np.ndarray

    def radii(self, positions: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the coordinates (2n,) and, per group, the gradients (r,k,3) of its rows."""
        radii, gradients = self.frozen.copy(), []
        for rows, corners in self.groups:
            radius, gradient = radius_and_gradient(positions[corners])
            live = self.sound[rows] & np.isfinite(radius)
            radii[rows] = np.where(live, radius, self.frozen[rows])
            gradients.append(gradient * live[:, None, None])
        return radii, gradients

    def value_and_gradient(self, positions: np.ndarray) -> tuple[float, np.ndarray]:
        """Return L_topo and its gradient (u,3) at `positions` (u,3)."""
        radii, gradients = self.radii(positions)
        live = radii.reshape(2, -1)
        half_lifetime = (live[1] - live[0]) / 2
        residual = live - self.target
        value = np.where(self.diagonal, half_lifetime**2, (residual**2).sum(axis=0))
        slope = np.where(self.diagonal, half_lifetime * _AWAY, 2 * residual) * self.weight
        slope = slope.ravel()
        total = np.zeros_like(positions)
        for (rows, corners), gradient in zip(self.groups, gradients, strict=True):
            np.add.at(total, corners, slope[rows, None, None] * gradient)
        return float((self.weight * value).sum()), total


# d/db and d/dd of ((d - b)/2)² are -(d - b)/2 and +(d - b)/2.
_AWAY = np.array([[-1.0], [1.0]])


class _PlanValue(torch.autograd.Function):
    @staticmethod
    def forward(ctx, positions: Tensor, arrays: _Arrays) -> Tensor:
        value, gradient = arrays.value_and_gradient(positions.detach().numpy())
        ctx.save_for_backward(torch.from_numpy(gradient))
        return torch.tensor(value, dtype=torch.float64)

    @staticmethod
    @once_differentiable
    def backward(ctx, upstream: Tensor) -> tuple[Tensor, None]:
        return upstream * ctx.saved_tensors[0], None


def _compile(terms: tuple[Term, ...]) -> tuple[np.ndarray, _Arrays]:
    """Return the used samples (u,) int64 and the terms as arrays."""
    simplices = [term.birth_simplex for term in terms] + [term.death_simplex for term in terms]
    used = (
        np.unique(np.concatenate([np.asarray(s, dtype=np.int64) for s in simplices]))
        if simplices
        else np.zeros(0, np.int64)
    )
    groups = []
    for size in (2, 3, 4):  # a vertex (birth in dimension 0) has the constant radius 0
        rows = np.array([i for i, simplex in enumerate(simplices) if len(simplex) == size], dtype=np.int64)
        if len(rows):
            groups.append((rows, np.searchsorted(used, np.array([simplices[i] for i in rows]))))
    return used, _Arrays(
        groups=tuple(groups),
        frozen=np.array([term.birth for term in terms] + [term.death for term in terms], dtype=np.float64),
        sound=np.array([term.sound for term in terms] * 2, dtype=bool),
        target=np.array([term.target or (0.0, 0.0) for term in terms], dtype=np.float64).reshape(-1, 2).T,
        diagonal=np.array([term.target is None for term in terms], dtype=bool),
        weight=np.array([term.weight for term in terms], dtype=np.float64),
    )


def build_plan(cloud: np.ndarray, bundle: Bundle, config: LossConfig = LossConfig()) -> Plan:
    """Make the plan of a live `cloud` (M,3) float64, divided by the bundle's diagonal: persistence, matching,
    recruitment, gate.

    Only the bundle's dimensions enter. Raises what `alpha_persistence` raises for its points.
    """
    live_floor = measurement_floor(cloud, 1.0, bundle.floor_multiplier)
    floor = bundle.floor if config.floor_source == "bundle" else live_floor
    pairs = alpha_persistence(cloud, method=config.method)
    terms, failing, dimensions = [], [], {}
    for dimension in bundle.dimensions:
        made, failed, report = _plan_dimension(
            cloud, pairs[dimension], bundle.bars[dimension], floor, dimension, config
        )
        terms += made
        failing += failed
        dimensions[str(dimension)] = report
    if config.curvature_weighted and terms:
        weights = pair_weights(cloud, [term.birth_simplex + term.death_simplex for term in terms])
        terms = [Term(**{**vars(term), "weight": float(w)}) for term, w in zip(terms, weights, strict=True)]
    report = {"floor": floor, "live_floor": live_floor, "samples": len(cloud), "dimensions": dimensions}
    return Plan(tuple(terms), len(cloud), report, tuple(failing))


def _plan_dimension(cloud, pairs, target, floor, dimension, config):
    """Return (terms, failing simplices, report) of one dimension; target (m,2)."""
    bars = np.column_stack([pairs.births, pairs.deaths])
    simplices = (pairs.birth_simplices, pairs.death_simplices)
    dropped = 0
    if config.fallback == "drop":
        keep = _sound(cloud, simplices, bars)
        dropped = int((~keep & significant(bars, floor)).sum())
        bars, simplices = bars[keep], tuple(each[keep] for each in simplices)
    is_significant = significant(bars, floor)
    live = np.flatnonzero(is_significant)
    matching = match_bars(bars[live], target)
    claims = [(int(live[i]), int(j), "matched") for i, j in matching.matched]
    left = live[matching.unmatched_live]
    missing = matching.unmatched_target
    if config.recruitment and len(missing):
        pool = np.concatenate([left, np.flatnonzero(~is_significant)])
        recruited = [
            (int(pool[k]), int(missing[j]), "recruited") for k, j in recruit(bars[pool], target[missing])
        ]
        left = np.setdiff1d(left, [row for row, _, _ in recruited])
        claims += recruited
    claims += [(int(row), None, "diagonal") for row in left]
    rows = np.array([row for row, _, _ in claims], dtype=np.int64)
    sound = _sound(cloud, tuple(each[rows] for each in simplices), bars[rows])
    terms, failed, unsound = [], [], 0
    for (row, j, kind), passed in zip(claims, sound, strict=True):
        pair = [tuple(each[row].tolist()) for each in simplices]
        if not passed:
            unsound += 1
            pair, passed = _repair(cloud, pair, bars[row], config.fallback, failed)
        terms.append(
            Term(
                dimension,
                kind,
                float(bars[row, 0]),
                float(bars[row, 1]),
                pair[0],
                pair[1],
                None if j is None else tuple(target[j].tolist()),
                bool(passed),
            )
        )
    report = _report(claims, bars, target, int(is_significant.sum()), unsound + dropped)
    return terms, failed, report


def _sound(cloud, simplices, bars) -> np.ndarray:
    return passes_gate(cloud, simplices[0], bars[:, 0]) & passes_gate(cloud, simplices[1], bars[:, 1])


def _repair(cloud, pair, bar, fallback, failed):
    """Note the pair's failing simplices in `failed`; return the (birth, death) simplices to differentiate,
    and whether sound.
    """
    passed = True
    for side in (0, 1):
        simplex = np.array(pair[side], dtype=np.int64)
        if passes_gate(cloud, simplex[None], bar[side : side + 1])[0]:
            continue
        failed.append(pair[side])
        coface = coface_of_value(cloud, simplex, float(bar[side])) if fallback == "subgradient" else None
        passed = passed and coface is not None
        if coface is not None:
            pair[side] = tuple(coface.tolist())
    return pair, passed


def _report(claims, bars, target, count, failures) -> dict:
    owner = {j: (row, kind) for row, j, kind in claims if j is not None}
    targets = []
    for j, bar in enumerate(target):
        row, kind = owner.get(j, (None, "unreached"))
        targets.append(
            {"target": bar.tolist(), "live": None if row is None else bars[row].tolist(), "kind": kind}
        )
    counts = {kind: sum(each == kind for _, _, each in claims) for kind in KINDS}
    return {
        "significant": count,
        **counts,
        "unreached": len(target) - len(owner),
        "gabriel_failures": failures,
        "targets": targets,
    }
