"""What `--verify` compares: the records of runs, and of the same runs made again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from paper_artifact.config import RunConfig
from paper_artifact.errors import InputError


def recorded_runs(configs: Iterable[RunConfig], results: Path) -> list[Path]:
    """Return the paths of the runs' records. Raises InputError for a run that has none, and for a record that
    cannot be read, before anything is trained."""
    from paper_artifact.record.store import read_record, recorded_path
    from paper_artifact.scene.given import called, is_own, resolve

    found = []
    for config in configs:
        path = recorded_path(resolve(config).config if is_own(config) else config, results / "runs")
        if path is None:
            raise InputError(
                f"{results / 'runs'} has no record of {called(config)} {config.condition} seed {config.seed} "
                "with these settings to compare with; leave out --verify to train it"
            )
        read_record(path)
        found.append(path)
    return found


def report_differences(recorded: Iterable[Path], again: Iterable[Path]) -> int:
    """Print for each record and the record of the same run, made again, whether they hold the same bits.
    Returns 0 if all do, else 1."""
    from paper_artifact.record.store import first_difference, read_record

    different = 0
    for old, new in zip(recorded, again, strict=True):
        before, after = read_record(old), read_record(new)
        found = first_difference(before, after)
        different += found is not None
        print(f"{old.name}: {found or 'same bits'}")
        versions = [
            f"{name} {before['packages'].get(name)}, now {version}"
            for name, version in after["packages"].items()
            if before["packages"].get(name) != version
        ]
        if versions:
            print(f"  the record was made with {'; '.join(versions)}")
    return int(different > 0)
