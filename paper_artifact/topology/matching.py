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
    return ((live[:, None, :] - target[None, :, :]) ** 2).sum(axis=2)


def match_bars(live: np.ndarray, target: np.ndarray, diagonal_factor: float = PAPER_DIAGONAL) -> Matching:
    """Return the optimal partial matching of bars `live` (n,2) and `target` (m,2) on the augmented cost.

    The (n+m) × (m+n) cost holds the pair costs, diagonal_factor·(d - b)² on the diagonals of the two side
    blocks, and 0 between two diagonal copies; solved by scipy's linear_sum_assignment (Crouse 2016, a
    Hungarian-type method).
    """
    live, target = (np.asarray(bars, dtype=np.float64).reshape(-1, 2) for bars in (live, target))
    n, m = len(live), len(target)
    live_diagonal = diagonal_factor * (live[:, 1] - live[:, 0]) ** 2
    target_diagonal = diagonal_factor * (target[:, 1] - target[:, 0]) ** 2
    cost = np.zeros((n + m, m + n))
    cost[:n, :m] = pair_costs(live, target)
    # Dearer than any whole matching, yet on the scale of the costs, so no digits of theirs are lost.
    forbidden = 2 * (cost.sum() + live_diagonal.sum() + target_diagonal.sum()) + np.finfo(np.float64).tiny
    cost[:n, m:] = forbidden
    cost[n:, :m] = forbidden
    cost[np.arange(n), m + np.arange(n)] = live_diagonal
    cost[n + np.arange(m), np.arange(m)] = target_diagonal
    rows, columns = linear_sum_assignment(cost)
    is_pair = (rows < n) & (columns < m)
    matched = np.column_stack([rows[is_pair], columns[is_pair]]).astype(np.int64).reshape(-1, 2)
    matched = matched[np.argsort(matched[:, 1], kind="stable")]
    return Matching(
        matched=matched,
        unmatched_live=np.setdiff1d(np.arange(n), matched[:, 0]),
        unmatched_target=np.setdiff1d(np.arange(m), matched[:, 1]),
        cost=float(cost[rows, columns].sum()),
    )


def recruit(pool: np.ndarray, missing: np.ndarray) -> list[tuple[int, int]]:
    """Return (pool index, missing index) pairs: each missing target claims its nearest free pool bar.

    The paper's L_recruit. pool (n,2): every live bar the matching did not claim, sub-threshold ones included;
    missing (m,2): unmatched targets. Targets go in decreasing persistence (equal ones in index order),
    without replacement; an empty pool leaves the rest out.
    """
    pool, missing = (np.asarray(bars, dtype=np.float64).reshape(-1, 2) for bars in (pool, missing))
    free = np.ones(len(pool), dtype=bool)
    claimed: list[tuple[int, int]] = []
    for j in np.argsort(-(missing[:, 1] - missing[:, 0]), kind="stable"):
        if not free.any():
            break
        costs = np.where(free, pair_costs(pool, missing[j : j + 1])[:, 0], np.inf)
        k = int(np.argmin(costs))
        free[k] = False
        claimed.append((k, int(j)))
    return claimed
