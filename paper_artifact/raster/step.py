"""The photometric step of training on the CPU: the loss of a batch of views and its gradients.

Each view goes from raster to gradient before the next, so that its buffers stay in the cache.
"""

from __future__ import annotations

import queue
from collections.abc import Sequence

import numpy as np

from paper_artifact.raster.arrays import SoupArrays
from paper_artifact.raster.threads import run_jobs
from paper_artifact.raster.view import ViewCamera, ViewRaster


class PhotometricStep:
    """The step for images of one size; it keeps memory between calls, never values."""

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
