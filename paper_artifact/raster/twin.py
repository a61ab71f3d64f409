"""The rasterizer's twin in plain torch: shading, edge gradient, opacity gradient, photometric loss.

Same semantics as the numba path, in other terms: whatever is ordinary autograd is left to autograd, and the
whole batch is handled at once. In float64 on the CPU it is the reference of the tests; in float32 it is the
path on CUDA (sums by index are not bit-reproducible there). Frames and `Raster` as in `twin_visibility`. The
three backward paths are DiffSoup's: colour → features and MLP; error → opacity; colour edges → vertices
(EdgeGrad: Pidhorskyi et al., "Rasterized Edge Gradients: Handling Discontinuities Differentiably", ECCV
2024).
"""

from __future__ import annotations

import torch
from torch.nn import functional

from paper_artifact.raster.twin_visibility import Raster as Raster
from paper_artifact.raster.twin_visibility import corner_weights, pixel_centres, to_clip
from paper_artifact.raster.twin_visibility import rasterize as rasterize
from paper_artifact.ssim import WINDOW, gaussian_window, similarity

_FLOOR = 1e-5  # of a chance that the opacity gradient divides by

MLP = tuple[torch.Tensor, ...]  # w1, c1, w2, c2, w3, c3: see `shade`


def view_directions(world_to_clip: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Return unit world-space directions (B,H,W,3) from what is seen at each pixel centre to the camera.

    world_to_clip (B,4,4) must be perspective with w the depth in front of the camera. Along a viewing ray
    away from the camera, (clip x, clip y, w) grows in proportion to (x, y, 1), so the direction needs rows x,
    y, w only: no near or far.
    """
    x, y = pixel_centres(
        torch.arange(height * width, device=world_to_clip.device), height, width, world_to_clip.dtype
    )
    inverse = torch.linalg.inv(world_to_clip[:, [0, 1, 3], :3])
    away = torch.einsum("bij,pj->bpi", inverse, torch.stack([x, y, torch.ones_like(x)], dim=-1))
    return -functional.normalize(away, dim=-1).reshape(-1, height, width, 3)


def spherical_harmonics(direction: torch.Tensor) -> torch.Tensor:
    """Return the 9 real spherical harmonics of degrees 0–2 (...,9) of unit directions (...,3).

    Order (degree, order): (0,0), (1,-1), (1,0), (1,1), (2,-2) … (2,2), orthonormal on the sphere, with the
    Condon–Shortley sign (odd orders negative), as in graphics codes since 3-D Gaussian splatting.
    """
    x, y, z = direction.unbind(-1)
    constant = torch.full_like(x, 0.5 / torch.pi**0.5)
    first = (3 / (4 * torch.pi)) ** 0.5
    second = (15 / (4 * torch.pi)) ** 0.5
    zonal = (5 / (16 * torch.pi)) ** 0.5
    return torch.stack(
        [
            constant,
            -first * y,
            first * z,
            -first * x,
            second * x * y,
            -second * y * z,
            zonal * (2 * z * z - x * x - y * y),
            -second * x * z,
            second / 2 * (x * x - y * y),
        ],
        dim=-1,
    )


def shade(
    features: torch.Tensor, mlp: MLP, raster: Raster, world_to_clip: torch.Tensor, background: torch.Tensor
) -> torch.Tensor:
    """Return the colour image (B,3,H,W) of a raster, differentiable in features and MLP by ordinary autograd.

    features (T,3,7) in [0, 1] per corner (after the sigmoid): base colour, blend r, three latent; mlp = (w1
    (16,16), c1 (16), w2 (16,16), c2 (16), w3 (3,16), c3 (3)), layers x @ w.T + c with ReLU between and a
    sigmoid at the end; background (3,). Input of the MLP: the 7 interpolated features, then the 9 spherical
    harmonics of the direction towards the camera; colour = (1 - r)·base + r·output.
    """
    views, height, width = raster.triangle.shape
    flat = raster.triangle.reshape(-1)
    hit = torch.nonzero(flat)[:, 0]
    b0, b1 = raster.b0.reshape(-1)[hit], raster.b1.reshape(-1)[hit]
    barycentrics = torch.stack([b0, b1, 1 - b0 - b1], dim=-1)
    interpolated = torch.einsum("pi,pif->pf", barycentrics, features[flat[hit] - 1])
    harmonics = spherical_harmonics(view_directions(world_to_clip, height, width).reshape(-1, 3)[hit])
    w1, c1, w2, c2, w3, c3 = mlp
    hidden = torch.relu(torch.cat([interpolated, harmonics], dim=-1) @ w1.T + c1)
    output = torch.sigmoid(torch.relu(hidden @ w2.T + c2) @ w3.T + c3)
    blend = interpolated[:, 3:4]
    colour = (1 - blend) * interpolated[:, :3] + blend * output
    image = background.to(colour).expand(flat.numel(), 3).index_put((hit,), colour)
    return image.reshape(views, height, width, 3).permute(0, 3, 1, 2)


def opacity_gradient(
    opacity: torch.Tensor, colour: torch.Tensor, target: torch.Tensor, raster: Raster
) -> torch.Tensor:
    """Return a scalar that is exactly 0 and whose gradient in opacity (T,3) is DiffSoup's opacity path.

    colour and target are (B,3,H,W), both taken as constants; opacity (T,3) in [0, 1] must be the one
    rasterized. With e = Σ_c |colour - target| at the pixel, every fragment at or in front of the visible
    depth contributes e / max(alpha, 1e-5) if it is the visible one, else -e / max(1 - alpha, 1e-5), over
    B·H·W·3, times its barycentrics to the corners.
    """
    with torch.no_grad():
        views, height, width = raster.triangle.shape
        error = (colour - target).abs().sum(1).reshape(-1)
        slot = raster.fragment_view * (height * width) + raster.fragment_pixel
        winner = raster.triangle.reshape(-1)[slot]
        reached = torch.nonzero((winner == 0) | (raster.fragment_depth <= raster.depth.reshape(-1)[slot]))[
            :, 0
        ]
        slot, winner, triangle = slot[reached], winner[reached], raster.fragment_triangle[reached]
        alpha = raster.fragment_alpha[reached]
        factor = torch.where(
            winner == triangle + 1, 1 / alpha.clamp(min=_FLOOR), -1 / (1 - alpha).clamp(min=_FLOOR)
        )
        factor = factor * error[slot] / (views * height * width * 3)
        b0, b1 = raster.fragment_b0[reached], raster.fragment_b1[reached]
        shares = factor[:, None] * torch.stack([b0, b1, 1 - b0 - b1], dim=-1)
        gradient = torch.zeros_like(opacity).index_add_(0, triangle, shares)
    value = (gradient * opacity).sum()
    return value - value.detach()


def edge_gradient(
    colour: torch.Tensor, vertices: torch.Tensor, raster: Raster, world_to_clip: torch.Tensor
) -> torch.Tensor:
    """Return colour (B,3,H,W) unchanged; its backward adds the edge gradient of vertices (T,3,3), world.

    The gradient with respect to colour passes unchanged. For every covered pixel p and each of its four
    neighbours q, with a = Σ_c ½(g_p + g_q)(c_p - c_q) and d the pixel step in NDC^-1 (±W/2 or ±H/2), a·d
    pushes p's triangle at the midpoint (one triangle on both; or p's triangle goes on under q and q's is
    farther or background), at the crossing of the triangle's border (q outside it, and farther or
    background), or, where two triangles pass through each other between p and q, along p's normal as far as
    that moves the crossing line. Summed over the views.

    Two habits of DiffSoup are kept as they are: a pair inside one triangle is met from both its pixels and so
    counts twice, and a crossing line that is slanted in the image gets its z part from row and column
    neighbours both. Borders and opacity edges are met once and agree with the derivative of the exact
    integral (tests/test_twin.py).
    """
    return _EdgeGradient.apply(colour, vertices, raster, world_to_clip)


class _EdgeGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, colour, vertices, raster, world_to_clip):
        ctx.save_for_backward(colour, vertices, world_to_clip)
        ctx.raster = raster
        return colour.view_as(colour)

    @staticmethod
    def backward(ctx, grad_colour):
        colour, vertices, world_to_clip = ctx.saved_tensors
        if not ctx.needs_input_grad[1]:
            return grad_colour, None, None, None
        return (
            grad_colour,
            _vertex_gradient(colour, grad_colour, vertices, ctx.raster, world_to_clip),
            None,
            None,
        )


def _pairs(
    colour: torch.Tensor, grad_colour: torch.Tensor, triangle: torch.Tensor
) -> tuple[torch.Tensor, ...]:
    """Return (slot of p, slot of q, step x, step y, adjoint a), each (N,), for pixels p and neighbours q.

    Only pairs with p covered and a ≠ 0. A slot is view·H·W + row·W + column.
    """
    _, height, width = triangle.shape
    slot = torch.nonzero(triangle.reshape(-1))[:, 0]
    step = torch.tensor([[1, 0], [-1, 0], [0, -1], [0, 1]], device=triangle.device)
    column, row = slot % width + step[:, :1], slot // width % height + step[:, 1:]
    direction, index = torch.nonzero(
        (column >= 0) & (column < width) & (row >= 0) & (row < height), as_tuple=True
    )
    p, step_x, step_y = slot[index], step[direction, 0], step[direction, 1]
    q = p + step_y * width + step_x
    c, g = (image.permute(0, 2, 3, 1).reshape(-1, image.shape[1]) for image in (colour, grad_colour))
    adjoint = ((g[p] + g[q]) * (c[p] - c[q])).sum(-1) / 2
    active = torch.nonzero(adjoint)[:, 0]
    return p[active], q[active], step_x[active], step_y[active], adjoint[active]


def _crossing_motion(own: torch.Tensor, other: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return (N,3) d(crossing coordinate)/d(NDC point of own) for two planes crossing.

    In the plane of `axis` (0 x, 1 y) and z. own and other (N,3,4) are clip corners; where the planes are
    (nearly) parallel there, the motion is 0.
    """

    def normal(corners: torch.Tensor) -> torch.Tensor:
        ndc = corners[..., :3] / corners[..., 3:]
        direction = torch.linalg.cross(ndc[:, 1] - ndc[:, 0], ndc[:, 2] - ndc[:, 0])
        return functional.normalize(
            torch.stack([direction.gather(1, axis[:, None])[:, 0], direction[:, 2]], -1), dim=-1
        )

    moving, fixed = normal(own), normal(other)
    along = torch.stack([-fixed[:, 1], fixed[:, 0]], dim=-1)
    projected = (along * moving).sum(-1)
    crossing = projected.abs() > 1e-12
    motion = torch.where(crossing, along[:, 0] / torch.where(crossing, projected, 1.0), 0.0)[:, None] * moving
    result = torch.zeros_like(own[:, 0, :3])
    result[:, 2] = motion[:, 1]
    return result.scatter(1, axis[:, None], motion[:, :1])


def _border_crossing(
    own: torch.Tensor, weights_p: torch.Tensor, weights_q: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (weights (N,3), fraction (N,)) where the segment from p (inside) to q first leaves the triangle.

    weights_p, weights_q (N,3) are λ_i / w_i, which are linear along the segment; the corner opposite the
    crossed edge gets exactly 0, so only the edge's own two corners move.
    """
    inside = weights_p.clamp(min=0)
    fraction = torch.where(weights_q < 0, inside / (inside - weights_q), torch.inf)
    first, corner = fraction.min(dim=-1)
    weights = (
        (weights_p + first[:, None] * (weights_q - weights_p)).clamp(min=0).scatter(1, corner[:, None], 0.0)
    )
    return weights / (weights * own[..., 3]).sum(-1, keepdim=True), first


def _vertex_gradient(
    colour: torch.Tensor,
    grad_colour: torch.Tensor,
    vertices: torch.Tensor,
    raster: Raster,
    world_to_clip: torch.Tensor,
) -> torch.Tensor:
    """Return the edge gradient (T,3,3) in world space; see `edge_gradient`."""
    _, height, width = raster.triangle.shape
    p, q, step_x, step_y, adjoint = _pairs(colour, grad_colour, raster.triangle)
    view = p // (height * width)
    clip = to_clip(vertices, world_to_clip)
    triangle, depth = raster.triangle.reshape(-1) - 1, raster.depth.reshape(-1)
    own_index, other_index = triangle[p], triangle[q]
    own, other = clip[view, own_index], clip[view, other_index.clamp(min=0)]
    x_p, y_p = pixel_centres(p % (height * width), height, width, clip.dtype)
    x_q, y_q = pixel_centres(q % (height * width), height, width, clip.dtype)
    weights_p, _ = corner_weights(own, x_p, y_p)
    weights_q, continues = corner_weights(own, x_q, y_q)
    own_depth_q = (weights_q * own[..., 2]).sum(-1)
    other_weights_p, other_covers_p = corner_weights(other, x_p, y_p)
    other_depth_p = (other_weights_p * other[..., 2]).sum(-1)

    same = own_index == other_index
    hit = other_index >= 0
    front = ~hit | (depth[p] < depth[q])
    hidden = ~same & continues & hit & (depth[q] < own_depth_q)
    intersection = hidden & other_covers_p & (depth[p] < other_depth_p)
    midpoint = same | (continues & ~hidden & front)
    border = ~same & ~continues & front

    crossing_weights, fraction = _border_crossing(own, weights_p, weights_q)
    fraction = torch.where(border, fraction, 0.5)
    weights = torch.where(border[:, None], crossing_weights, (weights_p + weights_q) / 2)
    unit = torch.stack([step_x, step_y, torch.zeros_like(step_x)], dim=-1).to(clip.dtype)
    size = torch.tensor([width / 2, height / 2, 1], dtype=clip.dtype, device=clip.device)
    push = adjoint[:, None] * unit * size
    motion = _crossing_motion(own, other, (step_x == 0).long())
    push = torch.where(intersection[:, None], push.sum(-1, keepdim=True) * motion, push)

    z_point = (weights * own[..., 2]).sum(-1)
    point = torch.stack([x_p + fraction * (x_q - x_p), y_p + fraction * (y_q - y_p), z_point], dim=-1)
    push = torch.cat([push, -(push * point).sum(-1, keepdim=True)], dim=-1)
    used = torch.nonzero(midpoint | border | intersection)[:, 0]
    shares = weights[used, :, None] * push[used, None, :]
    flat = clip.new_zeros(clip.shape[0] * clip.shape[1], 3, 4).index_add_(
        0, view[used] * clip.shape[1] + own_index[used], shares
    )
    return torch.einsum("btir,brk->tik", flat.reshape(clip.shape), world_to_clip[:, :, :3])


def photometric_loss(colour: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the scalar .8·mean|target - colour| + .2·½(1 - SSIM) of images (B,3,H,W) in [0, 1].

    H and W are at least 11; SSIM is that of `paper_artifact.ssim`, the mean over windows, channels and views.
    """
    window = torch.tensor(gaussian_window(), dtype=colour.dtype, device=colour.device)

    def blur(image: torch.Tensor) -> torch.Tensor:
        plane = functional.conv2d(image.reshape(-1, 1, *image.shape[2:]), window.reshape(1, 1, WINDOW, 1))
        return functional.conv2d(plane, window.reshape(1, 1, 1, WINDOW))

    dissimilarity = 1 - similarity(colour, target, blur).mean()
    return 0.8 * (target - colour).abs().mean() + 0.2 * dissimilarity / 2
