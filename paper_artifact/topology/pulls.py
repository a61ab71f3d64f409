"""The pulls of a plan as arrays, and the loss they stand for: value and gradient in closed form (paper §3.3).

A pull is one bar of the live cloud with its birth and death simplex and what pulls it: a target bar (matched
or recruited) or the diagonal. Births, deaths, targets and positions are divided by the bundle's diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from paper_artifact.alpha.diagrams import FirstDerivative
from paper_artifact.alpha.radii import radius_and_gradient

KINDS = ("matched", "recruited", "diagonal")
MATCHED, RECRUITED, DIAGONAL = range(3)
CORNERS = 4  # of a tetrahedron: the most that a simplex has
NONE = -1  # no sample, no target


@dataclass(frozen=True, eq=False)
class Pulls:
    """n bars and what pulls each, as arrays."""

    dimension: np.ndarray  # (n,) int64
    kind: np.ndarray  # (n,) int64: MATCHED, RECRUITED, DIAGONAL
    values: np.ndarray  # (n,2) float64: birth and death in the cloud the plan saw
    simplices: np.ndarray  # (n,2,4) int64: samples of the birth and the death simplex, then NONE
    target: np.ndarray  # (n,2) float64: birth and death of the target bar; 0 for the diagonal, which has none
    sound: np.ndarray  # (n,) bool: passed the Gabriel gate; else value only, no gradient
    weight: np.ndarray  # (n,) float64: of the bar's term in the loss

    def __len__(self) -> int:
        return len(self.kind)


def padded(simplices: np.ndarray) -> np.ndarray:
    """Return simplices (n,k) as (n,4) int64, NONE behind the corners."""
    wide = np.full((len(simplices), CORNERS), NONE, dtype=np.int64)
    wide[:, : simplices.shape[1]] = simplices
    return wide


def join_pulls(parts: Sequence[Pulls]) -> Pulls:
    """Return the pulls of all parts, in order."""
    shapes = {"values": (0, 2), "target": (0, 2), "simplices": (0, 2, CORNERS)}
    kinds = {"dimension": np.int64, "kind": np.int64, "simplices": np.int64, "sound": bool}
    joined = {}
    for name in (each.name for each in fields(Pulls)):
        empty = np.zeros(shapes.get(name, (0,)), dtype=kinds.get(name, np.float64))
        joined[name] = np.concatenate([empty, *(getattr(part, name) for part in parts)])
    return Pulls(**joined)


@dataclass(frozen=True, eq=False)
class LossArrays:
    """A plan's pulls for the loss: simplices grouped by their number of corners, into the used samples."""

    # (rows (r,), corners (r,k)): rows into the 2n coordinates (births, then deaths), corners into used
    # samples
    groups: tuple[tuple[np.ndarray, np.ndarray], ...]
    scatter: np.ndarray  # the groups' corners one after the other: where gradients are summed
    frozen: np.ndarray  # (2n,) coordinates at the refresh
    sound: np.ndarray  # (2n,) bool
    target: np.ndarray  # (2,n)
    diagonal: np.ndarray  # (n,) bool
    weight: np.ndarray  # (n,)

    def radii(self, positions: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the coordinates (2n,) and, per group, the gradients (r,k,3) of its rows."""
        radii, gradients = self.frozen.copy(), []
        for rows, corners in self.groups:
            radius, gradient = radius_and_gradient(positions[corners])
            live = self.sound[rows] & np.isfinite(radius)
            radii[rows] = np.where(live, radius, self.frozen[rows])
            gradients.append(gradient * live[:, None, None])
        return radii, gradients

    def value_and_gradient(self, positions: np.ndarray) -> tuple[float, np.ndarray]:
        """Return L_topo and its gradient (u,3) at `positions` (u,3) of the used samples."""
        radii, gradients = self.radii(positions)
        live = radii.reshape(2, -1)
        half_lifetime = (live[1] - live[0]) / 2
        residual = live - self.target
        value = np.where(self.diagonal, half_lifetime**2, (residual**2).sum(axis=0))
        slope = np.where(self.diagonal, half_lifetime * _AWAY, 2 * residual) * self.weight
        slope = slope.ravel()
        parts = [
            (slope[rows, None, None] * gradient).reshape(-1, 3)
            for (rows, _), gradient in zip(self.groups, gradients, strict=True)
        ]
        total = np.zeros_like(positions)
        if parts:
            pulls = np.concatenate(parts)
            for axis in range(3):  # bincount adds in the order of the rows: the same bits at every call
                total[:, axis] = np.bincount(self.scatter, pulls[:, axis], len(positions))
        return float((self.weight * value).sum()), total


# d/db and d/dd of ((d - b)/2)² are -(d - b)/2 and +(d - b)/2.
_AWAY = np.array([[-1.0], [1.0]])


def loss_value(positions: Tensor, arrays: LossArrays) -> Tensor:
    """Return L_topo (scalar float64) at `positions` (u,3) float64 of the used samples; differentiable
    once.
    """
    return _Value.apply(positions, arrays)


class _Value(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, positions: Tensor, arrays: LossArrays) -> Tensor:
        value, gradient = arrays.value_and_gradient(positions.detach().numpy())
        ctx.save_for_backward(positions, torch.from_numpy(gradient))
        return torch.tensor(value, dtype=torch.float64)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        positions, gradient = ctx.saved_tensors
        return FirstDerivative.apply(upstream * gradient, positions), None


def compiled(pulls: Pulls) -> tuple[np.ndarray, LossArrays]:
    """Return the used samples (u,) int64 and the pulls as the loss takes them."""
    simplices = pulls.simplices.transpose(1, 0, 2).reshape(-1, CORNERS)
    used = np.unique(simplices[simplices != NONE])
    sizes = (simplices != NONE).sum(axis=1)
    groups = []
    for size in (2, 3, 4):  # a vertex (birth in dimension 0) has the constant radius 0
        rows = np.flatnonzero(sizes == size)
        if len(rows):
            groups.append((rows, np.searchsorted(used, simplices[rows, :size])))
    return used, LossArrays(
        groups=tuple(groups),
        scatter=np.concatenate([corners.ravel() for _, corners in groups] or [np.zeros(0, dtype=np.int64)]),
        frozen=pulls.values.T.ravel(),
        sound=np.tile(pulls.sound, 2),
        target=np.ascontiguousarray(pulls.target.T),
        diagonal=pulls.kind == DIAGONAL,
        weight=pulls.weight,
    )
