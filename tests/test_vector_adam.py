"""VectorAdam against plain numpy, its rotation equivariance (Adam has none), and the learning rate."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from paper_artifact.randomness import stream
from paper_artifact.soup.adam import VectorAdam


def descend(kind, start: np.ndarray, gradients: np.ndarray, lr: float = 0.03) -> np.ndarray:
    """Return an optimizer's positions (steps,N,3,3) under these gradients (steps,N,3,3), float64."""
    parameter = torch.tensor(start, requires_grad=True)
    optimizer = kind([parameter], lr=lr)
    positions = []
    for gradient in gradients:
        parameter.grad = torch.tensor(gradient)
        optimizer.step()
        positions.append(parameter.detach().numpy().copy())
    return np.stack(positions)


def reference(start: np.ndarray, gradients: np.ndarray, lr: float = 0.03) -> np.ndarray:
    """Ling et al. 2022, algorithm 1: Adam with the squared norm of each vector in the second moment."""
    position, mean, square, positions = start.copy(), np.zeros_like(start), np.zeros(start.shape[:-1]), []
    for t, gradient in enumerate(gradients, 1):
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.999 * square + 0.001 * np.linalg.norm(gradient, axis=-1) ** 2
        length = np.sqrt(square / (1 - 0.999**t)) + 1e-8
        position = position - lr * (mean / (1 - 0.9**t)) / length[..., None]
        positions.append(position)
    return np.stack(positions)


def trial(seed: int, steps: int = 12) -> tuple[np.ndarray, np.ndarray]:
    draws = stream(seed, "vector adam test")
    scale = 10.0 ** draws.uniform(-6, 3, size=(steps, 4, 3, 1))  # as on visible and hidden corners
    return draws.normal(size=(4, 3, 3)), scale * draws.normal(size=(steps, 4, 3, 3))


@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_numpy(seed):
    start, gradients = trial(seed)
    np.testing.assert_allclose(
        descend(VectorAdam, start, gradients), reference(start, gradients), rtol=1e-12, atol=1e-14
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31))
def test_commutes_with_rotations(seed):
    start, gradients = trial(seed)
    rotation = Rotation.random(rng=stream(seed, "rotation")).as_matrix()
    straight = descend(VectorAdam, start, gradients) @ rotation.T
    np.testing.assert_allclose(
        descend(VectorAdam, start @ rotation.T, gradients @ rotation.T), straight, atol=1e-10
    )


def test_adam_does_not_commute_with_rotations():
    start, gradients = trial(0)
    rotation = Rotation.from_rotvec((0.3, -0.7, 0.5)).as_matrix()
    straight = descend(torch.optim.Adam, start, gradients) @ rotation.T
    assert (
        np.abs(descend(torch.optim.Adam, start @ rotation.T, gradients @ rotation.T) - straight).max() > 0.01
    )


def test_the_first_step_is_lr_long_whatever_the_gradient_and_along_it():
    start, gradients = trial(4)
    step = descend(VectorAdam, start, gradients[:1], lr=0.02)[0] - start
    length = np.linalg.norm(gradients[0], axis=-1)
    np.testing.assert_allclose(step, -0.02 * gradients[0] / (length + 1e-8)[..., None], rtol=1e-9)


def test_a_vertex_without_gradient_stays():
    start, gradients = trial(5)
    gradients[:, 2, 1] = 0.0
    end = descend(VectorAdam, start, gradients)[-1]
    moved = (end != start).reshape(-1, 3)
    assert not moved[7].any() and np.delete(moved, 7, axis=0).all()


def test_the_schedule_sets_the_rate_of_each_step_and_keeps_the_moments():
    start, gradients = trial(6)
    parameter = torch.tensor(start, requires_grad=True)
    optimizer = VectorAdam([parameter], lr=1.0)
    whole, before = reference(start, gradients, lr=1.0), start
    for step, gradient in enumerate(gradients):
        rate = 0.01 ** ((step + 1) / len(gradients))
        optimizer.param_groups[0]["lr"] = rate
        parameter.grad = torch.tensor(gradient)
        previous = parameter.detach().numpy().copy()
        optimizer.step()
        np.testing.assert_allclose(
            parameter.detach().numpy() - previous, rate * (whole[step] - before), rtol=1e-9, atol=1e-12
        )
        before = whole[step]


def test_parameters_without_gradient_are_skipped_and_a_closure_is_refused():
    used, unused = torch.ones(2, 3, requires_grad=True), torch.ones(2, 3, requires_grad=True)
    optimizer = VectorAdam([used, unused], lr=0.1)
    used.grad = torch.ones(2, 3)
    optimizer.step()
    assert torch.equal(unused, torch.ones(2, 3)) and not torch.equal(used, torch.ones(2, 3))
    with pytest.raises(ValueError, match="closure"):
        optimizer.step(lambda: 0.0)
