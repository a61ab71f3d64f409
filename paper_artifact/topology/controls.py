"""The norm-matched control C2: a short-range repulsion of the same samples, with no topological information.

Paper §3.5 names "a short-range repulsion on the same frozen samples, calibrated with the same ρ (C2g: a
gentler radius)" and gives no formula. Ours: E = (1/M) Σ over sample pairs closer than h of (1 - r/h)²,
distances divided by the diagonal, h a multiple of the target's median spacing r_med(M). Default h = 4 r_med:
about eleven neighbours of a uniform sample, and below the floor of 6 r_med, hence short-range for every
significant feature; C2g halves it (about three neighbours).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from paper_artifact.alpha.diagrams import FirstDerivative

# Pairs are listed with the plan, up to this multiple of h, so that samples that come closer between two
# refreshes count.
SKIN = 1.25


def neighbour_pairs(cloud: np.ndarray, radius: float) -> np.ndarray:
    """Return the index pairs (n,2) int64 of `cloud` (M,3) closer than SKIN·radius, in a fixed order."""
    pairs = cKDTree(cloud).query_pairs(SKIN * radius, output_type="ndarray").astype(np.int64).reshape(-1, 2)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def repulsion(positions: Tensor, pairs: np.ndarray, radius: float) -> Tensor:
    """Return E (scalar float64) of `positions` (M,3) float64 over `pairs` (n,2).

    radius: h, in the unit of the positions. Differentiable once; two samples at one place push each other in
    no direction (gradient 0).
    """
    return _Repulsion.apply(positions, pairs, radius)


class _Repulsion(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, positions: Tensor, pairs: np.ndarray, radius: float) -> Tensor:
        points = positions.detach().numpy()
        difference = points[pairs[:, 0]] - points[pairs[:, 1]]
        distance = np.sqrt((difference**2).sum(axis=1))
        overlap = np.maximum(0.0, 1.0 - distance / radius)
        slope = -2.0 * overlap / (radius * len(points)) / np.where(distance > 0, distance, 1.0)
        force = slope[:, None] * difference
        gradient = np.column_stack(
            [
                np.bincount(pairs[:, 0], force[:, axis], len(points))
                - np.bincount(pairs[:, 1], force[:, axis], len(points))
                for axis in range(3)
            ]
        )
        ctx.save_for_backward(positions, torch.from_numpy(gradient))
        return torch.tensor((overlap**2).sum() / len(points), dtype=torch.float64)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        positions, gradient = ctx.saved_tensors
        return FirstDerivative.apply(upstream * gradient, positions), None, None
