"""A record of another form, with a digest that fits: one sentence, wherever records are read."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from paper_artifact.catalogue import study_config
from paper_artifact.cli.runs import closing_notes, summary
from paper_artifact.errors import InputError
from paper_artifact.evaluate.scores import tails
from paper_artifact.pipeline import audit_remarks
from paper_artifact.record.form import misfit
from paper_artifact.record.store import _hash as digest_of
from paper_artifact.record.store import first_difference, read_record, recorded_path, write_record
from paper_artifact.results import _dump_row, _expected, _refresh_rows, _run_row
from paper_artifact.study.studies import study_configs
from tests.fuzz_mutations import ODD_VALUES
from tests.tiny_run import bare_record

KEPT = ("schema", "version", "defaults", "config", "config_hash", "digest")  # test_record


def recorded(study: str, condition: str) -> dict:
    """Return the record of the study's first run of this condition."""
    config = next(each for each in study_configs(study) if each.condition == condition)
    path = recorded_path(config)
    assert path is not None
    record = read_record(path)
    if "topology" in record:  # of each kind of event one is enough
        record["topology"] = [*{event["event"]: event for event in record["topology"]}.values()]
    return record | {"dumps": record["dumps"][-2:]}


def without_truth() -> dict:
    """Return the record of a run on photographs, as they have no ground truth."""
    dump = {
        "step": 1,
        "counts": [1, 2, 0],
        "floor": 0.02,
        "bars": [[], [[0.1, 0.2]], []],
        "margins": [[2.0]] * 3,
    }
    return bare_record(study_config("own", "C0", 2, steps=1, dump_steps=(1,)), [dump], tails([dump], 1))


RECORDS = {
    "C0": lambda: recorded("table1", "C0"),
    "C1": lambda: recorded("table1", "C1"),
    "C2": lambda: recorded("table1", "C2"),
    "T1": lambda: recorded("words", "T1"),
    "T2": lambda: recorded("words", "T2"),
    "without a truth": without_truth,
}


def places(value: Any, form: tuple = ()) -> dict[tuple, tuple]:
    """Return the places of a JSON value's entries, one of each kind: in lists any item stands for all."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = {tuple(0 if isinstance(key, int) else key for key in form): form} if form else {}
    for key, each in items:
        found |= places(each, (*form, key))
    return found


def signed(record: dict) -> dict:
    """Return the record with a digest that fits."""
    return record | {"digest": digest_of({key: value for key, value in record.items() if key != "digest"})}


def read_everywhere(path: Path) -> None:
    """Read a record as every part of the program does."""
    record = read_record(path)
    summary(record), closing_notes(record), first_difference(record, record)
    for kind in ("warnings", "notes"):
        audit_remarks(record, kind)
    rows = [
        {"loss_samples": None} | _run_row(path.stem, record),
        *(_dump_row(dump, 0) for dump in record["dumps"]),
    ]
    for entry in record.get("topology") or ():
        rows += _refresh_rows(entry) if "dimensions" in entry else ()
    assert _expected(pd.DataFrame(rows[:1])).size == 1


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_of_another_form_is_one_sentence(name, tmp_path):
    """Each entry in turn replaced by each of some odd values, and left out."""
    record = RECORDS[name]()
    read_everywhere(write_record(signed(record), tmp_path))
    draws = np.random.default_rng(0)
    refused = 0
    for place in places({key: value for key, value in record.items() if key not in KEPT}).values():
        for value in (*(ODD_VALUES[k] for k in draws.choice(14, 3)), KEPT):
            odd = copy.deepcopy(record)
            holder = odd
            for key in place[:-1]:
                holder = holder[key]
            if value is KEPT:
                del holder[place[-1]]
            else:
                holder[place[-1]] = value
            try:
                read_everywhere(write_record(signed(odd), tmp_path))
            except InputError as error:
                assert "run it again" in str(error) or "delete it" in str(error) or "diagonal" in str(error)
                refused += 1
    assert refused > 100
    if name in ("T1", "T2"):  # a cloud may have no bar but the wanted ones
        event = next(each for each in record["topology"] if each["event"] == "refresh")
        plan = event["dimensions"]["0"]
        plan |= {"margins": plan["margins"][: plan["wanted"]], "surplus": 0}
        assert misfit(record) is None
        plan["surplus"] = 1
        assert misfit(record).endswith("dimensions 0 margins")
    for key in ("shape", "condition", "seed", "budget", "initial_ratio"):
        config = {name: value for name, value in record["config"].items() if name != key}
        assert misfit(record | {"config": config}) == f"config {key}"
