"""The training loop on a tiny scene: it learns, its bits depend on the configuration alone, its
term, its errors. Resuming: test_train_resume.

CUDA cannot be tested on a machine without one: what runs there is the twin, held to the CPU kernels below in
float64 on the CPU.
"""

import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from paper_artifact import cli
from paper_artifact.errors import InputError
from paper_artifact.evaluate.image import view_scores
from paper_artifact.files import REPOSITORY
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.threads import set_thread_count, thread_count
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.state import render_views
from paper_artifact.train.backend import CpuBackend, TwinBackend, backend_for
from paper_artifact.train.loop import batch_views, train
from paper_artifact.train.state import TrainingError, TrainState, learning_rates
from tests.tiny_run import STEPS, tiny_arguments, tiny_config

RESAMPLED = [10, 20, 30, 40, 50]


def same_bits(first: TrainState, second: TrainState) -> bool:
    told = [(state.losses, state.dumps, state.resamplings) for state in (first, second)]
    pairs = zip(first.soup.tensors(), second.soup.tensors(), strict=True)
    return told[0] == told[1] and all(torch.equal(a, b) for a, b in pairs)


def dump(soup, step: int) -> dict:
    size = float(soup.vertices.detach().double().square().sum())
    return {"step": step, "triangles": len(soup), "size": size}


@pytest.fixture(scope="module")
def trained(tiny_scene) -> TrainState:
    return train(tiny_scene, tiny_config(), evaluate=dump, device="cpu")


def test_it_learns(trained, tiny_scene):
    assert len(trained.losses) == STEPS and np.mean(trained.losses[-5:]) < 0.75 * np.mean(trained.losses[:5])

    def psnr(soup):
        return view_scores(soup, tiny_scene, tiny_scene.holdout)["psnr"]

    assert psnr(trained.soup) > psnr(initial_soup(tiny_scene.points, 600, 0)) + 1.5


def test_a_supersampled_pixel_is_the_mean_of_the_rays_of_a_larger_image(trained, tiny_scene):
    views, (height, width) = tiny_scene.holdout, tiny_scene.images.shape[2:]
    larger = replace(tiny_scene, images=np.zeros((len(tiny_scene.names), 3, 3 * height, 3 * width), np.uint8))
    rays = render_views(trained.soup, larger, views).astype(float)
    means = rays.reshape(len(views), height, 3, width, 3, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(render_views(trained.soup, tiny_scene, views, supersample=3), means, atol=2e-6)
    # The middle of 3 × 3 rays is the pixel's own ray: one ray a pixel is what records hold.
    one = render_views(trained.soup, tiny_scene, views)
    assert np.mean(np.abs(one - rays[:, 1::3, 1::3]) < 1e-3) > 0.999


def test_history_of_a_run(trained):
    assert [entry["step"] for entry in trained.dumps] == [20, 30, 60]
    assert [entry["step"] for entry in trained.resamplings] == RESAMPLED
    first = trained.resamplings[0]
    assert (first["before"], first["pruned"]) == (600, 200)
    for one, following in pairwise(trained.resamplings):
        assert one["after"] >= one["pruned"] == 200 and following["before"] == one["after"]
    assert len(trained.soup) == trained.resamplings[-1]["after"] == trained.dumps[-1]["triangles"]
    assert set(trained.seconds) == {"photometric", "topology", "optimiser", "resample", "evaluate"}
    assert trained.resumed_at is None


def test_threads_change_no_bit_and_torch_itself_trains_on_one(trained, tiny_scene):
    # With two, torch cuts large tensors elsewhere: a 5,250-triangle torus run differs from step 20 or so on.
    inside, before = [], (torch.get_num_threads(), thread_count())

    def note(step: int, text: str) -> None:
        inside.append(torch.get_num_threads())

    try:
        torch.set_num_threads(2)
        set_thread_count(2)
        again = train(tiny_scene, tiny_config(), evaluate=dump, device="cpu", progress=note)
        assert same_bits(trained, again) and set(inside) == {1} and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before[0])
        set_thread_count(before[1])


def test_evaluation_and_progress_change_no_bit_and_another_seed_does(trained, tiny_scene):
    steps = []
    again = train(tiny_scene, tiny_config(), device="cpu", progress=lambda step, text: steps.append(step))
    assert again.dumps == [] and same_bits(trained, replace(again, dumps=trained.dumps))
    assert steps == list(range(1, STEPS + 1))
    other = train(tiny_scene, tiny_config(seed=1, steps=12), device="cpu")
    reference = train(tiny_scene, tiny_config(steps=12), device="cpu")
    assert not set(other.losses) & set(reference.losses)
    assert not torch.equal(other.soup.mlp[0], reference.soup.mlp[0])


@pytest.mark.parametrize("count, batch", [(7, 4), (5, 5), (3, 8)])
def test_batches_are_permutations_redrawn_each_epoch(count, batch):
    train_views = np.arange(count) * 3
    per_epoch = -(-count // batch)

    def epoch_of(seed, epoch):
        return [batch_views(train_views, batch, seed, epoch * per_epoch + k + 1) for k in range(per_epoch)]

    epochs = [epoch_of(0, epoch) for epoch in range(4)]
    for epoch in epochs:
        assert Counter(int(view) for views in epoch for view in views) == Counter(train_views.tolist())
        assert [len(views) for views in epoch[:-1]] == [batch] * (per_epoch - 1)
    assert len({tuple(np.concatenate(epoch)) for epoch in epochs}) > 1
    other = np.concatenate(epoch_of(1, 0))
    assert count == 3 or not np.array_equal(np.concatenate(epochs[0]), other)


# --- the additive term


class FakeTerm:
    """Pulls every corner along +x, hard; remembers how it was called. Its state: test_train_resume."""

    def __init__(self, weight: float | None = -1e3) -> None:
        self.weight = weight
        self.calls: list[tuple] = []
        self.log: list[dict] = []

    def due(self, step, resampled):
        self.calls.append((step, bool(resampled)))
        return True

    def refresh(self, step, vertices, opacity):
        assert vertices.requires_grad and vertices.shape[1:] == (3, 3) and step == self.calls[-1][0]
        assert opacity.shape == vertices.shape[:2] and not opacity.requires_grad
        assert 0 <= opacity.min() <= opacity.max() <= 1
        self.calls[-1] += (len(vertices),)

    def value(self, step, vertices, photo_gradient_norm):
        assert step == self.calls[-1][0]
        assert photo_gradient_norm() == pytest.approx(float(vertices.grad.double().norm()), rel=1e-5)
        assert photo_gradient_norm() > 0
        if step == 2:  # the mean over more batches leaves this step's gradients as they are
            before = vertices.grad.clone()
            one, two, three = (photo_gradient_norm(count) for count in (1, 2, 3))
            assert two != one and 3 * three - 2 * two > 0 and three == photo_gradient_norm(3)
            assert torch.equal(vertices.grad, before)
        return None if self.weight is None else self.weight * vertices[..., 0].sum()


def test_a_term_is_called_each_step_from_one_and_told_of_every_new_soup(trained, tiny_scene):
    term = FakeTerm(weight=None)
    result = train(tiny_scene, tiny_config(), term=term, evaluate=dump, device="cpu")
    assert same_bits(trained, result)  # a term that gives None changes nothing
    assert [step for step, _, _ in term.calls] == list(range(1, STEPS + 1))
    assert [step for step, resampled, _ in term.calls if resampled] == [1, *(step + 1 for step in RESAMPLED)]
    sizes = [600] + [entry["after"] for entry in result.resamplings]
    assert [count for step, _, count in term.calls if step % 10 == 1] == sizes
    assert "topology" in result.seconds


def test_a_terms_gradient_moves_the_vertices(tiny_scene):
    start = initial_soup(tiny_scene.points, 600, 0).vertices
    config = tiny_config(steps=1)
    moved = train(tiny_scene, config, term=FakeTerm(), device="cpu").soup.vertices - start
    rate = config.vertex_lr * tiny_scene.radius * config.final_lr
    # Beside 1e3 along x the photometric gradient is nothing.
    expected = torch.tensor([rate, 0.0, 0.0]).expand_as(moved)
    torch.testing.assert_close(moved, expected, rtol=1e-3, atol=1e-3 * rate)
    alone = train(tiny_scene, config, device="cpu").soup.vertices - start
    assert not torch.allclose(alone, expected, atol=0.1 * rate)


def test_without_a_term_none_of_its_code_is_imported(tiny_results):
    program = f"""
import sys
from pathlib import Path
from tests.tiny_run import tiny_config
from paper_artifact.scene.load import load_scene
from paper_artifact.train.loop import train
scene = load_scene(next(Path({str(tiny_results)!r}).glob("scenes/*")))
assert len(train(scene, tiny_config(steps=2), device="cpu").losses) == 2
print(*sorted(name for name in sys.modules if name.startswith(("paper_artifact.topology", "gudhi"))))
"""
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=600)
    assert (result.returncode, result.stdout.strip()) == (0, ""), result.stderr


# --- what goes wrong


class BadTerm(FakeTerm):
    """Fine until step 4, then not a number, in its value or in its gradient only."""

    def __init__(self, gradient_only: bool) -> None:
        super().__init__()
        self.gradient_only = gradient_only

    def value(self, step, vertices, photo_gradient_norm):
        if step < 4:
            return None
        return torch.sqrt(0 * vertices.sum()) if self.gradient_only else vertices.sum() * torch.nan


def diverging(monkeypatch, name: str, first: int, rate: float = 1e30) -> None:
    """Let the learning rate of `name` be beyond what a configuration may ask for, from step `first` on."""

    def rates(config, radius, step):
        return learning_rates(config, radius, step) | ({name: rate} if step >= first else {})

    monkeypatch.setattr("paper_artifact.train.loop.learning_rates", rates)


@pytest.mark.parametrize(
    "rate, term, words",
    [
        ("mlp", None, r"the loss of step 2 is nan"),
        (None, BadTerm(gradient_only=False), r"the added loss term of step 4 is nan"),
        (None, BadTerm(gradient_only=True), r"vertices are not finite after step 4"),
    ],
)
def test_what_is_not_finite_stops_the_run_and_names_the_step(
    rate, term, words, tiny_scene, tmp_path, monkeypatch
):
    if rate:
        diverging(monkeypatch, rate, 1)
    with pytest.raises(TrainingError, match=words):
        train(tiny_scene, tiny_config(), term=term, checkpoint=tmp_path / "run.pt", device="cpu")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name, words",
    [("opacity", "opacities are not finite after step 30"), ("features", "the loss of step 24 is nan")],
)
def test_the_last_checkpoint_before_a_value_that_is_not_finite_resumes(
    name, words, tiny_scene, trained, tmp_path, monkeypatch
):
    checkpoint = tmp_path / "run.pt"
    with monkeypatch.context() as patch:
        diverging(patch, name, 23, rate=float("nan"))
        with pytest.raises(TrainingError, match=words):
            train(tiny_scene, tiny_config(), checkpoint=checkpoint, device="cpu")
    resumed = train(tiny_scene, tiny_config(), evaluate=dump, checkpoint=checkpoint, device="cpu")
    assert resumed.resumed_at == 20 and resumed.losses == trained.losses
    assert all(torch.equal(a, b) for a, b in zip(resumed.soup.tensors(), trained.soup.tensors(), strict=True))


def test_a_run_that_breaks_is_one_line_for_the_command_line(tiny_results, tmp_path, capsys, monkeypatch):
    shutil.copytree(tiny_results, tmp_path / "results")
    diverging(monkeypatch, "mlp", 1)
    assert cli.main([*tiny_arguments(), f"--results={tmp_path / 'results'}"]) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "the loss of step 2 is nan" in error
    assert not list((tmp_path / "results" / "runs").iterdir())
    assert not (tmp_path / "results" / "soups").exists()


def test_a_scene_without_training_views_and_devices_that_are_not_there_are_refused(tiny_scene, monkeypatch):
    with pytest.raises(InputError, match="no training views"):
        train(replace(tiny_scene, train=np.array([], np.int64)), tiny_config(), device="cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert isinstance(backend_for("auto", tiny_scene, tiny_scene.train), CpuBackend)
    for device, words in (("cuda", "no CUDA device here"), ("tpu", "unknown device 'tpu'")):
        with pytest.raises(InputError, match=words):
            train(tiny_scene, tiny_config(), device=device)


# --- the twin


def test_the_twin_backend_gives_the_cpu_backends_step(trained, tiny_scene):
    views = batch_views(tiny_scene.train, 4, 0, 1)
    keys = [view_key(0, 1, int(view)) for view in views]
    results = []
    scene = tiny_scene, tiny_scene.train
    for backend in (CpuBackend(*scene), TwinBackend(*scene, "cpu", torch.float64)):
        soup = backend.to_device(trained.soup.select(torch.arange(len(trained.soup))))
        for tensor in soup.mlp:
            tensor.grad = None
        loss = backend.photometric_step(soup, views, keys)
        results.append((loss, [tensor.grad.double().flatten() for tensor in soup.tensors()]))
        assert all(tensor.dtype == torch.float32 for tensor in backend.to_host(soup).tensors())
    (loss, gradients), (twin_loss, twin_gradients) = results
    assert abs(loss - twin_loss) < 1e-4
    for mine, theirs in zip(gradients, twin_gradients, strict=True):
        assert theirs.norm() > 0
        assert torch.nn.functional.cosine_similarity(mine, theirs, dim=0) > 0.999
        assert float(mine.norm() / theirs.norm()) == pytest.approx(1, abs=0.01)
