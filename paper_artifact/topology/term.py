"""The training-side term: frozen samples, plan, calibrated weight, ramp and log (paper §3.2, §3.4).

    term = TopologyTerm(LossConfig(), bundle, steps=2500, seed=0)
    if term.due(step, resampled):
        term.refresh(step, vertices, opacity)
    extra = term.value(step, vertices, photo_gradient_norm)                # None while inactive

vertices (T,3,3) world units; steps count from 1. The ramp and the random streams go by the steps that are
done, step - 1. The trainer needs to know nothing else, and imports nothing of this when off.

The norm-matched control C2 (§3.5) is "a short-range repulsion on the same frozen samples, calibrated with the
same ρ (C2g: a gentler radius)", without a formula. Ours: E = (1/M) Σ over sample pairs closer than h of
(1 - r/h)², distances divided by the diagonal, h a multiple of the target's median spacing r_med(M). Default h
= 4 r_med: about eleven neighbours of a uniform sample, and below the floor of 6 r_med, hence short-range for
every significant feature; C2g halves it (about three neighbours).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from paper_artifact.arithmetic import length
from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_soup
from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.loss import check_cloud, plan_towards
from paper_artifact.topology.plan import Known
from paper_artifact.topology.statement import (
    Statement,
    choose_density,
    cleaned,
    contradictions,
    cost,
    frame_diagonal,
    measured_on,
    unmeasured,
    unseen,
)

Within = Callable[[np.ndarray], np.ndarray]  # of points (n,3), world units: which count, (n,) bool
# ‖∇V L_topo‖ ÷ ‖∇V L_photo‖ at calibration below which no weight is set: a term whose gradient is rounding
# alone would get λ = 5e14. The smallest ratio of the recorded runs is 1.3e-3 (torus, C6, seed 3).
LEAST_RATIO = 1e-5
AUDIT_EVERY = 10  # refreshes between two looks at whether the images contradict a statement
# Pairs of the control are listed with the plan, up to this multiple of h, so that samples that come closer
# between two refreshes count.
SKIN = 1.25


@dataclass(frozen=True, eq=False)
class FrozenSamples:
    """M samples of a triangle soup (paper §3.2): X_j = Σ_i w_ij V[F(f_j), i], triangles f_j drawn α × area
    weighted, barycentric weights w_ij frozen, positions recomputed from the live vertices."""

    faces: Tensor  # (M,) int64: the triangle of each sample
    barycentrics: Tensor  # (M,3) float64: its frozen corner weights
    triangles: int  # of the soup that was sampled

    def positions(self, vertices: Tensor, indices: Tensor | None = None) -> Tensor:
        """Return the samples' positions (M,3) float64 on the CPU, world units.

        Differentiable by `vertices` (T,3,3), on any device. indices (m,) int64: only these samples (a
        frozen-plan step needs a handful). Raises InputError when the soup has another number of triangles
        than the one sampled (it was resampled: refresh first).
        """
        if vertices.ndim != 3 or tuple(vertices.shape) != (self.triangles, 3, 3):
            raise InputError(
                f"the samples were drawn on a soup ({self.triangles}, 3, 3), got {tuple(vertices.shape)}; "
                "refresh after every resampling"
            )
        faces = self.faces if indices is None else self.faces[indices]
        weights = self.barycentrics if indices is None else self.barycentrics[indices]
        corners = vertices[faces.to(vertices.device)].cpu().double()
        return (weights[:, :, None] * corners).sum(dim=1)


def draw_samples(
    vertices: Tensor,
    opacity: Tensor | None,
    count: int,
    generator: np.random.Generator,
    within: Within | None = None,
) -> FrozenSamples:
    """Return `count` samples drawn with density α × area on a soup, `within` of its triangles' middles;
    arguments and errors of `sample_soup`, as tensors on any device."""
    alpha = None if opacity is None else opacity.detach().cpu().numpy()
    if within is not None:
        held = within(vertices.detach().cpu().numpy().mean(axis=1))
        alpha = held[:, None] * (np.ones(3) if alpha is None else alpha)
    _, faces, barycentrics = sample_soup(vertices.detach().cpu().numpy(), alpha, count, generator)
    return FrozenSamples(torch.from_numpy(faces), torch.from_numpy(barycentrics), len(vertices))


def samples_stream(seed: int, step: int) -> np.random.Generator:
    """Return the generator of a run's samples at `step`: a function of (seed, step) only."""
    return stream(seed, "topology-samples", step)


class TopologyTerm:
    """One condition's additive term during a run of `steps` steps.

    lambda_peak: the calibrated weight, None before. log: JSON-able dicts, one per refresh ("event":
    "refresh"), one for λ ("event": "lambda"), one per plan and reason at which no weight could be set
    ("event": "no-op", "reason"), and for a statement its audits, the first before any gradient ("event":
    "audit"; "warnings": what contradicts it; "notes": what does not show yet). target: a Statement for the
    kind "betti", else a bundle. within: only triangles with their middle there are sampled. tell: is called
    with each warning and note; strict: a warning is an InputError. Raises InputError when the target's
    density is not the loss's.
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
        within: Within | None = None,
    ) -> None:
        if (config.kind == "betti") != isinstance(target, Statement):
            raise InputError(f"the loss kind {config.kind!r} does not act towards a {type(target).__name__}")
        if steps < 1 or config.refresh_every < 1:
            raise InputError(
                f"steps and refresh_every must be at least 1, got {steps} and {config.refresh_every}"
            )
        target.require_density(config.samples)
        self.config, self.target, self.steps, self.seed = config, target, steps, seed
        self.strict, self.tell, self.within = strict, tell, within
        self.lambda_peak: float | None = None
        self.log: list[dict] = []
        self._objective: Persistence | Repulsion | None = None
        self._refreshed = 0
        self._resampled = False

    def factor(self, step: int) -> float:
        """Return the ramp's factor of λ at `step`: 0 before the ramp, 1 after it."""
        return ramp_factor(step - 1, self.steps, self.config.ramp)

    def due(self, step: int, resampled: bool = False) -> bool:
        """Return whether `step` needs a new plan: the first active step, every `refresh_every` steps, and the
        first step after a resampling (resampled: the soup was changed wholesale since the last step)."""
        self._resampled |= bool(resampled)
        if not self.factor(step) > 0:
            return False
        every = self.config.refresh_every
        return self._objective is None or self._resampled or step - self._refreshed >= every

    def refresh(self, step: int, vertices: Tensor, opacity: Tensor | None) -> None:
        """Draw samples and make the plan.

        vertices (T,3,3) world units; opacity (T,3) in [0,1], or None for 1. Raises InputError for NaN or a
        soup without visible area, and with `strict` for a contradiction.
        """
        generator = samples_stream(self.seed, step - 1)
        samples = draw_samples(vertices, opacity, self.config.samples, generator, self.within)
        kind = Repulsion if self.config.kind == "repulsion" else Persistence
        self._objective = kind(self, step, samples, vertices.detach())
        self._refreshed, self._resampled = step, False
        self.log.append({"event": "refresh", "step": step, **self._objective.report})
        if isinstance(self.target, Statement):
            self._audit(step, self.target, self._objective.report)

    def value(
        self, step: int, vertices: Tensor, photo_gradient_norm: float | Callable[..., float]
    ) -> Tensor | None:
        """Return λ(t)·L_topo (scalar, dtype and device of `vertices`), or None while inactive.

        Differentiable by `vertices` (T,3,3), world units. photo_gradient_norm: ‖∇V L_photo‖ of this step, or
        a function that gives its mean over so many batches; used once, at calibration. A zero or non-finite
        norm there is a no-op: None is returned, the log says why, and the next step tries again. Raises
        InputError when `refresh` was due and not called.
        """
        factor = self.factor(step)
        if factor <= 0:
            return None
        if self._objective is None or self._resampled:
            raise InputError(f"step {step} is active but has no plan; call refresh where due before value")
        if self.lambda_peak is None:
            self.lambda_peak = self._calibrated(step, self._objective, vertices, photo_gradient_norm)
        if self.lambda_peak is None:
            return None
        return (self.lambda_peak * factor * self._objective.value(vertices)).to(vertices)

    def state(self) -> dict:
        """Return what a resumed run needs (JSON-able), exact where a refresh is due."""
        return {"lambda_peak": self.lambda_peak, "log": list(self.log)}

    def load_state(self, state: dict) -> None:
        """Take over `state`; the next active step refreshes. Raises ValueError for what no term leaves."""
        self.lambda_peak, self.log = state["lambda_peak"], list(state["log"])
        if not isinstance(self.lambda_peak, float | None) or any("event" not in each for each in self.log):
            raise ValueError("it holds no state of a term")
        self._objective = None

    def _audit(self, step: int, statement: Statement, report: dict) -> None:
        """Log and tell what contradicts the statement and what does not show yet: at the first refresh, and
        at every `AUDIT_EVERY`th until something does, which is an InputError when strict."""
        earlier = [event for event in self.log if event["event"] == "audit"]
        refreshes = sum(event["event"] == "refresh" for event in self.log)
        if (refreshes - 1) % AUDIT_EVERY or any(event["warnings"] for event in earlier):
            return
        warnings = contradictions(statement, report)
        notes = [] if earlier else unseen(statement, report, self.config)
        if earlier and not warnings:
            return
        self.log.append({"event": "audit", "step": step, "warnings": warnings, "notes": notes})
        if warnings and self.strict:
            raise InputError(f"strict, and at step {step} the images contradict the words: {warnings[0]}")
        if self.tell is not None:
            for each in (*warnings, *notes):
                self.tell(f"step {step}: {each}")

    def _calibrated(
        self,
        step: int,
        objective: Persistence | Repulsion,
        vertices: Tensor,
        photo_gradient_norm: float | Callable[..., float],
    ) -> float | None:
        """Return λ_peak = ρ ‖∇V L_photo‖ / ‖∇V L_topo‖ of this step and log it, or None and the reason."""
        live = vertices.detach().clone().requires_grad_(True)
        (gradient,) = torch.autograd.grad(objective.value(live), live)
        topo_norm = length(gradient.cpu().numpy())
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
        config, target = term.config, term.target
        self.plan = plan_towards(target, samples.positions(vertices).numpy(), config, term.seed, step - 1)
        self.samples, self.diagonal = samples, target.diagonal
        # The key belongs to the records' format: a fallback that never fired sampled again in rounds.
        self.report = {**self.plan.report, "denser_rounds": 0}

    def value(self, vertices: Tensor) -> Tensor:
        """Return L_topo under the plan."""
        return self.plan.value(self.samples.positions(vertices, self.plan.used) / self.diagonal)


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


def statement_term(
    loss: LossConfig,
    points: np.ndarray,
    steps: int,
    seed: int,
    *,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
    within: Within | None = None,
) -> TopologyTerm:
    """Return the term of stated Betti numbers in a run of `steps` steps.

    points (P,3): the SfM cloud, world units; only what is `within` is asked. A density chosen from it,
    cleaned, is logged ("event": "density"). strict, tell, within: see `TopologyTerm`. Raises InputError as
    `frame_diagonal`, `cleaned` and `choose_density` do.
    """
    statement = Statement(loss.betti or (), frame_diagonal(points))
    points = points if within is None else points[within(points)]
    asked = loss.samples == 0 or loss.aim == "cloud"
    points = cleaned(points) if asked and len(points) > 3 else points
    log: list[dict] = []
    said: list[str] = []
    if loss.samples == 0:
        density = choose_density(points, statement, loss)
        chosen = vars(density) | {"reasons": list(density.reasons)}
        loss, log = replace(loss, samples=density.samples), [{"event": "density", **chosen}]
        said += [*density.reasons, *cost(points, loss, steps)]
    if loss.aim == "cloud":
        statement = measured_on(points, statement, loss.samples)
        said += unmeasured(statement, loss.samples, len(points))
    if tell is not None:
        for each in said:
            tell(each)
    statement = replace(statement, samples=loss.samples)
    term = TopologyTerm(loss, statement, steps, seed, strict=strict, tell=tell, within=within)
    term.log += log
    return term


def ramp_factor(step: int, steps: int, window: tuple[float, float] | None) -> float:
    """Return the factor in [0, 1] of λ at `step` of `steps`: 0 up to window[0]·steps, 1 from window[1]·steps,
    linear between; 1 at every step for window None (condition C3, no ramp)."""
    if window is None:
        return 1.0
    start, end = window
    return min(1.0, max(0.0, (step / steps - start) / (end - start)))


def peak_weight(rho: float, photo_norm: float, topo_norm: float) -> float | None:
    """Return λ_peak = ρ ‖∇V L_photo‖ / ‖∇V L_topo‖, or None where `no_weight` has a reason against it: the
    term stays out of this step, the log says so, and the next step tries again."""
    return None if no_weight(rho, photo_norm, topo_norm) else rho * photo_norm / topo_norm


def no_weight(rho: float, photo_norm: float, topo_norm: float) -> str:
    """Return why no weight can be set from these norms; an empty text when one can."""
    for name, norm in (("topology", topo_norm), ("photometric", photo_norm)):
        if not math.isfinite(norm) or norm <= 0:
            return f"the {name} gradient is zero or not finite, no weight can be set"
    if topo_norm < LEAST_RATIO * photo_norm:
        return (
            f"the topology gradient is {topo_norm / photo_norm:.1e} of the photometric one, below "
            f"{LEAST_RATIO:g}: too little to set a weight by"
        )
    weight = rho * photo_norm / topo_norm
    return "" if math.isfinite(weight) and weight > 0 else "the weight is zero or not finite"


def neighbour_pairs(cloud: np.ndarray, radius: float) -> np.ndarray:
    """Return the index pairs (n,2) int64 of `cloud` (M,3) closer than SKIN·radius, in a fixed order."""
    pairs = cKDTree(cloud).query_pairs(SKIN * radius, output_type="ndarray").astype(np.int64).reshape(-1, 2)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def repulsion(positions: Tensor, pairs: np.ndarray, radius: float) -> Tensor:
    """Return E (scalar float64) of `positions` (M,3) float64 over `pairs` (n,2).

    radius: h, in the unit of the positions. Differentiable once; two samples at one place push each other in
    no direction (gradient 0).
    """
    points, (i, j) = positions.detach().numpy(), pairs.T
    difference = points[i] - points[j]
    distance = np.sqrt((difference**2).sum(axis=1))
    overlap = np.maximum(0.0, 1.0 - distance / radius)
    slope = -2.0 * overlap / (radius * len(points)) / np.where(distance > 0, distance, 1.0)
    forces = (slope[:, None] * difference).T
    gradient = [np.bincount(i, each, len(points)) - np.bincount(j, each, len(points)) for each in forces]
    return Known.apply(positions, (overlap**2).sum() / len(points), np.column_stack(gradient))
