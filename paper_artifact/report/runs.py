"""The runs that a report rests on: the committed records of the study's configurations, and, plainly, those that are missing.

A record counts only if its configuration is exactly the study's for (shape, condition, seed), by hash: a record of other settings
is another experiment. In the profile "full" the same configurations are trained again, into a folder of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS
from paper_artifact.pipeline import run
from paper_artifact.record.store import config_of, find_records, record_path
from paper_artifact.scene.find import find_mesh

RETRAINED = RESULTS / "retrained"
Run = tuple[str, str, int]  # shape, condition, seed


@dataclass(frozen=True, eq=False)
class Collected:
    """records: in the order asked for; missing: runs without one."""

    records: tuple[dict, ...]
    missing: tuple[Run, ...]

    def of(self, shape: str, condition: str | None = None) -> tuple[dict, ...]:
        """Return the records of one shape, and of one condition unless it is None."""
        return tuple(
            record
            for record in self.records
            if record["config"]["shape"] == shape and condition in (None, record["config"]["condition"])
        )


def collect(
    wanted: Iterable[Run],
    profile: str = "recorded",
    folder: Path = RESULTS / "runs",
    retrained: Path = RETRAINED,
) -> Collected:
    """Return the records of the wanted runs.

    profile "recorded": read them from `folder`; "full": train each into `retrained` (hours; what is there already is kept).
    Raises InputError for another profile and for a damaged record.
    """
    wanted = list(dict.fromkeys(wanted))
    if profile == "full":
        return Collected(
            tuple(run(study_config(*each), mesh=find_mesh(each[0]), results=retrained) for each in wanted), ()
        )
    if profile != "recorded":
        raise InputError(f"the profile {profile!r} is unknown; use 'recorded' or 'full'")
    stored = {config_of(record): record for record in find_records(folder)}
    found, missing = [], []
    for each in wanted:
        record = stored.get(study_config(*each))
        if record is not None:
            found.append(record)
        else:
            missing.append(each)
    return Collected(tuple(found), tuple(missing))


def missing_text(collected: Collected, study: str | None = None) -> str:
    """Return what is not recorded, one line per shape and condition with the command that makes it, or that nothing is missing.

    study: the sweep that has these runs (its command makes all missing seeds of a line), or None for single training runs.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for shape, condition, seed in collected.missing:
        groups.setdefault((shape, condition), []).append(seed)
    if not groups:
        return f"all {len(collected.records)} runs are recorded"
    total = len(collected.records) + len(collected.missing)
    lines = [f"NOT RECORDED: {len(collected.missing)} of {total} runs; the command beside a line makes them"]
    for (shape, condition), seeds in groups.items():
        if study is None:
            make = command(shape, condition, seeds[0])
        else:
            make = f"python -m paper_artifact sweep {study} --shape {shape} --condition {condition}"
        lines.append(f"  {shape} {condition}, seed {', '.join(map(str, seeds))}: {make}")
    return "\n".join(lines)


def command(shape: str, condition: str, seed: int) -> str:
    """Return the command line that trains and records one run of the study."""
    return f"python -m paper_artifact train {shape} --condition {condition} --seed {seed}"


def soup_path(record: Mapping, results: Path = RESULTS) -> Path:
    """Return where `train.run` with this results folder keeps the trained soup of `record`."""
    return results / "soups" / f"{record_path(config_of(record), results / 'runs').stem}.npz"


def dump_table(records: Iterable[Mapping]) -> pd.DataFrame:
    """Return one line per record and dump: shape, condition, seed, step, bottleneck and count in the discriminating dimension,
    Chamfer.

    bottleneck: radius / diagonal; chamfer: mean of both directions / diagonal, percent.
    """
    rows = []
    for record in records:
        dimension, config = record["mesh"]["dimension"], record["config"]
        rows += [
            {
                "shape": config["shape"],
                "condition": config["condition"],
                "seed": config["seed"],
                "step": dump["step"],
                "bottleneck": dump["bottleneck"][dimension],
                "count": dump["counts"][dimension],
                "chamfer %": 100 * dump["chamfer"],
            }
            for dump in record["dumps"]
        ]
    return pd.DataFrame(
        rows, columns=["shape", "condition", "seed", "step", "bottleneck", "count", "chamfer %"]
    )


def loss_table(records: Iterable[Mapping]) -> pd.DataFrame:
    """Return one line per record and kept step: shape, condition, seed, step, loss (the photometric objective, dimensionless)."""
    rows = []
    for record in records:
        config = record["config"]
        rows += [
            {
                "shape": config["shape"],
                "condition": config["condition"],
                "seed": config["seed"],
                "step": step,
                "loss": loss,
            }
            for step, loss in zip(
                record["losses"].get("step", []), record["losses"].get("loss", []), strict=True
            )
        ]
    return pd.DataFrame(rows, columns=["shape", "condition", "seed", "step", "loss"])
