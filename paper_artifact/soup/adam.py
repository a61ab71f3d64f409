"""Adam for a soup: one kernel per rule for float32 on the CPU, torch's operations elsewhere.

Plain Adam (Kingma & Ba, ICLR 2015) for features, opacity and MLP; VectorAdam (Ling, Sharp, Jacobson, NeurIPS
2022) for the vertices: its second moment is pooled over the last dimension, one step size per vector, so the
update commutes with rotations of the coordinates. Betas (.9, .999), eps 1e-8, bias-corrected. Learning rates
are given anew at every step, by the name of what they move: "vertices", "features", "opacity", "mlp".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from paper_artifact.arithmetic import power
from paper_artifact.kernel_cache import njit
from paper_artifact.soup.state import Soup

NAMES = ("vertices", "features", "opacity", *["mlp"] * 6)  # of `Soup.tensors`
_BETA1, _BETA2, _EPS = 0.9, 0.999, 1e-8
_KEEP1, _KEEP2 = np.float32(_BETA1), np.float32(_BETA2)
_NEW1, _NEW2 = np.float32(1 - _BETA1), np.float32(1 - _BETA2)


@njit(cache=True, nogil=True, error_model="numpy")
def adam(value, gradient, mean, square, rate, eps):
    """Take one step of Adam in place; all arrays (n,) float32.

    rate, eps float32: the learning rate and Adam's eps with the bias corrections in them, see `_corrected`.
    """
    for i in range(len(value)):
        g = gradient[i]
        mean[i] = _KEEP1 * mean[i] + _NEW1 * g
        square[i] = _KEEP2 * square[i] + _NEW2 * g * g
        value[i] -= rate * mean[i] / (np.sqrt(square[i]) + eps)


@njit(cache=True, nogil=True, error_model="numpy")
def _vector_adam(value, gradient, mean, square, rate, eps, scale):
    """As `adam`, but with one second moment per vector: value, gradient and mean (3·n,), square (n,); the
    rate of vector i is rate · scale[i], scale (n,) float32."""
    for i in range(len(square)):
        x, y, z = gradient[3 * i], gradient[3 * i + 1], gradient[3 * i + 2]
        square[i] = _KEEP2 * square[i] + _NEW2 * (x * x + y * y + z * z)
        factor = rate * scale[i] / (np.sqrt(square[i]) + eps)
        for k in range(3 * i, 3 * i + 3):
            mean[k] = _KEEP1 * mean[k] + _NEW1 * gradient[k]
            value[k] -= factor * mean[k]


def _corrected(rate: float, step: int) -> tuple[np.float32, np.float32]:
    """Return learning rate and eps with the bias corrections of `step` (from 1) in them.

    rate · (mean / c1) / (√(square / c2) + eps) with c = 1 - beta^step is (rate·√c2 / c1) · mean / (√square +
    eps·√c2).
    """
    root, first = _corrections(step)
    return np.float32(rate * root / first), np.float32(_EPS * root)


@cache
def _corrections(step: int) -> tuple[float, float]:
    """Return √(1 - β2^step) and 1 - β1^step; all tensors of a run count the same steps, many times."""
    return math.sqrt(1 - power(_BETA2, step)), 1 - power(_BETA1, step)


class SoupOptimiser:
    """Adam of a soup's tensors; it writes to them in place."""

    def __init__(self, soup: Soup) -> None:
        """Start with zero moments."""
        self._tensors = soup.tensors()
        self._means = [torch.zeros_like(tensor.detach()) for tensor in self._tensors]
        self._squares = [torch.zeros_like(mean) for mean in self._means]
        self._squares[0] = torch.zeros_like(soup.vertices.detach()[..., 0])
        self._steps = dict.fromkeys(NAMES, 0)  # taken with these moments
        self._flat = None  # for the kernels: the same values and moments as flat arrays
        if soup.vertices.device.type == "cpu" and soup.vertices.dtype == torch.float32:
            parts = zip(self._tensors, self._means, self._squares, strict=True)
            self._flat = [[each.detach().view(-1).numpy() for each in part] for part in parts]

    @torch.no_grad()
    def step(self, rates: Mapping[str, float], units: np.ndarray | None = None) -> None:
        """Move every tensor along its gradient; rates by name, see `NAMES`. units: what the vertices' rate is
        multiplied by at each vertex, (T,3) float32; None: 1."""
        for name in self._steps:
            self._steps[name] += 1
        scale = np.ones(self._squares[0].shape, np.float32) if units is None else units
        numbers = {name: _corrected(rates[name], step) for name, step in self._steps.items()}
        for index, (name, tensor) in enumerate(zip(NAMES, self._tensors, strict=True)):
            assert tensor.grad is not None, "a step without gradients"
            if self._flat is None:
                self._torch_step(index, tensor.grad, *numbers[name], scale)
                continue
            value, mean, square = self._flat[index]
            moments = value, tensor.grad.numpy().reshape(-1), mean, square, *numbers[name]
            if name == "vertices":
                _vector_adam(*moments, scale.reshape(-1))
            else:
                adam(*moments)

    def _torch_step(
        self, index: int, gradient: Tensor, rate: np.float32, eps: np.float32, scale: np.ndarray
    ) -> None:
        """Do what `adam` does, or `_vector_adam` for the vertices (index 0); any device and dtype."""
        mean, square = self._means[index], self._squares[index]
        mean.lerp_(gradient, 1 - _BETA1)
        squared = gradient.square()
        square.lerp_(squared if index else squared.sum(-1), 1 - _BETA2)
        factor = float(rate) / (square.sqrt() + float(eps))
        if not index:
            factor = (factor * torch.from_numpy(scale).to(factor)).unsqueeze(-1)
        self._tensors[index].sub_(factor * mean)

    def mlp_state(self) -> dict[str, Any]:
        """Return the MLP's moments and the number of steps they saw, as `load_mlp_state` takes them."""
        return {"step": self._steps["mlp"], "mean": self._means[3:], "square": self._squares[3:]}

    def load_mlp_state(self, state: Mapping[str, Any]) -> None:
        """Go on with moments of another soup's MLP."""
        self._steps["mlp"] = state["step"]
        mine = (*self._means[3:], *self._squares[3:])
        for tensor, moment in zip(mine, (*state["mean"], *state["square"]), strict=True):
            tensor.copy_(moment.reshape(tensor.shape))
