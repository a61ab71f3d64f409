"""Diagrams as tensors: values of alpha_persistence, gradients by finite differences, degenerate clouds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from paper_artifact.alpha import alpha_diagrams, alpha_persistence
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream


def cloud(count: int = 40, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(stream(seed, "diagram tensors").normal(size=(count, 3)))


def test_the_bars_are_those_of_alpha_persistence():
    points = cloud(300)
    for diagram, pairs in zip(alpha_diagrams(points), alpha_persistence(points.numpy()), strict=True):
        np.testing.assert_allclose(
            diagram.bars.numpy(), np.column_stack([pairs.births, pairs.deaths]), rtol=1e-9, atol=1e-12
        )
        assert len(diagram) == len(pairs.births) and bool(diagram.gabriel.all())


def test_gradients_are_those_of_finite_differences():
    points = cloud().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda p: tuple(each.bars for each in alpha_diagrams(p)), (points,), eps=1e-7, atol=1e-5
    )


def test_scaling_the_points_scales_the_bars():
    """Euler's identity: radii are homogeneous of degree 1, so points · a radius's gradient is the radius."""
    points = cloud(200).requires_grad_()
    deaths = alpha_diagrams(points)[2].bars[:, 1]
    (gradient,) = torch.autograd.grad(deaths.sum(), points)
    assert float((points.detach() * gradient).sum()) == pytest.approx(float(deaths.sum().detach()), rel=1e-9)


def test_single_precision_in_single_precision_out():
    points = cloud(100).float().requires_grad_()
    loops = alpha_diagrams(points)[1].bars
    assert loops.dtype == torch.float32
    (loops[:, 1] - loops[:, 0]).square().sum().backward()
    assert (
        points.grad.dtype == torch.float32
        and bool(points.grad.isfinite().all())
        and bool((points.grad != 0).any())
    )


def test_a_lattice_gives_finite_gradients():
    """Cospherical points: a value that is not the simplex's own radius is a constant, never NaN."""
    axis = torch.arange(4, dtype=torch.float64)
    points = torch.cartesian_prod(axis, axis, axis).requires_grad_()
    diagrams = alpha_diagrams(points)
    sum(each.bars.sum() for each in diagrams).backward()
    assert bool(points.grad.isfinite().all())
    reference = alpha_persistence(points.detach().numpy(), method="gudhi")
    for diagram, pairs in zip(diagrams, reference, strict=True):
        np.testing.assert_allclose(
            np.sort(diagram.bars.detach().numpy()[:, 1]), np.sort(pairs.deaths), atol=1e-9
        )


def test_few_points_and_bad_ones():
    nothing = alpha_diagrams(torch.zeros((1, 3), dtype=torch.float64))
    assert [each.bars.shape for each in nothing] == [(0, 2)] * 3
    with pytest.raises(InputError):
        alpha_diagrams(torch.full((5, 3), float("nan")))
    with pytest.raises(InputError):
        alpha_diagrams(torch.zeros((5, 4)))
