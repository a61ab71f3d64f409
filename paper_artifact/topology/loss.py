"""The topology losses for a point tensor, usable alone: towards a bundle, or towards stated Betti numbers.

    loss = TopologyLoss(build_bundle(target_points, diagonal))
    loss = BettiLoss((1, 2, 1))        # no target: one component, two loops, one void
    loss(points).backward()            # points (M,3), requires_grad; the plan is refreshed every 10 calls

Paper §3: L_topo of births and deaths (radius / diagonal, dimensionless) under a plan that is frozen between
refreshes.

`BettiLoss` is not the paper's. At each refresh the bars of each dimension are ranked by lifetime; r is the
live cloud's median spacing, the floor is 6 r, and k = b0 - 1, b1, b2 bars are wanted. W are those of the
first k that exceed guard · floor, R those beyond k that exceed the floor (with suppress "all", in H1 and H2:
all beyond k). With d_ref the death at the refresh,

    L = Σ_W (d - (d_ref + pull · r))² + Σ_R ((d - b) / 2)²,

a practically linear pull of the wanted deaths, and the paper's diagonal term for the rest. Births of wanted
bars are free: sampling sets them. With the aim "cloud" (T3) W are the first bars of as many classes as the
SfM cloud shows, pulled up to its deaths and no further, without a guard: the statement says which of the
cloud's bars count, the cloud how far. In a dimension in which the cloud shows more, it does nothing. Other
targets of the wanted bars are ablations (`LossConfig.aim`):
"smoothed" (S16): at least the death of the bar of the same rank in the cloud whose points are means of 16
neighbours; "births": deaths are free, and births go to what a clean sample of the same spacing has; "none":
wanted bars are not pulled at all.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.arithmetic import dot, log, norm, normals, product
from paper_artifact.config import LossConfig, with_changes
from paper_artifact.errors import InputError, as_numbers, whole
from paper_artifact.randomness import stream
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.floor import (
    MULTIPLIER,
    check_diagonal,
    diagonal_of,
    in_diagonals,
    measurement_floor,
    median_spacing,
    space_points,
    unit_of,
)
from paper_artifact.topology.plan import (
    BIRTHS,
    DEATHS,
    DIAGONAL,
    MATCHED,
    NONE,
    Claims,
    Plan,
    build_plan,
    make_plan,
)
from paper_artifact.topology.statement import NAMES, SURPLUS, Statement

FLAT = 1e-12  # height over extent below which a cloud counts as coplanar
KEPT = 2  # lifetimes beyond the wanted ones that a report of `BettiLoss` keeps
NEIGHBOURS = 16  # of the smoothed cloud
PERCOLATION = 1.128  # mean number of discs of a point at which discs on a plane connect


def check_cloud(cloud: np.ndarray, frame: Bundle | Statement) -> np.ndarray:
    """Return `cloud` (M,3), world units, as float64 divided by the frame's diagonal.

    Raises InputError for another density than the frame's, fewer than 4 points, coplanar points, NaN, or
    another scale than the diagonal's.
    """
    cloud = space_points(cloud, 4, "the loss")
    frame.require_density(len(cloud))
    scaled = cloud / unit_of(np.ptp(cloud, axis=0))
    if _height(scaled - scaled.mean(axis=0)) <= FLAT:
        raise InputError(
            "all live points lie in one plane: no alpha complex in space; check the geometry they sample"
        )
    return in_diagonals(cloud, frame.diagonal)


def _height(cloud: np.ndarray) -> float:
    """Return how far `cloud` (M,3) around 0 reaches from the line through 0 and its farthest point, or, where
    that is less, out of the plane through these and the point farthest from the line; over the farthest's
    distance."""
    far = cloud[np.argmax(dot(cloud, cloud))]
    areas = np.cross(cloud, far)
    normal = areas[np.argmax(dot(areas, areas))]
    length, area = float(norm(far)), float(norm(normal))
    if not area > 0:
        return 0.0
    return min(area / length**2, float(np.abs(product(cloud, normal)).max()) / (area * length))


def plan_towards(
    target: Bundle | Statement, points: np.ndarray, config: LossConfig, seed: int, counter: int
) -> Plan:
    """Return the plan of live `points` (M,3), world units. It sees Gaussian noise of the deviation
    `config.noise` (/ diagonal), a function of (seed, counter).

    Raises InputError as `check_cloud`, `build_plan` and `build_betti_plan` do.
    """
    cloud = check_cloud(points, target)
    if config.noise > 0:
        cloud = cloud + config.noise * normals(stream(seed, "topology-noise", counter), *cloud.shape)
    if isinstance(target, Statement):
        return build_betti_plan(cloud, target, config)
    return build_plan(cloud, target, config)


class PlannedLoss(ABC):
    """A loss of M points whose plan is refreshed every few calls; what it aims at is a subclass's.

    defaults, settings: its LossConfig and what is changed in it; seed: of the noise that only the plan sees.
    Raises InputError for a setting that it does not follow or one out of range.
    """

    follows: tuple[str, ...] = ("noise", "curvature_weighted", "refresh_every", "fallback", "method")

    def __init__(self, defaults: LossConfig, settings: Mapping[str, Any], seed: int) -> None:
        if ignored := ", ".join(sorted(set(settings) - set(self.follows))):
            words = f"{type(self).__name__} does not follow the setting {ignored}"
            raise InputError(f"{words}; choose among {', '.join(self.follows)}")
        self.config, self.seed = with_changes(defaults, settings), whole("seed", seed)
        self.plan: Plan | None = None
        self._calls = self._refreshes = 0

    @abstractmethod
    def frame(self, points: np.ndarray) -> Bundle | Statement:
        """Return what the loss acts towards; points (M,3), world units, those of a refresh."""

    def refresh(self, points: Tensor | np.ndarray) -> Plan:
        """Make the plan of `points` (M,3), world units, and return it.

        Raises InputError when M is not the bundle's, for fewer than 4 points, coplanar ones, or a coordinate
        that is not finite.
        """
        cloud = as_numbers(points, "the points", "give an (M, 3) array of real numbers")
        frame = self.frame(cloud)
        self.plan = plan_towards(frame, cloud, self.config, self.seed, self._refreshes)
        self._diagonal = frame.diagonal
        self._refreshes += 1
        self._calls = 0
        return self.plan

    def __call__(self, points: Tensor) -> Tensor:
        """Return the loss (scalar, dtype of `points`) at `points` (M,3) floating point, world units.

        Differentiable once. Raises InputError as `refresh` does, and when refresh_every is 0 and `refresh`
        was never called.
        """
        if not isinstance(points, Tensor):
            raise InputError(
                f"the loss needs a torch tensor, got {type(points).__name__}; give "
                "torch.tensor(points, requires_grad=True)"
            )
        if not points.is_floating_point() or points.ndim != 2 or points.shape[1] != 3:
            raise InputError(
                "the loss needs floating-point points of shape (M, 3), "
                f"got {points.dtype} {tuple(points.shape)}"
            )
        every, plan = self.config.refresh_every, self.plan
        if plan is None and not every:
            raise InputError("no plan yet: call refresh(points) first, or give refresh_every > 0")
        if plan is None or (every and self._calls >= every):
            plan = self.refresh(points)
        self._calls += 1
        if len(points) != plan.samples:
            raise InputError(
                f"the plan was made on {plan.samples} points, got {len(points)}; call refresh(points)"
            )
        if self._diagonal * torch.finfo(points.dtype).max < 1.0:
            raise InputError(f"{points.dtype} cannot hold gradients by points so small; scale them up")
        used = points[plan.used.to(points.device)].cpu().double() / self._diagonal
        return plan.value(used).to(device=points.device, dtype=points.dtype)


class TopologyLoss(PlannedLoss):
    """Matched persistence loss of M points against a bundle.

    seed: of the noise that only the plan sees; settings: those fields of `paper_artifact.config.LossConfig`
    that stand in `follows`, for example refresh_every=0 (only `refresh` makes a plan) or noise=.005; samples
    and dimensions are the bundle's. Raises InputError for another setting or one out of range.
    """

    follows = (*PlannedLoss.follows, "recruitment", "floor_source")

    def __init__(self, bundle: Bundle, *, seed: int = 0, **settings: Any) -> None:
        if not isinstance(bundle, Bundle):
            raise InputError(f"a {type(bundle).__name__} is no Bundle; make one by `build_bundle`")
        super().__init__(LossConfig(samples=bundle.samples), settings, seed)
        self.bundle = bundle

    def frame(self, points: np.ndarray) -> Bundle:
        """Return the bundle."""
        return self.bundle


PRESETS: dict[str, dict[str, Any]] = {
    # Nothing else moves bare points: pull classes out of the noise, push all others to the diagonal (T2).
    "points": {"guard": 0.0, "suppress": "all"},
    # Images move a soup: pull only what is seen, push only what is no noise (T1).
    "soup": {},
}


class BettiLoss(PlannedLoss):
    """Loss of M points that are to have the Betti numbers `betti`.

    preset: "points" acts on bare points, which nothing else moves; "soup" on samples of a surface that images
    move too (condition T1). diagonal: the unit of the loss, world units; None takes the bounding box of the
    first points it sees. seed: of the noise that only the plan sees; settings: those fields of
    `paper_artifact.config.LossConfig` that stand in `follows`, over the preset's, for example
    dimensions=(1,), refresh_every=0 (only `refresh` makes a plan). A wanted class that the guard keeps the
    loss from is a Python warning, once.
    Raises InputError for other than three whole numbers b0 >= 1, b1 >= 0, b2 >= 0, an unknown preset, and as
    `TopologyLoss` does.
    """

    follows = (*PlannedLoss.follows, "betti", "dimensions", "guard", "suppress", "aim", "pull")

    def __init__(
        self,
        betti: tuple[int, ...],
        preset: str = "points",
        *,
        diagonal: float | None = None,
        seed: int = 0,
        **settings: Any,
    ) -> None:
        if not isinstance(preset, str) or preset not in PRESETS:
            raise InputError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r:.60}")
        stated = {"betti": () if betti is None else betti}  # None is refused, as any other than three numbers
        super().__init__(LossConfig("betti"), stated | PRESETS[preset] | settings, seed)
        if self.config.aim == "cloud":
            raise InputError("aim='cloud' needs a scene's SfM cloud (condition T3); choose another aim")
        self.betti = self.config.betti or ()
        self.statement = None if diagonal is None else Statement(self.betti, check_diagonal(diagonal))
        self._warned = False

    def frame(self, points: np.ndarray) -> Statement:
        """Return the statement, in the unit of the first points (M,3)."""
        if self.statement is None:
            extent = np.ptp(points, axis=0) if points.ndim == 2 and points.size else np.zeros(3)
            diagonal = diagonal_of(extent)
            if not np.isfinite(diagonal) or diagonal <= 0:  # the cloud's own check says what is wrong
                return Statement(self.betti, 1.0)
            self.statement = Statement(self.betti, diagonal)
        return self.statement

    def refresh(self, points: Tensor | np.ndarray) -> Plan:
        """As `PlannedLoss.refresh`; a wanted class that the loss does not act on is a warning, once."""
        plan = super().refresh(points)
        missed = sum(each["unreached"] for each in plan.report["dimensions"].values())
        if missed and not self._warned:
            self._warned = True
            warnings.warn(
                f"the loss does not act on {missed} of the wanted classes: no bar of theirs is longer than "
                f"{self.config.guard:g} of the floor; a smaller guard pulls them out of the noise",
                stacklevel=3,
            )
        return plan


def build_betti_plan(cloud: np.ndarray, statement: Statement, config: LossConfig) -> Plan:
    """Return the plan of a live `cloud` (M,3) float64, divided by the statement's diagonal.

    config: its guard, suppress and pull; dimensions None acts in all three. Raises InputError when more
    classes are wanted than there are bars, and what `alpha_persistence` raises for its points.
    """
    floor = measurement_floor(cloud, 1.0)

    def claim(dimension: int, bars: np.ndarray) -> Claims:
        claims = _ranked(bars, dimension, statement, floor, config)
        return _with_aim(claims, bars, dimension, cloud, config)

    return make_plan(cloud, config.dimensions or (0, 1, 2), claim, floor, floor, config)


def _ranked(
    bars: np.ndarray, dimension: int, statement: Statement, floor: float, config: LossConfig
) -> Claims:
    """Return what pulls the live `bars` (k,2) of one dimension: W, then R."""
    wanted = statement.wanted[dimension]
    if wanted > len(bars):
        raise InputError(
            f"betti asks for {wanted} finite bars of dimension {dimension} ({NAMES[dimension][1]}), but the "
            f"points have {len(bars)} in all; give a smaller number or more points"
        )
    lifetimes = bars[:, 1] - bars[:, 0]
    order = np.argsort(-lifetimes, kind="stable")
    first, others = order[:wanted], order[wanted:]
    chosen = first[lifetimes[first] > config.guard * floor]
    aims = bars[chosen] + [0.0, config.pull * floor / MULTIPLIER]
    if config.suppress == "none":
        others = others[:0]
    elif config.suppress == "floor" or dimension == 0:
        others = others[lifetimes[others] > floor]
    if statement.shown is not None:
        shown = statement.shown[dimension]
        chosen, others = first[: len(shown or ())], others[:0] if shown is None else others
        aims = np.column_stack([bars[chosen, 0], np.maximum(bars[chosen, 1], shown or ())])
    margins = lifetimes[order[: wanted + KEPT]] / floor
    return Claims(
        rows=np.concatenate([chosen, others]),
        targets=np.concatenate([np.arange(len(chosen)), np.full(len(others), NONE)]),
        kinds=np.repeat([MATCHED, DIAGONAL], [len(chosen), len(others)]),
        aims=aims,
        free=BIRTHS,
        report={
            "wanted": wanted,
            "unreached": wanted - len(chosen),
            "surplus": int((lifetimes[order[wanted:]] > SURPLUS * floor).sum()),
            "margins": margins.tolist(),  # lifetimes / floor: the wanted bars' and the next KEPT
        },
    )


def smoothed(cloud: np.ndarray) -> np.ndarray:
    """Return `cloud` (M,3) with each point moved to the mean of its nearest 16 points, itself among them,
    without repetitions."""
    _, nearest = cKDTree(cloud).query(cloud, k=min(NEIGHBOURS, len(cloud)))
    return np.unique(cloud[nearest].mean(axis=1), axis=0)  # two points may share all neighbours


def _clean_birth(dimension: int, samples: int, spacing: float) -> float:
    """Return the radius at which a uniform sample of a surface bears its classes, in the unit of `spacing`.

    spacing: the median distance r to the nearest neighbour of M = `samples` points. Points bear components at
    0; discs percolate (loops) at radius r sqrt(1.128 / ln 2) and cover (voids) at r sqrt(a / ln 2),
    a = ln M + ln(1 + a).
    """
    logarithm = float(log(samples))
    covering = logarithm
    for _ in range(50):  # a contraction: its derivative is 1 / (1 + a)
        covering = logarithm + float(log(1 + covering))
    return spacing * math.sqrt((0.0, PERCOLATION, covering)[dimension] / float(log(2.0)))


def _with_aim(
    claims: Claims, bars: np.ndarray, dimension: int, cloud: np.ndarray, config: LossConfig
) -> Claims:
    """Return `claims` on the `bars` (k,2) of one dimension with the aims of an ablation in `config.aim`.

    cloud (M,3): whose bars they are; all divided by the diagonal.
    """
    wanted = claims.kinds != DIAGONAL
    if config.aim == "none":
        return replace(
            claims,
            rows=claims.rows[~wanted],
            targets=claims.targets[~wanted],
            kinds=claims.kinds[~wanted],
            aims=np.zeros((0, 2)),
        )
    if config.aim in ("deaths", "cloud") or not wanted.any():
        return claims
    aims = claims.aims.copy()
    if config.aim == "births":
        aims[:, BIRTHS] = _clean_birth(dimension, len(cloud), median_spacing(cloud))
        return replace(claims, aims=aims, free=DEATHS)
    pairs = alpha_persistence(smoothed(cloud), config.method, as_given=True)[dimension]
    order = np.argsort(pairs.births - pairs.deaths, kind="stable")[: len(aims)]
    aims[:, DEATHS] = bars[claims.rows[wanted], DEATHS]
    aims[: len(order), DEATHS] = np.maximum(aims[: len(order), DEATHS], pairs.deaths[order])
    return replace(claims, aims=aims)
