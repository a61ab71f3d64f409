"""The differentiable rasterizer on the CPU: torch functions over the numba kernels.

A step reads: raster = rasterize(...); colour = shade(...); aux = opacity_gradient(...); colour = edge_gradient(...); loss =
photometric_loss(...) + aux. All tensors are float32 on the CPU, images planar (B,3,H,W) in [0,1]; vertices (T,3,3) are world
positions of the corners that each triangle owns. `paper_artifact.raster.twin` has the same functions in plain torch (any float
dtype, any device): the tests hold these to that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from paper_artifact.raster import edges, photometric, shading
from paper_artifact.raster.threads import run_jobs
from paper_artifact.raster.visibility import ViewRaster, to_clip


class RasterBuffers:
    """Reusable per-view buffers; a raster made with them is valid until the next one is."""

    def __init__(self) -> None:
        self._views: list[ViewRaster] = []
        self._activations: list[np.ndarray] = []

    def view(self, index: int, height: int, width: int) -> ViewRaster:
        """Return the buffers of slot `index`, made anew when the image size changes."""
        while len(self._views) <= index:
            self._views.append(ViewRaster(height, width))
        if (self._views[index].height, self._views[index].width) != (height, width):
            self._views[index] = ViewRaster(height, width)
        return self._views[index]

    def activations(self, index: int, blocks: int) -> np.ndarray:
        """Return slot `index`'s shading activations with room for `blocks` blocks."""
        while len(self._activations) <= index:
            self._activations.append(np.empty((0, shading.ROWS, shading.BLOCK), np.float32))
        if len(self._activations[index]) < blocks:
            self._activations[index] = np.empty((blocks, shading.ROWS, shading.BLOCK), np.float32)
        return self._activations[index]


@dataclass(frozen=True)
class Raster:
    """A batch's visibility: one `ViewRaster` per view, with the cameras it was made with."""

    views: list[ViewRaster]
    world_to_clip: np.ndarray  # (B,4,4) float32
    rays: np.ndarray  # (B,3,3) float32, see `camera_rays`
    triangles: int
    height: int
    width: int
    buffers: RasterBuffers

    def triangle_image(self) -> np.ndarray:
        """Return (B,H,W) int32: the visible triangle's index + 1, 0 where there is none."""
        return np.stack([view.triangle.reshape(self.height, self.width) + 1 for view in self.views])


def camera_rays(world_to_clip: np.ndarray) -> np.ndarray:
    """Return (…,3,3) float32 rows (r0, rx, ry): r0 + rx·ndc_x + ry·ndc_y points from the surface to the camera (world, not unit).

    Follows from clip rows x, y, w of world_to_clip (…,4,4): at unit step of w the ray moves by inverse(M[[0,1,3],:3])·(ndc_x,
    ndc_y, 1).
    """
    inverse = -np.linalg.inv(np.asarray(world_to_clip, np.float64)[..., [0, 1, 3], :3])
    return np.ascontiguousarray(np.stack([inverse[..., 2], inverse[..., 0], inverse[..., 1]], -2), np.float32)


def _array(tensor: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy(), np.float32)


def rasterize(
    vertices: torch.Tensor,
    opacity: torch.Tensor,
    world_to_clip: np.ndarray,
    height: int,
    width: int,
    keys: list[int] | None,
    buffers: RasterBuffers | None = None,
) -> Raster:
    """Raster the soup into every view; not differentiable itself.

    vertices (T,3,3) float32 world, opacity (T,3) float32 in [0,1], world_to_clip (B,4,4); keys: one draw key per view
    (`draws.view_key`) for stochastic masking, None for the threshold .5.
    """
    corners = _array(vertices).reshape(-1, 3)
    alpha = _array(opacity)
    matrices = np.ascontiguousarray(world_to_clip, np.float32)
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    buffers = buffers or RasterBuffers()
    views = [buffers.view(index, height, width) for index in range(len(matrices))]

    def job(index: int) -> None:
        views[index].draw(
            to_clip(corners, matrices[index]), faces, alpha, None if keys is None else keys[index]
        )

    run_jobs(job, len(views))
    return Raster(views, matrices, camera_rays(matrices), len(faces), height, width, buffers)


class _Shade(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features, w1, c1, w2, c2, w3, c3, raster, background):
        arrays = [_array(tensor) for tensor in (features, w1, c1, w2, c2, w3, c3)]
        size = raster.height * raster.width
        colour = np.empty((len(raster.views), 3, size), np.float32)
        colour[:] = np.asarray(background, np.float32)[:, None]

        def job(index: int) -> None:
            view = raster.views[index]
            blocks = -(-view.covered // shading.BLOCK)
            shading.shade_forward(
                view.pixels,
                view.covered,
                view.visible,
                view.fragment_index,
                view.fragment_value,
                raster.width,
                raster.height,
                raster.rays[index],
                *arrays,
                raster.buffers.activations(index, blocks),
                colour[index],
            )

        for index in range(len(raster.views)):
            raster.buffers.activations(index, 0)  # make the slots here: jobs may run on several threads
        run_jobs(job, len(raster.views))
        ctx.raster, ctx.arrays = raster, arrays
        return torch.from_numpy(colour.reshape(-1, 3, raster.height, raster.width))

    @staticmethod
    def backward(ctx, gradient):
        raster = ctx.raster
        _, w1, _, w2, _, w3, _ = ctx.arrays
        incoming = _array(gradient).reshape(len(raster.views), 3, -1)
        outputs = [np.zeros((len(raster.views), *array.shape), np.float32) for array in ctx.arrays]

        def job(index: int) -> None:
            view = raster.views[index]
            shading.shade_backward(
                view.pixels,
                view.covered,
                view.visible,
                view.fragment_index,
                view.fragment_value,
                w1,
                w2,
                w3,
                raster.buffers.activations(index, 0),
                incoming[index],
                *(output[index] for output in outputs),
            )

        run_jobs(job, len(raster.views))
        return (*(torch.from_numpy(output.sum(0)) for output in outputs), None, None)


def shade(
    features: torch.Tensor, mlp: tuple[torch.Tensor, ...], raster: Raster, background: np.ndarray
) -> torch.Tensor:
    """Return colour (B,3,H,W): features (T,3,7) in [0,1] interpolated and shaded where visible, background (3,) elsewhere.

    mlp = (w1 (16,16), c1 (16,), w2 (16,16), c2 (16,), w3 (3,16), c3 (3,)). Differentiable in features and mlp.
    """
    return _Shade.apply(features, *mlp, raster, background)


class _EdgeGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, colour, vertices, raster):
        ctx.raster, ctx.colour = raster, colour.detach()
        return colour.view_as(colour)

    @staticmethod
    def backward(ctx, gradient):
        raster = ctx.raster
        colour = _array(ctx.colour).reshape(len(raster.views), 3, -1)
        incoming = _array(gradient).reshape(len(raster.views), 3, -1)
        out = np.zeros((len(raster.views), raster.triangles, 3, 3), np.float32)

        def job(index: int) -> None:
            view = raster.views[index]
            moments = np.zeros((raster.triangles, 12), np.float64)
            edges.edge_moments(
                view.triangle,
                view.depth,
                colour[index],
                incoming[index],
                raster.height,
                raster.width,
                view.coefficients,
                view.rectangles,
                moments,
            )
            edges.moments_to_vertices(
                moments, view.coefficients, view.rectangles, raster.world_to_clip[index], out[index]
            )

        run_jobs(job, len(raster.views))
        return gradient, torch.from_numpy(out.sum(0)), None


def edge_gradient(colour: torch.Tensor, vertices: torch.Tensor, raster: Raster) -> torch.Tensor:
    """Return colour unchanged; its backward also gives vertices (T,3,3) the edge gradient (world units, summed over views)."""
    return _EdgeGradient.apply(colour, vertices, raster)


class _OpacityGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, opacity, colour, target, raster):
        shown = _array(colour).reshape(len(raster.views), 3, -1)
        wanted = _array(target).reshape(len(raster.views), 3, -1)
        out = np.zeros((len(raster.views), raster.triangles, 3), np.float32)
        weight = np.float32(1.0 / shown.size)

        def job(index: int) -> None:
            view = raster.views[index]
            edges.opacity_backward(
                view.fragments,
                view.fragment_index,
                view.fragment_value,
                view.visible,
                view.depth,
                shown[index],
                wanted[index],
                weight,
                out[index],
            )

        run_jobs(job, len(raster.views))
        ctx.gradient = torch.from_numpy(out.sum(0))
        return opacity.new_zeros(())

    @staticmethod
    def backward(ctx, gradient):
        return gradient * ctx.gradient, None, None, None


def opacity_gradient(
    opacity: torch.Tensor, colour: torch.Tensor, target: torch.Tensor, raster: Raster
) -> torch.Tensor:
    """Return a scalar 0 whose backward gives opacity (T,3) the masking gradient; colour and target (B,3,H,W) are not
    differentiated."""
    return _OpacityGradient.apply(opacity, colour.detach(), target, raster)


def target_statistics(target: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return the windowed mean and mean square of target (B,3,H,W), each (B,3,H-10,W-10) float32; images are at least 11 px."""
    images = _array(target)
    shape = (len(images), 3, images.shape[2] - photometric.TAPS + 1, images.shape[3] - photometric.TAPS + 1)
    mean, square = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for index in range(len(images)):
        photometric.target_moments(images[index], mean[index], square[index])
    return mean, square


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx, colour, target, mean, square):
        shown, wanted = _array(colour), _array(target)
        gradient = np.empty_like(shown)

        def job(index: int) -> float:
            return photometric.photometric_view(
                shown[index], wanted[index], mean[index], square[index], len(shown), gradient[index]
            )

        values = run_jobs(job, len(shown))
        ctx.gradient = torch.from_numpy(gradient)
        return colour.new_tensor(sum(values))

    @staticmethod
    def backward(ctx, gradient):
        return gradient * ctx.gradient, None, None, None


def photometric_loss(
    colour: torch.Tensor, target: torch.Tensor, statistics: tuple[np.ndarray, np.ndarray] | None = None
) -> torch.Tensor:
    """Return .8·mean|target - colour| + .2·½(1 - SSIM) over (B,3,H,W); statistics: `target_statistics(target)`, when at hand."""
    mean, square = statistics if statistics is not None else target_statistics(target)
    return _Photometric.apply(colour, target, mean, square)
