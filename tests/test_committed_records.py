"""What results/runs holds is whole, belongs to the study as it is configured now, and its tails follow from
its dumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from paper_artifact.config import RunConfig
from paper_artifact.evaluate.scores import tail
from paper_artifact.record.store import RUNS, config_of, read_record
from paper_artifact.study.studies import STUDIES, study_configs
from paper_artifact.topology.schedule import LEAST_RATIO

RECORDS = sorted(RUNS.glob("*.json"))


@pytest.fixture(scope="module")
def study_runs() -> set[RunConfig]:
    return {config for study in STUDIES for config in study_configs(study)}


def test_the_baseline_is_recorded():
    names = {tuple(path.stem.split("-")[:3]) for path in RECORDS}
    assert {(shape, "C0", f"s{seed}") for shape in ("sphere", "torus", "spot") for seed in range(3)} <= names


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.stem)
def test_record(path: Path, study_runs):
    record = read_record(path)
    assert config_of(record) in study_runs
    dumps, dimension = record["dumps"], record["mesh"]["dimension"]
    assert [dump["step"] for dump in dumps] == list(record["config"]["dump_steps"])
    assert [dump["step"] for dump in dumps][-3:] == [2300, 2400, 2500]
    assert np.isclose(tail(dumps, dimension), record["tails"]["bottleneck"][dimension], rtol=1e-6)
    assert (
        record["losses"]["step"][-1] == 2500
        and np.mean(record["losses"]["loss"][-10:]) < 0.1 * record["losses"]["loss"][0]
    )
    # The dumps after the first resampling hold the budget, but for the splits since.
    assert all(dump["triangles"] <= 1.1 * record["config"]["budget"] for dump in dumps)
    if record["config"]["loss"] is not None:
        refreshes = [entry for entry in record["topology"] if entry["event"] == "refresh"]
        assert (
            len([entry for entry in record["topology"] if entry["event"] == "lambda"]) == 1
            and len(refreshes) >= 190
        )
        (weight,) = [entry for entry in record["topology"] if entry["event"] == "lambda"]
        assert weight["topo_norm"] / weight["photo_norm"] > 100 * LEAST_RATIO
