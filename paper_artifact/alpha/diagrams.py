"""Persistence diagrams of a point tensor with gradients: closed-form circumradii (paper §3.2).

    loops = alpha_diagrams(points)[1]
    (loops.bars[:, 1] - loops.bars[:, 0]).square().sum().backward()

Where this breaks: the pairing is that of the points as they are; a gradient step may change it, so call again
after every step (`TopologyLoss` keeps its plan for a few steps instead). Bars of length zero are left out, so
they get no gradient. A radius has no second derivative here: a gradient penalty raises InputError.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from paper_artifact.alpha.persistence import alpha_persistence, canonical_order, check_points, of_each
from paper_artifact.alpha.radii import TOLERANCE, radius_and_gradient
from paper_artifact.errors import InputError


@dataclass(frozen=True, eq=False)
class DiagramTensor:
    """The k bars of one dimension."""

    bars: Tensor  # (k,2) births and deaths, RADII in the points' unit; dtype and device of the points
    gabriel: Tensor  # (k,2) bool: is the value its simplex's own circumradius; where not, it is a constant

    def __len__(self) -> int:
        return len(self.bars)


@of_each
def alpha_diagrams(
    points: Tensor | np.ndarray,
    *,
    infinite: bool = False,
    squared: bool = False,
    max_dimension: int | None = None,
    max_radius: float = float("inf"),
) -> tuple[DiagramTensor, ...]:
    """Return the alpha diagrams of `points` (n,3) or (n,2), differentiable (once) by the points.

    One DiagramTensor for each dimension, as `alpha_persistence` gives them with the same options. points: a
    tensor of any real dtype and device, or an array; computed in double precision on the CPU. The bars have
    the dtype and device of a floating-point tensor, and are float64 for all else. A value that fails the
    Gabriel gate, relative 1e-6, is detached. A batch (b,n,d) or a list of clouds gives a list of such tuples.
    Raises InputError as `alpha_persistence` does (other shapes, complex numbers, NaN), and for bars beyond
    the range of the points' dtype.
    """
    checked = check_points(points)
    if not isinstance(points, Tensor) or not points.is_floating_point():
        points = torch.tensor(checked)
    order = canonical_order(checked)
    cloud = points.reshape(checked.shape).to("cpu", torch.float64)[torch.from_numpy(order)]
    if cloud.shape[1] == 2:
        cloud = torch.nn.functional.pad(cloud, (0, 1))
    made = []
    options: Any = {"squared": squared, "max_dimension": max_dimension, "max_radius": max_radius}
    for pairs in alpha_persistence(checked[order], as_given=True, infinite=infinite, **options):
        ends = np.sqrt((pairs.births, pairs.deaths)) if squared else (pairs.births, pairs.deaths)
        births, born = _radii(cloud, pairs.birth_simplices, ends[0])
        deaths, died = _radii(cloud, pairs.death_simplices, ends[1])
        bars, gabriel = torch.stack([births, deaths], dim=1), torch.stack([born, died], dim=1)
        bars = (bars.square() if squared else bars).to(points.dtype)
        if bars.isinf().sum() != np.isinf(pairs.deaths).sum() or not (bars[:, 1] > 0).all():
            raise InputError(f"the bars leave the range of {bars.dtype}; scale the points or give float64")
        made.append(DiagramTensor(bars.to(points.device), gabriel.to(points.device)))
    return tuple(made)


def _radii(cloud: Tensor, simplices: np.ndarray, values: np.ndarray) -> tuple[Tensor, Tensor]:
    """Return the simplices' radii (k,), a constant where the Gabriel gate fails, and the gate (k,) bool."""
    constants = torch.from_numpy(values)
    own = circumradius(cloud[torch.from_numpy(simplices)])
    gate = ((own.detach() - constants).abs() <= TOLERANCE * constants) & constants.isfinite()
    return torch.where(gate, own, constants), gate


class AlphaPersistence(torch.nn.Module):
    """`alpha_diagrams` with fixed options as a module: points in, diagrams out."""

    def __init__(self, **options: Any) -> None:
        """Keep the options of `alpha_diagrams`: infinite, squared, max_dimension, max_radius."""
        super().__init__()
        self.options = options

    def forward(self, points: Tensor | Sequence[Tensor]) -> tuple[DiagramTensor, ...] | list:
        """Return the diagrams of `points` (n,3) or (n,2); of a batch (b,n,d) or a list, a list of them."""
        return alpha_diagrams(points, **self.options)

    def extra_repr(self) -> str:
        """Return the options for print()."""
        return ", ".join(f"{name}={value}" for name, value in self.options.items())


def circumradius(corners: Tensor) -> Tensor:
    """Return the circumradii (n,) of simplices with `corners` (n,k,3), k = 1 (radius 0), 2, 3 or 4.

    Dtype and device are those of the corners. Differentiable once, by the closed form above. Use float64: the
    Gabriel gate compares at 1e-6. Raises InputError for another shape or an integer dtype.
    """
    shape = tuple(corners.shape) if isinstance(corners, Tensor) and corners.is_floating_point() else ()
    if shape[1:] not in [(k, 3) for k in range(1, 5)]:
        raise InputError(f"corners must be a tensor of floats (n, 1 to 4, 3), got {corners!r:.80}")
    return _Circumradius.apply(corners)


class _Circumradius(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, corners: Tensor) -> Tensor:
        # numpy: for the handful of simplices of a plan its calls cost a fraction of torch's.
        radius, gradient = radius_and_gradient(corners.detach().cpu().double().numpy())
        ctx.save_for_backward(corners, torch.from_numpy(gradient).to(corners))
        return torch.from_numpy(radius).to(corners)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> Tensor:
        corners, gradient = ctx.saved_tensors
        # A flat simplex has gradient 0; an infinite upstream value must not turn that into NaN.
        pulled = torch.where(gradient == 0, gradient, upstream[:, None, None] * gradient)
        return FirstDerivative.apply(pulled, corners)


class FirstDerivative(torch.autograd.Function):
    """Return `gradient` unchanged; refuse to differentiate it by `sources`, the tensors it depends on.

    Without it, `autograd.grad(loss + penalty_of_the_gradient)` would drop the penalty and say nothing.
    """

    @staticmethod
    def forward(ctx: Any, gradient: Tensor, *sources: Tensor) -> Tensor:
        """Return the gradient."""
        return gradient.view_as(gradient)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> Tensor:
        """Raise InputError."""
        raise InputError(
            "this loss has a first derivative only; leave the gradient penalty out, or detach the gradient"
        )
