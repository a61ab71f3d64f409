"""The plan: the frozen combinatorics of one refresh, and the loss it stands for.

`build_plan` aims at a bundle's bars; `loss.build_betti_plan` makes its plan from the same parts. Everything
is divided by the diagonal of bundle or statement (births, deaths, targets, floor: radius / diagonal). A pull
is one bar of the live cloud with its birth and death simplex and what pulls it: a target bar (matched or
recruited) or the diagonal.

Which live bars are significant: lifetime > floor. The default floor is the BUNDLE's, 6 r_med(M) of the target
at the same M ("locked for all live evaluations", paper §3.1), so the objective is one function during a run
and a soup cannot change what counts by changing its own spacing. `floor_source="live"` takes the live cloud's
own 6 r_med instead; both are reported at every refresh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from paper_artifact.alpha.diagrams import FirstDerivative
from paper_artifact.alpha.persistence import Pairs, alpha_persistence
from paper_artifact.alpha.radii import passes_gate, radius_and_gradient
from paper_artifact.arithmetic import spreads, symmetric_eigen
from paper_artifact.config import LossConfig
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.floor import measurement_floor, significant, space_points
from paper_artifact.topology.matching import match_bars, recruit

KINDS = ("matched", "recruited", "diagonal")
MATCHED, RECRUITED, DIAGONAL = range(3)
CORNERS = 4  # of a tetrahedron: the most that a simplex has
NONE = -1  # no sample, no target
BIRTHS, DEATHS = 0, 1  # columns of a bar
NEIGHBOURS = 16  # samples that make a sample's curvature
CLIP = (0.25, 4.0)  # least and largest curvature weight


@dataclass(frozen=True, eq=False)
class Pulls:
    """n bars and what pulls each, as arrays."""

    dimension: np.ndarray  # (n,) int64
    kind: np.ndarray  # (n,) int64: MATCHED, RECRUITED, DIAGONAL
    values: np.ndarray  # (n,2) float64: birth and death in the cloud the plan saw
    simplices: np.ndarray  # (n,2,4) int64: samples of the birth and the death simplex, then NONE
    target: np.ndarray  # (n,2) float64: birth and death of the target bar; 0 for the diagonal, which has none
    sound: np.ndarray  # (n,) bool: passed the Gabriel gate; else value only, no gradient
    weight: np.ndarray  # (n,) float64: of the bar's term in the loss

    def __len__(self) -> int:
        return len(self.kind)


def padded(simplices: np.ndarray) -> np.ndarray:
    """Return simplices (n,k) as (n,4) int64, NONE behind the corners."""
    wide = np.full((len(simplices), CORNERS), NONE, dtype=np.int64)
    wide[:, : simplices.shape[1]] = simplices
    return wide


def join_pulls(parts: Sequence[Pulls]) -> Pulls:
    """Return the pulls of all parts, at least one, in order."""
    names = [each.name for each in fields(Pulls)]
    return Pulls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class Known(torch.autograd.Function):
    """A scalar function of positions (n,3) float64 whose value and gradient (n,3) are known there;
    differentiable once."""

    @staticmethod
    def forward(ctx: Any, positions: Tensor, value: float, gradient: np.ndarray) -> Tensor:
        """Return the value."""
        ctx.save_for_backward(positions, torch.from_numpy(gradient))
        return torch.tensor(value, dtype=torch.float64)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        """Return the gradient times `upstream`."""
        positions, gradient = ctx.saved_tensors
        return FirstDerivative.apply(upstream * gradient, positions), None, None


# d/db and d/dd of ((d - b)/2)² are -(d - b)/2 and +(d - b)/2.
_AWAY = np.array([[-1.0], [1.0]])


class Plan:
    """Frozen pulls of one refresh. `value` gives the loss at positions of the used samples.

    pulls; samples: M of the cloud; report: JSON-able, counts and bars per dimension; used (u,) int64: the
    samples any pull touches; groups: the simplices by their number of corners, as (rows (r,), corners (r,k)),
    rows into the 2n coordinates (births, then deaths), corners into the used samples.
    """

    def __init__(self, pulls: Pulls, samples: int, report: dict) -> None:
        self.pulls, self.samples, self.report = pulls, samples, report
        simplices = pulls.simplices.transpose(1, 0, 2).reshape(-1, CORNERS)
        used = np.unique(simplices[simplices != NONE])
        sizes = (simplices != NONE).sum(axis=1)
        self.used = torch.from_numpy(used)
        self.groups = []
        for size in (2, 3, 4):  # a vertex (birth in dimension 0) has the constant radius 0
            rows = np.flatnonzero(sizes == size)
            if len(rows):
                self.groups.append((rows, np.searchsorted(used, simplices[rows, :size])))

    def __len__(self) -> int:
        return len(self.pulls)

    def radii(self, positions: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the pulls' live births, then deaths (2n,) float64, and per group the gradients (r,k,3) of
        its rows, at `positions` (u,3) of the used samples; all divided by D.

        A pull that failed the gate, and a coordinate whose simplex has become flat since, keeps the refresh's
        value.
        """
        frozen, sound, gradients = self.pulls.values.T.ravel(), np.tile(self.pulls.sound, 2), []
        radii = frozen.copy()
        for rows, corners in self.groups:
            radius, gradient = radius_and_gradient(positions[corners])
            live = sound[rows] & np.isfinite(radius)
            radii[rows] = np.where(live, radius, frozen[rows])
            gradients.append(gradient * live[:, None, None])
        return radii, gradients

    def value_and_gradient(self, positions: np.ndarray) -> tuple[float, np.ndarray]:
        """Return L_topo and its gradient (u,3) at `positions` (u,3) of the used samples."""
        radii, gradients = self.radii(positions)
        live, diagonal, weight = radii.reshape(2, -1), self.pulls.kind == DIAGONAL, self.pulls.weight
        half_lifetime = (live[1] - live[0]) / 2
        residual = live - self.pulls.target.T
        value = np.where(diagonal, half_lifetime**2, (residual**2).sum(axis=0))
        slope = (np.where(diagonal, half_lifetime * _AWAY, 2 * residual) * weight).ravel()
        total = np.zeros_like(positions)
        if self.groups:
            scatter = np.concatenate([corners.ravel() for _, corners in self.groups])
            parts = zip(self.groups, gradients, strict=True)
            pulls = [(slope[rows, None, None] * each).reshape(-1, 3) for (rows, _), each in parts]
            for axis, column in enumerate(np.concatenate(pulls).T):
                # bincount adds in the order of the rows: the same bits at every call
                total[:, axis] = np.bincount(scatter, column, len(positions))
        return float((weight * value).sum()), total

    def value(self, positions: Tensor) -> Tensor:
        """Return the paper's L_topo (scalar float64) at `positions` (u,3) float64 of the used samples, / D.

        Differentiable once, in closed form. An empty plan gives an exact 0 with a zero gradient.
        """
        return Known.apply(positions, *self.value_and_gradient(positions.detach().numpy()))


@dataclass(frozen=True, eq=False)
class Claims:
    """Which live bars of one dimension are pulled by what, n times."""

    rows: np.ndarray  # (n,) int64 into the live bars
    targets: np.ndarray  # (n,) int64 into the target bars, NONE for the diagonal
    kinds: np.ndarray  # (n,) int64: MATCHED, RECRUITED, DIAGONAL
    aims: np.ndarray  # (m,2) float64: the target bars
    free: int | None = None  # BIRTHS or DEATHS: those of target bars pull nothing
    report: dict = field(default_factory=dict)  # JSON-able: what is added to the report, or replaced in it


# (dimension, its live bars (k,2) float64) → what is pulled by what
Claim = Callable[[int, np.ndarray], Claims]


def build_plan(cloud: np.ndarray, bundle: Bundle, config: LossConfig | None = None) -> Plan:
    """Return the plan of a live `cloud` (M,3) float64, divided by the bundle's diagonal.

    Persistence, matching, recruitment, gate; only the bundle's dimensions enter. config: None is the paper's.
    Raises InputError as `measurement_floor` and `alpha_persistence` do for its points.
    """
    config = LossConfig() if config is None else config
    cloud = space_points(cloud, 4, "a plan")
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
    parts, reports = [], {}
    for dimension in dimensions:
        part, reports[str(dimension)] = _plan_dimension(
            cloud, pairs[dimension], claim, floor, dimension, config
        )
        parts.append(part)
    pulls = join_pulls(parts)
    if config.curvature_weighted and len(pulls):
        pulls = replace(pulls, weight=pair_weights(cloud, pulls.simplices.reshape(len(pulls), -1)))
    report = {"floor": floor, "live_floor": live_floor, "samples": len(cloud), "dimensions": reports}
    return Plan(pulls, len(cloud), report)


def _plan_dimension(
    cloud: np.ndarray, pairs: Pairs, claim: Claim, floor: float, dimension: int, config: LossConfig
) -> tuple[Pulls, dict]:
    """Return (pulls, report) of one dimension."""
    dropped = 0
    if config.fallback == "drop":
        keep = np.asarray(_passes(cloud, pairs).all(axis=1))
        dropped = int((~keep & significant(pairs.diagram, floor)).sum())
        pairs = _chosen(pairs, keep)
    claims = claim(dimension, pairs.diagram)
    pulled = _chosen(pairs, claims.rows)
    passes = _passes(cloud, pulled)
    simplices = np.stack([padded(pulled.birth_simplices), padded(pulled.death_simplices)], axis=1)
    failures = int((~passes.all(axis=1)).sum()) + dropped
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
    return pulls, _report(claims, pairs.diagram, floor, failures)


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
    return Pairs(**{name: each[rows] for name, each in vars(pairs).items()})


def _passes(cloud: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Return whether the birth and the death simplices pass the Gabriel gate, (k,2) bool."""
    births = passes_gate(cloud, pairs.birth_simplices, pairs.births)
    return np.column_stack([births, passes_gate(cloud, pairs.death_simplices, pairs.deaths)])


def _report(claims: Claims, bars: np.ndarray, floor: float, failures: int) -> dict:
    """Return the JSON-able report of one dimension: counts, and of each target bar what claims it."""
    targets: list[dict] = [{"target": bar, "live": None, "kind": "unreached"} for bar in claims.aims.tolist()]
    owned = claims.targets != NONE
    lives = bars[claims.rows[owned]].tolist()
    for j, live, kind in zip(claims.targets[owned], lives, claims.kinds[owned], strict=True):
        targets[j] |= {"live": live, "kind": KINDS[kind]}
    counts = np.bincount(claims.kinds, minlength=len(KINDS)).tolist()
    return {
        "significant": int(significant(bars, floor).sum()),
        **dict(zip(KINDS, counts, strict=True)),
        "unreached": len(targets) - int(owned.sum()),
        "gabriel_failures": failures,
        "targets": targets,
        **claims.report,
    }


def surface_variation(cloud: np.ndarray) -> np.ndarray:
    """Return the surface variation (M,), in [0, 1/3], 0 on a plane, at each point of `cloud` (M,3): the
    smallest share λ0 / (λ0 + λ1 + λ2) of the eigenvalues of its 16 nearest points' covariance (Pauly, Gross &
    Kobbelt 2002).
    """
    _, near = cKDTree(cloud).query(cloud, k=min(NEIGHBOURS, len(cloud)))
    centred = cloud[near] - cloud[near].mean(axis=1, keepdims=True)
    eigenvalues, _ = symmetric_eigen(spreads(centred))
    total = eigenvalues.sum(axis=1)
    return np.where(total > 0, np.maximum(eigenvalues[:, 0], 0.0) / np.where(total > 0, total, 1.0), 0.0)


def pair_weights(cloud: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the curvature weights (n,) of pulls with corner samples `corners` (n,c) int64, NONE where there
    is none: condition C4, which the paper defers and leaves undefined; the definition is ours.

    A weight is the mean surface variation over the corners of the pull's two simplices, divided by the mean
    over the cloud and clipped to [1/4, 4]; 1 for each when the whole cloud is flat. Frozen with the plan.
    """
    variation = surface_variation(cloud)
    mean = variation.mean()
    if mean <= 0:
        return np.ones(len(corners))
    present = corners >= 0
    total = np.zeros(len(corners))
    for column, there in zip(corners.T, present.T, strict=True):  # corner by corner: one order of summation
        total += np.where(there, variation[column], 0.0)
    return np.clip(total / present.sum(axis=1) / mean, *CLIP)
