"""The importance field of the allocation study: where a surface's significant features live (paper App. A,
the field's equation).

Each significant feature of the target gives Gaussian kernels at the vertices of its birth and death
simplices, or of its death simplex alone. Everything here is in world units; a death is a RADIUS (the paper's
"death" is the squared alpha value, and it takes the root).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.arithmetic import exp
from paper_artifact.config import AllocationConfig
from paper_artifact.errors import InputError
from paper_artifact.topology.floor import measurement_floor, median_spacing, significant

NORMALISING_PERCENTILE = 99.5  # of a dimension's values on the dense sample: becomes 1
NARROWEST, WIDEST = 3.0, 0.5  # a width is at least 3 r_med and at most half the diagonal, before it is spread
CHUNK = 4096  # points evaluated at once, for memory


@dataclass(frozen=True, eq=False)
class Kernels:
    """The Gaussian kernels of one dimension."""

    centres: np.ndarray  # (n,3) world
    weights: np.ndarray  # (n,) w_f = lifetime / s², world units
    widths: np.ndarray  # (n,) σ_f = s · clip(death, 3 r_med, diagonal / 2), world units

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return φ_d (m,), the sum of the kernels at `points` (m,3), world units."""
        values = [
            (self.weights * exp(-((block[:, None] - self.centres) ** 2).sum(2) / (2 * self.widths**2))).sum(1)
            for block in np.array_split(points, max(1, -(-len(points) // CHUNK)))
        ]
        return np.concatenate(values)


@dataclass(frozen=True, eq=False)
class ImportanceField:
    """Importance in [0, 1] of any point: the value of the nearest point of a dense sample of the target
    surface."""

    samples: np.ndarray  # (n,3) world
    values: np.ndarray  # (n,) in [0, 1]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the importance (m,) of `points` (m,3), world units."""
        return self.values[cKDTree(self.samples).query(points)[1]]


def feature_kernels(points: np.ndarray, diagonal: float, prior: AllocationConfig) -> list[Kernels]:
    """Return the kernels of the dimensions that have significant features, of a target's `points` (M,3),
    world units, at the vertices of the features' simplices that `prior` names, as widely spread.

    diagonal: of the target, world units. A feature is significant when its lifetime exceeds 6 r_med(M).
    Raises InputError when no feature is significant.
    """
    spread = prior.spread
    floor = measurement_floor(points, diagonal) * diagonal
    spacing = median_spacing(points)
    made = []
    for pairs in alpha_persistence(points, as_given=True):
        rows = np.flatnonzero(significant(np.column_stack([pairs.births, pairs.deaths]), floor))
        if not len(rows):
            continue
        centres, weights, widths = [], [], []
        for row in rows:
            corners = pairs.death_simplices[row]
            if prior.simplices == "both":
                corners = np.union1d(pairs.birth_simplices[row], corners)
            width = spread * np.clip(pairs.deaths[row], NARROWEST * spacing, WIDEST * diagonal)
            centres.append(points[corners])
            weights += [(pairs.deaths[row] - pairs.births[row]) / spread**2] * len(corners)
            widths += [width] * len(corners)
        made.append(Kernels(np.concatenate(centres), np.array(weights), np.array(widths)))
    if not made:
        raise InputError(
            f"the target has no significant feature at M = {len(points)}, so no field; raise samples"
        )
    return made


def importance_field(kernels: list[Kernels], dense: np.ndarray) -> ImportanceField:
    """Return the field of `kernels` (one per dimension) on a `dense` sample (n,3) of the target surface,
    world units.

    Each dimension is divided by its 99.5th percentile and cut at 1; dimensions are combined by their maximum.
    """
    values = []
    for each in kernels:
        raw = each.at(dense)
        values.append(np.minimum(raw / np.percentile(raw, NORMALISING_PERCENTILE), 1.0))
    return ImportanceField(dense, np.maximum.reduce(values))
