"""Fixtures that more than one test file uses: the command line, a folder for it, the tiny scene, built once;
and what needs a network."""

import os
import shlex
from pathlib import Path

import nbformat
import pytest
import torch
import trimesh

from paper_artifact import cli
from paper_artifact.pipeline import prepare_scene
from paper_artifact.scene.fetch import Unreachable
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import Soup, initial_mlp, save_soup
from tests.tiny_run import tiny_config


@pytest.fixture
def command(capsys):
    """command(line, *words, code=0): run the verb with its words, check the exit code, return what it said
    (.out and .err)."""

    def run(line: str, *words, code: int = 0):
        capsys.readouterr()
        try:
            found = cli.main([*shlex.split(line), *map(str, words)])
        except SystemExit as ended:
            found = ended.code
        said = capsys.readouterr()
        assert found == code, said.err
        return said

    return run


@pytest.fixture
def refused(command, tmp_path):
    """refused(line, *words, code=1): run the command, which ends with this code (2 where the arguments alone
    are wrong) and one line that says what is wrong and what to do, all files as before; return the line."""

    def tree() -> dict:
        found = tmp_path.rglob("*")
        return {path.relative_to(tmp_path): path.read_bytes() if path.is_file() else None for path in found}

    def check(line: str, *words: str, code: int = 1) -> str:
        before = tree()
        out, error = command(f"{line} --quiet", code=code)
        assert error.startswith("paper_artifact: ") and error.endswith("\n"), error
        assert len(error.splitlines()) == 1 and "Traceback" not in error and out == ""
        for word in words:
            assert word in error
        assert tree() == before
        return error

    return check


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with ball.ply, a link to it, ball.npz of one triangle and notebooks/01_a.ipynb."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(1).export("ball.ply")
    os.symlink("ball.ply", "link.ply")
    opacity = torch.full((1, 3), 6.0)
    save_soup("ball.npz", Soup(torch.eye(3)[None], torch.zeros(1, 3, 7), opacity, initial_mlp(0)))
    Path("notebooks").mkdir()
    nbformat.write(nbformat.v4.new_notebook(), "notebooks/01_a.ipynb")
    return tmp_path


@pytest.fixture(scope="session")
def tiny_results(tmp_path_factory):
    """A results folder that holds the tiny run's scene and nothing else; copy it, do not write to it."""
    folder = tmp_path_factory.mktemp("tiny") / "results"
    prepare_scene(tiny_config(), make_shape("sphere"), folder / "scenes")
    return folder


@pytest.fixture(scope="session")
def tiny_scene(tiny_results):
    """The tiny run's scene, loaded."""
    return prepare_scene(tiny_config(), make_shape("sphere"), tiny_results / "scenes")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call():
    """Skip a test that needs an external mesh where no mirror is set and GitHub cannot be reached."""
    try:
        return (yield)
    except Unreachable as error:
        pytest.skip(f"external meshes: {error}")
