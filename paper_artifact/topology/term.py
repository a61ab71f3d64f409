"""The training-side term: samples, plan, calibration, ramp and log behind two calls per step (paper §3.4).

    term = TopologyTerm(LossConfig(), bundle, steps=2500, seed=0)
    term.refresh_if_due(step, vertices, opacity, resampled)
    extra = term.value(step, vertices, photo_gradient_norm)                # None while inactive

vertices (T,3,3) world units; steps count from 1. The ramp and the random streams go by the steps that are
done, step - 1. The trainer needs to know nothing else, and imports nothing of this when off.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.betti import build_betti_plan
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.cloud import check_cloud, noisy
from paper_artifact.topology.controls import neighbour_pairs, repulsion
from paper_artifact.topology.plan import Plan, build_plan
from paper_artifact.topology.samples import FrozenSamples, draw_samples, samples_stream
from paper_artifact.topology.schedule import no_weight, peak_weight, ramp_factor
from paper_artifact.topology.statement import Statement, contradictions, unseen

DENSER_ROUNDS, DENSER_PER_TRIANGLE = (
    3,
    8,
)  # the fallback "denser": how often, and samples per failing triangle


class Objective(Protocol):
    """What one refresh fixes: a differentiable function of the vertices until the next one."""

    report: dict  # what the refresh found, JSON-able, for the log

    def value(self, vertices: Tensor) -> Tensor:
        """Return the unweighted loss (scalar float64) at `vertices` (T,3,3), world units."""


class TopologyTerm:
    """One condition's additive term during a run of `steps` steps.

    lambda_peak: the calibrated weight, None before. log: JSON-able dicts, one per refresh ("event":
    "refresh"), one for λ ("event": "lambda"), one per plan and reason at which no weight could be set
    ("event": "no-op", "reason"), and for a statement in words its audit at the first refresh, before any
    gradient ("event": "audit"; "warnings": what contradicts it; "notes": what does not show yet). target: a
    Statement for the kind "betti", else a bundle. tell: is called with each warning and note; strict: a
    warning is an InputError. Raises InputError when the target's density is not the loss's.
    """

    def __init__(
        self,
        config: LossConfig,
        target: Bundle | Statement,
        steps: int,
        seed: int,
        *,
        strict: bool = False,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        if (config.kind == "betti") != isinstance(target, Statement):
            raise InputError(f"the loss kind {config.kind!r} does not act towards a {type(target).__name__}")
        if steps < 1 or config.refresh_every < 1:
            raise InputError(
                f"steps and refresh_every must be at least 1, got {steps} and {config.refresh_every}"
            )
        target.require_density(config.samples)
        self.config, self.target, self.steps, self.seed = config, target, steps, seed
        self.strict, self.tell = strict, tell
        self.lambda_peak: float | None = None
        self.log: list[dict] = []
        self._objective: Objective | None = None
        self._refreshed = 0
        self._resampled = False

    def factor(self, step: int) -> float:
        """Return the ramp's factor of λ at `step`: 0 before the ramp, 1 after it."""
        return ramp_factor(step - 1, self.steps, self.config.ramp)

    def refresh_if_due(
        self, step: int, vertices: Tensor, opacity: Tensor | np.ndarray | None, resampled: bool = False
    ) -> bool:
        """Draw samples and make the plan when due; return whether that happened.

        Due are the first active step, every `refresh_every` steps, and the first step after a resampling.
        vertices (T,3,3) world units; opacity (T,) or (T,3) in [0,1], or None; resampled: the soup was changed
        wholesale since the last call. Raises InputError for NaN or a soup without visible area.
        """
        self._resampled |= bool(resampled)
        if not self.factor(step) > 0:
            return False
        due = (
            self._objective is None or self._resampled or step - self._refreshed >= self.config.refresh_every
        )
        if not due:
            return False
        samples = draw_samples(vertices, opacity, self.config.samples, samples_stream(self.seed, step - 1))
        kind = Repulsion if self.config.kind == "repulsion" else Persistence
        self._objective = kind(self, step, samples, vertices.detach())
        self._refreshed, self._resampled = step, False
        self.log.append({"event": "refresh", "step": step, **self._objective.report})
        if isinstance(self.target, Statement) and not any(each["event"] == "audit" for each in self.log):
            report = self._objective.report
            self._audit(step, contradictions(self.target, report), unseen(self.target, report, self.config))
        return True

    def value(
        self, step: int, vertices: Tensor, photo_gradient_norm: float | Callable[..., float]
    ) -> Tensor | None:
        """Return λ(t)·L_topo (scalar, dtype and device of `vertices`), or None while inactive.

        Differentiable by `vertices` (T,3,3), world units. photo_gradient_norm: ‖∇V L_photo‖ of this step, or
        a function that gives its mean over so many batches; used once, at calibration. A zero or non-finite
        norm there is a no-op: None is returned, the log says why, and the next step tries again. Raises
        InputError when `refresh_if_due` was not called or the soup changed without it.
        """
        factor = self.factor(step)
        if factor <= 0:
            return None
        if self._objective is None or self._resampled:
            raise InputError(f"step {step} is active but has no plan; call refresh_if_due before value")
        if self.lambda_peak is None:
            self.lambda_peak = self._calibrated(step, self._objective, vertices, photo_gradient_norm)
        if self.lambda_peak is None:
            return None
        return (self.lambda_peak * factor * self._objective.value(vertices)).to(vertices)

    def state(self) -> dict:
        """Return what a resumed run needs (JSON-able).

        Exact at a step where a refresh is due, as after every resampling.
        """
        return {"lambda_peak": self.lambda_peak, "log": list(self.log)}

    def load_state(self, state: dict) -> None:
        """Take over `state`; the next active step refreshes."""
        self.lambda_peak, self.log = state["lambda_peak"], list(state["log"])
        self._objective = None

    def _audit(self, step: int, warnings: list[str], notes: list[str]) -> None:
        """Log and tell what contradicts the statement and what does not show yet.

        Raises InputError for a contradiction when strict.
        """
        self.log.append({"event": "audit", "step": step, "warnings": warnings, "notes": notes})
        if warnings and self.strict:
            raise InputError(f"strict, and at step {step} the images contradict the words: {warnings[0]}")
        if self.tell is not None:
            for each in (*warnings, *notes):
                self.tell(f"step {step}: {each}")

    def _calibrated(
        self,
        step: int,
        objective: Objective,
        vertices: Tensor,
        photo_gradient_norm: float | Callable[..., float],
    ) -> float | None:
        """Return λ_peak = ρ ‖∇V L_photo‖ / ‖∇V L_topo‖ of this step and log it, or None and the reason."""
        live = vertices.detach().clone().requires_grad_(True)
        (gradient,) = torch.autograd.grad(objective.value(live), live)
        topo_norm = float(torch.linalg.vector_norm(gradient.double()))
        if callable(photo_gradient_norm):
            photo_gradient_norm = photo_gradient_norm(self.config.calibration_batches)
        photo_norm = float(photo_gradient_norm)
        peak = peak_weight(self.config.rho, photo_norm, topo_norm)
        if peak is None:
            reason = no_weight(self.config.rho, photo_norm, topo_norm)
            if self.log[-1].get("reason") != reason:  # once a plan, unless there is another reason
                self.log.append({"event": "no-op", "step": step, "reason": reason})
        else:
            norms = {"rho": self.config.rho, "photo_norm": photo_norm, "topo_norm": topo_norm}
            self.log.append({"event": "lambda", "step": step, "lambda_peak": peak, **norms})
        return peak


class Persistence:
    """One refresh of the persistence loss: samples and plan."""

    def __init__(self, term: TopologyTerm, step: int, samples: FrozenSamples, vertices: Tensor) -> None:
        config, target, done = term.config, term.target, step - 1

        def make(cloud: np.ndarray) -> Plan:
            seen = noisy(cloud, config.noise, term.seed, done)
            if isinstance(target, Statement):
                return build_betti_plan(seen, target, config)
            return build_plan(seen, target, config)

        plan = make(check_cloud(samples.positions(vertices).numpy(), target))
        rounds = 0
        while plan.failing and config.fallback == "denser" and rounds < DENSER_ROUNDS:
            rounds += 1
            generator = stream(term.seed, f"topology-denser-{rounds}", done)
            samples = samples.joined(_denser(plan, samples, vertices, generator))
            plan = make(samples.positions(vertices).numpy() / target.diagonal)
        self.samples, self.plan, self.diagonal = samples, plan, target.diagonal
        self.report = {**plan.report, "denser_rounds": rounds}

    def value(self, vertices: Tensor) -> Tensor:
        """Return L_topo under the plan."""
        return self.plan.value(self.samples.positions(vertices, self.plan.used) / self.diagonal)


def _denser(
    plan: Plan, samples: FrozenSamples, vertices: Tensor, generator: np.random.Generator
) -> FrozenSamples:
    """Draw more samples, only on the triangles that hold the plan's failing simplices."""
    failing = np.unique(np.concatenate([list(simplex) for simplex in plan.failing]))
    triangles = np.unique(samples.faces.numpy()[failing])
    weight = np.zeros(samples.triangles)
    weight[triangles] = 1.0
    return draw_samples(vertices, weight, DENSER_PER_TRIANGLE * len(triangles), generator)


class Repulsion:
    """One refresh of the control C2: samples and neighbour pairs."""

    def __init__(self, term: TopologyTerm, step: int, samples: FrozenSamples, vertices: Tensor) -> None:
        bundle = term.target
        assert isinstance(bundle, Bundle)
        self.samples, self.diagonal = samples, bundle.diagonal
        self.radius = term.config.repulsion_radius * bundle.spacing
        cloud = check_cloud(samples.positions(vertices).numpy(), bundle)
        self.pairs = neighbour_pairs(cloud, self.radius)
        self.report = {"samples": len(cloud), "radius": self.radius, "pairs": len(self.pairs)}

    def value(self, vertices: Tensor) -> Tensor:
        """Return the repulsion's energy."""
        return repulsion(self.samples.positions(vertices) / self.diagonal, self.pairs, self.radius)
