"""Cameras and small soups that the raster tests share."""

import numpy as np
import torch

from paper_artifact.randomness import stream
from paper_artifact.raster.arrays import FEATURES, MLP_SHAPES, SoupArrays

BACKGROUND = np.array([1.0, 0.9, 0.8], np.float32)


def look_at(
    centre, target=(0.0, 0.0, 0.0), focal: float = 3.0, near: float = 0.5, far: float = 10.0
) -> np.ndarray:
    """Return world_to_clip (4,4) float64 of a square camera at `centre`; NDC y down, w the depth in front."""
    centre, target = np.asarray(centre, float), np.asarray(target, float)
    forward = (target - centre) / np.linalg.norm(target - centre)
    helper = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, helper)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    rotation = np.stack([right * focal, down * focal, forward * (far + near) / (far - near), forward])
    shift = np.array([0.0, 0.0, -2 * far * near / (far - near), 0.0])
    return np.concatenate([rotation, (shift - rotation @ centre)[:, None]], axis=1)


def front_camera(distance: float = 4.0, focal: float = 1.8) -> torch.Tensor:
    """Return world_to_clip (1,4,4) float64 of a camera at z = -distance along +z, image x, y as world."""
    near, far = 0.5, 10.0
    matrix = torch.diag(torch.tensor([focal, focal, (far + near) / (far - near), 0.0], dtype=torch.float64))
    matrix[2, 3] = distance * (far + near) / (far - near) - 2 * far * near / (far - near)
    matrix[3, 2], matrix[3, 3] = 1.0, distance
    return matrix[None]


def soup(seed: int, count: int, size: float = 0.5) -> dict[str, torch.Tensor]:
    """Return a random soup in the unit ball, float64: vertices (T,3,3), opacity (T,3), features."""
    draws = stream(seed, "raster test soup")
    centres = draws.normal(size=(count, 1, 3))
    centres *= draws.uniform(size=(count, 1, 1)) ** (1 / 3) / np.linalg.norm(centres, axis=-1, keepdims=True)
    return {
        "vertices": torch.from_numpy(centres + size * draws.normal(size=(count, 3, 3)) / 2),
        "opacity": torch.from_numpy(draws.uniform(0.05, 0.95, size=(count, 3))),
        "features": torch.from_numpy(draws.uniform(0.02, 0.98, size=(count, 3, FEATURES))),
    }


def cameras(seed: int, count: int, distance: float = 4.0) -> torch.Tensor:
    """Return world_to_clip (B,4,4) float64 of cameras at random directions, looking at the origin."""
    directions = stream(seed, "raster test cameras").normal(size=(count, 3))
    centres = distance * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return torch.from_numpy(np.stack([look_at(centre) for centre in centres]))


def mlp(seed: int) -> tuple[torch.Tensor, ...]:
    """Return random weights of the shading MLP, float64: (w1, c1, w2, c2, w3, c3)."""
    draws = stream(seed, "raster test mlp")
    return tuple(torch.from_numpy(draws.normal(scale=0.4, size=shape)) for shape in MLP_SHAPES)


def soup_arrays(seed: int, count: int, size: float = 0.35) -> SoupArrays:
    """Return the random soup with a random MLP in float32, as the kernels take it."""
    tensors = soup(seed, count, size)
    values = (tensors["vertices"], tensors["features"], tensors["opacity"], *mlp(seed))
    return SoupArrays.of(value.float().numpy() for value in values)


def doubles(arrays: SoupArrays) -> list[torch.Tensor]:
    """Return exact float64 copies of the nine arrays: vertices, features, opacity, MLP."""
    return [torch.from_numpy(array).double() for array in arrays.flat()]


def distance(found: np.ndarray, expected: torch.Tensor) -> float:
    """Return the relative difference of two gradients in the Euclidean norm."""
    assert expected.abs().max() > 0
    return float((torch.from_numpy(found).double() - expected).norm() / expected.norm())
