"""What a user may get wrong, through the command line.

Wanted: exit code 1, one line on stderr that says what is wrong and what to do, no trace, and the folders as
they were before.
"""

from __future__ import annotations

import functools
import json
import shutil

import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.mesh import mesh_hash
from paper_artifact.pipeline import run
from paper_artifact.record.store import make_record, write_record
from paper_artifact.scene.shapes import make_shape
from tests.tiny_run import tiny_arguments, tiny_config


@pytest.fixture
def refused(tmp_path, capsys):
    """refused(arguments, *words): run the command, check the refusal described above, return the line."""

    def tree() -> dict:
        return {
            path.relative_to(tmp_path): path.read_bytes() if path.is_file() else None
            for path in tmp_path.rglob("*")
        }

    def check(arguments, *words: str) -> str:
        before = tree()
        capsys.readouterr()
        assert cli.main([str(argument) for argument in arguments]) == 1
        out, error = capsys.readouterr()
        assert (
            error.startswith("paper_artifact: ") and error.endswith("\n") and len(error.splitlines()) == 1
        ), error
        assert "Traceback" not in error and out == ""
        for word in words:
            assert word in error
        assert tree() == before
        return error

    return check


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
MESHES = {
    "empty.obj": ("", "empty"),
    "vertices_only.obj": (SQUARE, "no triangles"),
    "nan.obj": (SQUARE + "v nan 0 1\nf 1 2 3\nf 3 4 5\n", "1 vertices with NaN"),
    "flat.obj": (SQUARE + "v 2 0 0\nv 3 0 0\nf 1 2 5\nf 2 5 6\nf 1 1 2\n", "only triangles of zero area"),
    "index.obj": (SQUARE + "f 1 2 9\n", "index 8 is out of bounds"),
    "prose.obj": ("It was a dark and stormy night.\n", "no triangles"),
    "prose.ply": ("It was a dark and stormy night.\n", "no PLY mesh"),
    "empty.stl": ("", "empty"),
    "notes.txt": ("It was a dark and stormy night.\n", "no mesh format"),
}


@pytest.mark.parametrize("verb", ["train", "scene"])
@pytest.mark.parametrize("name", MESHES)
def test_meshes_that_cannot_be_used(verb, name, refused, tmp_path):
    content, words = MESHES[name]
    file = tmp_path / name
    file.write_text(content)
    given = ["train", file, "--results"] if verb == "train" else ["scene", "--mesh", file, "--out"]
    refused([*given, tmp_path / "out", "--quiet"], name, words)


def test_a_mesh_cut_in_half(refused, tmp_path):
    file = tmp_path / "ball.ply"
    trimesh.creation.icosphere(subdivisions=2).export(file)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    refused(["train", file, "--quiet", "--results", tmp_path / "results"], "ball.ply")


def test_a_missing_mesh_and_a_folder(refused, tmp_path):
    refused(["train", tmp_path / "none.obj", "--quiet", "--results", tmp_path / "results"], "no mesh file at")
    (tmp_path / "folder.obj").mkdir()
    refused(
        ["train", tmp_path / "folder.obj", "--quiet", "--results", tmp_path / "results"], "no mesh file at"
    )


def test_unknown_names(refused, tmp_path):
    results = ["--quiet", "--results", tmp_path / "results"]
    refused(["train", "sphere_", *results], "unknown shape 'sphere_'", "sphere, cube")
    refused(
        ["scene", "--shape", "spher", "--out", tmp_path / "out", "--quiet"],
        "unknown shape 'spher'",
        "sphere, cube",
    )
    refused(["fetch", "spott", "--quiet", "--out", tmp_path / "out"], "no mesh is called 'spott'", "spot")
    refused(["train", "sphere", "--condition", "C99", *results], "C99", "C1")
    refused(["train", "sphere", "--device", "tpu", *results], "unknown device 'tpu'")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--steps", "-5"], "steps must be at least 1, got -5"),
        (["--steps=0"], "steps must be at least 1"),
        (["--seed=-1"], "seed must be at least 0"),
        (["--threads=0"], "--threads must be at least 1"),
        (["--set=budget=0"], "budget must be at least 1"),
        (["--set=budget=many"], "budget takes a value of kind int, got 'many'"),
        (["--set=budget=2.5"], "budget takes a value of kind int, got 2.5"),
        (["--set=views=1"], "views must be at least 2"),
        (["--set=size=9"], "at least 22 pixels"),
        (["--set=vertex_lr=-1"], "vertex_lr must be positive"),
        (["--set=vertex_lr=1e999"], "vertex_lr takes a value of kind float, got inf"),
        (["--set=dump_steps=5.5"], "dump_steps takes a value of kind tuple"),
        (["--set=dump_steps=(5,9999)"], "dump_steps must be a tuple of steps in 1"),
        (["--set=topology=5"], "unknown setting topology; choose among shape"),
        (["--set=background=grey"], "unknown background 'grey'; choose one of white, black"),
        (["--set=colour=red"], "unknown setting colour; choose among shape"),
        (["--set=steps=5"], "steps has an argument of its own"),
        (["--set=shape=cube"], "shape has an argument of its own"),
        (["--set=loss=5"], "loss has an argument of its own"),
        (["--set", "budget"], "--set takes NAME=VALUE"),
    ],
)
def test_numbers_out_of_range(arguments, words, refused, tmp_path):
    refused(["train", "sphere", "--quiet", *arguments, "--results", tmp_path / "results"], words)


@pytest.mark.parametrize(
    "setting, words",
    [
        ("lambda=0.2", "unknown setting lambda; choose among kind, rho, ramp"),
        ("rho", "--loss takes NAME=VALUE, got 'rho'"),
        ("rho=many", "rho takes a value of kind float, got 'many'"),
        ("rho=0", "rho must be positive and finite, got 0"),
        ("rho=-0.1", "rho must be positive and finite, got -0.1"),
        ("samples=2", "samples must be at least 4, got 2"),
        ("samples=2e3", "samples takes a value of kind int, got 2000.0"),
        ("dimensions=3", "dimensions must be some of 0, 1, 2, or None"),
        ("dimensions=()", "dimensions must be some of 0, 1, 2, or None"),
        ("ramp=(0.5,0.2)", "ramp must be two fractions 0 <= start < end <= 1"),
        ("noise=-1.0", "noise must not be negative, got -1.0"),
        ("refresh_every=0", "refresh_every must be at least 1 in a run, got 0"),
        ("kind=homology", "unknown loss kind 'homology'; choose one of topology, repulsion"),
        ("fallback=skip", "unknown Gabriel fallback 'skip'; choose one of detach"),
        ("recruitment=3", "recruitment takes a value of kind bool, got 3"),
    ],
)
def test_loss_settings_are_refused_before_anything_is_made(setting, words, refused, tmp_path, monkeypatch):
    """Unknown names and values out of range: neither mesh nor scene is looked at, let alone built."""
    monkeypatch.setattr("paper_artifact.scene.given.find_mesh", None)  # calling it would fail
    options = ["--quiet", "--condition", "C1", "--results", tmp_path / "results"]
    refused(["train", "sphere", *options, "--loss", setting], words)


def test_a_loss_that_has_nothing_to_act_on(refused, tmp_path):
    arguments = [*tiny_arguments(), "--results", tmp_path / "results"]
    refused([*arguments, "--loss=rho=0.2"], "condition C0 has no loss, so it takes no loss settings (rho)")
    refused([*arguments, "--condition=C1", "--loss=dimensions=0"], "no significant bar in dimension 0")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["nope"], "unknown study 'nope'; choose one of baseline"),
        (["table1", "--shape", "spot"], "has no shape spot; choose among sphere"),
        (["table1", "--condition", "C9"], "has no condition C9; choose among C0"),
        (["table1", "--seed", "99"], "has no seed 99; choose among 0"),
        (["table1", "--executor", "dask"], "belong together; give both or neither"),
    ],
)
def test_sweeps_that_are_no_study(arguments, words, refused, tmp_path):
    refused(["sweep", *arguments, "--list", "--results", tmp_path / "results"], words)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--views", "-8"], "views must be a whole number from 2"),
        (["--size", "0"], "size must be a whole number"),
        (["--points", "3"], "points must be a whole number from 4"),
        (["--seed", "-1"], "seed must be a whole number"),
    ],
)
def test_scene_numbers_out_of_range(arguments, words, refused, tmp_path):
    refused(["scene", "--shape", "sphere", "--quiet", *arguments, "--out", tmp_path / "out"], words)


def test_an_output_folder_that_cannot_be_written(refused, tmp_path):
    # Below a regular file nobody can write, root included (whom permissions do not stop).
    (tmp_path / "file").write_text("mine")
    (tmp_path / "ball.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    below = tmp_path / "file" / "below"
    for folder in (below, tmp_path / "file"):
        refused([*tiny_arguments(), "--results", folder], "cannot write", str(folder), "choose a folder")
    refused(
        ["scene", "--mesh", tmp_path / "ball.obj", "--quiet", "--out", below],
        "cannot write",
        "choose a folder",
    )
    refused(
        ["scene", "--mesh", tmp_path / "ball.obj", "--quiet", "--out", tmp_path / "file"],
        "choose another folder",
    )


def test_a_mirror_without_the_file(tmp_path, monkeypatch, refused, capsys):
    (tmp_path / "mirror").mkdir()
    monkeypatch.delenv("PAPER_ARTIFACT_MIRROR", raising=False)
    # `fetch` goes on with the other meshes, so each failure has its line and the sum is the last one.
    assert (
        cli.main(
            ["fetch", "spot", "--quiet", "--mirror", str(tmp_path / "mirror"), "--out", str(tmp_path / "out")]
        )
        == 1
    )
    out, error = capsys.readouterr()
    lines = error.splitlines()
    assert out == "" and len(lines) == 2 and lines[1] == "paper_artifact: 1 of 1 meshes could not be fetched"
    assert (
        lines[0].startswith("spot: the mirror ")
        and "has no readable" in lines[0]
        and "add the file" in lines[0]
    )
    assert not (tmp_path / "out").exists()

    from paper_artifact.scene import find

    monkeypatch.setattr(
        find, "mesh_path", functools.partial(find.mesh_path, downloads=tmp_path / "downloads")
    )
    monkeypatch.setenv("PAPER_ARTIFACT_MIRROR", str(tmp_path / "mirror"))
    refused(["train", "spot", "--quiet", "--results", tmp_path / "results"], "has no readable", "for 'spot'")
    monkeypatch.setenv("PAPER_ARTIFACT_MIRROR", str(tmp_path / "nowhere"))
    refused(["train", "spot", "--quiet", "--results", tmp_path / "results"], "is no folder")


def test_no_dead_progress_bar_stands_above_an_error(tmp_path, capsys):
    (tmp_path / "results").write_text("a file, no folder")
    arguments = [each for each in tiny_arguments() if each != "--quiet"]
    assert cli.main([*arguments, "--results", str(tmp_path / "results")]) == 1
    error = capsys.readouterr().err
    assert "0/60" in error, "there was a bar"
    assert error.count("\n") == 1 and error.split("\r")[-1].startswith("paper_artifact: cannot write")


def recorded(results, config, mesh):
    """Write a record as a finished run leaves it and return its path."""
    sections = {
        "images": {"psnr": 20.0, "ssim": 0.5},
        "soup": {"triangles": 1},
        "cpu_seconds": 1.0,
        "mesh": {"name": mesh.name, "sha256": mesh_hash(mesh), "dimension": 2},
    }
    return write_record(make_record(config, [], {}, {"photometric": 1.0}, **sections), results / "runs")


def test_a_record_cut_in_half(refused, tmp_path):
    mesh = make_shape("sphere")
    path = recorded(tmp_path / "results", tiny_config(), mesh)
    arguments = [*tiny_arguments(), "--results", str(tmp_path / "results")]
    assert cli.main(arguments) == 0  # whole, it is taken for the run
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    refused(arguments, str(path), "damaged or cut off", "delete it and run again")
    path.write_text("{}")
    refused(arguments, str(path), "no run record")


def test_a_record_of_another_version(refused, tmp_path):
    path = recorded(tmp_path / "results", tiny_config(), make_shape("sphere"))
    arguments = [*tiny_arguments(), "--results", str(tmp_path / "results")]
    written = json.loads(path.read_text())
    path.write_text(json.dumps(written | {"version": 1}))
    refused(arguments, str(path), "has version 1, this code reads 2; run it again")
    path.write_text(json.dumps(written | {"defaults": 99}))
    refused(arguments, str(path), "the defaults' version 99 is unknown to this code", "run it again")
    path.write_text(json.dumps(written | {"config": written["config"] | {"colour": "red"}}))
    refused(arguments, str(path), "unknown setting colour", "run it again")


def test_a_checkpoint_cut_in_half(refused, tiny_results, tmp_path):
    results = tmp_path / "results"
    shutil.copytree(tiny_results, results)

    def stop(step, text):
        if step == 15:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tiny_config(), results=results, progress=stop, device="cpu")
    (path,) = (results / "checkpoints").iterdir()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    refused(
        [*tiny_arguments(), "--results", results], str(path), "is damaged", "delete it to start the run anew"
    )


def test_a_scene_a_soup_and_a_target_that_are_not_there(refused, tmp_path):
    refused(["export", tmp_path / "none.npz", "--quiet", "--out", tmp_path / "out"], "no soup at")
    refused(["evaluate", tmp_path / "none.npz", "--quiet", "--target", "sphere"], "no file at")
    (tmp_path / "text.npz").write_text("no archive")
    refused(
        ["export", tmp_path / "text.npz", "--quiet", "--out", tmp_path / "out"],
        "not a readable soup",
        "no .npz archive",
    )
    refused(["evaluate", tmp_path / "text.npz", "--quiet", "--target", "sphere"], "not a readable soup")
