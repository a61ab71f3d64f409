"""The runs that a report rests on: the committed records of the study's configurations, and, plainly, those
that are missing.

A record counts only if its configuration is exactly the one asked for: a record of other settings is another
experiment. Where a study changes a condition's settings, the arm's name says so: "C1, rho=0.03". In the
profile "full" the same configurations are trained again, into a folder of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from paper_artifact.catalogue import study_config, tag_of
from paper_artifact.config import RunConfig
from paper_artifact.errors import InputError
from paper_artifact.evaluate.scores import Target, make_target
from paper_artifact.files import RESULTS
from paper_artifact.pipeline import run
from paper_artifact.record.store import config_of, read_record, record_path, recorded_path
from paper_artifact.scene.shapes import find_mesh, surface
from paper_artifact.study.studies import settings

RETRAINED = RESULTS / "retrained"
Run = tuple[str, str, int]  # shape, arm (a condition, and its setting where one is changed), seed


@dataclass(frozen=True, eq=False)
class Collected:
    """The records of the runs that a report asked for, and the runs that have none."""

    records: tuple[dict, ...]  # in the order asked for
    missing: tuple[Run, ...]
    results: Path = RESULTS  # the folder of their soups

    @property
    def wanted(self) -> tuple[Run, ...]:
        """Return every run that was asked for, the recorded ones first."""
        return tuple(key(record) for record in self.records) + self.missing

    def only(self, *arms: str) -> Collected:
        """Return the same of these arms alone."""
        return Collected(
            tuple(record for record in self.records if key(record)[1] in arms),
            tuple(each for each in self.missing if each[1] in arms),
            self.results,
        )

    def of(self, shape: str, condition: str | None = None, seed: int | None = None) -> tuple[dict, ...]:
        """Return the records of one shape, and of one condition and one seed unless they are None."""
        wanted = (shape, condition, seed)
        return tuple(
            record
            for record in self.records
            if all(ask in (None, own) for ask, own in zip(wanted, key(record), strict=True))
        )


def key(record: Mapping) -> Run:
    """Return the record's shape, condition and seed."""
    config = record["config"]
    return config["shape"], config["condition"], config["seed"]


def collect(
    wanted: Iterable[Run],
    profile: str = "recorded",
    folder: Path = RESULTS / "runs",
    retrained: Path = RETRAINED,
) -> Collected:
    """Return the records of the wanted runs.

    profile "recorded": read them from `folder`; "full": train each into `retrained` (hours; what is there
    already is kept). Raises InputError for another profile and for a damaged record.
    """
    return _collected({each: study_config(*each) for each in wanted}, profile, folder, retrained)


def collect_study(name: str, profile: str = "recorded", folder: Path = RESULTS / "runs") -> Collected:
    """Return the records of a study's runs (see `study.studies`), and which are missing; profile as for
    `collect`.

    In a block of changed settings the records' condition is the arm's name, "C1, rho=0.03".
    """
    wanted = {}
    for setting, configs in settings(name).items():
        for each in configs:
            arm = f"{each.condition}, {setting}" if setting else each.condition
            wanted[each.shape, arm, each.seed] = each
    return _collected(wanted, profile, folder, RETRAINED)


def joined(*collected: Collected) -> Collected:
    """Return several collections as one, each run once: of arms that are compared across studies."""
    records = {key(record): record for each in collected for record in each.records}
    missing = dict.fromkeys(run for each in collected for run in each.missing if run not in records)
    return Collected(tuple(records.values()), tuple(missing), collected[0].results)


def _collected(wanted: Mapping[Run, RunConfig], profile: str, folder: Path, retrained: Path) -> Collected:
    if profile == "full":
        made = {
            each: run(config, mesh=find_mesh(config.shape), results=retrained)
            for each, config in wanted.items()
        }
        return Collected(tuple(_named(record, each[1]) for each, record in made.items()), (), retrained)
    if profile != "recorded":
        raise InputError(f"the profile {profile!r} is unknown; use 'recorded' or 'full'")
    # By name: the folder holds hundreds of other runs, and reading one costs 8 ms.
    paths = {each: recorded_path(config, folder) for each, config in wanted.items()}
    found = {each: None if path is None else read_record(path) for each, path in paths.items()}
    return Collected(
        tuple(_named(record, each[1]) for each, record in found.items() if record is not None),
        tuple(each for each, record in found.items() if record is None),
        folder.parent,
    )


def _named(record: dict, arm: str) -> dict:
    return record | {"config": record["config"] | {"condition": arm}}


def missing_text(collected: Collected, study: str | None = None) -> str:
    """Return what is not recorded, one line per shape and condition with the command that makes it, or that
    nothing is missing.

    study: the sweep that has these runs (its command makes all missing seeds of a line; with changed settings
    those of all lines), or None for single training runs.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for shape, condition, seed in collected.missing:
        groups.setdefault((shape, condition), []).append(seed)
    if not groups:
        return f"all {len(collected.records)} runs are recorded"
    total = len(collected.wanted)
    lines = [f"NOT RECORDED: {len(collected.missing)} of {total} runs; the command beside a line makes them"]
    for (shape, condition), seeds in groups.items():
        if study is None:
            make = command(shape, condition, seeds[0])
        elif tag_of(condition) != condition:  # a sweep cannot be restricted to one setting
            make = f"python -m paper_artifact sweep {study}"
        else:
            make = f"python -m paper_artifact sweep {study} --shape {shape} --condition {condition}"
        lines.append(f"  {shape} {condition}, seed {', '.join(map(str, seeds))}: {make}")
    return "\n".join(lines)


def command(shape: str, condition: str, seed: int) -> str:
    """Return the command line that trains and records one run of the study."""
    return f"python -m paper_artifact train {shape} --condition {condition} --seed {seed}"


def soup_path(record: Mapping, results: Path = RESULTS) -> Path:
    """Return where a run with this results folder keeps the trained soup of `record`."""
    return (
        results / "soups" / f"{record_path(config_of(record), results / 'runs', record['defaults']).stem}.npz"
    )


@cache
def target_of(shape: str) -> Target:
    """Return the clean surface of a shape as the evaluation sees it (20,000 samples); made once per
    process."""
    return make_target(surface(shape), cache=None)
