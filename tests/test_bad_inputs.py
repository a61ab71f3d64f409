"""What a user may get wrong, through the command line.

Wanted: exit code 1, or 2 where the arguments alone are wrong, one line on stderr that says what is wrong and
what to do, no trace, folders as before.
"""

from __future__ import annotations

import functools
import shlex
import sys

import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.errors import InputError
from paper_artifact.mesh import mesh_hash
from paper_artifact.record.store import make_record, write_record
from paper_artifact.scene.fetch import fetch
from paper_artifact.scene.shapes import make_shape
from tests.tiny_run import tiny_arguments, tiny_config

pytestmark = pytest.mark.faults


@pytest.fixture
def refused(tmp_path, capsys):
    """refused(arguments, *words, code=1): run the command, check the refusal described above."""

    def tree() -> dict:
        found = tmp_path.rglob("*")
        return {path.relative_to(tmp_path): path.read_bytes() if path.is_file() else None for path in found}

    def check(arguments, *words: str, code: int = 1) -> None:
        before = tree()
        capsys.readouterr()
        assert cli.main([str(argument) for argument in arguments]) == code
        out, error = capsys.readouterr()
        assert error.startswith("paper_artifact: ") and error.endswith("\n"), error
        assert len(error.splitlines()) == 1 and "Traceback" not in error and out == ""
        for word in words:
            assert word in error
        assert tree() == before

    return check


# Every row: nothing is looked at, let alone built, before it is refused.
TRAIN = [
    ("sphere_", "unknown shape 'sphere_'"),
    ("sphere --condition C99", "C99"),
    ("sphere --steps -5", "steps must be at least 1 and at most 1e+09, got -5"),
    ("sphere --steps 99999999999999999", "steps must be at least 1 and at most 1e+09"),
    ("sphere --steps 1" + "0" * 400, "steps must be at least 1 and at most 1e+09"),
    ("sphere --set=views=10001", "views must be at least 2 and at most 10000"),
    ("sphere --set=size=8193", "size must be at least 22 and at most 8192 pixels"),
    ("sphere --threads=0", "--threads must be at least 1"),
    ("sphere --set=budget=many", "budget takes a value of kind int, got 'many'"),
    ("sphere --set=budget=" + "1+" * 20_000 + "1", "'1+1+1+"),
    ("sphere --set=budget=" + "-" * 100_000 + "1", "'-----"),
    ("sphere --set=vertex_lr=1e999", "vertex_lr takes a value of kind float, got inf"),
    ("sphere --set=dump_steps=(5,9999)", "dump_steps must be a tuple of steps in 1"),
    ("sphere --set=steps=5", "steps has an argument of its own"),
    ("sphere --set=loss=5", "loss has an argument of its own"),
    ("sphere --set=allocation=5", "allocation has an argument of its own or is the condition's"),
    ("sphere --set=budget={[1]:2}", "budget: '{[1]:2}' is no number, text or list of these"),
    ("sphere --set budget", "--set takes NAME=VALUE"),
    ("sphere --loss rho=0.2", "condition C0 has no loss, so it takes no loss settings (rho)"),
    ("sphere --condition C1 --loss rho", "--loss takes NAME=VALUE, got 'rho'"),
    ("sphere --condition C1 --loss samples=2e3", "samples takes a value of kind int, got 2000.0"),
    ("sphere --condition C1 --loss ramp=(0.5,0.2)", "ramp must be two fractions 0 <= start < end <= 1"),
]
OTHERS = [
    ("scene --shape spher --out out", "unknown shape 'spher'; choose one of sphere, cube"),
    ("scene --shape sphere --views -8 --out out", "views must be a whole number from 2"),
    ("fetch spott --out out", "no mesh is called 'spott'"),
    ("sweep nope --list", "unknown study 'nope'; choose one of baseline"),
    ("sweep none.obj --steps=9", "unknown study 'none.obj'; choose one of baseline"),
    ("sweep table1 --steps=9", "--steps, --betti and --set go with a mesh or --scene"),
    ("sweep sphere --shape=torus", "--shape restricts a study; with a mesh or --scene leave it out"),
    ("sweep sphere --betti=1,0,1", "--betti is for T1 to T3, not C0; add --condition T3"),
    ("sweep sphere --set=allocation=1", "allocation has an argument of its own"),
    ("sweep table1 --shape spot --list", "has no shape spot; choose among sphere"),
    ("sweep table1 --condition C9 --list", "has no condition C9; choose among C0"),
    ("sweep table1 --seed 99 --list", "has no seed 99; choose among 0"),
    ("sweep table1 --executor dask --list", "belong together; give both or neither"),
    ("certify sphere --out a.ply", "--out has a meaning with --fill or --cut alone"),
    ("export none.npz --out out", "no soup at"),
    ("export text.npz --out out", "not a readable soup"),
    ("evaluate none.npz --target sphere", "no file at"),
    ("evaluate text.npz --target sphere", "not a readable soup"),
]


@pytest.mark.parametrize("command, words", [*((f"train {text}", words) for text, words in TRAIN), *OTHERS])
def test_values_that_make_no_sense(command, words, refused, tmp_path, monkeypatch):
    (tmp_path / "text.npz").write_text("no archive")
    monkeypatch.chdir(tmp_path)
    if words not in (row[1] for row in TRAIN[:1]):  # calling these would fail
        monkeypatch.setattr("paper_artifact.scene.given.find_mesh", None)
        monkeypatch.setattr("paper_artifact.pipeline.prepare_scene", None)
    results = ["--results", "results"] if command.startswith(("train", "sweep")) else []
    looked_at = ("unknown shape", "no soup at", "no file at", "not a readable")
    code = 1 if words.startswith(looked_at) else 2
    refused([*shlex.split(command), *results, "--quiet"], words, code=code)


def test_a_loss_whose_target_has_no_bar(refused, tmp_path):
    arguments = [
        *tiny_arguments(),
        "--condition=C1",
        "--loss=dimensions=0",
        "--results",
        tmp_path / "results",
    ]
    refused(arguments, "no significant bar in dimension 0")


def test_an_output_folder_that_cannot_be_written(refused, tmp_path, capsys, monkeypatch):
    """Below a regular file nobody can write, root included (whom permissions do not stop)."""
    (tmp_path / "file").write_text("mine")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.obj")
    below, scene = tmp_path / "file" / "below", ["scene", "--mesh", tmp_path / "ball.obj", "--quiet", "--out"]
    for folder in (below, tmp_path / "file"):
        refused([*tiny_arguments(), "--results", folder], "cannot write", str(folder), "choose a folder")
    refused([*scene, below], "cannot write", "choose a folder")
    refused([*scene, tmp_path / "file"], "choose another folder")
    # and no dead progress bar is left above the error
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    arguments = [each for each in tiny_arguments() if each != "--quiet"]
    assert cli.main([*arguments, "--results", str(tmp_path / "file")]) == 1
    error = capsys.readouterr().err
    assert "preparing scene and kernels" in error, "there was a bar"
    assert error.count("\n") == 1 and error.split("\r")[-1].startswith("paper_artifact: cannot write")


def test_a_mirror_without_the_file(tmp_path, monkeypatch, refused, capsys):
    (tmp_path / "mirror").mkdir()
    mirror, out = str(tmp_path / "mirror"), str(tmp_path / "out")
    monkeypatch.delenv("PAPER_ARTIFACT_MIRROR", raising=False)
    # `fetch` goes on with the other meshes, so each failure has its line and the sum is the last one.
    assert cli.main(["fetch", "spot", "--quiet", "--mirror", mirror, "--out", out]) == 1
    printed, error = capsys.readouterr()
    first, last = error.splitlines()
    assert printed == "" and last == "paper_artifact: 1 of 1 meshes could not be fetched"
    assert first.startswith("spot: the mirror ") and "has no readable" in first and "add the file" in first
    assert not (tmp_path / "out").exists()

    elsewhere = functools.partial(fetch, downloads=tmp_path / "downloads", quiet=True)
    monkeypatch.setattr("paper_artifact.scene.shapes.mesh_path", lambda key: elsewhere(key).path)
    for folder, words in ((mirror, "has no readable"), (str(tmp_path / "nowhere"), "is no folder")):
        monkeypatch.setenv("PAPER_ARTIFACT_MIRROR", folder)
        refused(["train", "spot", "--quiet", "--results", tmp_path / "results"], words)


def test_a_record_that_is_not_one(refused, tmp_path):
    """How else a record is refused: test_record."""
    mesh = make_shape("sphere")
    sections = {"images": {"psnr": 20.0, "ssim": 0.5}, "soup": {"triangles": 1}, "cpu_seconds": 1.0}
    sections["mesh"] = {"name": mesh.name, "sha256": mesh_hash(mesh), "dimension": 2}
    record = make_record(tiny_config(), [], {}, {"photometric": 1.0}, **sections)
    path = write_record(record, tmp_path / "results" / "runs")
    arguments = [*tiny_arguments(), "--results", str(tmp_path / "results")]
    assert cli.main(arguments) == 0  # whole, it is taken for the run
    path.write_text(path.read_text()[:1000])
    refused(arguments, str(path), "damaged or cut off", "delete it and run again")


def test_a_name_that_is_too_long_is_one_sentence_in_python_too():
    from paper_artifact.scene.load import load_scene
    from paper_artifact.scene.shapes import find_mesh
    from paper_artifact.soup.state import load_soup

    for read in (load_scene, find_mesh, load_soup):
        for name in ("x" * 300, "x" * 300 + ".obj"):
            with pytest.raises(InputError):
                read(name)
