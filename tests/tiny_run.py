"""The smallest run that still learns something: a sphere in 8 views of 64 px, 200 triangles, 60 steps (about
a second)."""

from __future__ import annotations

from typing import Any

from paper_artifact.catalogue import study_config
from paper_artifact.config import RunConfig

STEPS = 60
TINY = {
    "steps": STEPS,
    "budget": 200,
    "views": 8,
    "size": 64,
    "vertex_lr": 0.02,
    "final_lr": 0.1,
    "initial_ratio": 3.0,
    "resample_every": 10,
    "samples": 500,
    "dump_steps": (20, 30, 60),
}


def tiny_config(**changes: Any) -> RunConfig:
    """Return the tiny run's configuration with `changes`; dump steps beyond a smaller number of steps fall
    away."""
    values = TINY | changes
    if "dump_steps" not in changes:
        values["dump_steps"] = tuple(step for step in TINY["dump_steps"] if step <= values["steps"])
    return study_config("sphere", **values)


def tiny_arguments() -> list[str]:
    """Return the command-line arguments of `tiny_config()` for the verb train."""
    changes = [f"--set={name}={value}".replace(" ", "") for name, value in TINY.items() if name != "steps"]
    return ["train", "sphere", "--quiet", "--device=cpu", f"--steps={STEPS}", *changes]
