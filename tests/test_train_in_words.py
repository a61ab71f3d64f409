"""Training towards Betti numbers: without a mesh in its path, from the command line, and what is recorded."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.catalogue import study_config
from paper_artifact.cli.runs import audited, closing_notes
from paper_artifact.errors import InputError
from paper_artifact.pipeline import make_run_term
from paper_artifact.record.store import read_record, recorded_path
from paper_artifact.scene.load import load_scene
from paper_artifact.soup.state import load_soup, save_soup
from paper_artifact.train.loop import train
from tests.tiny_run import find_records, tiny_arguments, tiny_config


@pytest.fixture
def results(tiny_results, tmp_path):
    shutil.copytree(tiny_results, tmp_path / "results")
    return tmp_path / "results"


@pytest.mark.parametrize("samples", [512, "auto"])
def test_a_scene_without_its_mesh_is_trained(samples, results, monkeypatch):
    """No ground truth: its file is gone, and so is everything that could make a mesh or a bundle."""
    (folder,) = (results / "scenes").iterdir()
    (folder / "ground_truth.npz").unlink()
    monkeypatch.setattr("paper_artifact.scene.given.find_mesh", None)
    monkeypatch.setattr("paper_artifact.scene.shapes.find_mesh", None)
    monkeypatch.setattr("paper_artifact.pipeline.build_from_mesh", None)
    monkeypatch.setattr("paper_artifact.topology.bundle.build_from_mesh", None)
    scene = load_scene(folder)
    config = tiny_config(condition="T1", loss={"betti": (1, 0, 1), "samples": samples})
    term = make_run_term(config, None, scene.points)
    state = train(scene, config, term=term, device="cpu")
    events = [event["event"] for event in term.log]
    assert len(state.losses) == config.steps and np.isfinite(state.losses).all()
    assert events.count("lambda") == 1 and events.count("audit") == 1 and events.count("refresh") >= 5
    assert (events[0] == "density") == (samples == "auto")
    refreshed = {event["samples"] for event in term.log if event["event"] == "refresh"}
    assert refreshed == {2048 if samples == "auto" else 512}


def test_the_command_line_trains_in_words_and_records_them(results, capsys):
    arguments = [*tiny_arguments(), "--condition=T1", "--loss=samples=2048", "--betti=1,0,0"]
    arguments.append(f"--results={results}")
    assert cli.main(arguments) == 0
    printed = capsys.readouterr()
    for stream in printed:
        assert "you said no void; the images show 1 void" in stream
    assert "warning: you said" in printed.out and "step 14: you said" in printed.err
    (record,) = find_records(results / "runs")
    assert record["config"]["loss"]["betti"] == [1, 0, 0] and "bundle" not in record
    assert record["statement"]["betti"] == [1, 0, 0] and record["statement"]["samples"] == 2048
    # What is recorded is not run again; strict, it is an error all the same.
    assert cli.main([*arguments, "--strict"]) == 1
    assert "strict, and the record holds a warning: you said " in capsys.readouterr().err
    assert cli.main([*arguments, "--strict", "--again"]) == 1
    error = capsys.readouterr().err
    assert "strict, and at step 14 the images contradict the words" in error and len(error.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["sphere", "--condition=T1", "--betti=1,-2,1"], "b0 at least 1, got (1, -2, 1)"),
        (["sphere", "--condition=T2", "--betti=1,2.5,1"], "got (1, 2.5, 1)"),
        (["sphere", "--condition=T2", "--betti=one"], "got ('one',)"),
        (["sphere", "--condition=T1", "--betti=0,0,1"], "b0 at least 1"),
        (["sphere", "--condition=T1", "--betti=1,0,1", "--loss=betti=1,0,1"], "are one setting"),
        (["sphere", "--betti=1,0,1"], "condition C0 has no loss, so it takes no loss settings (betti)"),
        (["my.obj", "--condition=T1"], "needs the Betti numbers of 'my.obj': give --betti"),
    ],
)
def test_other_words_are_refused_before_anything_is_made(arguments, words, monkeypatch, capsys):
    monkeypatch.setattr("paper_artifact.scene.given.find_mesh", None)  # calling it would fail
    assert cli.main(["train", "--quiet", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error and len(error.splitlines()) == 1


def test_a_mesh_outside_the_study_gets_the_density_of_the_audits_rule(tmp_path, capsys):
    """A flat pebble's void is below the floor at M = 2048 and above it at 8192; a disc's is below at both."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    paths = []
    for name, height in (("pebble", 0.16), ("disc", 0.02)):
        paths.append(str(tmp_path / f"{name}.ply"))
        trimesh.Trimesh(sphere.vertices * [1, 1, height], sphere.faces).export(paths[-1])
    config = audited(study_config(paths[0], "C1"), ())
    assert (config.loss.samples, config.loss.dimensions) == (8192, (2,))
    assert "M = 8192 is the first working density" in capsys.readouterr().err
    for given in ({"samples": 4096}, {"dimensions": (1,)}):
        own = study_config(paths[0], "C1", loss=given)
        assert audited(own, given) is own
    for untouched in (study_config("sphere", "C1"), study_config(paths[0])):
        assert audited(untouched, ()) is untouched
    stated = study_config(paths[0], "T3", loss={"betti": (1, 0, 1)})
    assert audited(stated, ()).loss.samples == 0, "the cloud says, when the run starts"
    assert audited(stated, ["samples"]) is stated
    with pytest.raises(InputError, match="is measurable at M = 2048 or 8192: .* Train it with condition C0"):
        audited(study_config(paths[1], "C2"), ())


def test_a_run_tells_at_the_end_what_it_never_saw(capsys):
    """Of the committed runs: a sphere's loop, which never rose above the guard; a loss that could only
    suppress where nothing was to; and the horse's, which has all it was told."""

    def notes(**loss):
        return closing_notes(read_record(recorded_path(study_config("sphere", "T1", 0, loss=loss))))

    (unseen,) = notes(betti=(1, 1, 1))
    assert unseen.startswith("you said 1 loop; none so far: the next candidate has 0.") and "noise" in unseen
    (idle,) = notes(aim="none")
    assert idle == "the loss never acted: none of its plans had a bar to act on"
    assert cli.main(["train", "sphere", "--condition=T1", "--seed=0", "--loss=aim=none", "--quiet"]) == 0
    assert f"note, at the end: {idle}" in capsys.readouterr().out
    for condition in ("T1", "C1"):
        assert closing_notes(read_record(recorded_path(study_config("horse", condition, 0)))) == []


def test_a_run_made_again_replaces_nothing_that_somebody_changed(results):
    arguments = [*tiny_arguments(), f"--results={results}", "--again"]
    assert cli.main(arguments) == 0
    (soup,) = (results / "soups").glob("*.npz")
    record, whole = results / "runs" / f"{soup.stem}.json", soup.read_bytes()
    kept = load_soup(soup)
    save_soup(soup, replace(kept, vertices=kept.vertices + 1))
    changed = soup.read_bytes()
    assert cli.main(arguments) == 1 and soup.read_bytes() == changed
    soup.write_bytes(whole)
    noted = record.read_text().replace('"cpu_seconds"', '"note": "mine", "cpu_seconds"', 1)
    record.write_text(noted)
    assert cli.main(arguments) == 1 and record.read_text() == noted
    record.write_text("{")  # an edit that was cut off
    assert cli.main(arguments) == 1 and record.read_text() == "{"
    soup.write_bytes(b"damaged")
    record.unlink()
    assert cli.main(arguments) == 1 and soup.read_bytes() == b"damaged"
    soup.unlink()
    assert cli.main(arguments) == 0
