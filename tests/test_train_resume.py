"""A run that is killed goes on from its checkpoint to the same record; damaged checkpoints are refused."""

import io
import shutil
import signal
import subprocess
import sys
import threading

import pytest
import torch

from paper_artifact import cli
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.pipeline import run
from paper_artifact.randomness import stream
from paper_artifact.soup.state import load_soup
from paper_artifact.train.backend import backend_for
from paper_artifact.train.loop import train
from paper_artifact.train.state import SEAL, _seal, resumed_state
from tests.sweep_runs import same_run
from tests.tiny_run import STEPS, find_records, tiny_arguments, tiny_config

# Kills its own process without warning, either between two steps or in the middle of writing a checkpoint.
KILLED = """
import os, pathlib, signal, sys
from paper_artifact import cli
from paper_artifact.train import loop
where, arguments = sys.argv[1], sys.argv[2:]
def kill():
    os.kill(os.getpid(), signal.SIGKILL)
batch_views, write, checkpoints = loop.batch_views, pathlib.Path.write_bytes, []
def at_step(train, batch, seed, step):
    if step == 37 and where == "step":
        kill()
    return batch_views(train, batch, seed, step)
def half(path, data):
    checkpoints.extend([path] * ("checkpoints" in path.parts))
    if len(checkpoints) == 4:
        write(path, data[:len(data) // 2])
        kill()
    write(path, data)
loop.batch_views = at_step
if where == "write":
    pathlib.Path.write_bytes = half
cli.main(arguments)
"""


def arguments(condition: str, folder) -> list[str]:
    extra = ["--condition=C1", "--loss=samples=512"] if condition == "C1" else []
    return [*tiny_arguments(), *extra, f"--results={folder}"]


@pytest.fixture(scope="module")
def whole_runs(tiny_results, tmp_path_factory):
    """{condition: (results folder, record)} of tiny runs by the command line, never stopped."""
    runs = {}
    for condition in ("C0", "C1"):
        folder = tmp_path_factory.mktemp("whole") / "results"
        shutil.copytree(tiny_results, folder)
        assert cli.main(arguments(condition, folder)) == 0
        (record,) = find_records(folder / "runs", condition=condition)
        runs[condition] = folder, record
    return runs


@pytest.mark.parametrize("condition, where", [("C0", "write"), ("C1", "step")])
def test_a_run_that_was_killed_goes_on_to_the_same_record(
    condition, where, whole_runs, tiny_results, tmp_path
):
    folder = tmp_path / "results"
    shutil.copytree(tiny_results, folder)
    command = [sys.executable, "-c", KILLED, where, *arguments(condition, folder)]
    killed = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=600)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not list((folder / "runs").iterdir())
    # A dot file is what the kill left of the one being written.
    (checkpoint,) = (folder / "checkpoints").glob("[!.]*.pt")
    assert cli.main(arguments(condition, folder)) == 0
    assert not checkpoint.exists()

    whole_folder, expected = whole_runs[condition]
    (record,) = find_records(folder / "runs")
    assert expected["resumed_at"] is None and record["resumed_at"] == 30
    assert same_run(record, expected)
    assert record["tails"]["steps"] == [20, 30, 60] and len(record["losses"]["loss"]) == STEPS
    if condition == "C1":
        refreshed = [entry["step"] for entry in record["topology"] if entry["event"] == "refresh"]
        assert refreshed[:3] == [14, 21, 31]
    (first,), (second,) = ((where / "soups").iterdir() for where in (folder, whole_folder))
    assert first.name == second.name
    pairs = zip(load_soup(first).tensors(), load_soup(second).tensors(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)


def test_two_equal_runs_at_once_train_once(tiny_results, tmp_path, monkeypatch):
    shutil.copytree(tiny_results, tmp_path / "r")
    trained, waits, records = [], threading.Event(), []

    def make(tell):
        records.append(run(tiny_config(), results=tmp_path / "r", tell=tell))

    second = threading.Thread(target=make, args=[lambda text: waits.set() if "waiting" in text else None])

    def slow(*arguments, **options):
        trained.append(0)
        if len(trained) == 1:
            second.start()
            assert waits.wait(60), "the second run does not wait for the first"
        return train(*arguments, **options)

    monkeypatch.setattr("paper_artifact.pipeline.train", slow)
    make(print)
    second.join()
    assert len(trained) == 1 and records[0] == records[1]
    assert not list((tmp_path / "r" / "checkpoints").iterdir())


def test_a_checkpoint_that_is_damaged_or_of_another_run_is_refused(tiny_scene, tmp_path):
    path, config = tmp_path / "run.pt", tiny_config(steps=12)
    train(tiny_scene, config, checkpoint=path, device="cpu")
    data = path.read_bytes()
    backend = backend_for("cpu", tiny_scene, tiny_scene.train)
    assert resumed_state(path, config, None, backend).step == 10
    assert resumed_state(tmp_path / "none.pt", config, None, backend) is None
    assert b"steps" in data and b"opacity_lr" not in data  # defaults are not in it: a new field orphans none

    with pytest.raises(InputError, match="belongs to another configuration"):
        train(tiny_scene, tiny_config(steps=12, seed=5), checkpoint=path, device="cpu")
    _, _, content = data.partition(b"\n")  # as a version without a digest wrote it
    for bad in (data[: len(data) // 2], b"", b"no checkpoint at all", content):
        path.write_bytes(bad)
        with pytest.raises(InputError, match="run.pt is damaged .*digest"):
            train(tiny_scene, config, checkpoint=path, device="cpu")
    saved, forged = torch.load(io.BytesIO(content), weights_only=True), io.BytesIO()
    torch.save(saved | {"step": 13}, forged)
    path.write_bytes(_seal(forged.getvalue()) + forged.getvalue())
    with pytest.raises(InputError, match="run.pt is damaged .*it is of step 13 of 12"):
        resumed_state(path, config, None, backend)
    soup = saved["soup"]
    for change in (
        {"losses": saved["losses"][:-1]},
        {"losses": ["a"] * 10},
        {"losses": 5},
        {"dumps": [{"step": 40}]},
        {"dumps": [3]},
        {"resamplings": [{}]},
        {"seconds": {"photometric": "long"}},
        {"seconds": [1.0]},
        {"step": 10.0},
        {"soup": [soup[0][:-1], *soup[1:]]},
        {"soup": [soup[0].double(), *soup[1:]]},
        {"soup": [soup[0] * float("nan"), *soup[1:]]},
        {"soup": []},
        {"mlp_moments": {}},
    ):
        torch.save(saved | change, forged := io.BytesIO())
        path.write_bytes(_seal(forged.getvalue()) + forged.getvalue())
        with pytest.raises(InputError, match="run.pt is damaged .*; delete it to start the run anew"):
            train(tiny_scene, config, checkpoint=path, device="cpu")
    draws = stream(0, "flipped bits")
    for place in [0, len(SEAL), *draws.integers(0, len(data), 60).tolist()]:
        path.write_bytes(data[:place] + bytes([data[place] ^ 1 << draws.integers(8)]) + data[place + 1 :])
        with pytest.raises(InputError, match="run.pt is damaged .*delete it to start the run anew"):
            resumed_state(path, config, None, backend)


def test_a_checkpoint_whose_dumps_no_run_leaves_makes_no_record(tiny_results, tmp_path):
    folder = tmp_path / "results"
    shutil.copytree(tiny_results, folder)
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, "step", *arguments("C0", folder)], cwd=REPOSITORY, capture_output=True
    )
    assert killed.returncode == -signal.SIGKILL
    (path,) = (folder / "checkpoints").glob("[!.]*.pt")
    saved = torch.load(io.BytesIO(path.read_bytes().partition(b"\n")[2]), weights_only=True)
    saved["dumps"][0]["counts"] = ["many"]
    torch.save(saved, forged := io.BytesIO())
    path.write_bytes(_seal(forged.getvalue()) + forged.getvalue())
    with pytest.raises(InputError, match=r"has no dumps\[0\].* as a run leaves it; delete it to start"):
        run(tiny_config(), results=folder, device="cpu")
    assert not list((folder / "runs").iterdir())
