"""A procedural solid texture: colour as a smooth function of position, so that places can be told apart.

The photometric loss needs contrast everywhere, at several scales, but nothing finer than a soup of about a
thousand triangles can show: the waves are about 2, 1 and .5 bounding radii long, and their sum is folded once
through a sine.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream

OCTAVES = ((3.0, 1.0), (6.0, 0.6), (12.0, 0.35))  # (radians per bounding radius, amplitude)
WAVES_PER_OCTAVE = 3
DARKEST, BRIGHTEST = 0.08, 0.92  # stays apart from black and white backgrounds


def solid_texture(
    positions: np.ndarray, centre: np.ndarray, radius: float, frequency: float = 1.0
) -> np.ndarray:
    """Return colours (n,3) float32 in [.08, .92] at world positions (n,3).

    `centre` (3,) and `radius` are the scene's bounding sphere in world units, so that the pattern follows its
    scale; `frequency` multiplies every wave number. Deterministic, independent of light and view.
    """
    vectors, phases, amplitudes = _waves()
    local = ((np.asarray(positions) - centre) * (frequency / radius)).astype(np.float32)
    colours = np.empty(local.shape, dtype=np.float32)
    for channel in range(3):
        waves = np.sin(local @ vectors[channel].T + phases[channel])
        colours[:, channel] = np.sin(np.float32(np.pi / 2) * (waves @ amplitudes) + phases[channel][0])
    return np.float32((DARKEST + BRIGHTEST) / 2) + np.float32((BRIGHTEST - DARKEST) / 2) * colours


def mesh_texture(positions: np.ndarray, mesh: Mesh, frequency: float = 1.0) -> np.ndarray:
    """Return `solid_texture` (n,3) float32 at world positions (n,3), for the mesh's own bounding sphere."""
    return solid_texture(positions, mesh.centre, mesh.radius, frequency)


@lru_cache(maxsize=1)
def _waves() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return wave vectors (3,k,3), phases (3,k) and amplitudes (k,), float32: the same on every machine."""
    generator = stream(0, "solid texture")
    count = WAVES_PER_OCTAVE * len(OCTAVES)
    directions = generator.standard_normal((3, count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    numbers = np.repeat([number for number, _ in OCTAVES], WAVES_PER_OCTAVE)
    amplitudes = np.repeat([amplitude for _, amplitude in OCTAVES], WAVES_PER_OCTAVE) / np.sqrt(
        WAVES_PER_OCTAVE
    )
    phases = generator.random((3, count)) * 2 * np.pi
    return (
        (directions * numbers[None, :, None]).astype(np.float32),
        phases.astype(np.float32),
        amplitudes.astype(np.float32),
    )
