"""VectorAdam (Ling, Sharp, Jacobson, NeurIPS 2022): Adam whose second moment is pooled over the last
dimension.

One step size per vector, so the update commutes with rotations of the coordinates; plain Adam's does not.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch


class VectorAdam(torch.optim.Optimizer):
    """Optimizer of tensors (…, 3): second moment = running mean of the squared gradient norm, betas (.9,
    .999), eps 1e-8."""

    def __init__(
        self,
        parameters: Iterable[torch.Tensor],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__(parameters, {"lr": lr, "betas": betas, "eps": eps})

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
                parameter.addcdiv_(mean, scale.expand_as(mean), value=-group["lr"])
