"""Run records: round trip, naming, and every way a file on disk can be wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.record.store import (
    check_unedited,
    config_hash,
    config_of,
    make_record,
    pack,
    read_record,
    record_path,
    recorded_path,
    unpack,
    write_record,
)
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.state import save_soup

CONFIG = study_config("torus", "C1", 3)


def example(config=CONFIG, **more) -> dict:
    found = {"bottleneck": [0.001, 0.02, 0.003], "counts": [0, 2, 1]}
    dumps = [{"step": step} | found for step in (2300, 2400, 2500)]
    losses = {"step": np.arange(2500), "loss": np.linspace(1, 0.1, 2500, dtype=np.float32)}
    tails = {"bottleneck": np.array(found["bottleneck"]), "counts": [0, 2, 1]}
    tails |= {"chamfer": 0.01, "hausdorff95": 0.02}
    more = {"images": {}, "soup": {"triangles": 1}, "cpu_seconds": 1.0, "mesh": {"dimension": 1}} | more
    return make_record(config, dumps, tails, {"train": 12.34567}, losses=losses, **more)


def test_round_trip(tmp_path):
    event = {
        "event": "lambda",
        "step": 1,
        "lambda_peak": np.float32(0.5),
        "photo_norm": 1 / 3,
        "topo_norm": 1,
    }
    record = example(topology=[event | {"live": np.array([0.1, np.nan])}])
    path = write_record(record, tmp_path)
    assert path.name == f"torus-C1-s3-{config_hash(CONFIG)}.json"
    again = read_record(path)
    assert again == record
    assert again["config"]["loss"]["ramp"] == [0.2, 0.5]
    assert config_of(again) == CONFIG
    assert again["topology"] == [event | {"photo_norm": 0.3333333, "live": [0.1, None]}]
    assert again["losses"]["step"][-1] == 2499 and len(again["losses"]["step"]) == 250
    assert again["packages"]["numpy"] == np.__version__ and again["host"]["cores"] >= 1
    assert path.stat().st_size < 20_000


def test_names_tell_runs_apart():
    assert config_hash(replace(CONFIG, vertex_lr=0.0100001)) != config_hash(CONFIG)
    assert record_path(replace(CONFIG, shape="meshes/my shape.obj")).name.startswith("my_shape.obj-C1-s3-")


def test_a_topology_log_stays_small_and_comes_back():
    """That of a committed run, packed, beside plain JSON."""
    log = read_record(recorded_path(study_config("torus", "C1", 3)))["topology"]
    packed = json.dumps(pack(log))
    assert unpack(json.loads(packed)) == log and len(log) > 200 and 4 * len(packed) < len(json.dumps(log))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 3) | st.sampled_from([0.5, 1.0, -0.0, "a", "b"]),
    lambda inner: (
        st.lists(inner, max_size=5)
        | st.dictionaries(st.sampled_from("xyz"), inner, max_size=3)
        | st.lists(st.fixed_dictionaries({"x": inner}, optional={"y": inner}), min_size=2, max_size=5)
    ),
    max_leaves=25,
)


@settings(max_examples=300, deadline=None)
@given(json_values)
def test_packing_loses_nothing(value):
    again = unpack(json.loads(json.dumps(pack(value))))
    assert json.dumps(again, sort_keys=True) == json.dumps(value, sort_keys=True)


def changed(path, change) -> None:
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


@pytest.mark.parametrize(
    "change, reason",
    [
        (lambda record: record["config"].update(seed=4), "config does not match"),
        (lambda record: record["tails"].update(bottleneck=[0, 0, 0]), "digest mismatch"),
        (lambda record: record.update(dumps=[]), "digest mismatch"),
        (lambda record: record.update(dumps={"#table": {"a": [1], "b": [1, 2]}}), "damaged in its tables"),
        (lambda record: record.pop("dumps"), "lacks dumps"),
        (lambda record: record.update(version=1), "has version 1, this code reads 2; move it"),
        (lambda record: record.update(version=99), "version 99"),
        (lambda record: record.update(defaults=7), "defaults' version 7 is unknown to this code"),
        (lambda record: record["config"].update(colour=1), "does not know .unknown setting colour"),
        (lambda record: record.update(schema="other"), "no run record"),
    ],
)
def test_changed_records_are_refused(tmp_path, change, reason):
    path = write_record(example(), tmp_path)
    changed(path, change)
    with pytest.raises(InputError, match=reason) as caught:
        read_record(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "change, reason",
    [
        (lambda text: text[: len(text) // 2], "cut off"),
        (lambda text: "", "cut off"),
        (lambda text: "\x89PNG", "cut off|damaged"),
        (lambda text: "[1, 2]", "no run record"),
        (lambda text: text.replace('"train":12.346', '"train":NaN'), "NaN"),
    ],
)
def test_half_and_foreign_files_are_refused(tmp_path, change, reason):
    path = write_record(example(), tmp_path)
    path.write_text(change(path.read_text()), encoding="latin-1")
    with pytest.raises(InputError, match=reason):
        read_record(path)


def test_misnamed_and_missing_files_are_refused(tmp_path):
    moved = write_record(example(), tmp_path).rename(tmp_path / "sphere-C1-s3-0123456789ab.json")
    with pytest.raises(InputError, match="misnamed"):
        read_record(moved)
    with pytest.raises(InputError, match="cannot read"):
        read_record(tmp_path / "absent.json")


def test_make_record_refuses_what_it_cannot_hold():
    with pytest.raises(InputError, match="cannot hold a set"):
        example(topology={1, 2})
    with pytest.raises(InputError, match="must not start"):
        example(topology={"#same": 1})


def labelled(soup):
    np.savez(soup, **np.load(soup), my_labels=np.zeros(3))


@pytest.mark.parametrize(
    "change",
    [
        lambda record, soup: changed(record, lambda mine: mine.update(schema="mine")),
        lambda record, soup: changed(record, lambda mine: mine.update(version=1)),
        lambda record, soup: changed(record, lambda mine: mine["config"].update(my_note="the best one")),
        lambda record, soup: record.write_text("{"),
        lambda record, soup: np.savez(soup, my_vertices=np.eye(3)),
        lambda record, soup: (record.unlink(), labelled(soup)),
        lambda record, soup: (record.unlink(), np.savez(soup, my_vertices=np.eye(3))),
    ],
)
def test_what_a_user_changed_is_not_replaced(tmp_path, change):
    record = write_record(example(), tmp_path / "runs")
    soup = tmp_path / "soups" / f"{record.stem}.npz"
    save_soup(soup, initial_soup(np.eye(9, 3, dtype=np.float32), 8, 0))
    check_unedited(record)
    change(record, soup)
    with pytest.raises(InputError, match="was changed, or another version wrote it, and would be replaced"):
        check_unedited(record)


def test_a_soup_whose_record_was_not_written_is_replaced(tmp_path):
    record = record_path(CONFIG, tmp_path / "runs")
    save_soup(tmp_path / "soups" / f"{record.stem}.npz", initial_soup(np.eye(9, 3, dtype=np.float32), 8, 0))
    check_unedited(record)  # a run was ended in between
