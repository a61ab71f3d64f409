"""Each stage of the numba rasterizer (float32) against the torch twin (float64), in two tiers.

First tier: wherever both see the same triangle, barycentrics, depth and every gradient agree tightly. Second
tier: pixels where rounding lets another fragment win are counted, and stay a small fraction. The incoming
gradient is 0 on counted pixels and their neighbours, so that no tolerance has to hide a flip. Colours and the
gradients of features and MLP: test_photometric_step.
"""

from typing import NamedTuple

import numpy as np
import pytest
import torch

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.raster import draws, twin
from paper_artifact.raster.arrays import SoupArrays
from paper_artifact.raster.photometric import make_target
from paper_artifact.raster.view import ViewCamera, ViewRaster, make_camera
from tests.raster_cases import BACKGROUND, cameras, distance, doubles, front_camera, soup_arrays

FLIPS = 5e-4  # largest allowed fraction of pixels where the two disagree on the visible triangle


class Case(NamedTuple):
    """The same soup in the same views for both paths; the twin's values are exact float64 copies."""

    soup: SoupArrays
    views: list[ViewRaster]  # rendered
    cameras: list[ViewCamera]
    reference: twin.Raster
    matrices: torch.Tensor  # (B,4,4) float64
    flipped: torch.Tensor  # (B,H,W) bool


def make_case(
    seed: int, count: int = 200, size: tuple[int, int] = (64, 56), views: int = 3, stochastic: bool = True
) -> Case:
    soup = soup_arrays(seed, count)
    matrices = cameras(seed, views, distance=3.0).float()
    keys = [draws.view_key(seed, 17, view) for view in range(views)] if stochastic else None
    drawn = []
    for index, matrix in enumerate(matrices.numpy()):
        drawn.append(ViewRaster(*size))
        drawn[-1].render(soup, make_camera(matrix), BACKGROUND, keys[index] if keys else None)
    vertices, _, opacity, *_ = doubles(soup)
    reference = twin.rasterize(vertices, opacity, matrices.double(), *size, keys)
    seen = np.stack([view.seen() for view in drawn])
    flipped = torch.from_numpy(seen).long() != reference.triangle
    return Case(
        soup, drawn, [make_camera(matrix) for matrix in matrices], reference, matrices.double(), flipped
    )


@pytest.mark.parametrize("stochastic", [True, False])
def test_both_see_the_same_triangles_at_the_same_place(stochastic):
    case = make_case(1, stochastic=stochastic)
    assert case.reference.triangle.bool().float().mean() > 0.2
    assert case.flipped.float().mean() <= FLIPS
    for index, view in enumerate(case.views):
        pixel, _, b0, b1 = (array[: view.covered] for array in view.shown)
        assert np.array_equal(np.sort(pixel), np.flatnonzero(view.seen()))
        same = ~case.flipped[index].reshape(-1).numpy()[pixel]
        expected = (case.reference.b0, case.reference.b1, case.reference.depth)
        for values, image in zip((b0, b1, view.surface.depth[pixel]), expected, strict=True):
            error = np.abs(values - image[index].reshape(-1).numpy()[pixel])[same]
            assert np.quantile(error, 0.99) < 1e-5  # a needle's barycentrics may be worse, but not often
            assert error.max() < 1e-3


@pytest.mark.parametrize("layer", range(6))
def test_a_broken_mlp_shows(layer):
    soup, camera = soup_arrays(2, 60), make_camera(cameras(2, 1)[0].numpy())
    soup.mlp[layer][...] = np.nan
    view = ViewRaster(33, 41)
    view.render(soup, camera, BACKGROUND)
    assert np.array_equal(np.isnan(view.colour), np.broadcast_to(view.seen() > 0, view.colour.shape))


def test_edge_gradient_agrees_for_nearly_every_single_triangle():
    """The gradient of all at any size: test_photometric_step."""
    case = make_case(309, size=(64, 45))
    # A random gradient image of float32 values, 0 within a pixel of a flip.
    near = torch.nn.functional.max_pool2d(case.flipped[:, None].float(), 3, stride=1, padding=1) > 0
    image = torch.randn((len(near), 3, 64, 45), generator=torch.Generator().manual_seed(3))
    gradient = torch.where(near, 0.0, image).double()
    found = np.zeros_like(case.soup.vertices)
    for view, camera, each in zip(case.views, case.cameras, gradient.numpy(), strict=True):
        view.gradient[:] = each
        view.add_edge_gradient(camera.matrix, found)
    vertices, features, _, *weights = doubles(case.soup)
    vertices.requires_grad_()
    background = torch.from_numpy(BACKGROUND).double()
    colour = twin.shade(features, tuple(weights), case.reference, case.matrices, background)
    twin.edge_gradient(colour, vertices, case.reference, case.matrices).backward(gradient)
    expected = vertices.grad
    assert distance(found, expected) < 1e-4
    differences = torch.from_numpy(found).double() - expected
    off, norm = (each.flatten(1).norm(dim=1) for each in (differences, expected))
    assert (off > 1e-2 * norm + 1e-6 * norm.max()).float().mean() < 0.02


def test_edge_gradient_of_one_triangle_all_over_the_image():
    """60,000 pairs of one triangle: their sum keeps its precision."""
    size, soup, camera = (201, 157), soup_arrays(3, 1), make_camera(front_camera()[0].numpy())
    vertices = np.array([[[-9, -8, 0], [10, -7, 1], [0, 12, -1]]], np.float32)
    view = ViewRaster(*size)
    view.render(soup._replace(vertices=vertices, opacity=np.ones((1, 3), np.float32)), camera, BACKGROUND)
    assert view.seen().all()
    draw = torch.Generator().manual_seed(3)
    colour, gradient = (torch.randn(1, 3, *size, generator=draw) for _ in range(2))
    view.colour[:], view.gradient[:] = colour[0], gradient[0]
    found = np.zeros_like(vertices)
    view.add_edge_gradient(camera.matrix, found)
    leaf, matrix = torch.from_numpy(vertices).double(), torch.from_numpy(camera.matrix).double()[None]
    reference = twin.rasterize(leaf, torch.ones(1, 3).double(), matrix, *size, None)
    leaf.requires_grad_()
    twin.edge_gradient(colour.double(), leaf, reference, matrix).backward(gradient.double())
    assert distance(found, leaf.grad) < 2e-6


def test_edge_gradient_of_hidden_triangles_is_none():
    """Behind the camera, beyond a clip plane, without area, covered by another one: not a bit."""
    near = np.array([[-3, -3, 0], [4, -3, 0], [0, 5, 0]])
    others = [near - [0, 0, 9], near + [60, 0, 0], near[[0, 0, 1]], 0.3 * near + [0, 0, 1]]
    vertices, view = np.stack([near, *others]).astype(np.float32), ViewRaster(33, 41)
    soup = soup_arrays(1, 5)._replace(vertices=vertices, opacity=np.ones((5, 3), np.float32))
    camera = make_camera(front_camera()[0].numpy())
    view.render(soup, camera, BACKGROUND)
    view.gradient[:] = stream(1, "gradient").normal(size=view.gradient.shape)
    found = np.zeros_like(vertices)
    view.add_edge_gradient(camera.matrix, found)
    assert found[0].any() and not found[1:].any()


@pytest.mark.parametrize("everywhere", [True, False])
@pytest.mark.parametrize("size", [(50, 43), (23, 64), (67, 22), (11, 12)])
def test_photometric_loss_and_gradient_agree(size, everywhere):
    draw = torch.Generator().manual_seed(6)
    target = torch.nn.functional.interpolate(torch.rand(3, 3, 9, 8, generator=draw), size, mode="bilinear")
    colour = (target + 0.2 * torch.randn(target.shape, generator=draw)).clamp(0, 1)
    if not everywhere:  # equal but for a patch near a corner, and one view equal altogether
        patch = torch.zeros_like(target, dtype=torch.bool)
        patch[:2, :, 3:17, size[1] * 2 // 3 :] = True
        colour = torch.where(patch, colour, target)
    reference = colour.double().requires_grad_()
    expected = twin.photometric_loss(reference, target.double())
    expected.backward()
    view, value, gradients = ViewRaster(*size), 0.0, []
    for shown, image in zip(colour.numpy(), target.numpy(), strict=True):
        view.colour[:] = shown
        value += view.compare(make_target(image), len(colour))
        gradients.append(view.gradient.copy())
    assert value == pytest.approx(expected.item(), rel=1e-5)
    assert distance(np.stack(gradients), reference.grad) < 1e-4


@pytest.mark.parametrize("size", [(22, 67), (31, 16), (45, 23)])
def test_a_target_of_bytes_gives_the_bits_of_its_fractions(size):
    draw = torch.Generator().manual_seed(7)
    levels = torch.randint(0, 256, (3, *size), generator=draw, dtype=torch.uint8).numpy()
    view = ViewRaster(*size)
    view.colour[:] = torch.rand(3, *size, generator=draw).numpy()
    found = []
    for target in (levels, levels / np.float32(255)):
        value = view.compare(make_target(target), 2)
        found.append((value, view.gradient.copy(), view.error[: size[0] * size[1]].copy()))
    assert found[0][0] == found[1][0]
    assert np.array_equal(found[0][1], found[1][1]) and np.array_equal(found[0][2], found[1][2])
    np.testing.assert_allclose(
        found[0][2], np.abs(view.colour - levels / np.float32(255)).sum(0).reshape(-1), rtol=1e-6
    )


def test_a_target_below_the_window_of_ssim_is_refused():
    with pytest.raises(InputError, match="at least 11 × 11 pixels, got 10 × 20"):
        make_target(np.zeros((3, 10, 20), np.float32))


def test_twin_in_single_precision_as_on_cuda_stays_close_to_double():
    soup, matrices = soup_arrays(9, 200), cameras(9, 3, distance=3.0).float()
    keys = [draws.view_key(9, 17, view) for view in range(3)]
    gradients, images = [], []
    for dtype in (torch.float32, torch.float64):
        vertices, features, opacity, *weights = (tensor.to(dtype) for tensor in doubles(soup))
        raster = twin.rasterize(vertices, opacity, matrices.to(dtype), 64, 56, keys)
        vertices.requires_grad_()
        images.append(raster.triangle)
        background = torch.from_numpy(BACKGROUND).to(dtype)
        colour = twin.shade(features, tuple(weights), raster, matrices.to(dtype), background)
        assert colour.dtype == dtype
        twin.edge_gradient(colour, vertices, raster, matrices.to(dtype)).square().sum().backward()
        gradients.append(vertices.grad)
    flips = (images[0] != images[1]).float().mean().item()
    assert flips <= FLIPS
    assert distance(gradients[0].numpy(), gradients[1]) < 1e-3 + 0.1 * bool(flips)
