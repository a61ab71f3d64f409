"""VectorAdam against plain numpy; the kernels' Adam against torch's; the MLP's moments handed on."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from paper_artifact.randomness import stream
from paper_artifact.soup.adam import NAMES, KernelOptimiser, TorchOptimiser, VectorAdam, soup_optimiser
from paper_artifact.soup.state import Soup
from tests.raster_cases import soup_arrays

RATES = {"vertices": 2e-3, "features": 2e-2, "opacity": 1e-2, "mlp": 5e-3}


def make_soup(triangles: int, dtype: torch.dtype = torch.float32) -> Soup:
    """Return a soup of random values, the same for every dtype."""
    vertices, features, opacity, *mlp = (
        torch.from_numpy(array.copy()).to(dtype) for array in soup_arrays(1, triangles).flat()
    )
    return Soup(vertices, features, opacity, tuple(mlp)).trainable()


def give_gradients(soups: list[Soup], step: int) -> None:
    """Give all soups the same gradients: of every size, and 0 on every fifth corner, as for hidden
    triangles."""
    for index, tensors in enumerate(zip(*(soup.tensors() for soup in soups), strict=True)):
        draws = stream(step, "gradients", index)
        gradient = draws.normal(size=tensors[0].shape) * 10.0 ** draws.uniform(
            -9, 1, tensors[0].shape[:1] + (1,) * (tensors[0].dim() - 1)
        )
        if index < 3:
            gradient.reshape(-1, *gradient.shape[2:])[::5] = 0.0
        for tensor in tensors:
            tensor.grad = torch.from_numpy(gradient.astype(np.float32)).to(tensor.dtype)


def rates_at(step: int) -> dict[str, float]:
    """Return learning rates that decay as in training."""
    return {name: rate * 0.01 ** (step / 200) for name, rate in RATES.items()}


@pytest.mark.parametrize("triangles", [1, 2, 23, 67])
def test_200_steps_stay_at_torchs_in_double_precision(triangles):
    soup, twin = make_soup(triangles), make_soup(triangles, torch.float64)
    start = [tensor.detach().clone() for tensor in twin.tensors()]
    optimiser, reference = soup_optimiser(soup), soup_optimiser(twin)
    assert isinstance(optimiser, KernelOptimiser) and isinstance(reference, TorchOptimiser)
    for step in range(1, 201):
        give_gradients([soup, twin], step)
        optimiser.step(rates_at(step))
        reference.step(rates_at(step))
    for index, (ours, expected, before) in enumerate(zip(soup.tensors(), twin.tensors(), start, strict=True)):
        moved = (expected - before).abs().max()
        assert moved > RATES[NAMES[index]]
        assert (ours.detach().double() - expected).abs().max() < 2e-6 * expected.abs().max() + 1e-5 * moved


@pytest.mark.parametrize(
    "kinds",
    [
        (KernelOptimiser, KernelOptimiser),
        (TorchOptimiser, KernelOptimiser),
        (KernelOptimiser, TorchOptimiser),
    ],
)
def test_the_mlp_goes_on_with_its_moments_in_another_soup(kinds):
    soup, whole = make_soup(5), make_soup(5)
    first, reference = kinds[0](soup), kinds[1](whole)
    for step in range(20):
        if step == 8:  # the triangles change, the MLP's tensors stay
            soup = soup.select(torch.arange(3))
            second = kinds[1](soup)
            second.load_mlp_state(first.mlp_state())
            first = second
        for index, (ours, theirs) in enumerate(zip(soup.mlp, whole.mlp, strict=True)):
            gradient = stream(step, "gradients", index).normal(size=ours.shape).astype(np.float32)
            ours.grad, theirs.grad = torch.from_numpy(gradient), torch.from_numpy(gradient)
        for each in (*soup.tensors()[:3], *whole.tensors()[:3]):
            each.grad = torch.zeros_like(each)
        first.step(RATES)
        reference.step(RATES)
    for ours, theirs in zip(soup.mlp, whole.mlp, strict=True):
        if kinds[0] == kinds[1]:
            assert torch.equal(ours, theirs)
        else:
            torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_vector_adam_is_the_papers_algorithm_at_the_rate_of_each_step(seed):
    """Ling et al. 2022, algorithm 1: Adam with the squared norm of each vector in the second moment."""
    draws = stream(seed, "vector adam test")
    scale = 10.0 ** draws.uniform(-6, 3, size=(12, 4, 3, 1))  # as on visible and hidden corners
    start, gradients = draws.normal(size=(4, 3, 3)), scale * draws.normal(size=(12, 4, 3, 3))
    parameter, unused = torch.tensor(start, requires_grad=True), torch.ones(2, 3, requires_grad=True)
    optimizer = VectorAdam([parameter, unused], lr=1.0)
    position, mean, square = start.copy(), np.zeros_like(start), np.zeros(start.shape[:-1])
    for t, gradient in enumerate(gradients, 1):
        optimizer.param_groups[0]["lr"] = rate = 0.01 ** (t / 12)
        parameter.grad = torch.tensor(gradient)
        optimizer.step()
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.999 * square + 0.001 * np.linalg.norm(gradient, axis=-1) ** 2
        length = np.sqrt(square / (1 - 0.999**t)) + 1e-8
        position -= rate * (mean / (1 - 0.9**t)) / length[..., None]
        np.testing.assert_allclose(parameter.detach().numpy(), position, rtol=1e-12, atol=1e-14)
    assert torch.equal(unused, torch.ones(2, 3))
    with pytest.raises(ValueError, match="closure"):
        optimizer.step(lambda: 0.0)
