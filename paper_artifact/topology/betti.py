"""The loss of a statement in words: Betti numbers (b0, b1, b2) instead of a ground truth's diagram.

    loss = BettiLoss((1, 2, 1))
    loss(points).backward()            # points (M,3), requires_grad; the plan is refreshed every 10 calls

At each refresh the bars of each dimension are ranked by lifetime; r is the live cloud's median spacing, the
floor is 6 r, and k = b0 - 1, b1, b2 bars are wanted. W are those of the first k that exceed guard · floor, R
those beyond k that exceed the floor (with suppress "all", in H1 and H2: all beyond k). With d_ref the death
at the refresh,

    L = Σ_W (d - (d_ref + pull · r))² + Σ_R ((d - b) / 2)²,

a practically linear pull of the wanted deaths, and the paper's diagonal term for the rest. Births of wanted
bars are free: sampling sets them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.topology.aims import aimed_otherwise
from paper_artifact.topology.floor import MULTIPLIER, measurement_floor
from paper_artifact.topology.loss import PlannedLoss
from paper_artifact.topology.plan import BIRTHS, Claims, Plan, make_plan
from paper_artifact.topology.pulls import DIAGONAL, MATCHED, NONE
from paper_artifact.topology.statement import NAMES, SURPLUS, Statement

KEPT = 2  # lifetimes beyond the wanted ones that a report keeps


def build_betti_plan(cloud: np.ndarray, statement: Statement, config: LossConfig) -> Plan:
    """Return the plan of a live `cloud` (M,3) float64, divided by the statement's diagonal.

    config: its guard, suppress and pull; dimensions None acts in all three. Raises InputError when more
    classes are wanted than there are bars, and what `alpha_persistence` raises for its points.
    """
    floor = measurement_floor(cloud, 1.0)

    def claim(dimension: int, bars: np.ndarray) -> Claims:
        claims = _ranked(bars, dimension, statement.wanted[dimension], floor, config)
        return claims if config.aim == "deaths" else aimed_otherwise(claims, bars, dimension, cloud, config)

    return make_plan(cloud, config.dimensions or (0, 1, 2), claim, floor, floor, config)


def _ranked(bars: np.ndarray, dimension: int, wanted: int, floor: float, config: LossConfig) -> Claims:
    """Return what pulls the live `bars` (k,2) of one dimension: W, then R."""
    if wanted > len(bars):
        raise InputError(
            f"betti asks for {wanted} finite bars of dimension {dimension} ({NAMES[dimension][1]}), but the "
            f"points have {len(bars)} in all; give a smaller number or more points"
        )
    lifetimes = bars[:, 1] - bars[:, 0]
    order = np.argsort(-lifetimes, kind="stable")
    first, others = order[:wanted], order[wanted:]
    chosen = first[lifetimes[first] > config.guard * floor]
    if config.suppress == "none":
        others = others[:0]
    elif config.suppress == "floor" or dimension == 0:
        others = others[lifetimes[others] > floor]
    margins = lifetimes[order[: wanted + KEPT]] / floor
    return Claims(
        rows=np.concatenate([chosen, others]),
        targets=np.concatenate([np.arange(len(chosen)), np.full(len(others), NONE)]),
        kinds=np.repeat([MATCHED, DIAGONAL], [len(chosen), len(others)]),
        aims=bars[chosen] + [0.0, config.pull * floor / MULTIPLIER],
        free=BIRTHS,
        report={
            "wanted": wanted,
            "unreached": wanted - len(chosen),
            "surplus": int((lifetimes[order[wanted:]] > SURPLUS * floor).sum()),
            "margins": margins.tolist(),  # lifetimes / floor: the wanted bars' and the next KEPT
        },
    )


class BettiLoss(PlannedLoss):
    """Loss of M points that are to have the Betti numbers `betti`.

    diagonal: the unit of the loss, world units; None takes the bounding box of the first points it sees.
    seed: of the noise that only the plan sees; settings: fields of `paper_artifact.config.LossConfig`, for
    example guard=0, suppress="all" (condition T2), refresh_every=0 (only `refresh` makes a plan). Raises
    InputError for other than three whole numbers b0 >= 1, b1 >= 0, b2 >= 0, and as `TopologyLoss` does.
    """

    def __init__(
        self, betti: tuple[int, ...], *, diagonal: float | None = None, seed: int = 0, **settings: Any
    ) -> None:
        super().__init__(LossConfig("betti"), {"betti": betti, **settings}, seed)
        self.betti = self.config.betti or ()
        self.statement = None if diagonal is None else Statement(self.betti, diagonal)

    def frame(self, points: np.ndarray) -> Statement:
        """Return the statement, in the unit of the first points (M,3)."""
        if self.statement is None:
            extent = np.ptp(points, axis=0) if points.ndim == 2 and len(points) else np.zeros(3)
            diagonal = float(np.linalg.norm(extent))
            if not np.isfinite(diagonal) or diagonal <= 0:  # the cloud's own check says what is wrong
                return Statement(self.betti, 1.0)
            self.statement = Statement(self.betti, diagonal)
        return self.statement

    def make(self, cloud: np.ndarray) -> Plan:
        """Return the plan of `cloud` (M,3), divided by the diagonal."""
        assert self.statement is not None
        return build_betti_plan(cloud, self.statement, self.config)
