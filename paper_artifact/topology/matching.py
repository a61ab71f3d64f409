"""Optimal partial matching of live bars to target bars, and recruitment for the targets it leaves out.

Paper §3.3. Bars are (birth, death) radii divided by the target's diagonal; the metric between bars is the
squared birth-death distance (b - b*)² + (d - d*)², and a bar left alone costs ((d - b)/2)².

"Equivalently W2" (paper) holds up to the diagonal's norm: W2 with the Euclidean ground metric charges (d -
b)²/2, twice the paper's term, and W2 with the maximum norm charges ((d - b)/2)² but measures matched bars by
the larger coordinate. The paper's equation mixes the two; `diagonal_factor` = 1/4 is the equation, 1/2 is W2²
exactly (tests compare with gudhi).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

PAPER_DIAGONAL = 0.25  # of (d - b)²: what a bar left alone costs


@dataclass(frozen=True)
class Matching:
    """Optimal partial matching: indices into the live bars (n,2) and target bars (m,2) it was made from."""

    matched: np.ndarray  # (p,2) int64: pairs (live, target), in target order
    unmatched_live: np.ndarray  # sorted int64
    unmatched_target: np.ndarray  # sorted int64
    cost: float  # of the whole, the constants of unmatched targets included


def pair_costs(live: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the squared birth-death distances (n,m) of bars (n,2) and (m,2)."""
    births, deaths = (live[:, None, side] - target[None, :, side] for side in (0, 1))
    return births**2 + deaths**2


def match_bars(live: np.ndarray, target: np.ndarray, diagonal_factor: float = PAPER_DIAGONAL) -> Matching:
    """Return the optimal partial matching of bars `live` (n,2) and `target` (m,2) on the augmented cost.

    Minimises the augmented cost (pair costs, diagonal_factor·(d - b)² of each bar left alone). A pair's gain
    is its cost less that of leaving both alone; the best set of gains is an assignment on the n × m matrix of
    the gains below 0, without the copies of the diagonal. Solved by scipy's linear_sum_assignment (Crouse
    2016, a Hungarian-type method).
    """
    live, target = (np.asarray(bars, dtype=np.float64).reshape(-1, 2) for bars in (live, target))
    alone = [diagonal_factor * (bars[:, 1] - bars[:, 0]) ** 2 for bars in (live, target)]
    gains = np.minimum(pair_costs(live, target) - alone[0][:, None] - alone[1], 0.0)
    # a bar that no pair gains anything with stays alone
    rows, columns = (np.flatnonzero(gains.any(axis=axis)) for axis in (1, 0))
    chosen = linear_sum_assignment(gains[np.ix_(rows, columns)])
    matched = np.column_stack([rows[chosen[0]], columns[chosen[1]]]).astype(np.int64)
    matched = matched[gains[matched[:, 0], matched[:, 1]] < 0]
    matched = matched[np.argsort(matched[:, 1], kind="stable")]
    return Matching(
        matched=matched,
        unmatched_live=np.setdiff1d(np.arange(len(live)), matched[:, 0]),
        unmatched_target=np.setdiff1d(np.arange(len(target)), matched[:, 1]),
        cost=float(alone[0].sum() + alone[1].sum() + gains[matched[:, 0], matched[:, 1]].sum()),
    )


def recruit(pool: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Return pairs (p,2) int64 (pool, missing): each missing target claims its nearest free pool bar.

    The paper's L_recruit. pool (n,2): every live bar the matching did not claim, sub-threshold ones included;
    missing (m,2): unmatched targets. Targets go in decreasing persistence (equal ones in index order),
    without replacement; an empty pool leaves the rest out.
    """
    pool, missing = (np.array(bars, dtype=np.float64).reshape(-1, 2) for bars in (pool, missing))
    births, deaths = pool.T.copy()
    claimed = []
    for j in np.argsort(-(missing[:, 1] - missing[:, 0]), kind="stable")[: len(pool)]:
        k = int(np.argmin((births - missing[j, 0]) ** 2 + (deaths - missing[j, 1]) ** 2))
        births[k] = np.inf  # no longer free
        claimed.append((k, int(j)))
    return np.array(claimed, dtype=np.int64).reshape(-1, 2)
