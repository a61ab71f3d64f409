"""One view of a soup on the CPU, from corners to gradients: the only place that calls the numba kernels.

Each method is one stage and calls the kernels of one module (`visibility`, `shading`, `photometric`,
`edges`); `PhotometricStep` runs them in order for a batch of views, the photometric step of training, and the
tests hold each to the twin in plain torch (`twin`).
"""

from __future__ import annotations

import queue
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from paper_artifact import arithmetic
from paper_artifact.raster import edges, photometric, shading, visibility
from paper_artifact.raster.arrays import SoupArrays
from paper_artifact.raster.lanes import WIDTH
from paper_artifact.raster.threads import run_jobs
from paper_artifact.raster.visibility import Planes, Shown, Surface


class ViewCamera(NamedTuple):
    """A camera as the kernels take it; see `make_camera`."""

    matrix: np.ndarray  # (4,4) float32, world → clip, w the depth in front of the camera
    rays: (
        np.ndarray
    )  # (3,3) float32 rows r0, rx, ry: r0 + rx·ndc_x + ry·ndc_y points to the camera (world, not unit)


def make_camera(world_to_clip: np.ndarray) -> ViewCamera:
    """Return the camera of a matrix world_to_clip (4,4).

    The rays follow from its rows x, y, w: at unit step of w the ray moves by inverse(M[[0,1,3],:3])·(ndc_x,
    ndc_y, 1).
    """
    matrix = np.ascontiguousarray(world_to_clip, np.float32)
    adjugate, determinant = arithmetic.adjugate(matrix[[0, 1, 3], :3].astype(np.float64))
    return ViewCamera(matrix, np.ascontiguousarray((adjugate.T / -determinant)[[2, 0, 1]], np.float32))


def to_clip(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return clip-space points (…,4) float32 of points (…,3) float32 under matrix (4,4) float32.

    Summed in a fixed order: a BLAS product may choose another one on another machine.
    """
    x, y, z = points.reshape(-1, 3).T
    clip = np.empty((len(x), 4), np.float32)
    for row in range(4):
        clip[:, row] = x * matrix[row, 0] + y * matrix[row, 1] + z * matrix[row, 2] + matrix[row, 3]
    return clip.reshape(*points.shape[:-1], 4)


class ViewRaster:
    """One view and its buffers, to be used again and again.

    A training step calls `render`, `compare`, and then the three `add_…_gradient`; `draw` alone is enough to
    know what is visible. What a method leaves in the arrays is valid until it is called again.
    """

    def __init__(self, height: int, width: int) -> None:
        """Make the buffers for images of height × width pixels."""
        size = height * width
        self.height, self.width = height, width
        self.planes = Planes.room(0)
        self.surface = Surface.room(size)
        self.shown = Shown.room(size)
        self._met = 0  # triangles with fragments
        self._opacity = np.empty((0, 3), np.float32)  # as drawn
        self.covered = 0  # pixels where something is visible
        # Memory that is never written costs nothing: whoever only draws pays for no more.
        self.colour = np.empty((3, height, width), np.float32)
        self.gradient = np.empty((3, height, width), np.float32)  # dL/dcolour
        self.error = np.empty(size + WIDTH, np.float32)  # (H·W + 16,): sum over channels of |colour - target|

    def draw(self, clip: np.ndarray, opacities: np.ndarray, key: int | None) -> ViewRaster:
        """Find what is visible; return self.

        clip (T,3,4) float32 clip-space corners, opacities (T,3) float32 in [0,1]; key: `draws.view_key` for
        stochastic masking, None for the threshold .5. Fills planes, surface, shown and covered.
        """
        triangles = len(clip)
        if len(self.planes.order) < triangles:
            self.planes = Planes.room(triangles + triangles // 4)
        self._opacity = opacities
        kept = visibility.set_up_triangles(clip, self.height, self.width, self.planes)
        stochastic = key is not None
        self._met = visibility.draw(
            self.planes, kept, opacities, self.width, np.uint32(key or 0), stochastic, self.surface
        )
        self.covered = visibility.list_visible(self.planes, self._met, self.width, self.surface, self.shown)
        return self

    def shade(
        self, features: np.ndarray, mlp: tuple[np.ndarray, ...], rays: np.ndarray, background: np.ndarray
    ) -> np.ndarray:
        """Return colour (3,H,W) float32 in [0,1] of what was drawn, over background (3,).

        features, mlp: see `SoupArrays`; rays: see `ViewCamera`.
        """
        self.colour[:] = np.asarray(background, np.float32)[:, None, None]
        shading.shade_forward(self.shown, self.covered, rays, features, mlp, self.colour)
        return self.colour

    def render(
        self, soup: SoupArrays, camera: ViewCamera, background: np.ndarray, key: int | None = None
    ) -> np.ndarray:
        """Draw and shade a soup; return colour (3,H,W) float32. key: see `draw`; background (3,) in [0,1]."""
        self.draw(to_clip(soup.vertices, camera.matrix), soup.opacity, key)
        return self.shade(soup.features, soup.mlp, camera.rays, background)

    def compare(self, target: np.ndarray, views: int) -> float:
        """Return the view's share of the loss of a batch of `views` views; fills gradient with its
        dL/dcolour, and error.

        The loss is .8·mean|target - colour| + .2·½(1 - SSIM), see `photometric`; target: see
        `photometric.make_target`.
        """
        return photometric.photometric_view(self.colour, target, views, self.gradient, self.error)

    def add_opacity_gradient(self, views: int, out: np.ndarray) -> None:
        """Add DiffSoup's masking gradient of `error` to out (T,3) float32, for a batch of `views` views."""
        weight = np.float32(1.0 / (views * self.colour.size))
        visibility.opacity_backward(
            self.planes, self._met, self._opacity, self.width, self.surface, self.error, weight, out
        )

    def add_edge_gradient(self, matrix: np.ndarray, out: np.ndarray) -> None:
        """Add the edge gradient of `gradient` to out (T,3,3) float32, world; matrix: see `ViewCamera`."""
        edges.edge_backward(self.surface, self.planes, self.colour, self.gradient, matrix, out)

    def add_shading_gradient(
        self, soup: SoupArrays, rays: np.ndarray, features_out: np.ndarray, mlp_out: tuple[np.ndarray, ...]
    ) -> None:
        """Add `gradient` times dcolour/d(features, MLP) to features_out (T,3,7) and mlp_out, float32; soup,
        rays as shaded."""
        shading.shade_backward(
            self.shown, self.covered, rays, soup.features, soup.mlp, self.gradient, features_out, mlp_out
        )

    def seen(self) -> np.ndarray:
        """Return which triangle is visible at each pixel, (H,W) int32: its index + 1, 0 where there is
        none."""
        size = self.height * self.width
        return self.surface.triangle[:size].reshape(self.height, self.width) + 1

    def visible_pixels(self, triangles: int) -> np.ndarray:
        """Return in how many pixels each of the drawn `triangles` is visible, (T,) int64."""
        return np.bincount(self.shown.triangle[: self.covered], minlength=triangles)


def rasterize_opaque(
    clip: np.ndarray, faces: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest surface of an opaque mesh: (triangle, b0, b1, depth), each (height, width).

    clip (V,4) float32 clip-space vertices, faces (T,3) integer. triangle int32 is 0 where nothing is hit,
    else index + 1; b0, b1 float32 are perspective-correct barycentrics of corners 0 and 1 (0 where nothing is
    hit); depth float32 is NDC z (+inf where nothing is hit).
    """
    corners = np.ascontiguousarray(clip[faces], np.float32)
    view = ViewRaster(height, width).draw(corners, np.ones((len(faces), 3), np.float32), None)
    barycentrics = np.zeros((2, height * width), np.float32)
    pixel, _, *values = (each[: view.covered] for each in view.shown)
    barycentrics[:, pixel] = values
    b0, b1, depth = (
        image[: height * width].reshape(height, width) for image in (*barycentrics, view.surface.depth)
    )
    return view.seen(), b0, b1, depth


class PhotometricStep:
    """The step for images of one size; it keeps memory between calls, never values.

    Each view goes from raster to gradient before the next, so that its buffers stay in the cache.
    """

    def __init__(self, height: int, width: int, background: np.ndarray) -> None:
        """Make the step for images of height × width pixels over background (3,) in [0,1]."""
        self._size, self._background = (height, width), background
        # As many views' buffers as were ever in work at the same time: one per thread.
        self._idle: queue.SimpleQueue[ViewRaster] = queue.SimpleQueue()
        self._gradients: list[np.ndarray] = []

    def __call__(
        self,
        soup: SoupArrays,
        cameras: Sequence[ViewCamera],
        targets: Sequence[np.ndarray],
        keys: Sequence[int],
    ) -> tuple[float, SoupArrays]:
        """Return the loss of the batch and its gradients, summed over the views in their order.

        One camera, target (`photometric.make_target`) and draw key (`draws.view_key`) per view. The opacity
        gradient is DiffSoup's masking gradient, the vertices' is the edge gradient.
        """
        count = len(keys)
        gradients = self._zeroed(count, soup)

        def job(index: int) -> float:
            camera, target = cameras[index], targets[index]
            out = SoupArrays.of(array[index] for array in gradients)
            try:
                view = self._idle.get_nowait()
            except queue.Empty:
                view = ViewRaster(*self._size)
            view.render(soup, camera, self._background, keys[index])
            loss = view.compare(target, count)
            view.add_opacity_gradient(count, out.opacity)
            view.add_edge_gradient(camera.matrix, out.vertices)
            view.add_shading_gradient(soup, camera.rays, out.features, out.mlp)
            self._idle.put(view)
            return loss

        loss = sum(run_jobs(job, count))
        return loss, SoupArrays.of(array[:count].sum(0) for array in gradients)

    def _zeroed(self, count: int, soup: SoupArrays) -> list[np.ndarray]:
        # One gradient per view, kept between steps: fresh ones would be fresh pages of memory each time.
        kept = self._gradients
        if not kept or len(kept[0]) < count or kept[0].shape[1] != len(soup.vertices):
            kept = [np.empty((count, *array.shape), np.float32) for array in soup.flat()]
            self._gradients = kept
        for array in kept:
            array[:count].fill(0.0)
        return kept
