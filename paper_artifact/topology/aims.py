"""What else the wanted bars of a statement in words may be pulled to than beyond their deaths: ablations.

"smoothed" (S16): at least the death of the bar of the same rank in the cloud whose points are means of 16
neighbours; bounded, since roughness that is averaged away cannot be pulled at. "births": deaths are free, and
births go to what a clean sample of the same spacing has. "none": wanted bars are not pulled at all.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.config import LossConfig
from paper_artifact.topology.floor import median_spacing
from paper_artifact.topology.plan import BIRTHS, DEATHS, Claims
from paper_artifact.topology.pulls import DIAGONAL

NEIGHBOURS = 16  # of the smoothed cloud
PERCOLATION = 1.128  # mean number of discs of a point at which discs on a plane connect


def smoothed(cloud: np.ndarray, neighbours: int = NEIGHBOURS) -> np.ndarray:
    """Return `cloud` (M,3) with each point moved to the mean of its nearest `neighbours`, itself among
    them, without repetitions."""
    _, nearest = cKDTree(cloud).query(cloud, k=min(neighbours, len(cloud)))
    return np.unique(cloud[nearest].mean(axis=1), axis=0)  # two points may share all neighbours


def clean_birth(dimension: int, samples: int, spacing: float) -> float:
    """Return the radius at which a uniform sample of a surface bears its classes, in the unit of `spacing`.

    spacing: the median distance r to the nearest neighbour of M = `samples` points. Points bear components at
    0; discs percolate (loops) at radius r sqrt(1.128 / ln 2) and cover (voids) at r sqrt(a / ln 2),
    a = ln M + ln(1 + a).
    """
    covering = math.log(samples)
    for _ in range(50):  # a contraction: its derivative is 1 / (1 + a)
        covering = math.log(samples) + math.log(1 + covering)
    return spacing * math.sqrt((0.0, PERCOLATION, covering)[dimension] / math.log(2))


def aimed_otherwise(
    claims: Claims, bars: np.ndarray, dimension: int, cloud: np.ndarray, config: LossConfig
) -> Claims:
    """Return `claims` on the `bars` (k,2) of one dimension with the aims of `config.aim`.

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
    if not wanted.any():
        return claims
    aims = claims.aims.copy()
    if config.aim == "births":
        aims[:, BIRTHS] = clean_birth(dimension, len(cloud), median_spacing(cloud))
        return replace(claims, aims=aims, free=DEATHS)
    pairs = alpha_persistence(smoothed(cloud), config.method, as_given=True)[dimension]
    order = np.argsort(pairs.births - pairs.deaths, kind="stable")[: len(aims)]
    aims[:, DEATHS] = bars[claims.rows[wanted], DEATHS]
    aims[: len(order), DEATHS] = np.maximum(aims[: len(order), DEATHS], pairs.deaths[order])
    return replace(claims, aims=aims)
