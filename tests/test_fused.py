"""The trainer's fused CPU step against the torch functions that the gradient tests hold to the twin: the same bits."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from paper_artifact.randomness import stream
from paper_artifact.raster import functions
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.fused import FusedStep
from paper_artifact.raster.threads import set_thread_count, thread_count
from paper_artifact.raster.visibility import to_clip
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import CpuBackend
from tests.raster_cases import cameras, mlp, soup

HEIGHT, WIDTH, BATCH = 40, 56, 3
BACKGROUND = np.array([0.9, 1.0, 0.2], np.float32)
NAMES = ("vertices", "features", "opacity", "w1", "c1", "w2", "c2", "w3", "c3")


def leaf(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.to(torch.float32).clone().requires_grad_()


class Case:
    """A random soup before random targets, with everything that both paths take."""

    def __init__(self, triangles: int = 60) -> None:
        self.soup = soup(3, triangles)
        self.mlp = mlp(3)
        self.matrices = cameras(3, BATCH).numpy().astype(np.float32)
        self.target = torch.from_numpy(
            stream(3, "fused test targets").random((BATCH, 3, HEIGHT, WIDTH), dtype=np.float32)
        )
        self.keys = [view_key(0, 5, index) for index in range(BATCH)]

    def leaves(self) -> list[torch.Tensor]:
        return [
            leaf(tensor)
            for tensor in (self.soup["vertices"], self.soup["features"], self.soup["opacity"], *self.mlp)
        ]

    def by_autograd(self, leaves: list[torch.Tensor], logits: bool = False) -> float:
        """Set the leaves' gradients and return the loss; logits: features and opacity are, as in a soup that is trained."""
        vertices, features, opacity, *weights = leaves
        features, opacity = (
            (torch.sigmoid(features), torch.sigmoid(opacity)) if logits else (features, opacity)
        )
        raster = functions.rasterize(vertices, opacity, self.matrices, HEIGHT, WIDTH, self.keys)
        colour = functions.shade(features, tuple(weights), raster, BACKGROUND)
        auxiliary = functions.opacity_gradient(opacity, colour, self.target, raster)
        loss = functions.photometric_loss(functions.edge_gradient(colour, vertices, raster), self.target)
        (loss + auxiliary).backward()
        return loss.item()

    def fused(self, step: FusedStep) -> tuple[float, list[np.ndarray]]:
        """Return the loss and the nine gradients."""
        vertices, features, opacity, *weights = (tensor.detach().numpy() for tensor in self.leaves())
        mean, square = functions.target_statistics(self.target)
        loss, gradients = step(
            vertices,
            features,
            opacity,
            tuple(weights),
            self.matrices,
            functions.camera_rays(self.matrices),
            list(self.target.numpy()),
            list(zip(mean, square)),
            self.keys,
        )
        return loss, [gradients.vertices, gradients.features, gradients.opacity, *gradients.mlp]


@pytest.fixture(scope="module")
def case() -> Case:
    return Case()


@pytest.fixture
def two_threads():
    before = thread_count()
    set_thread_count(2)
    yield
    set_thread_count(before)


def test_fused_gradients_are_the_autograd_functions_bits(case):
    leaves = case.leaves()
    loss = case.by_autograd(leaves)
    fused_loss, gradients = case.fused(FusedStep(HEIGHT, WIDTH, BACKGROUND))
    assert np.float32(fused_loss) == np.float32(loss)
    for name, tensor, gradient in zip(NAMES, leaves, gradients):
        assert gradient.dtype == np.float32 and np.abs(gradient).max() > 0, name
        assert np.array_equal(gradient, tensor.grad.numpy()), name


def test_a_step_object_keeps_nothing_from_one_call_to_the_next(case):
    step = FusedStep(HEIGHT, WIDTH, BACKGROUND)
    first = case.fused(step)
    Case(triangles=9).fused(step)
    again = case.fused(step)
    assert first[0] == again[0] and all(np.array_equal(a, b) for a, b in zip(first[1], again[1]))


def test_one_and_two_threads_give_the_same_bits(case, two_threads):
    loss, gradients = case.fused(FusedStep(HEIGHT, WIDTH, BACKGROUND))
    set_thread_count(1)
    expected_loss, expected = case.fused(FusedStep(HEIGHT, WIDTH, BACKGROUND))
    assert loss == expected_loss and all(np.array_equal(a, b) for a, b in zip(gradients, expected))


def backend_of(case: Case) -> CpuBackend:
    """Return the backend of a scene of four views, of which the case's three, in this order, are views 3, 0 and 2."""
    order = [3, 0, 2]
    images, matrices = np.zeros((4, HEIGHT, WIDTH, 3), np.float32), np.tile(case.matrices[:1], (4, 1, 1))
    images[order], matrices[order] = case.target.numpy().transpose(0, 2, 3, 1), case.matrices
    fields = {"images": images, "world_to_clip": matrices, "background": BACKGROUND}
    scene = Scene(**{name: fields.get(name) for name in Scene.__dataclass_fields__})
    return CpuBackend(scene, np.array([0, 2, 3]))


def test_the_cpu_backend_sets_the_soups_gradients(case):
    def trainable() -> Soup:
        vertices, features, opacity, *weights = (tensor.detach() for tensor in case.leaves())
        return Soup(vertices, torch.logit(features), torch.logit(opacity), tuple(weights)).trainable()

    fused, reference = trainable(), trainable()
    loss = backend_of(case).photometric_step(fused, np.array([3, 0, 2]), case.keys)
    leaves = [reference.vertices, reference.features, reference.opacity, *reference.mlp]
    assert loss == pytest.approx(case.by_autograd(leaves, logits=True), rel=1e-6)
    for name, tensor, expected in zip(
        NAMES, (fused.vertices, fused.features, fused.opacity, *fused.mlp), leaves
    ):
        if name in ("features", "opacity"):  # the sigmoid's derivative is formed in another order
            torch.testing.assert_close(
                tensor.grad, expected.grad, rtol=1e-6, atol=1e-6 * float(expected.grad.abs().max())
            )
        else:
            assert torch.equal(tensor.grad, expected.grad), name


def test_clip_space_points_are_the_matrix_product():
    corners = stream(0, "fused test corners").normal(size=(50, 3)).astype(np.float32)
    matrix = cameras(1, 1)[0].numpy()
    expected = np.concatenate([corners, np.ones((50, 1))], axis=1) @ matrix.T
    np.testing.assert_allclose(to_clip(corners, matrix.astype(np.float32)), expected, rtol=1e-5, atol=1e-5)
