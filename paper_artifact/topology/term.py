"""The training-side term: samples, plan, calibration, ramp and log behind two calls per step.

    term = make_term(get_condition("C1"), bundle, steps=2500, seed=0)      # None for C0
    term.refresh_if_due(step, vertices, opacity, resampled)
    extra = term.value(step, vertices, photo_gradient_norm)                # None while inactive

vertices (T,3,3) world units; steps count from 0. The trainer needs to know nothing else, and imports nothing of this when off.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.bundle import Bundle
from paper_artifact.catalogue import Condition
from paper_artifact.topology.controls import neighbour_pairs, repulsion
from paper_artifact.topology.loss import check_cloud, noisy
from paper_artifact.topology.plan import Plan, PlanOptions, build_plan
from paper_artifact.topology.samples import FrozenSamples, draw_samples, samples_stream
from paper_artifact.topology.schedule import peak_weight, ramp_factor

REFRESH_EVERY = 10
DENSER_ROUNDS, DENSER_PER_TRIANGLE = 3, 8


class TopologyTerm:
    """One condition's additive term during a run. Raises InputError for C0 or an unknown option (see `PlanOptions`).

    log: list of JSON-able dicts: one per refresh ("event": "refresh"), one for λ ("event": "lambda"), one per step on which
    the calibration was a no-op ("event": "no-op", "reason").
    """

    def __init__(
        self,
        condition: Condition,
        bundle: Bundle,
        steps: int,
        seed: int,
        *,
        samples: int | None = None,
        refresh_every: int = REFRESH_EVERY,
        **options,
    ) -> None:
        if condition.kind not in ("topology", "repulsion"):
            raise InputError(
                f"condition {condition.name} has no topology term; use make_term, which returns None for it"
            )
        if steps < 1 or refresh_every < 1:
            raise InputError(f"steps and refresh_every must be at least 1, got {steps} and {refresh_every}")
        bundle.require_density(bundle.samples if samples is None else samples)
        self.condition, self.bundle, self.steps, self.seed = condition, bundle, steps, seed
        self.refresh_every = refresh_every
        self.options = PlanOptions(
            recruitment=condition.recruitment, curvature_weighted=condition.curvature_weighted, **options
        )
        self.lambda_peak: float | None = None
        self.log: list[dict] = []
        self._channel: _Persistence | _Repulsion | None = None
        self._refreshed = -1
        self._resampled = False

    def active(self, step: int) -> bool:
        """Return whether the ramp is above 0 at `step`."""
        return ramp_factor(step, self.steps, self.condition.ramp) > 0

    def refresh_if_due(
        self, step: int, vertices: Tensor, opacity: Tensor | np.ndarray | None, resampled: bool = False
    ) -> bool:
        """Draw samples and make the plan when due: first active step, every `refresh_every` steps, after a resampling.

        vertices (T,3,3) world units; opacity (T,) or (T,3) in [0,1], or None; resampled: the soup was changed wholesale since
        the last call. Returns whether a refresh happened. Raises InputError for NaN or a soup without visible area.
        """
        self._resampled |= bool(resampled)
        if not self.active(step):
            return False
        if self._channel is not None and not self._resampled and step - self._refreshed < self.refresh_every:
            return False
        samples = draw_samples(vertices, opacity, self.bundle.samples, samples_stream(self.seed, step))
        kind = _Persistence if self.condition.kind == "topology" else _Repulsion
        self._channel = kind(self, step, samples, vertices.detach())
        self._refreshed, self._resampled = step, False
        self.log.append({"event": "refresh", "step": step, **self._channel.report})
        return True

    def value(
        self, step: int, vertices: Tensor, photo_gradient_norm: float | Callable[[], float]
    ) -> Tensor | None:
        """Return λ(t)·L_topo (scalar, dtype and device of `vertices`), differentiable by `vertices` (T,3,3); None while inactive.

        photo_gradient_norm: ‖∇V L_photo‖ of this step, or a function that computes it; used once, at calibration. A zero or
        non-finite norm there is a no-op: None is returned, the log says why, and the next step tries again.
        Raises InputError when `refresh_if_due` was not called or the soup changed without it.
        """
        factor = ramp_factor(step, self.steps, self.condition.ramp)
        if factor <= 0:
            return None
        if self._channel is None or self._resampled:
            raise InputError(f"step {step} is active but has no plan; call refresh_if_due before value")
        if self.lambda_peak is None and not self._calibrate(step, vertices, photo_gradient_norm):
            return None
        return (self.lambda_peak * factor * self._channel.value(vertices)).to(vertices)

    def state(self) -> dict:
        """Return what a resumed run needs (JSON-able). Exact at a step where a refresh is due, as after every resampling."""
        return {"lambda_peak": self.lambda_peak, "log": list(self.log)}

    def load_state(self, state: dict) -> None:
        """Take over `state`; the next active step refreshes."""
        self.lambda_peak, self.log = state["lambda_peak"], list(state["log"])
        self._channel = None

    def _calibrate(
        self, step: int, vertices: Tensor, photo_gradient_norm: float | Callable[[], float]
    ) -> bool:
        live = vertices.detach().clone().requires_grad_(True)
        (gradient,) = torch.autograd.grad(self._channel.value(live), live)
        topo_norm = float(torch.linalg.vector_norm(gradient.double()))
        photo_norm = float(photo_gradient_norm() if callable(photo_gradient_norm) else photo_gradient_norm)
        self.lambda_peak = peak_weight(self.condition.rho, photo_norm, topo_norm)
        if self.lambda_peak is None:
            which = "topology" if not topo_norm > 0 or not np.isfinite(topo_norm) else "photometric"
            self.log.append(
                {
                    "event": "no-op",
                    "step": step,
                    "reason": f"the {which} gradient is zero or not finite, no weight can be set",
                }
            )
            return False
        self.log.append(
            {
                "event": "lambda",
                "step": step,
                "lambda_peak": self.lambda_peak,
                "rho": self.condition.rho,
                "photo_norm": photo_norm,
                "topo_norm": topo_norm,
            }
        )
        return True


def make_term(
    condition: Condition, bundle: Bundle | None, steps: int, seed: int, **options
) -> TopologyTerm | None:
    """Return the condition's TopologyTerm, or None for C0. Raises InputError when a condition that needs a bundle has none."""
    if condition.kind == "none":
        return None
    if bundle is None:
        raise InputError(
            f"condition {condition.name} needs a target bundle; build one at the density the loss samples"
        )
    return TopologyTerm(condition, bundle, steps, seed, **options)


class _Persistence:
    """One refresh of the persistence loss: samples and plan."""

    def __init__(self, term: TopologyTerm, step: int, samples: FrozenSamples, vertices: Tensor) -> None:
        cloud = check_cloud(samples.positions(vertices).numpy(), term.bundle)
        plan = build_plan(noisy(cloud, term.condition.noise, term.seed, step), term.bundle, term.options)
        rounds = 0
        while plan.failing and term.options.fallback == "denser" and rounds < DENSER_ROUNDS:
            rounds += 1
            samples = samples.joined(
                _denser(plan, samples, vertices, stream(term.seed, f"topology-denser-{rounds}", step))
            )
            cloud = samples.positions(vertices).numpy() / term.bundle.diagonal
            plan = build_plan(noisy(cloud, term.condition.noise, term.seed, step), term.bundle, term.options)
        self.samples, self.plan, self.diagonal = samples, plan, term.bundle.diagonal
        self.report = {**plan.report, "denser_rounds": rounds}

    def value(self, vertices: Tensor) -> Tensor:
        return self.plan.value(self.samples.positions(vertices, self.plan.used) / self.diagonal)


def _denser(
    plan: Plan, samples: FrozenSamples, vertices: Tensor, generator: np.random.Generator
) -> FrozenSamples:
    """Draw more samples, only on the triangles that hold the plan's failing simplices."""
    triangles = np.unique(
        samples.faces.numpy()[np.unique(np.concatenate([list(simplex) for simplex in plan.failing]))]
    )
    weight = np.zeros(samples.triangles)
    weight[triangles] = 1.0
    return draw_samples(vertices, weight, DENSER_PER_TRIANGLE * len(triangles), generator)


class _Repulsion:
    """One refresh of the control C2: samples and neighbour pairs."""

    def __init__(self, term: TopologyTerm, step: int, samples: FrozenSamples, vertices: Tensor) -> None:
        self.samples, self.diagonal = samples, term.bundle.diagonal
        self.radius = term.condition.repulsion_radius * term.bundle.spacing
        cloud = check_cloud(samples.positions(vertices).numpy(), term.bundle)
        self.pairs = neighbour_pairs(cloud, self.radius)
        self.report = {"samples": len(cloud), "radius": self.radius, "pairs": len(self.pairs)}

    def value(self, vertices: Tensor) -> Tensor:
        return repulsion(self.samples.positions(vertices) / self.diagonal, self.pairs, self.radius)
