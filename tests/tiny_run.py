"""The smallest run that still learns something: a sphere in 8 views of 64 px, 200 triangles, 60 steps (about
a second)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from paper_artifact.catalogue import study_config
from paper_artifact.config import RunConfig
from paper_artifact.record.store import make_record, read_record

STEPS = 60
TINY = {
    "steps": STEPS, "budget": 200, "views": 8, "size": 64, "vertex_lr": 0.02, "final_lr": 0.1,
    "initial_ratio": 3.0, "resample_every": 10, "samples": 500, "dump_steps": (20, 30, 60),
}  # fmt: skip


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


def find_records(folder: Path, **wanted: Any) -> list[dict]:
    """Return the records in `folder`, by file name, whose config has these values."""
    records = [read_record(path) for path in sorted(folder.glob("[!.]*.json"))]
    return [each for each in records if wanted.items() <= each["config"].items()]


def bare_record(
    config: RunConfig, dumps: Sequence[dict] = (), ends: Mapping = MappingProxyType({}), **more: Any
) -> dict:
    """Return the record of a run of one step with these dumps and tails, and no more than a record must have;
    more: other sections."""
    sections: dict[str, Any] = {
        "losses": {"step": [1], "loss": [0.5]},
        "soup": {"triangles": 1},
        "cpu_seconds": 1.0,
    }
    return make_record(config, list(dumps), ends, {"photometric": 1.0}, **(sections | {"images": {}} | more))
