"""Bad and odd meshes through certify, audit, ingest, scene and train: a result, or one clear sentence and
exit code 1; never a trace, never a part of a file.
"""

import json
from pathlib import Path

import pytest

from paper_artifact import cli
from paper_artifact.audit import page
from tests import odd_meshes

VERBS = ("certify", "audit", "ingest", "scene")
OPTIONS = {
    "certify": "{mesh} --json {out}/certificate.json",
    "audit": "{mesh} --out {out} --densities 64 --working 128 --quiet",
    "ingest": "{mesh} --out {out}/shell.ply --offset 0.04 --cells 1.5 --quiet",
    "scene": "--mesh {mesh} --out {out}/scene --views 2 --size 32 --points 32 --supersample 1 --quiet",
    "train": "{mesh} --results {out} --quiet",
}


def arguments(verb: str, mesh: Path, out: Path) -> list[str]:
    return [verb, *(word.format(mesh=mesh, out=out) for word in OPTIONS[verb].split())]


EXPECTED = {
    "certify": ["certificate.json"],
    "audit": ["audit.html", "audit.json"],
    "ingest": ["shell.ply"],
    "scene": ["scene/scene.json"],
}


@pytest.fixture(autouse=True)
def no_drawing(monkeypatch):
    """Figures are made, but not drawn: drawing takes a second each and knows nothing of meshes."""
    monkeypatch.setattr(page, "_image", lambda *_, **__: ("", ""))


def check_refused(verb: str, mesh: Path, out: Path, capsys, words: str) -> None:
    assert cli.main(arguments(verb, mesh, out)) == 1
    printed, error = capsys.readouterr()
    assert printed == "" and error.startswith("paper_artifact: ") and len(error.splitlines()) == 1, error
    assert words in error and len(error) < 700
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.parametrize("verb", OPTIONS)
@pytest.mark.parametrize("name", odd_meshes.REFUSED)
def test_bad_files_are_refused(name, verb, tmp_path, capsys):
    content, words = odd_meshes.REFUSED[name]
    (tmp_path / name).write_bytes(content)
    check_refused(verb, tmp_path / name, tmp_path / "out", capsys, words)


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("name", odd_meshes.TAKEN)
def test_odd_files_give_a_result(name, verb, tmp_path, capsys):
    (tmp_path / name).write_bytes(odd_meshes.TAKEN[name])
    out = tmp_path / "out"
    if verb == "ingest" and name in odd_meshes.REFUSED_BY_INGEST:
        check_refused(verb, tmp_path / name, out, capsys, odd_meshes.REFUSED_BY_INGEST[name])
        return
    code = cli.main(arguments(verb, tmp_path / name, out))
    printed, error = capsys.readouterr()
    failed = verb == "certify" and "FAIL" in printed.splitlines()[0]
    assert code == int(failed) and error == "", error
    assert all((out / expected).is_file() for expected in EXPECTED[verb])
    assert not list(out.rglob(".paper_artifact-partial-*")) and printed.strip()
    for written in out.rglob("*.json"):
        json.loads(written.read_text())


@pytest.mark.parametrize("verb", OPTIONS)
def test_missing_files_and_folders_are_refused(verb, tmp_path, capsys):
    (tmp_path / "folder.obj").mkdir()
    for name in ("absent.obj", "folder.obj"):
        check_refused(verb, tmp_path / name, tmp_path / "out", capsys, "no mesh file at")


@pytest.mark.parametrize("verb", VERBS)
def test_a_place_that_cannot_be_written_is_refused(verb, tmp_path, capsys):
    # Below a regular file nobody can write, root included (whom permissions do not stop).
    (tmp_path / "file").write_text("mine")
    (tmp_path / "ball.obj").write_bytes(odd_meshes.TAKEN["tetrahedron.obj"])
    assert cli.main(arguments(verb, tmp_path / "ball.obj", tmp_path / "file" / "below")) == 1
    printed, error = capsys.readouterr()
    assert printed == "" and "cannot write" in error and "choose a folder" in error
    assert len(error.splitlines()) == 1
    assert (tmp_path / "file").read_text() == "mine" and len(list(tmp_path.iterdir())) == 2
