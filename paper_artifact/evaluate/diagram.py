"""Persistence diagrams of surface samples, what is significant in them, and their bottleneck distances.

A diagram is a tuple of three arrays, one per dimension 0, 1, 2, each (k,2) float64: births and deaths of the
finite bars of the alpha complex, as RADII divided by the ground truth's bounding-box diagonal
(dimensionless). The one infinite bar of dimension 0 is left out, so a connected shape has no significant bar
there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from paper_artifact.alpha.distances import bottleneck
from paper_artifact.errors import require_memory
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.topology.floor import MULTIPLIER, check_diagonal, measurement_floor

BYTES_PER_POINT = 3000  # of alpha persistence: 300,000 points of a soup take 1.15 GB, uniform ones half of it
MOST = 24  # bars of a dimension that a record keeps
KEPT = 4  # longest bars kept per dimension: no surface of the study has more classes than that
Diagram = tuple[np.ndarray, np.ndarray, np.ndarray]


def diagram_of(points: np.ndarray, diagonal: float) -> Diagram:
    """Return the diagram of `points` (n,3) float64, world units, normalised by `diagonal` (world units).

    Raises InputError for a diagonal that is not positive, and what `alpha_persistence` raises for its points.
    """
    from paper_artifact.alpha.persistence import alpha_persistence  # compiled kernels: only when needed

    check_diagonal(diagonal)
    require_memory_for(len(points))
    pairs = alpha_persistence(points, as_given=True)
    h0, h1, h2 = (np.column_stack([each.births, each.deaths]) / float(diagonal) for each in pairs)
    return h0, h1, h2


def measure(mesh: Mesh, samples: int, seed: int) -> tuple[Diagram, float]:
    """Return (diagram, floor), radius / diagonal, of `samples` points of the mesh, those of a bundle: one
    rung of a density staircase (App. B, §6)."""
    points, _, _ = sample_surface(mesh.vertices, mesh.faces, samples, stream(seed, "bundle-samples"))
    return diagram_of(points, mesh.diagonal), measurement_floor(points, mesh.diagonal, MULTIPLIER)


def require_memory_for(samples: int) -> None:
    """Raise InputError when the diagram of so many samples takes more memory than is available."""
    require_memory(BYTES_PER_POINT * samples, f"the diagram of {samples} samples", "give fewer samples")


def lifetimes(bars: np.ndarray) -> np.ndarray:
    """Return deaths - births (k,) of one dimension's bars (k,2), in the bars' own unit."""
    return bars[:, 1] - bars[:, 0]


def significant_counts(diagram: Sequence[np.ndarray], floor: float) -> tuple[int, int, int]:
    """Return how many finite bars per dimension live longer than `floor` (radius / diagonal), paper §3.1.

    A connected shape counts 0 in dimension 0: add one for the infinite bar to compare with a Betti number.
    """
    h0, h1, h2 = (int((lifetimes(bars) > floor).sum()) for bars in diagram)
    return h0, h1, h2


def longest(bars: np.ndarray, count: int = KEPT) -> np.ndarray:
    """Return the `count` longest lifetimes (count,) of the bars (k,2), longest first, filled up with 0."""
    lengths = np.sort(lifetimes(bars))[::-1][:count]
    return np.pad(lengths, (0, count - len(lengths)))


def longest_bars(bars: np.ndarray, floor: float, at_least: int = 8) -> np.ndarray:
    """Return the longest of `bars` (k,2), longest first: those above half the `floor`, at most MOST.

    Ties are ordered by birth, so equal diagrams give equal rows.
    """
    lengths = lifetimes(bars)
    count = min(max(int((lengths > floor / 2).sum()), at_least), MOST)
    return bars[np.lexsort((bars[:, 0], -lengths))[:count]]


def bottlenecks(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Return the bottleneck distance per dimension of two diagrams (finite bars)."""
    h0, h1, h2 = (bottleneck(left, right) for left, right in zip(a, b, strict=True))
    return h0, h1, h2
