"""A disk that is full or fails, at any moment of any file: one sentence, nothing half-written, and a run that
goes on afterwards to the same bits.

The process's own limit on the size of a file (RLIMIT_FSIZE) makes the kernel refuse bytes as a full disk
does.
"""

import errno
import os
import resource
import shutil
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from paper_artifact import files
from paper_artifact.errors import InputError
from paper_artifact.export.flat import write_png
from paper_artifact.pipeline import run
from paper_artifact.record.store import write_record
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.adam import SoupOptimiser
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.state import load_soup, save_soup
from paper_artifact.train.state import TrainState, write_checkpoint
from tests.sweep_runs import same_run
from tests.tiny_run import bare_record, find_records, tiny_arguments, tiny_config

pytestmark = pytest.mark.faults


@contextmanager
def files_of_at_most(size: int):
    """Let no file grow beyond `size` bytes within the block."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def checkpoint(folder):
    soup = initial_soup(np.random.default_rng(0).normal(size=(99, 3)).astype(np.float32), 30, 0)
    state = TrainState(10, soup, SoupOptimiser(soup))
    backend = SimpleNamespace(to_host=lambda each: each)
    write_checkpoint(folder / "run.pt", tiny_config(), state, None, backend)


def record(folder):
    write_record(bare_record(tiny_config()), folder)


def soup(folder):
    save_soup(folder / "soup.npz", initial_soup(np.eye(9, 3, dtype=np.float32), 8, 0))


def scene(folder):
    build_scene(make_shape("cube"), SceneConfig(views=2, size=16, supersample=1, points=99), folder / "scene")


def picture(folder):
    write_png(folder / "a.png", np.random.default_rng(0).uniform(size=(40, 40, 3)))


WRITERS = (checkpoint, record, soup, scene, picture)


@pytest.mark.parametrize("write", WRITERS)
def test_every_writer_tells_a_full_disk_in_one_sentence_and_leaves_nothing(write, tmp_path, monkeypatch):
    def refused(words: str) -> None:
        with pytest.raises(InputError, match=words) as error:
            write(tmp_path)
        assert len(str(error.value).splitlines()) == 1 and list(tmp_path.iterdir()) == []

    write(tmp_path / "before")  # kernels are compiled and kept here
    shutil.rmtree(tmp_path / "before")
    for size in (0, 100):
        with files_of_at_most(size):
            refused(r"^cannot write .*: File too large; raise the file size limit \(ulimit -f\), or use")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    for name in ("fsync", "replace"):

        def fail(*_):
            raise full

        with monkeypatch.context() as patch:
            patch.setattr(files.os, name, fail)
            refused("cannot write .*: No space left on device; free some space and run")
    write(tmp_path)
    assert list(tmp_path.iterdir())


def test_a_file_that_is_there_survives_a_failed_write_and_other_errors_pass_unchanged(tmp_path):
    path = tmp_path / "a.json"
    files.write_json(path, {"old": 1})
    with files_of_at_most(3), pytest.raises(InputError, match="raise the file size limit"):
        files.write_json(path, {"new": list(range(99))})
    assert files.load_json(path) == {"old": 1} and list(tmp_path.iterdir()) == [path]
    with pytest.raises(ConnectionResetError), files.atomic_path(path):
        raise ConnectionResetError(errno.ECONNRESET, "of a download, not of the disk")


def test_a_run_whose_disk_was_full_goes_on_to_the_same_record(tiny_results, tmp_path, command):
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    for folder in (whole, stopped):
        shutil.copytree(tiny_results, folder)
    run(tiny_config(), results=whole, device="cpu")
    words = [*tiny_arguments(), "--results", stopped]
    # Full before the first checkpoint, after the second one.
    with files_of_at_most(1000):
        (told,) = command("", *words, code=1).err.splitlines()
    assert "raise the file size limit" in told and not list((stopped / "checkpoints").iterdir())

    def limit(step, text):
        if step == 25:
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))

    with (
        files_of_at_most(resource.RLIM_INFINITY),
        pytest.raises(InputError, match="checkpoints/.*raise the file size limit"),
    ):
        run(tiny_config(), results=stopped, device="cpu", progress=limit)
    assert len(list((stopped / "checkpoints").iterdir())) == 1
    command("", *words)
    (one,), (two,) = (find_records(folder / "runs") for folder in (whole, stopped))
    assert (one["resumed_at"], two["resumed_at"]) == (None, 20) and same_run(one, two)
    one, two = (load_soup(next((folder / "soups").iterdir())) for folder in (whole, stopped))
    assert all(torch.equal(a, b) for a, b in zip(one.tensors(), two.tensors(), strict=True))
