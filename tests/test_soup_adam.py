"""The vertices' Adam against plain numpy, all else's against torch's; the MLP's moments handed on."""

import numpy as np
import pytest
import torch

from paper_artifact.randomness import stream
from paper_artifact.soup.adam import NAMES, SoupOptimiser
from paper_artifact.soup.state import Soup, soup_of
from tests.raster_cases import soup_arrays

RATES = {"vertices": 2e-3, "features": 2e-2, "opacity": 1e-2, "mlp": 5e-3}


def make_soup(triangles: int, dtype: torch.dtype = torch.float32) -> Soup:
    """Return a soup of random values, the same for every dtype."""
    arrays = soup_arrays(1, triangles).flat()
    vertices, features, opacity, *mlp = (torch.from_numpy(array.copy()).to(dtype) for array in arrays)
    return Soup(vertices, features, opacity, tuple(mlp)).trainable()


def give_gradients(soups: list[Soup], step: int) -> None:
    """Give all soups the same gradients: of every size, and 0 on every fifth corner, as for hidden
    triangles."""
    for index, tensors in enumerate(zip(*(soup.tensors() for soup in soups), strict=True)):
        draws = stream(step, "gradients", index)
        shape = tuple(tensors[0].shape)
        gradient = draws.normal(size=shape) * 10.0 ** draws.uniform(
            -9, 1, shape[:1] + (1,) * (len(shape) - 1)
        )
        if index < 3:
            gradient.reshape(-1, *gradient.shape[2:])[::5] = 0.0
        for tensor in tensors:
            tensor.grad = torch.from_numpy(gradient.astype(np.float32)).to(tensor.dtype)


def rates_at(step: int) -> dict[str, float]:
    """Return learning rates that decay as in training."""
    return {name: rate * 0.01 ** (step / 200) for name, rate in RATES.items()}


@pytest.mark.parametrize(
    "triangles, dtype", [(1, "float32"), (23, "float32"), (67, "float32"), (23, "float64")]
)
def test_200_steps_stay_at_torchs_in_double_precision(triangles, dtype):
    soup, twin = make_soup(triangles, getattr(torch, dtype)), make_soup(triangles, torch.float64)
    start = [tensor.detach().clone() for tensor in twin.tensors()]
    optimiser, references = SoupOptimiser(soup), [torch.optim.Adam([tensor]) for tensor in twin.tensors()[1:]]
    position, mean = twin.vertices.detach().numpy(), np.zeros((triangles, 3, 3))
    square = np.zeros((triangles, 3))
    for step in range(1, 201):
        give_gradients([soup, twin], step)
        optimiser.step(rates_at(step))
        for name, reference in zip(NAMES[1:], references, strict=True):
            reference.param_groups[0]["lr"] = rates_at(step)[name]
            reference.step()
        # Ling et al. 2022, algorithm 1: Adam with the squared norm of each vector in the second moment
        gradient = twin.vertices.grad.numpy()
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.999 * square + 0.001 * np.linalg.norm(gradient, axis=-1) ** 2
        length = np.sqrt(square / (1 - 0.999**step)) + 1e-8
        position -= rates_at(step)["vertices"] * (mean / (1 - 0.9**step)) / length[..., None]
    for index, (ours, expected, before) in enumerate(zip(soup.tensors(), twin.tensors(), start, strict=True)):
        moved = (expected - before).abs().max()
        assert moved > RATES[NAMES[index]]
        assert (ours.detach().double() - expected).abs().max() < 2e-6 * expected.abs().max() + 1e-5 * moved


@pytest.mark.parametrize(
    "kinds", [(torch.float32, torch.float32), (torch.float64, torch.float32), (torch.float32, torch.float64)]
)
def test_the_mlp_goes_on_with_its_moments_in_another_soup(kinds):
    soup, whole = make_soup(5, kinds[0]), make_soup(5, kinds[1])
    first, reference = SoupOptimiser(soup), SoupOptimiser(whole)
    for step in range(20):
        if step == 8:  # the triangles change, the MLP's tensors stay
            fewer = soup.select(torch.arange(3)).tensors()
            soup = soup_of([tensor.detach().to(kinds[1]) for tensor in fewer]).trainable()
            second = SoupOptimiser(soup)
            second.load_mlp_state(first.mlp_state())
            first = second
        for index, (ours, theirs) in enumerate(zip(soup.mlp, whole.mlp, strict=True)):
            gradient = stream(step, "gradients", index).normal(size=ours.shape).astype(np.float32)
            ours.grad, theirs.grad = (torch.from_numpy(gradient).to(each.dtype) for each in (ours, theirs))
        for each in (*soup.tensors()[:3], *whole.tensors()[:3]):
            each.grad = torch.zeros_like(each)
        first.step(RATES)
        reference.step(RATES)
    for ours, theirs in zip(soup.mlp, whole.mlp, strict=True):
        if kinds[0] == kinds[1]:
            assert torch.equal(ours, theirs)
        else:
            torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)
