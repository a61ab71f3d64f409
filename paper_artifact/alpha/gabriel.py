"""The Gabriel gate: is a paired simplex's filtration value its own circumradius, and what if it is not.

Paper §3.2: the re-expressed value must match the filtration value to a relative 1e-6; a pair that fails is
detached. In general position a simplex of a bar of positive length is critical, hence Gabriel, so failures
mean rounding or degenerate input.

Fallbacks (`LossConfig.fallback`):
  detach       the paper's default: the pair keeps its value in the loss and gets no gradient;
  drop         failing bars are taken out before the matching: a sound bar may claim the target instead;
  subgradient  a non-Gabriel simplex has the value of one of its cofaces; if one more sample of the cloud
               gives a coface whose circumradius is that value, the coface is differentiated instead (one
               element of the generalised gradient); if none does (two levels up, or a tetrahedron), the pair
               is detached;
  denser       the surface is sampled more densely on the triangles of the failing simplices and the plan is
               made again on the enlarged cloud, at most three times; what still fails is detached. Needs a
               surface, so only `TopologyTerm` has it.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.alpha.circumradius import radius_and_gradient

TOLERANCE = 1e-6  # relative (paper §3.2)
NEAREST = 4  # candidate cofaces that are tried, best match first


def own_radii(cloud: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    """Return the circumradii (n,) of `simplices` (n,k) int64 into `cloud` (M,3) float64, unit of the
    cloud.
    """
    if not len(simplices):
        return np.zeros(0)
    return radius_and_gradient(cloud[simplices])[0]


def passes_gate(
    cloud: np.ndarray, simplices: np.ndarray, values: np.ndarray, tolerance: float = TOLERANCE
) -> np.ndarray:
    """Return the mask (n,) of simplices (n,k) whose circumradius is relatively their filtration value (n,).

    values: radii, like the cloud (M,3) in one unit.
    """
    return np.abs(own_radii(cloud, simplices) - values) <= tolerance * np.abs(values)


def coface_of_value(
    cloud: np.ndarray, simplex: np.ndarray, value: float, tolerance: float = TOLERANCE
) -> np.ndarray | None:
    """Return the coface (k+1,) of `simplex` (k,) with one more sample whose circumradius is `value`, or None.

    Only a coface may be differentiated in the simplex's place that itself has an empty circumsphere, that is,
    no sample strictly inside; the best match is taken.
    """
    if len(simplex) not in (2, 3):
        return None
    others = np.setdiff1d(np.arange(len(cloud)), simplex)
    candidates = np.column_stack([np.broadcast_to(simplex, (len(others), len(simplex))), others])
    error = np.abs(own_radii(cloud, candidates) - value)
    for row in np.argsort(error, kind="stable")[:NEAREST]:
        if error[row] <= tolerance * abs(value) and _is_empty(cloud, candidates[row], value):
            return candidates[row]
    return None


def _is_empty(cloud: np.ndarray, simplex: np.ndarray, radius: float) -> bool:
    """Return whether no sample lies strictly inside the smallest circumsphere, of `radius`, of `simplex`."""
    points = cloud[simplex]
    edges = points[1:] - points[0]
    # The least-norm solution is the circumcentre in the simplex's own plane, relative to its first corner.
    centre = points[0] + np.linalg.lstsq(edges, (edges**2).sum(axis=1) / 2, rcond=None)[0]
    distances = np.linalg.norm(cloud - centre, axis=1)
    distances[simplex] = np.inf
    return bool(distances.min() >= radius * (1 - TOLERANCE))
