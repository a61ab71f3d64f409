"""A training step's photometric gradients, one view from raster to gradient before the next: the CPU trainer's path.

Same kernels, same order, same bits as the torch functions in `functions` (a test holds them equal); what is gained is that a
view's buffers stay in the cache, and that torch's graph is left out.
"""

from __future__ import annotations

import queue
from dataclasses import dataclass

import numpy as np

from paper_artifact.raster import edges, photometric, shading
from paper_artifact.raster.threads import run_jobs
from paper_artifact.raster.visibility import ViewRaster, to_clip


@dataclass(frozen=True)
class Gradients:
    """dL/d of corner positions (T,3,3) world, corner features (T,3,7) and opacity (T,3) after the sigmoid, and the six MLP
    arrays."""

    vertices: np.ndarray
    features: np.ndarray
    opacity: np.ndarray
    mlp: tuple[np.ndarray, ...]


class _Workspace:
    """One view's buffers; as many exist as views were ever in work at the same time."""

    def __init__(self, height: int, width: int) -> None:
        self.raster = ViewRaster(height, width)
        self.colour = np.empty((3, height * width), np.float32)
        self.gradient = np.empty((3, height, width), np.float32)
        self.activations = np.empty(
            (-(-height * width // shading.BLOCK), shading.ROWS, shading.BLOCK), np.float32
        )


class FusedStep:
    """The photometric step for images of one size. background (3,) in [0,1]."""

    def __init__(self, height: int, width: int, background: np.ndarray) -> None:
        self.height, self.width = height, width
        self._background = np.asarray(background, np.float32)[:, None]
        self._free: queue.SimpleQueue[_Workspace] = queue.SimpleQueue()
        self._out: list[np.ndarray] = []

    def _zeroed(self, count: int, triangles: int) -> list[np.ndarray]:
        # Gradient buffers per view, kept between steps: fresh ones would be fresh pages of memory each time.
        if not self._out or self._out[0].shape[0] < count or self._out[0].shape[1] != triangles:
            self._out = [np.empty((count, triangles, *shape), np.float32) for shape in ((3, 3), (3, 7), (3,))]
        views = [array[:count] for array in self._out]
        for array in views:
            array.fill(0.0)
        return views

    def __call__(
        self,
        vertices: np.ndarray,
        features: np.ndarray,
        opacity: np.ndarray,
        mlp: tuple[np.ndarray, ...],
        matrices: np.ndarray,
        rays: np.ndarray,
        targets: list[np.ndarray],
        statistics: list[tuple[np.ndarray, np.ndarray]],
        keys: list[int],
    ) -> tuple[float, Gradients]:
        """Return the loss of the batch and its gradients, the opacity gradient included.

        vertices (T,3,3) world, features (T,3,7) and opacity (T,3) in [0,1], mlp as `functions.shade` (all float32); per view
        matrices (B,4,4), rays (B,3,3) (`functions.camera_rays`), targets (3,H,W), statistics (`functions.target_statistics`),
        draw keys.
        """
        count, triangles = len(keys), len(vertices)
        corners = np.ascontiguousarray(vertices.reshape(-1, 3))
        faces = np.arange(3 * triangles, dtype=np.int32).reshape(-1, 3)
        out = self._zeroed(count, triangles)
        out_mlp = [np.zeros((count, *array.shape), np.float32) for array in mlp]
        weight = np.float32(1.0 / (count * 3 * self.height * self.width))

        def job(index: int) -> float:
            try:
                space = self._free.get_nowait()
            except queue.Empty:
                space = _Workspace(self.height, self.width)
            view = space.raster.draw(to_clip(corners, matrices[index]), faces, opacity, keys[index])
            fragments = (view.visible, view.fragment_index, view.fragment_value)
            space.colour[:] = self._background
            shading.shade_forward(
                view.pixels,
                view.covered,
                *fragments,
                self.width,
                self.height,
                rays[index],
                features,
                *mlp,
                space.activations,
                space.colour,
            )
            loss = photometric.photometric_view(
                space.colour.reshape(3, self.height, self.width),
                targets[index],
                *statistics[index],
                count,
                space.gradient,
            )
            gradient = space.gradient.reshape(3, -1)
            edges.opacity_backward(
                view.fragments,
                view.fragment_index,
                view.fragment_value,
                view.visible,
                view.depth,
                space.colour,
                targets[index].reshape(3, -1),
                weight,
                out[2][index],
            )
            moments = np.zeros((triangles, 12), np.float64)
            edges.edge_moments(
                view.triangle,
                view.depth,
                space.colour,
                gradient,
                self.height,
                self.width,
                view.coefficients,
                view.rectangles,
                moments,
            )
            edges.moments_to_vertices(
                moments, view.coefficients, view.rectangles, matrices[index], out[0][index]
            )
            shading.shade_backward(
                view.pixels,
                view.covered,
                *fragments,
                mlp[0],
                mlp[2],
                mlp[4],
                space.activations,
                gradient,
                out[1][index],
                *(array[index] for array in out_mlp),
            )
            self._free.put(space)
            return loss

        losses = run_jobs(job, count)
        return sum(losses), Gradients(
            out[0].sum(0), out[1].sum(0), out[2].sum(0), tuple(array.sum(0) for array in out_mlp)
        )
