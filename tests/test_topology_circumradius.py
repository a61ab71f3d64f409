"""Circumradii against the paper's formulas and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from paper_artifact.alpha.diagrams import circumradius
from paper_artifact.errors import InputError


def readable(corners: torch.Tensor) -> torch.Tensor:
    """The slow twin: solve for the circumcentre in the simplex's own plane by autograd's least squares."""
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.mT
    weights = torch.linalg.solve(gram, torch.diagonal(gram, dim1=1, dim2=2)[:, :, None] / 2)
    return torch.linalg.vector_norm((weights * edges).sum(dim=1), dim=1)


@pytest.mark.parametrize("corners", [2, 3, 4])
def test_values_and_gradients_equal_the_readable_twin(corners):
    points = torch.tensor(
        np.random.default_rng(corners).standard_normal((200, corners, 3)), requires_grad=True
    )
    fast, slow = circumradius(points), readable(points)
    torch.testing.assert_close(fast, slow, rtol=1e-8, atol=0)
    weights = torch.linspace(0.5, 2, 200, dtype=torch.float64) / slow.detach()
    (a,) = torch.autograd.grad((weights * fast).sum(), points)
    (b,) = torch.autograd.grad((weights * slow).sum(), points)
    torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("corners", [1, 2, 3, 4])
def test_gradcheck(corners):
    points = torch.tensor(np.random.default_rng(7).random((5, corners, 3)), requires_grad=True)
    assert torch.autograd.gradcheck(circumradius, (points,), eps=1e-7, atol=1e-5, rtol=1e-4)


def test_known_radii():
    edge = torch.tensor([[[0.0, 0, 0], [3, 4, 0]]], dtype=torch.float64)
    triangle = torch.tensor([[[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]], dtype=torch.float64)
    cube_corners = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=torch.float64)
    assert circumradius(edge).item() == 2.5
    assert circumradius(triangle).item() == pytest.approx(2.5, rel=1e-15)
    assert circumradius(cube_corners).item() == pytest.approx(3**0.5 / 2, rel=1e-15)


def test_far_from_the_origin_keeps_nine_digits():
    near = torch.tensor(np.random.default_rng(3).random((50, 4, 3)))
    far = circumradius(near + torch.tensor([1000.0, -1000.0, 500.0], dtype=torch.float64))
    torch.testing.assert_close(far, circumradius(near), rtol=1e-6, atol=0)


def test_flat_simplices_have_radius_inf_and_gradient_zero():
    line = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]], dtype=torch.float64, requires_grad=True)
    plane = torch.tensor(
        [[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 4, 0]]], dtype=torch.float64, requires_grad=True
    )
    point_twice = torch.zeros((1, 2, 3), dtype=torch.float64, requires_grad=True)
    for corners, expected in ((line, np.inf), (plane, np.inf), (point_twice, 0.0)):
        radius = circumradius(corners)
        radius.sum().backward()
        assert radius.item() == expected
        assert not corners.grad.any()


def test_bad_shapes_and_integers_are_refused():
    for bad in (
        torch.zeros((3, 3)),
        torch.zeros((1, 5, 3)),
        torch.zeros((1, 3, 2)),
        torch.zeros((1, 3, 3), dtype=torch.int64),
    ):
        with pytest.raises(InputError, match="corners must be"):
            circumradius(bad)
