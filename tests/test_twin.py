"""The torch twin against ray casting, scipy, finite differences, closed forms and plain loops."""

import numba
import numpy as np
import pytest
import scipy.special
import scipy.stats
import torch
import trimesh

from paper_artifact.raster import draws, lanes, twin
from tests.raster_cases import cameras, front_camera, look_at, mlp, soup
from tests.test_image_scores import naive_ssim

KEYS = [draws.view_key(3, 5, view) for view in range(3)]


def fragments(raster: twin.Raster):
    """Yield view, pixel, triangle, depth, b0, b1 and alpha of every fragment."""
    parts = ("view", "pixel", "triangle", "depth", "b0", "b1", "alpha")
    return zip(*(getattr(raster, f"fragment_{part}").tolist() for part in parts), strict=True)


def opaque(vertices: torch.Tensor) -> torch.Tensor:
    return torch.ones(vertices.shape[:2], dtype=vertices.dtype)


def random(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def reference_draw(key: int, pixel: int, triangle: int) -> float:
    """Return the draw by Python's integers: Wellons' lowbias32 of the counters, its upper 24 bits."""
    x = (key + pixel * 0x9E3779B1 + triangle * 0x85EBCA77) % 2**32
    x = (x ^ x >> 16) * 0x7FEB352D % 2**32
    x = (x ^ x >> 15) * 0x846CA68B % 2**32
    return ((x ^ x >> 16) >> 8) / 2**24


@numba.njit
def sixteen_draws(key, pixel, triangle, out):
    lanes.store(out, 0, draws.draw_lanes(key, lanes.iota() + pixel, triangle))


def test_numba_and_torch_draw_the_same_bits_and_they_are_uniform():
    rng = np.random.default_rng(0)
    pixel, triangle = rng.integers(0, 65536, 4000), rng.integers(0, 6000, 4000)
    key = draws.view_key(7, 2500, 71)
    ours = draws.draw_torch(key, torch.from_numpy(pixel), torch.from_numpy(triangle)).numpy()
    expected = np.array([reference_draw(key, int(p), int(t)) for p, t in zip(pixel, triangle, strict=True)])
    assert np.array_equal(ours, expected)
    kernel = np.empty(16, np.float32)
    for start, index in zip(pixel[:200], triangle[:200], strict=True):
        sixteen_draws(np.uint32(key), start, index, kernel)
        assert kernel.tolist() == [reference_draw(key, int(start) + k, int(index)) for k in range(16)]
    neighbours = draws.draw_torch(key, torch.arange(20000), torch.full((20000,), 12)).numpy()
    for sample in (ours, neighbours):
        assert scipy.stats.kstest(sample, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(neighbours[:-1], neighbours[1:])[0, 1]) < 0.03


def test_coverage_and_depth_agree_with_ray_casting():
    vertices = soup(1, 60)["vertices"]
    centre, size = np.array([2.4, -2.9, 1.3]), 40
    matrix = torch.from_numpy(look_at(centre))[None]
    raster = twin.rasterize(vertices, opaque(vertices), matrix, size, size, None)
    directions = -twin.view_directions(matrix, size, size).reshape(-1, 3).numpy()
    mesh = trimesh.Trimesh(vertices.reshape(-1, 3).numpy(), np.arange(180).reshape(-1, 3), process=False)
    caster = trimesh.ray.ray_triangle.RayMeshIntersector(mesh)
    origins = np.tile(centre, (size * size, 1))
    hits, ray, index = caster.intersects_location(origins, directions, multiple_hits=False)
    expected, depth = np.zeros(size * size, int), np.zeros(size * size)
    expected[ray] = index + 1
    clip = np.c_[hits, np.ones(len(hits))] @ matrix[0].numpy().T
    depth[ray] = clip[:, 2] / clip[:, 3]
    ours = raster.triangle.reshape(-1).numpy()
    assert 0.2 < (ours > 0).mean() < 0.9
    assert (ours != expected).mean() < 0.005
    same = (ours == expected) & (ours > 0)
    assert np.allclose(raster.depth.reshape(-1).numpy()[same], depth[same], atol=1e-9)
    b0, b1 = raster.b0.reshape(-1).numpy()[ray], raster.b1.reshape(-1).numpy()[ray]
    corners = vertices.numpy()[index]
    points = np.einsum("kn,nkd->nd", [b0, b1, 1 - b0 - b1], corners)
    assert np.allclose(points[same[ray]], hits[same[ray]], atol=1e-9)


def test_nearest_surviving_fragment_wins_and_every_rejected_triangle_is_absent():
    case, matrices = soup(2, 50), cameras(2, 3)
    case["vertices"][0] *= 100  # one corner behind every camera, or all of it beyond a plane
    case["vertices"][1, 2] = case["vertices"][1, 1]  # no area
    raster = twin.rasterize(case["vertices"], case["opacity"], matrices, 24, 20, KEYS)
    assert not (raster.fragment_triangle == 1).any()
    best: dict[tuple[int, int], tuple[float, int]] = {}
    survived = 0
    for view, pixel, triangle, depth, b0, b1, alpha in fragments(raster):
        corners = case["opacity"][triangle].numpy()
        assert alpha == pytest.approx(corners @ [b0, b1, 1 - b0 - b1], abs=1e-12)
        if alpha >= reference_draw(KEYS[view], pixel, triangle):
            survived += 1
            best[view, pixel] = min(best.get((view, pixel), (2.0, 0)), (depth, triangle + 1))
    assert 0.3 < survived / len(raster.fragment_view) < 0.7
    expected = np.zeros((3, 480), int)
    for (view, pixel), (_, triangle) in best.items():
        expected[view, pixel] = triangle
    assert np.array_equal(raster.triangle.reshape(3, -1).numpy(), expected)


def test_tie_in_depth_goes_to_the_smaller_triangle_and_threshold_is_one_half_without_keys():
    vertices = torch.tensor([[-9.0, -9, 0], [9, -9, 0], [0, 15, 0]], dtype=torch.float64).expand(3, 3, 3)
    opacity = torch.tensor([0.49, 0.5, 0.9], dtype=torch.float64)[:, None].expand(3, 3)
    raster = twin.rasterize(vertices, opacity, front_camera(), 8, 8, None)
    assert (raster.triangle == 2).all()
    assert len(raster.fragment_view) == 3 * 64


def test_spherical_harmonics_agree_with_scipy():
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    polar, azimuth = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    expected = []
    for degree in range(3):
        for order in range(-degree, degree + 1):
            value = scipy.special.sph_harm_y(degree, abs(order), polar, azimuth)
            expected.append((value.imag if order < 0 else value.real) * (np.sqrt(2) if order else 1))
    ours = twin.spherical_harmonics(torch.from_numpy(directions)).numpy()
    assert np.allclose(ours, np.stack(expected, axis=1), atol=1e-12)


def test_shading_of_one_pixel_by_hand_and_background_elsewhere():
    case, weights, matrices = soup(3, 20), mlp(3), cameras(3, 2)
    raster = twin.rasterize(case["vertices"], opaque(case["vertices"]), matrices, 20, 24, None)
    background = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    image = twin.shade(case["features"], weights, raster, matrices, background)
    assert image.shape == (2, 3, 20, 24)
    empty = raster.triangle == 0
    assert torch.equal(image.permute(0, 2, 3, 1)[empty], background.expand(int(empty.sum()), 3))
    view, row, column = torch.nonzero(raster.triangle)[37].tolist()
    b0, b1 = raster.b0[view, row, column], raster.b1[view, row, column]
    corner = case["features"][raster.triangle[view, row, column] - 1]
    f = b0 * corner[0] + b1 * corner[1] + (1 - b0 - b1) * corner[2]
    direction = twin.view_directions(matrices, 20, 24)[view, row, column]
    x = torch.cat([f, twin.spherical_harmonics(direction)])
    for matrix, bias in (weights[0:2], weights[2:4]):
        x = (matrix @ x + bias).clamp(min=0)
    y = 1 / (1 + torch.exp(-(weights[4] @ x + weights[5])))
    assert torch.allclose(image[view, :, row, column], (1 - f[3]) * f[:3] + f[3] * y, atol=1e-12)


def test_photometric_loss_agrees_with_a_plain_double_loop():
    rng = np.random.default_rng(5)
    colour, target = rng.uniform(size=(2, 3, 14, 13)), rng.uniform(size=(2, 3, 14, 13))
    target = 0.5 * (target + colour)
    pairs = [[each.transpose(1, 2, 0) for each in pair] for pair in zip(colour, target, strict=True)]
    similarity = np.mean([naive_ssim(*pair) for pair in pairs])
    expected = 0.8 * np.abs(colour - target).mean() + 0.1 * (1 - similarity)
    ours = twin.photometric_loss(torch.from_numpy(colour), torch.from_numpy(target))
    assert float(ours) == pytest.approx(expected, abs=1e-12)
    assert float(twin.photometric_loss(*[torch.from_numpy(colour)] * 2)) == pytest.approx(0, abs=1e-12)


def test_opacity_gradient_agrees_with_a_plain_loop_and_its_value_is_zero():
    case, matrices = soup(6, 40), cameras(6, 3)
    opacity = case["opacity"].clone().requires_grad_()
    raster = twin.rasterize(case["vertices"], case["opacity"], matrices, 18, 16, KEYS)
    colour, target = random(6, 2, 3, 3, 18, 16)
    value = twin.opacity_gradient(opacity, colour, target, raster)
    assert value.item() == 0.0
    (3 * value).backward()
    expected = np.zeros((40, 3))
    for view, pixel, triangle, depth, b0, b1, alpha in fragments(raster):
        row, column = divmod(pixel, 16)
        shown = int(raster.triangle[view, row, column]) - 1
        if shown >= 0 and depth > raster.depth[view, row, column]:
            continue
        error = float((colour - target)[view, :, row, column].abs().sum())
        factor = error / max(alpha, 1e-5) if shown == triangle else -error / max(1 - alpha, 1e-5)
        expected[triangle] += 3 * factor * np.array([b0, b1, 1 - b0 - b1]) / (3 * 18 * 16 * 3)
    assert np.allclose(opacity.grad.numpy(), expected, rtol=1e-9, atol=1e-15)
    assert np.abs(expected).max() > 1e-3


PALETTE = torch.tensor([[1.0, 1.0, 1.0], [0.2, 0.6, 0.1], [0.9, 0.1, 0.5]], dtype=torch.float64)


FLOATING = [[-0.9, -0.8, -0.5], [0.8, -0.3, 0.1], [-0.1, 0.9, -0.2]]
WALL = [[-60.0, -60.0, 0.4], [60.0, -60.0, 0.4], [0.0, 90.0, 0.4]]
SCENES = {
    "border": [FLOATING, WALL],
    "opacity": [FLOATING, WALL],
    "slanted crossing": [
        [[-4.0, -5.0, -2.2], [4.0, -6.0, 0.0], [-1.0, 9.0, 1.5]],
        [[-9.0, -9.0, 1.35], [9.0, -9.0, -0.45], [0.0, 15.0, -0.75]],
    ],
    "upright crossing": [
        [[-6.0, -5.0, -1.5], [6.0, -6.0, 1.5], [0.0, 9.0, 0.0]],
        [[-9.0, -9.0, 1.0], [9.0, -9.0, -0.8], [0.0, 15.0, 0.1]],
    ],
}


def project(points: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
    clip = points @ matrix[:, :3].T + matrix[:, 3]
    return clip[..., :3] / clip[..., 3:]


def visible_outline(edge: str, ndc: torch.Tensor, alpha_edge: torch.Tensor) -> torch.Tensor:
    """Return the outline (k,2) in NDC of where triangle 0 is seen, from the NDC corners (2,3,3)."""
    if edge == "border":
        return ndc[0, :, :2]
    if edge == "opacity":  # the line alpha = .5 cuts the sides 01 and 02
        return torch.stack([alpha_edge[0], ndc[0, 1, :2], ndc[0, 2, :2], alpha_edge[1]])
    planes = torch.linalg.solve(torch.cat([ndc[..., :2], torch.ones_like(ndc[..., :1])], dim=-1), ndc[..., 2])
    along_x, along_y, constant = planes[0] - planes[1]
    assert along_x.item() > 0  # triangle 0 is the nearer one on the left
    low, high = (along_y - constant) / along_x, -(along_y + constant) / along_x
    assert max(abs(low.item()), abs(high.item())) < 1
    corner = -torch.ones_like(low)
    corners = ((corner, corner), (low, corner), (high, -corner), (corner, -corner))
    return torch.stack([torch.stack(pair) for pair in corners])


@pytest.mark.parametrize("edge", list(SCENES))
def test_vertex_gradients_agree_with_the_derivative_of_the_exact_integral(edge):
    """L = Σ linear weights · constant colours; without pixels it is a polygon's integral, a closed form.

    At a crossing line that is slanted in the image DiffSoup pushes z once for the row neighbours and once for
    the column neighbours, so z counts about twice there: only x and y are compared on that line.
    """
    size, matrix = 256, front_camera(focal=2.6)[0]
    vertices = torch.tensor(SCENES[edge], dtype=torch.float64)
    opacity = opaque(vertices)
    if edge == "opacity":
        opacity[0] = torch.tensor([0.1, 0.9, 0.75], dtype=torch.float64)
    centre = torch.arange(size, dtype=torch.float64) + 0.5
    slope = torch.tensor([[0.01, -0.004], [0.0, 0.02], [-0.013, 0.003]], dtype=torch.float64)
    across, down = slope.T[..., None, None]
    weights = 1 + across * centre + down * centre[:, None]
    leaf = vertices.clone().requires_grad_()
    raster = twin.rasterize(vertices, opacity, matrix[None], size, size, None)
    colour = PALETTE[raster.triangle].permute(0, 3, 1, 2)
    (twin.edge_gradient(colour, leaf, raster, matrix[None]) * weights).sum().backward()

    moved = vertices.clone().requires_grad_()
    part = torch.tensor([0.5, 0.4 / 0.65], dtype=torch.float64)[:, None]
    alpha_edge = project(moved[0, 0] + part * (moved[0, 1:] - moved[0, 0]), matrix)[:, :2]
    ndc = project(moved, matrix)
    outline = (visible_outline(edge, ndc, alpha_edge) + 1) * size / 2
    assert outline.min().item() >= 0 and outline.max().item() <= size
    one, two = outline[1:-1] - outline[0], outline[2:] - outline[0]
    area = (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    centroid = (outline[0] + outline[1:-1] + outline[2:]) / 3
    integral = (area * (1 + slope @ centroid.T)).sum(1) * torch.sign(area.detach().sum())
    assert area.sum().abs().item() > 4000
    ((PALETTE[1] - PALETTE[2]) * integral).sum().backward()
    axes = slice(0, 2 if edge == "slanted crossing" else 3)
    expected, found = moved.grad[..., axes], leaf.grad[..., axes]
    assert ((found - expected).abs().max() / expected.abs().max()).item() < 0.02


def test_colours_pass_through_the_edge_gradient_and_of_no_triangle_there_is_none():
    for count in (12, 0):
        case, matrices = soup(8, count), cameras(8, 2)
        raster = twin.rasterize(case["vertices"], case["opacity"], matrices, 15, 15, None)
        colour, weights = random(8, 2, 3, 15, 15).requires_grad_(), random(9, 2, 3, 15, 15)
        image = twin.edge_gradient(colour, case["vertices"].requires_grad_(), raster, matrices)
        (image * weights).sum().backward()
        assert torch.equal(image, colour) and torch.equal(colour.grad, weights)
        gradient = case["vertices"].grad
        assert gradient.shape == (count, 3, 3) and bool(gradient.any()) == (count > 0)
        assert torch.isfinite(gradient).all() and bool(raster.triangle.any()) == (count > 0)
