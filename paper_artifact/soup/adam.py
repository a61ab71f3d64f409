"""Adam for a soup: one kernel per rule on the CPU, torch's optimisers on other devices; both with the same
three methods.

Plain Adam (Kingma & Ba, ICLR 2015) for features, opacity and MLP; VectorAdam (Ling, Sharp, Jacobson, NeurIPS
2022) for the vertices: its second moment is pooled over the last dimension, one step size per vector, so the
update commutes with rotations of the coordinates. Betas (.9, .999), eps 1e-8, bias-corrected. Learning rates
are given anew at every step, by the name of what they move: "vertices", "features", "opacity", "mlp".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
import torch

from paper_artifact.arithmetic import power
from paper_artifact.kernel_cache import njit
from paper_artifact.soup.state import Soup


class VectorAdam(torch.optim.Optimizer):
    """Optimizer of tensors (…, 3): second moment = running mean of the squared gradient norm, betas (.9,
    .999), eps 1e-8; a group's "units" (…) multiply lr vector by vector."""

    def __init__(
        self,
        parameters: Iterable[torch.Tensor],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__(parameters, {"lr": lr, "betas": betas, "eps": eps, "units": None})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Take one step for every parameter with a gradient; a closure is not supported and must be None."""
        if closure is not None:
            raise ValueError("VectorAdam takes no closure")
        for group in self.param_groups:
            beta1, beta2 = group["betas"]
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                state = self.state[parameter]
                if not state:
                    state["step"] = 0
                    state["mean"] = torch.zeros_like(parameter)
                    state["square"] = torch.zeros_like(parameter[..., :1])
                state["step"] += 1
                state["mean"].lerp_(parameter.grad, 1 - beta1)
                state["square"].lerp_(parameter.grad.square().sum(-1, keepdim=True), 1 - beta2)
                mean = state["mean"] / (1 - beta1 ** state["step"])
                scale = (state["square"] / (1 - beta2 ** state["step"])).sqrt_().add_(group["eps"])
                if group["units"] is not None:
                    mean = mean * group["units"].unsqueeze(-1)
                parameter.addcdiv_(mean, scale.expand_as(mean), value=-group["lr"])


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


class KernelOptimiser:
    """Adam of a soup whose tensors are float32 on the CPU; it writes to them in place."""

    def __init__(self, soup: Soup) -> None:
        """Start with zero moments."""
        self._tensors = soup.tensors()
        self._values = [tensor.detach().view(-1).numpy() for tensor in self._tensors]
        self._means = [np.zeros_like(value) for value in self._values]
        self._squares = [np.zeros_like(value) for value in self._values]
        self._squares[0] = np.zeros(len(self._values[0]) // 3, np.float32)
        self._steps = dict.fromkeys(NAMES, 0)  # taken with these moments

    def step(self, rates: Mapping[str, float], units: np.ndarray | None = None) -> None:
        """Move every tensor along its gradient; rates by name, see `NAMES`. units: what the vertices' rate is
        multiplied by at each vertex, (T,3) float32; None: 1."""
        for name in self._steps:
            self._steps[name] += 1
        scale = np.ones(len(self._squares[0]), np.float32) if units is None else units.reshape(-1)
        numbers = {name: _corrected(rates[name], step) for name, step in self._steps.items()}
        arrays = zip(NAMES, self._tensors, self._values, self._means, self._squares, strict=True)
        for name, tensor, value, mean, square in arrays:
            assert tensor.grad is not None, "a step without gradients"
            moments = value, tensor.grad.numpy().reshape(-1), mean, square, *numbers[name]
            if name == "vertices":
                _vector_adam(*moments, scale)
            else:
                adam(*moments)

    def mlp_state(self) -> dict[str, Any]:
        """Return the MLP's moments and the number of steps they saw, as `load_mlp_state` takes them."""
        moments = {"mean": self._means, "square": self._squares}
        state = {name: [torch.from_numpy(array) for array in arrays[3:]] for name, arrays in moments.items()}
        return {"step": self._steps["mlp"], **state}

    def load_mlp_state(self, state: Mapping[str, Any]) -> None:
        """Go on with moments of another soup's MLP."""
        self._steps["mlp"] = state["step"]
        mine = (*self._means[3:], *self._squares[3:])
        for array, moment in zip(mine, (*state["mean"], *state["square"]), strict=True):
            array[:] = moment.cpu().numpy()


class TorchOptimiser:
    """As `KernelOptimiser`, by torch's optimisers: any device and dtype."""

    def __init__(self, soup: Soup) -> None:
        """Start with zero moments."""
        self._mlp = soup.mlp
        self._optimisers = {
            "vertices": VectorAdam([soup.vertices], lr=0.0),
            "features": torch.optim.Adam([soup.features]),
            "opacity": torch.optim.Adam([soup.opacity]),
            "mlp": torch.optim.Adam(soup.mlp),
        }

    def step(self, rates: Mapping[str, float], units: np.ndarray | None = None) -> None:
        """As `KernelOptimiser.step`."""
        group = self._optimisers["vertices"].param_groups[0]
        group["units"] = None if units is None else torch.from_numpy(units).to(group["params"][0])
        for name, optimiser in self._optimisers.items():
            optimiser.param_groups[0]["lr"] = rates[name]
            optimiser.step()

    def mlp_state(self) -> dict[str, Any]:
        """Return the MLP's moments and the number of steps they saw, as either `load_mlp_state` takes
        them."""
        states = [self._optimisers["mlp"].state[tensor] for tensor in self._mlp]
        mean, square = ([state[name].flatten() for state in states] for name in ("exp_avg", "exp_avg_sq"))
        return {"step": int(states[0]["step"]), "mean": mean, "square": square}

    def load_mlp_state(self, state: Mapping[str, Any]) -> None:
        """Go on with moments of another soup's MLP."""
        for tensor, mean, square in zip(self._mlp, state["mean"], state["square"], strict=True):
            mean, square = (moment.to(tensor).reshape(tensor.shape).clone() for moment in (mean, square))
            saved = {"step": torch.tensor(float(state["step"])), "exp_avg": mean, "exp_avg_sq": square}
            self._optimisers["mlp"].state[tensor] = saved


def soup_optimiser(soup: Soup) -> KernelOptimiser | TorchOptimiser:
    """Return a new optimiser of the soup's tensors: kernels where the rasterizer's are, else torch."""
    on_kernels = soup.vertices.device.type == "cpu" and soup.vertices.dtype == torch.float32
    return KernelOptimiser(soup) if on_kernels else TorchOptimiser(soup)
