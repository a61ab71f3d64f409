"""What a user may get wrong, through the command line: `refused` of conftest.py says what is wanted.

What a mesh file can be: test_odd_meshes.
"""

import functools
import re
import sys
from dataclasses import replace

import pytest
import torch

from paper_artifact import cli
from paper_artifact.errors import InputError
from paper_artifact.mesh import mesh_hash
from paper_artifact.record.store import write_record
from paper_artifact.scene.fetch import fetch
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import load_soup, save_soup
from tests.tiny_run import bare_record, tiny_arguments, tiny_config

pytestmark = pytest.mark.faults
TINY_RUN = " ".join(tiny_arguments())
C1 = "train sphere --condition C1 --loss"


@pytest.mark.parametrize(
    "line, words",
    [
        ("train sphere --condition C99", "C99"),
        ("train sphere --steps -5", "steps must be at least 1 and at most 1e+09, got -5"),
        ("train sphere --steps 1" + "0" * 400, "steps must be at least 1 and at most 1e+09"),
        ("train sphere --set=size=8193", "size must be at least 22 and at most 8192 pixels"),
        ("train sphere --threads=0", "--threads must be at least 1"),
        ("train sphere --set=budget=many", "budget takes a value of kind int, got 'many'"),
        ("train sphere --set=budget=" + "1+" * 20_000 + "1", "'1+1+1+"),
        ("train sphere --set=budget=" + "-" * 100_000 + "1", "'-----"),
        ("train sphere --set=dump_steps=(5,9999)", "dump_steps must be a tuple of steps in 1"),
        ("train sphere --set=steps=5", "steps has an argument of its own"),
        ("train sphere --set=loss=5", "loss has an argument of its own"),
        ("train sphere --set=allocation=5", "allocation has an argument of its own or is the condition's"),
        ("train sphere --set=budget=1_0", "budget: '1_0' is no number, text or list of these"),
        ("train sphere --set=budget={[1]:2}", "budget: '{[1]:2}' is no number, text or list of these"),
        ("train sphere --set budget", "--set takes NAME=VALUE"),
        ("train sphere --loss rho=0.2", "condition C0 has no loss, so it takes no loss settings (rho)"),
        (f"{C1} rho", "--loss takes NAME=VALUE, got 'rho'"),
        (f"{C1} samples=2e3", "samples takes a value of kind int, got 2000.0"),
        (f"{C1} noise=1e300", "noise must be at least 0 and at most 1"),
        ("train sphere --condition T1 --loss pull=1e300", "pull must be at least 0 and at most 1e+06"),
        ("scene --shape sphere --views -8 --out out", "views must be a whole number from 2"),
        ("fetch nope --out out", "no mesh is called 'nope'; known are ogre, …"),
        ("fetch spott --out out", "no mesh is called 'spott'; known are spot"),
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
        ("book --runs nowhere --out b", "--runs nowhere is no folder that can be read"),
        ("certify sphere --out a.ply", "--out has a meaning with --fill or --cut alone"),
        ("audit sphere --out out --densities 4", "--densities must be at least"),
        ("audit sphere --out out --seeds 0", "--seeds must be at least"),
        ("audit sphere --out out --seed -1", "--seed must be at least"),
        ("ingest ball.ply --out x.ply --offset nan", "the offset must be in (0, 0.25]"),
        ("ingest ball.ply --out x.ply --cells 0", "at least one grid cell"),
        # an output that would replace an input or another output
        ("certify ball.ply --json ball.ply", "mesh and --json are both ball.ply, which would be lost"),
        ("certify link.ply --json ./notebooks/../ball.ply", "mesh and --json are both"),
        ("ingest ball.ply --out ball.ply", "raw and --out are both"),
        ("ingest ball.ply --out x.ply --json x.ply", "are both x.ply"),
        ("ingest ball.ply --out=--", "--out=-- gives no value"),
        ("train ball.ply --loss=--", "--loss=-- gives no value"),
        ("solidify ball.ply --out ball.ply", "soup and --out are both"),
        ("solidify soup.npz --out ball.ply --target ball.ply", "--target and --out are both"),
        ("evaluate ball.ply --target sphere --json ball.ply", "surface and --json are both"),
        ("run-all --notebooks notebooks --out notebooks", "--out and --notebooks are both notebooks"),
        ("export ball.npz --out . --target ball.ply", "--target ball.ply would be lost"),
    ],
)
def test_wrong_usage_is_said_before_anything_is_looked_at(line, words, folder, refused, monkeypatch):
    for name in ("scene.given.find_mesh", "pipeline.prepare_scene"):  # calling them would fail
        monkeypatch.setattr(f"paper_artifact.{name}", None)
    refused(line + " --results r" * line.startswith(("train", "sweep")), words, code=2)


@pytest.mark.parametrize(
    "line, words",
    [
        ("train sphere_ --results r", "unknown shape 'sphere_'"),
        ("scene --shape spher --out out", "unknown shape 'spher'; choose one of sphere, cube"),
        ("export none.npz --out out", "no soup at"),
        ("export text.npz --out out", "not a readable soup"),
        ("export far.npz --out o", "too large or not finite"),
        ("evaluate none.npz --target sphere", "no file at"),
        ("evaluate text.npz --target sphere", "not a readable soup"),
        ("solidify ball.ply --out ball.ply/x.ply", "cannot write ball.ply/x.ply"),
        ("ingest ball.ply --out ball.ply/x.ply", "cannot write ball.ply/x.ply"),
        ("certify ball.ply --json notebooks", "cannot write notebooks: it is a folder"),
        ("ingest ball.ply --out x.ply --offset 1e-12", "take a larger offset or fewer cells"),
        (f"{TINY_RUN} --condition=C1 --loss=dimensions=0 --results r", "no significant bar in dimension 0"),
    ],
)
def test_a_failure_is_said_before_anything_is_written(line, words, folder, refused):
    (folder / "text.npz").write_text("no archive")
    soup = load_soup(folder / "ball.npz")
    save_soup(folder / "far.npz", replace(soup, vertices=torch.eye(3)[None] * 1e37))
    refused(line, words)


@pytest.mark.parametrize(
    "line, words",
    [
        (f"{C1} samples=200000000 --results r", "diagram of 200000000 samples"),
        ("train sphere --condition B2 --set samples=200000000 --results r", "diagram of 200000000 samples"),
        ("evaluate ball.ply --target sphere --samples 200000000", "diagram of 200000000 samples"),
        ("audit ball.ply --densities 64 200000000 --out .", "diagram of 200000000 samples"),
        (
            "export ball.npz --views 100000 --size 4096 --formats png --out o",
            "100000 views of 4096×4096 pixels",
        ),
    ],
)
def test_what_takes_more_memory_than_there_is_is_refused_with_the_amount(line, words, folder, refused):
    amount = " takes at least [^ ]+ GiB of memory, .* GiB are available; "
    assert re.search(words + amount, refused(line))


def test_an_output_folder_that_cannot_be_written(refused, folder, capsys, monkeypatch):
    """Below a regular file nobody can write, root included (whom permissions do not stop)."""
    for place in ("ball.npz/below", "ball.npz"):
        refused(f"{TINY_RUN} --results {place}", "cannot write", place, "choose a folder")
    refused("scene --mesh ball.ply --out ball.npz", "choose another folder")  # below it: test_odd_meshes
    # and no dead progress bar is left above the error
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    arguments = [each for each in tiny_arguments() if each != "--quiet"]
    assert cli.main([*arguments, "--results", "ball.npz"]) == 1
    error = capsys.readouterr().err
    assert "preparing scene and kernels" in error, "there was a bar"
    assert error.count("\n") == 1 and error.split("\r")[-1].startswith("paper_artifact: cannot write")


def test_a_mirror_without_the_file(folder, monkeypatch, refused):
    """What the verb fetch says of it: test_fetch."""
    elsewhere = functools.partial(fetch, downloads=folder / "downloads", quiet=True)
    monkeypatch.setattr("paper_artifact.scene.shapes.mesh_path", lambda key: elsewhere(key).path)
    for name, words in (("notebooks", "has no readable"), ("nowhere", "is no folder")):
        monkeypatch.setenv("PAPER_ARTIFACT_MIRROR", name)
        refused("train spot --results r", words)


def test_a_record_that_is_not_one(refused, command, folder):
    """How else a record is refused: test_record."""
    mesh = make_shape("sphere")
    truth = {"name": mesh.name, "sha256": mesh_hash(mesh), "dimension": 2}
    path = write_record(bare_record(tiny_config(), mesh=truth), folder / "r" / "runs")
    command(f"{TINY_RUN} --results r")  # whole, it is taken for the run
    path.write_text(path.read_text()[:1000])
    refused(f"{TINY_RUN} --results r", path.name, "damaged or cut off", "delete it and run again")


def test_a_name_that_is_too_long_is_one_sentence_in_python_too():
    from paper_artifact.scene.load import load_scene
    from paper_artifact.scene.shapes import find_mesh

    for read in (load_scene, find_mesh, load_soup):
        for name in ("x" * 300, "x" * 300 + ".obj"):
            with pytest.raises(InputError):
                read(name)
