"""Where a photometric step is computed: the numba kernels on the CPU, or the plain-torch twin on a GPU.

Both do the same: render a batch, add the loss gradients of vertices, features, opacity and MLP to the soup's tensors, return the
loss.
"""

from __future__ import annotations

import numpy as np
import torch

from paper_artifact.errors import InputError
from paper_artifact.raster import functions
from paper_artifact.raster.fused import FusedStep
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup, soup_of


class CpuBackend:
    """Numba kernels; targets are kept planar with their SSIM statistics, float32."""

    def __init__(self, scene: Scene, views: np.ndarray) -> None:
        self._row = {int(view): row for row, view in enumerate(views)}
        self._targets = np.ascontiguousarray(scene.images[views].transpose(0, 3, 1, 2), np.float32)
        self._statistics = functions.target_statistics(torch.from_numpy(self._targets))
        self._matrices = np.ascontiguousarray(scene.world_to_clip, np.float32)
        self._rays = functions.camera_rays(self._matrices)
        self._step = FusedStep(*self._targets.shape[2:], scene.background)

    def to_device(self, soup: Soup) -> Soup:
        """Return the soup itself: it lives on the CPU."""
        return soup

    to_host = to_device

    def photometric_step(self, soup: Soup, views: np.ndarray, keys: list[int]) -> float:
        """Set the soup's gradients to the batch's and return the loss; views are scene view indices, one draw key each."""
        rows = [self._row[int(view)] for view in views]
        with torch.no_grad():
            features, opacity = torch.sigmoid(soup.features), torch.sigmoid(soup.opacity)
            loss, gradients = self._step(
                soup.vertices.numpy(),
                features.numpy(),
                opacity.numpy(),
                tuple(each.numpy() for each in soup.mlp),
                self._matrices[views],
                self._rays[views],
                [self._targets[row] for row in rows],
                [tuple(each[row] for each in self._statistics) for row in rows],
                keys,
            )
            soup.vertices.grad = torch.from_numpy(gradients.vertices)
            soup.features.grad = torch.from_numpy(gradients.features).mul_(features * (1 - features))
            soup.opacity.grad = torch.from_numpy(gradients.opacity).mul_(opacity * (1 - opacity))
            for tensor, gradient in zip(soup.mlp, gradients.mlp):
                tensor.grad = torch.from_numpy(gradient)
        return loss


class TwinBackend:
    """Plain torch on any device and in any float dtype; the CUDA path."""

    def __init__(
        self, scene: Scene, views: np.ndarray, device: str, dtype: torch.dtype = torch.float32
    ) -> None:
        self._device, self._dtype = torch.device(device), dtype
        self._row = {int(view): row for row, view in enumerate(views)}
        self._targets = torch.from_numpy(scene.images[views].transpose(0, 3, 1, 2)).to(self._device, dtype)
        self._matrices = torch.from_numpy(scene.world_to_clip).to(self._device, dtype)
        self._background = torch.as_tensor(scene.background).to(self._device, dtype)

    def _moved(self, soup: Soup, device: torch.device, dtype: torch.dtype) -> Soup:
        tensors = (soup.vertices, soup.features, soup.opacity, *soup.mlp)
        return soup_of([tensor.detach().to(device, dtype).clone() for tensor in tensors]).trainable()

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
        raster = twin.rasterize(soup.vertices, opacity, matrices, *target.shape[2:], keys)
        colour = twin.shade(torch.sigmoid(soup.features), soup.mlp, raster, matrices, self._background)
        auxiliary = twin.opacity_gradient(opacity, colour.detach(), target, raster)
        colour = twin.edge_gradient(colour, soup.vertices, raster, matrices)
        loss = twin.photometric_loss(colour, target)
        (loss + auxiliary).backward()
        return loss.item()


Backend = CpuBackend | TwinBackend


def check_device(device: str) -> None:
    """Raise InputError unless `device` is "cpu", "auto", or "cuda" where there is one."""
    if device not in ("cpu", "cuda", "auto"):
        raise InputError(f"unknown device {device!r}; choose cpu, cuda or auto")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("no CUDA device here; use --device cpu (or auto)")


def backend_for(device: str, scene: Scene, views: np.ndarray) -> Backend:
    """Return the backend for "cpu", "cuda" or "auto" (cuda when there is one). Raises InputError as `check_device` does."""
    check_device(device)
    if device == "cpu" or not torch.cuda.is_available():
        return CpuBackend(scene, views)
    return TwinBackend(scene, views, "cuda")
