"""Fixtures that more than one test file uses: the tiny scene, built once a session; the external meshes."""

from __future__ import annotations

import os

import pytest
import requests

from paper_artifact.pipeline import prepare_scene
from paper_artifact.scene.fetch import MIRROR_VARIABLE, RAW
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


@pytest.fixture(scope="session")
def meshes():
    """For tests that need external meshes: skips where no mirror is set and GitHub cannot be reached."""
    if os.environ.get(MIRROR_VARIABLE):
        return
    try:
        requests.head(RAW, timeout=10)  # reached, whatever it thinks of the address
    except OSError:
        pytest.skip(
            f"external meshes: {RAW} cannot be reached, and {MIRROR_VARIABLE} names no folder"
        )
