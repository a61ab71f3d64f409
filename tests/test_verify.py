"""--verify: a run made again is compared with its record, value by value in the order of the run."""

import shutil
from copy import deepcopy
from pathlib import Path

import pytest

from paper_artifact.cli import main
from paper_artifact.config import RunConfig
from paper_artifact.record.store import (
    _hash,
    config_of,
    first_difference,
    make_record,
    read_record,
    recorded_path,
    write_record,
)
from paper_artifact.scene.given import resolve
from paper_artifact.study import sweep
from paper_artifact.study.studies import study_configs
from tests.tiny_run import tiny_arguments


def rewritten(record: dict, folder: Path) -> Path:
    """Write a record whose numbers were changed, with a digest that fits."""
    losses = {name: list(values) for name, values in record["losses"].items()}
    kept = ("dumps", "tails", "timings", "losses", "config", "config_hash", "schema", "version", "defaults")
    kept += ("packages", "host", "digest")
    more = {name: value for name, value in record.items() if name not in kept}
    made = make_record(config_of(record), record["dumps"], record["tails"], record["timings"], losses, **more)
    return write_record(made, folder)


def test_train_verify(tmp_path, capsys):
    command = [*tiny_arguments(), f"--results={tmp_path}"]
    assert main([*command, "--verify"]) == 1 and "no record of sphere C0 seed 0" in capsys.readouterr().err
    assert main(command) == 0
    (path,) = (tmp_path / "runs").glob("*.json")
    before = path.read_bytes()
    capsys.readouterr()
    assert main([*command, "--verify", "--threads=2"]) == 0
    assert capsys.readouterr().out == f"{path.name}: same bits\n"
    assert path.read_bytes() == before
    soup = tmp_path / "soups" / f"{path.stem}.npz"
    whole = soup.read_bytes()
    soup.write_bytes(whole[:500])
    assert main(command) == 1 and "not a readable soup" in capsys.readouterr().err
    soup.write_bytes(whole)
    record = read_record(path)
    place = record["losses"]["step"].index(40)
    value = record["losses"]["loss"][place]
    record["losses"]["loss"][place] = 0.5
    record["dumps"][-1]["bars"][0][0][1] += 1
    rewritten(record, tmp_path / "runs")
    assert main([*command, "--verify"]) == 1
    assert capsys.readouterr().out == f"{path.name}: step 40: loss is {value!r}, and 0.5 in the record\n"
    assert main([*command, "--verify", "--again"]) == 2
    path.write_text("{")  # edited, and cut off
    assert main([*command, "--again"]) == 1 and path.read_text() == "{"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda record: record["timings"].clear(), None),
        (lambda record: record["dumps"][0].update(floor=1.0), "step 3: dump floor is 1.0, and 0.5"),
        (lambda record: record["topology"][1]["found"].append(7), "step 2: refresh found is [1, 7], and [1]"),
        (lambda record: record["topology"].pop(), "step 3: the record has a refresh where this"),
        (lambda record: record["tails"].update(bottleneck=[1, 2, 4]), "at the end: tails bottleneck[2] is 4"),
    ],
)
def test_the_first_difference_is_the_first_of_the_run(change, sentence):
    record = {
        "losses": {"step": [1, 2, 3], "loss": [0.3, 0.2, 0.1]},
        "topology": [
            {"event": "density"},
            {"event": "refresh", "step": 2, "found": [1]},
            {"event": "refresh", "step": 3, "found": []},
        ],
        "dumps": [{"step": 3, "floor": 0.5}],
        "tails": {"bottleneck": [1, 2, 3]},
        "timings": {"photometric": 1.0},
    }
    again = deepcopy(record)
    change(again)
    found = first_difference(record, again)
    assert found is None if sentence is None else sentence in found
    again["losses"]["loss"][0] = 0.0
    assert first_difference(record, again) == "step 1: loss is 0.0, and 0.3 in the record"


def test_sweep_verify_counts_and_names_what_differs(tmp_path, capsys, monkeypatch):
    """Two committed records stand for what the sweep finds; one is made again with another package."""
    configs = study_configs("table1", ["sphere"], ["C1", "C2"], [0, 1])
    known = [config for config in configs if config.seed == 0]
    records = [read_record(path) for config in known if (path := recorded_path(config)) is not None]
    (tmp_path / "runs").mkdir()
    older = records[1] | {"packages": records[1]["packages"] | {"paper_artifact": "0.2.0"}}
    older["digest"] = _hash({key: value for key, value in older.items() if key != "digest"})
    for record in (records[0], older):
        write_record(record, tmp_path / "runs")

    def again(todo, results, **_):
        assert [config.condition for config in todo] == [config.condition for config in known]
        (results / "runs").mkdir()
        for path in (tmp_path / "runs").glob("*.json"):
            shutil.copy(path, results / "runs")
        changed = deepcopy(records[1])
        changed["topology"][0]["radius"] = 9.0
        rewritten(changed, results / "runs")
        return []

    monkeypatch.setattr("paper_artifact.study.sweep.sweep", again)
    words = ["sweep", "table1", "--shape", "sphere", "--condition", "C1", "--condition", "C2"]
    words += ["--seed=0", "--seed=1", "--quiet", f"--results={tmp_path}", "--verify"]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert "sphere-C1-s0" in said and "same bits" in said and "radius is 9.0" in said
    assert "the record was made with paper_artifact 0.2.0, now" in said.replace("numpy", "")
    assert "2 runs compared, 2 have no record" in said


@pytest.mark.parametrize("when", ["before the run", "while it runs"])
def test_a_mesh_saved_anew_during_a_sweep_ends_its_runs(tmp_path, monkeypatch, when):
    """Else seeds of one sweep would be of two shapes."""
    mesh = tmp_path / "own.obj"
    tetrahedron = "v {0} 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    mesh.write_text(tetrahedron.format(0))
    config = RunConfig(str(mesh))
    todo = sweep.missing([config], tmp_path)
    assert todo == {config: resolve(config).config}
    begun = []

    def start(*_):
        begun.append(mesh.write_text(tetrahedron.format(-1)))

    monkeypatch.setattr(sweep, "start_run", start)
    monkeypatch.setattr(sweep, "failure_of", lambda child, stepped: None)
    if when == "before the run":
        mesh.write_text(tetrahedron.format(-1))
    (outcome,) = sweep.run_all(todo, tmp_path, "cpu", 1)
    assert "own.obj was saved anew while the sweep ran" in outcome.failure
    assert len(begun) == (when == "while it runs")
