"""The measurement floor of a point sample.

Paper §3.1 and §6: a bar is significant iff its lifetime exceeds 6·r_med(M), r_med the median
nearest-neighbour distance of the M samples. For a uniform sample of a surface r_med ≈ sqrt(ln 2 · Area / (π
M)), so the floor falls as M^(-1/2).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact.alpha.persistence import LARGEST
from paper_artifact.arithmetic import norm
from paper_artifact.errors import InputError, as_numbers, real

MULTIPLIER = 6.0  # k of the measurement floor k·r_med (paper §3.1)
FAR = 1e100  # times a diagonal, or a part of it: a size of points whose squares leave float64


def space_points(points: Any, least: int, what: str) -> np.ndarray:
    """Return `points` (n,3) as float64. Raises InputError, a sentence that begins with `what`, for fewer than
    `least`, another shape, what are no numbers, and coordinates not finite or beyond LARGEST of `alpha`."""
    points = np.asarray(as_numbers(points, "the points", "give an (n, 3) array of real numbers"), np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < least:
        raise InputError(
            f"{what} needs at least {least} points of shape (n, 3), got {points.shape}; give more"
        )
    if not (np.abs(points) <= LARGEST).all():
        raise InputError(
            f"{what} needs coordinates that are finite and below 1e307; remove others, scale all, or take "
            "smaller steps"
        )
    return points


def unit_of(extent: np.ndarray) -> float:
    """Return the power of two just below the largest of an extent (3,): in this unit no square of a distance
    leaves float64, and to divide by it is exact."""
    return 2.0 ** (math.frexp(float(extent.max()))[1] - 1)


def diagonal_of(extent: np.ndarray) -> float:
    """Return the length of a box's extent (3,), of any size."""
    unit = unit_of(extent)
    return float(norm(extent / unit)) * unit


def in_diagonals(points: np.ndarray, diagonal: float) -> np.ndarray:
    """Return `points` (n,3) divided by the diagonal. Raises InputError where they have not its scale."""
    size = diagonal_of(np.ptp(points, axis=0)) / diagonal
    if size and not 1 / FAR < size < FAR:
        raise InputError(
            f"the points extend over {size:.1g} diagonals of {diagonal:.3g}; give the diagonal in their unit"
        )
    return points / diagonal


def median_spacing(points: np.ndarray) -> float:
    """Return r_med, the median nearest-neighbour distance of `points` (n,3) float, in their own unit (world).

    Raises InputError for fewer than two points or a coordinate that is not finite.
    """
    points = space_points(points, 2, "the median spacing")
    unit = unit_of(np.ptp(points, axis=0))
    points = points / unit
    distances, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distances[:, 1])) * unit


def check_diagonal(diagonal: float) -> float:
    """Return `diagonal` (world units) as a float; raise InputError unless it is a positive, finite length."""
    if not 0 < real(diagonal) < np.inf:
        raise InputError(
            f"the diagonal must be a positive length, got {diagonal!r:.60}; "
            "use the ground truth's bounding-box diagonal"
        )
    return float(diagonal)


def measurement_floor(points: np.ndarray, diagonal: float, k: float = MULTIPLIER) -> float:
    """Return the floor k·r_med/diagonal: lifetimes (radius / diagonal) above it are significant.

    points (n,3) float, world units; diagonal: the ground truth's bounding-box diagonal, same unit; k = 6 in
    the paper. Raises InputError for fewer than two points, a coordinate that is not finite, a diagonal or k
    that is not positive, and points of which most repeat others.
    """
    if not 0 < real(k) < np.inf:
        raise InputError(f"k is {k!r:.60}; give a positive number, {MULTIPLIER:g} in the paper")
    floor = float(k) * median_spacing(points) / check_diagonal(diagonal)
    if not floor > 0:
        raise InputError("most points repeat others, so that their median spacing is 0; give each point once")
    return floor


def uniform_spacing(area: float, count: int) -> float:
    """Return the closed form r_med = sqrt(ln 2 · area / (π count)) of `count` uniform samples of a surface.

    Nearest-neighbour distances of a planar Poisson process of density count/area follow P(r > s) = exp(-π s²
    count/area); the median is where this is one half. area in squared units, result in that unit (paper §6,
    the uniform-sampling law). Raises InputError when area or count is not positive.
    """
    if not (0 < real(area) < np.inf and 0 < real(count) < np.inf):
        raise InputError(f"the closed-form spacing needs a positive area and count, got {area} and {count}")
    return float(np.sqrt(np.log(2.0) * area / (np.pi * count)))


def significant(bars: np.ndarray, floor: float) -> np.ndarray:
    """Return the mask (k,) bool of the `bars` (k,2) (birth, death) whose lifetime exceeds `floor`.

    Bars and floor in one unit.
    """
    bars = np.asarray(bars, dtype=np.float64).reshape(-1, 2)
    return bars[:, 1] - bars[:, 0] > floor
