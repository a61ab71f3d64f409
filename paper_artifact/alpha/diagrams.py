"""Persistence diagrams of a point tensor with gradients: closed-form circumradii (paper §3.2).

    loops = alpha_diagrams(points)[1]
    (loops.bars[:, 1] - loops.bars[:, 0]).square().sum().backward()

Where this breaks: the pairing is that of the points as they are; a gradient step may change it, so call again
after every step (`TopologyLoss` keeps its plan for a few steps instead). Bars of length zero are not there,
so they get no gradient.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from paper_artifact.alpha.circumradius import circumradius
from paper_artifact.alpha.gabriel import TOLERANCE
from paper_artifact.alpha.persistence import alpha_persistence


@dataclass(frozen=True, eq=False)
class DiagramTensor:
    """The k finite bars of one dimension."""

    bars: Tensor  # (k,2) births and deaths, RADII in the points' unit; dtype and device of the points
    gabriel: Tensor  # (k,2) bool: is the value its simplex's own circumradius; where not, it is a constant

    def __len__(self) -> int:
        return len(self.bars)


def alpha_diagrams(points: Tensor) -> tuple[DiagramTensor, DiagramTensor, DiagramTensor]:
    """Return the alpha diagrams of dimensions 0, 1, 2 of `points` (n,3), differentiable (once) by the points.

    Any float dtype and device; computed in double precision on the CPU (`alpha_persistence`). A value that
    fails the Gabriel gate, relative 1e-6, is detached. Raises InputError as `alpha_persistence` does: other
    shapes, NaN.
    """
    cloud = points.to("cpu", torch.float64)
    made = []
    for pairs in alpha_persistence(cloud.detach().numpy()):
        births, born = _radii(cloud, pairs.birth_simplices, pairs.births)
        deaths, died = _radii(cloud, pairs.death_simplices, pairs.deaths)
        bars, gabriel = torch.stack([births, deaths], dim=1), torch.stack([born, died], dim=1)
        made.append(DiagramTensor(bars.to(points), gabriel.to(points.device)))
    components, loops, voids = made
    return components, loops, voids


def _radii(cloud: Tensor, simplices: np.ndarray, values: np.ndarray) -> tuple[Tensor, Tensor]:
    """Return the simplices' radii (k,), a constant where the Gabriel gate fails, and the gate (k,) bool."""
    constants = torch.from_numpy(values)
    own = circumradius(cloud[torch.from_numpy(simplices)])
    gate = (own.detach() - constants).abs() <= TOLERANCE * constants
    return torch.where(gate, own, constants), gate
