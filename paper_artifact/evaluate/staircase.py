"""One rung of a density staircase: what a clean surface shows at M samples, and its floor (App. B, §6)."""

from __future__ import annotations

import numpy as np

from paper_artifact.evaluate.diagram import Diagram, diagram_of, lifetimes
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.topology.floor import MULTIPLIER, measurement_floor

KEPT = 4  # longest bars kept per dimension: no surface of the study has more classes than that


def measure(mesh: Mesh, samples: int, seed: int) -> tuple[Diagram, float]:
    """Return (diagram, floor), radius / diagonal, of `samples` points of the mesh: those of a bundle."""
    points, _, _ = sample_surface(mesh.vertices, mesh.faces, samples, stream(seed, "bundle-samples"))
    return diagram_of(points, mesh.diagonal), measurement_floor(points, mesh.diagonal, MULTIPLIER)


def longest(bars: np.ndarray, count: int = KEPT) -> np.ndarray:
    """Return the `count` longest lifetimes (count,) of the bars (k,2), longest first, filled up with 0."""
    lengths = np.sort(lifetimes(bars))[::-1][:count]
    return np.pad(lengths, (0, count - len(lengths)))
