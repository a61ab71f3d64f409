"""Frozen surface samples of a triangle soup: drawn per refresh, recomputed from live vertices at every step.

Paper §3.2: X_j = Σ_i w_ij V[F(f_j), i], faces f_j drawn opacity × area-weighted, barycentric weights w_ij
frozen. A soup is vertices (T,3,3): T triangles, each owning its three corners, world units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface


@dataclass(frozen=True, eq=False)
class FrozenSamples:
    """M samples of a triangle soup."""

    faces: Tensor  # (M,) int64: the triangle of each sample
    barycentrics: Tensor  # (M,3) float64: its frozen corner weights
    triangles: int  # of the soup that was sampled

    def __len__(self) -> int:
        return len(self.faces)

    def positions(self, vertices: Tensor, indices: Tensor | None = None) -> Tensor:
        """Return the samples' positions (M,3) float64 on the CPU, world units.

        Differentiable by `vertices` (T,3,3), on any device. indices (m,) int64: only these samples (a
        frozen-plan step needs a handful). Raises InputError when the soup has another number of triangles
        than the one sampled (it was resampled: refresh first).
        """
        if vertices.ndim != 3 or tuple(vertices.shape) != (self.triangles, 3, 3):
            raise InputError(
                f"the samples were drawn on a soup ({self.triangles}, 3, 3), got {tuple(vertices.shape)}; "
                "refresh after every resampling"
            )
        faces = self.faces if indices is None else self.faces[indices]
        weights = self.barycentrics if indices is None else self.barycentrics[indices]
        corners = vertices[faces.to(vertices.device)].cpu().double()
        return (weights[:, :, None] * corners).sum(dim=1)

    def joined(self, other: FrozenSamples) -> FrozenSamples:
        """Return these samples followed by `other`'s; both of one soup."""
        return FrozenSamples(
            torch.cat([self.faces, other.faces]),
            torch.cat([self.barycentrics, other.barycentrics]),
            self.triangles,
        )


def draw_samples(
    vertices: Tensor | np.ndarray,
    opacity: Tensor | np.ndarray | None,
    count: int,
    generator: np.random.Generator,
) -> FrozenSamples:
    """Draw `count` samples with density opacity × area on a soup's vertices (T,3,3), world units.

    opacity (T,) or (T,3) in [0,1] (three corners: their mean), or None for area alone. Raises InputError for
    another shape, a value that is not finite, or a soup with no visible area.
    """
    corners = _array(vertices)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not np.isfinite(corners).all():
        raise InputError(
            f"a soup is finite vertices of shape (T, 3, 3), got {corners.shape}; check layout and values"
        )
    weights = None
    if opacity is not None:
        weights = _array(opacity)
        weights = weights.mean(axis=1) if weights.ndim == 2 else weights
        if weights.shape != (len(corners),) or not np.isfinite(weights).all() or (weights < 0).any():
            raise InputError(
                f"opacity must be finite, at least 0 and of shape ({len(corners)},) or ({len(corners)}, 3)"
            )
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    _, face, barycentrics = sample_surface(corners.reshape(-1, 3), faces, count, generator, weights)
    return FrozenSamples(torch.from_numpy(face), torch.from_numpy(barycentrics), len(corners))


def samples_stream(seed: int, step: int) -> np.random.Generator:
    """Return the generator of a run's samples at `step`: a function of (seed, step) only."""
    return stream(seed, "topology-samples", step)


def _array(values: Tensor | np.ndarray) -> np.ndarray:
    if isinstance(values, Tensor):
        values = values.detach().cpu().numpy()
    return np.asarray(values, dtype=np.float64)
