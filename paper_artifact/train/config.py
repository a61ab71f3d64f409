"""A run's configuration: every number that can change its result, and nothing else.

Paths, thread counts and verbosity are not here: they cannot change the bits. The record's name is a hash of this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from paper_artifact.errors import InputError

# Triangle budgets N by shape (paper §4); loop class 700, void class 1200, the genus-2 stretch case 2000.
BUDGETS = {
    "sphere": 1200,
    "cube": 1200,
    "cylinder": 1200,
    "bowl_narrow": 1200,
    "bowl_wide": 1200,
    "torus": 700,
    "two_spheres": 700,
    "double_torus": 2000,
    "bob": 700,
    "rocker-arm": 700,
    "eight": 700,
    "spot": 1200,
    "fandisk": 1200,
    "armadillo": 1200,
    "horse": 1200,
    "pot": 1200,
}
DEFAULT_BUDGET = 1200


@dataclass(frozen=True)
class RunConfig:
    """One training run. Learning rates: vertex_lr is per unit of scene radius (world units); the others are of logits and
    weights.

    initial_ratio: initial triangles ÷ budget; all beyond the budget are pruned at the first resampling. dump_steps: steps that
    are evaluated (after that step's resampling), with `samples` surface samples.
    """

    shape: str
    condition: str = "C0"
    seed: int = 0
    steps: int = 2500
    budget: int = DEFAULT_BUDGET
    views: int = 48
    size: int = 200
    background: str = "white"
    batch: int = 4
    vertex_lr: float = 1e-2
    feature_lr: float = 5e-2
    opacity_lr: float = 5e-2
    mlp_lr: float = 1e-2
    final_lr: float = 0.01
    initial_ratio: float = 7.5
    resample_every: int = 100
    split_views: int = 20
    split_height: float = 0.2
    dump_steps: tuple[int, ...] = (100, 200, 400, 700, 1000, 1300, 1600, 1900, 2100, 2300, 2400, 2500)
    samples: int = 20_000
    topology: tuple[tuple[str, Any], ...] = ()  # the condition's own parameters, sorted (name, value) pairs

    def __post_init__(self) -> None:
        lowest = {"steps": 1, "budget": 1, "views": 2, "batch": 1, "resample_every": 1, "split_views": 0, "samples": 4}
        for name, least in lowest.items():
            if getattr(self, name) < least:
                raise InputError(f"{name} must be at least {least}, got {getattr(self, name)}")
        if self.seed < 0:
            raise InputError(f"seed must not be negative, got {self.seed}")
        if self.size < 22:
            raise InputError(
                f"size must be at least 22 pixels (the SSIM window is 11, resampling works at half size), got {self.size}"
            )
        for name in ("vertex_lr", "feature_lr", "opacity_lr", "mlp_lr", "final_lr", "initial_ratio", "split_height"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if self.background not in ("white", "black"):
            raise InputError(f"background must be white or black, got {self.background!r}")
        whole = isinstance(self.dump_steps, tuple) and all(isinstance(step, int) for step in self.dump_steps)
        if not whole or any(step < 1 or step > self.steps for step in self.dump_steps):
            raise InputError(f"dump_steps must be a tuple of steps in 1…{self.steps}, got {self.dump_steps}")
        if not isinstance(self.topology, tuple) or not all(isinstance(pair, tuple) and len(pair) == 2 for pair in self.topology):
            raise InputError(f"topology must be a tuple of (name, value) pairs, got {self.topology!r}")


def default_config(shape: str, **changes: Any) -> RunConfig:
    """Return the study's configuration for a shape: its budget and dump steps that fit the number of steps.

    With other than 2,500 steps the dump steps scale with them. Raises InputError for values out of range.
    """
    names = {field.name for field in fields(RunConfig)}
    unknown = sorted(set(changes) - names)
    if unknown:
        raise InputError(f"unknown configuration {', '.join(unknown)}; known: {', '.join(sorted(names))}")
    base = RunConfig(shape=shape, budget=BUDGETS.get(shape, DEFAULT_BUDGET))
    steps = changes.get("steps", base.steps)
    if steps < 1:
        raise InputError(f"steps must be at least 1, got {steps}")
    if steps != base.steps:
        scaled = {max(1, round(step * steps / base.steps)) for step in base.dump_steps}
        changes.setdefault("dump_steps", tuple(sorted(scaled)))
    return replace(base, **changes)
