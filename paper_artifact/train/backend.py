"""Where a photometric step is computed: the numba kernels on the CPU, or the plain-torch twin on a GPU.

Both do the same: render a batch, add the loss gradients of vertices, features, opacity and MLP to the soup's
tensors, return the loss.
"""

from __future__ import annotations

import numpy as np
import torch

from paper_artifact.config import DEVICES
from paper_artifact.errors import InputError
from paper_artifact.raster.photometric import make_target
from paper_artifact.raster.view import PhotometricStep, make_camera
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup, soup_of


class CpuBackend:
    """Numba kernels; targets are the scene's own bytes."""

    def __init__(self, scene: Scene, views: np.ndarray) -> None:
        self._targets = {int(view): make_target(scene.images[view]) for view in views}
        self._cameras = {int(view): make_camera(scene.world_to_clip[view]) for view in views}
        height, width = scene.images.shape[2:]
        self._step = PhotometricStep(height, width, scene.background)

    def to_device(self, soup: Soup) -> Soup:
        """Return the soup itself: it lives on the CPU."""
        return soup

    to_host = to_device

    def photometric_step(self, soup: Soup, views: np.ndarray, keys: list[int]) -> float:
        """Set the soup's gradients to the batch's and return the loss.

        views: indices of the scene's views (B,), with one draw key (`draws.view_key`) each.
        """
        drawn = soup.drawn()
        cameras = [self._cameras[int(view)] for view in views]
        targets = [self._targets[int(view)] for view in views]
        loss, gradients = self._step(drawn, cameras, targets, keys)
        for sigmoid, gradient in ((drawn.features, gradients.features), (drawn.opacity, gradients.opacity)):
            gradient *= sigmoid * (1 - sigmoid)
        for tensor, gradient in zip(soup.tensors(), gradients.flat(), strict=True):
            tensor.grad = torch.from_numpy(gradient)
        return loss


class TwinBackend:
    """Plain torch on any device and in any float dtype; the CUDA path."""

    def __init__(
        self, scene: Scene, views: np.ndarray, device: str, dtype: torch.dtype = torch.float32
    ) -> None:
        self._device, self._dtype = torch.device(device), dtype
        self._row = {int(view): row for row, view in enumerate(views)}
        self._targets = torch.from_numpy(scene.images[views]).to(self._device, dtype) / 255
        self._matrices = torch.from_numpy(scene.world_to_clip).to(self._device, dtype)
        self._background = torch.as_tensor(scene.background).to(self._device, dtype)

    def _moved(self, soup: Soup, device: torch.device, dtype: torch.dtype) -> Soup:
        return soup_of([tensor.detach().to(device, dtype).clone() for tensor in soup.tensors()]).trainable()

    def to_device(self, soup: Soup) -> Soup:
        """Return a copy of the soup on this backend's device and dtype."""
        return self._moved(soup, self._device, self._dtype)

    def to_host(self, soup: Soup) -> Soup:
        """Return a float32 copy of the soup on the CPU."""
        return self._moved(soup, torch.device("cpu"), torch.float32)

    def photometric_step(self, soup: Soup, views: np.ndarray, keys: list[int]) -> float:
        """As `CpuBackend.photometric_step`."""
        from paper_artifact.raster import twin

        target = self._targets[[self._row[int(view)] for view in views]]
        matrices = self._matrices[torch.as_tensor(views, device=self._device)]
        opacity = torch.sigmoid(soup.opacity)
        height, width = target.shape[2:]
        raster = twin.rasterize(soup.vertices, opacity, matrices, height, width, keys)
        colour = twin.shade(torch.sigmoid(soup.features), soup.mlp, raster, matrices, self._background)
        auxiliary = twin.opacity_gradient(opacity, colour.detach(), target, raster)
        colour = twin.edge_gradient(colour, soup.vertices, raster, matrices)
        loss = twin.photometric_loss(colour, target)
        for tensor in soup.tensors():
            tensor.grad = None
        (loss + auxiliary).backward()
        return loss.item()


Backend = CpuBackend | TwinBackend


def check_device(device: str) -> None:
    """Raise InputError unless `device` is "cpu", "auto", or "cuda" where there is one."""
    if device not in DEVICES:
        raise InputError(f"unknown device {device!r}; choose one of {', '.join(DEVICES)}")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("no CUDA device here; use --device cpu (or auto)")


def backend_for(device: str, scene: Scene, views: np.ndarray) -> Backend:
    """Return the backend for "cpu", "cuda" or "auto" (cuda if there is one).

    Raises InputError as `check_device` does.
    """
    check_device(device)
    if device == "cpu" or not torch.cuda.is_available():
        return CpuBackend(scene, views)
    return TwinBackend(scene, views, "cuda")
