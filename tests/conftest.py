"""Fixtures that more than one test file uses: the tiny scene, built once; and what needs a network."""

from __future__ import annotations

import pytest

from paper_artifact.pipeline import prepare_scene
from paper_artifact.scene.fetch import Unreachable
from paper_artifact.scene.shapes import make_shape
from tests.tiny_run import tiny_config


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
