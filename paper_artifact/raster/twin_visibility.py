"""Fragments and depth test in plain torch: the visibility half of the rasterizer's twin.

Same semantics as the numba kernels (the forward raster of DiffSoup, the trainer that the paper builds on),
written from the facts in different terms, so that each checks the other. Dtype and device follow the inputs:
float64 on the CPU in the tests, float32 on CUDA for training there.

Frames: clip = world_to_clip @ (x, y, z, 1) with w the depth in front of the camera; NDC = xyz / w, y down;
the centre of pixel (row r, column c) is at NDC ((2c+1)/W - 1, (2r+1)/H - 1). `pixel` is the row-major index
r·W + c.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from paper_artifact.raster.draws import draw_torch


class Raster(NamedTuple):
    """Visible surface of B views, and the F fragments it was chosen from; no gradient flows through it.

    Fragments are every pixel centre that a triangle covers within the depth range, before opacity masking.
    """

    triangle: torch.Tensor  # (B,H,W) int64: 0 = background, else index + 1
    b0: torch.Tensor  # (B,H,W) perspective-correct barycentric of corner 0; 0 on background
    b1: torch.Tensor  # (B,H,W) of corner 1; corner 2 has 1 - b0 - b1
    depth: torch.Tensor  # (B,H,W) NDC z in [-1,1]; 0 on background
    fragment_view: torch.Tensor  # (F,) int64
    fragment_pixel: torch.Tensor  # (F,) int64, row-major index
    fragment_triangle: torch.Tensor  # (F,) int64
    fragment_b0: torch.Tensor  # (F,)
    fragment_b1: torch.Tensor  # (F,)
    fragment_depth: torch.Tensor  # (F,) NDC z
    fragment_alpha: torch.Tensor  # (F,) opacity in [0,1] at the pixel


def to_clip(vertices: torch.Tensor, world_to_clip: torch.Tensor) -> torch.Tensor:
    """Return clip-space corners (B,T,3,4) of world-space corners (T,3,3) under matrices (B,4,4)."""
    rotated = torch.einsum("brk,tik->btir", world_to_clip[:, :, :3], vertices)
    return rotated + world_to_clip[:, None, None, :, 3]


def pixel_centres(
    pixel: torch.Tensor, height: int, width: int, dtype: torch.dtype
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return NDC x and y (shaped as `pixel`) of row-major pixel indices in an image of height × width."""
    column, row = pixel % width, pixel // width
    return (2 * column + 1).to(dtype) / width - 1, (2 * row + 1).to(dtype) / height - 1


def corner_weights(
    corners: torch.Tensor, x: torch.Tensor, y: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (weights (F,3), inside (F,) bool) of NDC points (x, y) in triangles of clip corners.

    x, y (F,), corners (F,3,4).

    weights_i = λ_i / w_i, λ the affine screen-space barycentrics. From it everything else follows: Σ weights
    = 1/w, perspective-correct barycentrics b = weights / Σ weights, and NDC z = Σ weights_i · clip z_i (as Σ
    weights_i w_i = 1). inside includes the border; triangles without area on the screen contain nothing
    (their weights are 0). Homogeneous edge functions as in Olano & Greer, "Triangle scan conversion using 2D
    homogeneous coordinates" (1997), evaluated relative to the point, which keeps small triangles accurate in
    float32.
    """
    w = corners[..., 3]
    dx, dy = corners[..., 0] - x[..., None] * w, corners[..., 1] - y[..., None] * w
    following, last = [1, 2, 0], [2, 0, 1]
    area = dx[..., following] * dy[..., last] - dy[..., following] * dx[..., last]
    determinant = (area * w).sum(-1)
    sized = (determinant != 0) & (area.sum(-1) != 0)
    weights = torch.where(sized[..., None], area / torch.where(sized, determinant, 1.0)[..., None], 0.0)
    return weights, sized & (weights >= 0).all(-1)


def _candidates(
    clip: torch.Tensor, height: int, width: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return (view, triangle, pixel), each (N,) int64: the pixels in boxes of triangles worth testing.

    Skipped: triangles with a corner at w <= 0 (or not finite) and triangles with all corners beyond one clip
    plane.
    """
    views, triangles = clip.shape[:2]
    w = clip[..., 3]
    kept = (w > 0).all(-1) & torch.isfinite(clip).all(-1).all(-1)
    beyond = torch.cat([clip[..., :3] < -w[..., None], clip[..., :3] > w[..., None]], dim=-1)
    kept &= ~beyond.all(dim=2).any(-1)
    ndc = clip[..., :2] / torch.where(kept[..., None], w, 1.0)[..., None]
    size = torch.tensor([width, height], device=clip.device)
    position = (ndc.clamp(-1, 1) + 1) * size / 2
    first = position.amin(2).floor().long()
    final = torch.minimum(position.amax(2).floor().long(), size - 1)
    first, extent = first.reshape(-1, 2), (final - first + 1).clamp(min=0).reshape(-1, 2)
    counts = torch.where(kept.reshape(-1), extent[:, 0] * extent[:, 1], 0)
    owner = torch.repeat_interleave(torch.arange(views * triangles, device=clip.device), counts)
    local = torch.arange(owner.numel(), device=clip.device) - (counts.cumsum(0) - counts)[owner]
    column = first[owner, 0] + local % extent[owner, 0]
    row = first[owner, 1] + local // extent[owner, 0]
    return owner // triangles, owner % triangles, row * width + column


def _thresholds(
    keys: list[int] | None, view: torch.Tensor, pixel: torch.Tensor, triangle: torch.Tensor
) -> torch.Tensor:
    """Return each fragment's opacity threshold (F,) float64: its uniform draw, or .5 when keys is None."""
    thresholds = torch.full(view.shape, 0.5, dtype=torch.float64, device=view.device)
    for index, key in enumerate(keys or []):
        mine = view == index
        thresholds[mine] = draw_torch(key, pixel[mine], triangle[mine])
    return thresholds


def _winners(slot: torch.Tensor, depth: torch.Tensor, triangle: torch.Tensor, slots: int) -> torch.Tensor:
    """Return the indices of the fragments that win their slot: smallest depth, then smallest triangle."""
    nearest = torch.full((slots,), torch.inf, dtype=depth.dtype, device=depth.device)
    nearest = nearest.scatter_reduce(0, slot, depth, "amin")
    tied = torch.nonzero(depth == nearest[slot])[:, 0]
    lowest = torch.full((slots,), torch.iinfo(torch.int64).max, device=depth.device)
    lowest = lowest.scatter_reduce(0, slot[tied], triangle[tied], "amin")
    return tied[triangle[tied] == lowest[slot[tied]]]


@torch.no_grad()
def rasterize(
    vertices: torch.Tensor,
    opacity: torch.Tensor,
    world_to_clip: torch.Tensor,
    height: int,
    width: int,
    keys: list[int] | None,
) -> Raster:
    """Return the `Raster` of a soup in B views of height × width pixels.

    vertices (T,3,3) world space, every triangle owning its corners; opacity (T,3) in [0, 1] per corner;
    world_to_clip (B,4,4); keys: one 32-bit key per view (`draws.view_key`), or None for the fixed threshold
    .5 of evaluation. A fragment survives iff its alpha (perspective-correct interpolation of the corner
    opacities) is at least its threshold; the nearest survivor takes the pixel, ties go to the smallest
    triangle index.
    """
    views = len(world_to_clip)
    clip = to_clip(vertices, world_to_clip)
    view, triangle, pixel = _candidates(clip, height, width)
    corners = clip[view, triangle]
    weights, inside = corner_weights(corners, *pixel_centres(pixel, height, width, clip.dtype))
    depth = (weights * corners[..., 2]).sum(-1)
    covered = torch.nonzero(inside & (depth >= -1) & (depth <= 1))[:, 0]
    view, triangle, pixel, depth, weights = (
        part[covered] for part in (view, triangle, pixel, depth, weights)
    )
    barycentrics = weights / weights.sum(-1, keepdim=True)
    alpha = (opacity[triangle] * barycentrics).sum(-1)

    survivors = torch.nonzero(alpha >= _thresholds(keys, view, pixel, triangle))[:, 0]
    slot = view * (height * width) + pixel
    slots = views * height * width
    best = survivors[_winners(slot[survivors], depth[survivors], triangle[survivors], slots)]

    def image(values: torch.Tensor) -> torch.Tensor:
        return values.new_zeros(slots).index_put_((slot[best],), values[best]).reshape(views, height, width)

    b0, b1 = barycentrics[:, 0], barycentrics[:, 1]
    return Raster(
        image(triangle + 1), image(b0), image(b1), image(depth), view, pixel, triangle, b0, b1, depth, alpha
    )
