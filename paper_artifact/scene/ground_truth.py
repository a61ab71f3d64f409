"""Ground-truth images: the textured mesh, opaque, supersampled, over a plain background.

The texture is solid: colour is a smooth function of position. The photometric loss needs contrast everywhere,
at several scales, but nothing finer than a soup of about a thousand triangles can show: the waves are about
2, 1 and .5 bounding radii long, and their sum is folded once through a sine.
"""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np

from paper_artifact import arithmetic
from paper_artifact.errors import InputError
from paper_artifact.kernel_cache import njit
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.raster.view import rasterize_opaque
from paper_artifact.scene.cameras import FAR, NEAR, Camera, world_to_clip

BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}
OCTAVES = ((3.0, 1.0), (6.0, 0.6), (12.0, 0.35))  # (radians per bounding radius, amplitude)
WAVES_PER_OCTAVE = 3
DARKEST, BRIGHTEST = 0.08, 0.92  # stays apart from black and white backgrounds


def background_colour(name: str) -> np.ndarray:
    """Return the RGB colour (3,) float32 in [0,1] of a background: white, black or "#rrggbb".

    Raises InputError for any other.
    """
    if re.fullmatch("#[0-9a-fA-F]{6}", name):
        return np.frombuffer(bytes.fromhex(name[1:]), np.uint8) / np.float32(255)
    if name not in BACKGROUNDS:
        raise InputError(
            f"unknown background '{name}'; choose one of {', '.join(BACKGROUNDS)}, #rrggbb, or mean (of "
            "photographs)"
        )
    return np.array(BACKGROUNDS[name], dtype=np.float32)


def render_ground_truth(
    mesh: Mesh, camera: Camera, background: np.ndarray, supersample: int = 4
) -> np.ndarray:
    """Return the image (H,W,3) float32 in [0,1] of the textured mesh.

    The scene is rasterized at `supersample` times the camera's resolution, coloured at each sample's surface
    position (world units, perspective-correct), composited over `background`, (3,) or (H,W,3), and averaged
    over boxes of supersample².
    """
    matrix = world_to_clip(camera, NEAR * mesh.radius, FAR * mesh.radius)
    clip = arithmetic.product(mesh.vertices, matrix[:, :3].T) + matrix[:, 3]
    height, width = camera.height * supersample, camera.width * supersample
    triangle, b0, b1, _ = rasterize_opaque(
        clip.astype(np.float32), mesh.faces.astype(np.int32), height, width
    )
    covered = np.flatnonzero(triangle)
    corner = mesh.vertices.astype(np.float32)[mesh.faces[triangle.reshape(-1)[covered] - 1]]
    first, second = b0.reshape(-1)[covered, None], b1.reshape(-1)[covered, None]
    positions = corner[:, 2] + first * (corner[:, 0] - corner[:, 2]) + second * (corner[:, 1] - corner[:, 2])
    colours = mesh_texture(positions, mesh)
    pixel = covered // width // supersample * camera.width + covered % width // supersample
    pixels = camera.height * camera.width
    missed = supersample**2 - np.bincount(pixel, minlength=pixels)
    sums = np.stack([np.bincount(pixel, colours[:, channel], pixels) for channel in range(3)], axis=1)
    image = (sums + missed[:, None] * background.reshape(-1, 3)) / supersample**2
    return image.reshape(camera.height, camera.width, 3).astype(np.float32)


def solid_texture(positions: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Return colours (n,3) float32 in [.08, .92] at world positions (n,3).

    `centre` (3,) and `radius` are the scene's bounding sphere in world units, so that the pattern follows its
    scale. Deterministic, independent of light and view.
    """
    local = ((np.asarray(positions) - centre) * (1 / radius)).astype(np.float32)
    colours = np.empty(local.shape[::-1], dtype=np.float32)
    _folded_waves(np.ascontiguousarray(local.T), *_waves(), colours)
    return np.float32((DARKEST + BRIGHTEST) / 2) + np.float32((BRIGHTEST - DARKEST) / 2) * colours.T


@njit(forceinline=True)
def _sine(x):
    # Of a float32: x less a multiple of π in three parts (exact up to 200,000), then a polynomial.
    n = np.floor(x * np.float32(1 / np.pi) + np.float32(0.5))
    r = ((x - n * np.float32(3.140625)) - n * np.float32(9.67502593994140625e-4)) - n * np.float32(
        1.5099579909783764e-7
    )
    z = r * r
    p = np.float32(2.6083159809786593e-06) * z - np.float32(1.9810690719168633e-04)
    p = (p * z + np.float32(8.333078585565090e-03)) * z - np.float32(1.6666665971279144e-01)
    value = r + r * (z * p)
    return -value if np.int32(n) & 1 else value


@njit(cache=True, nogil=True)
def _folded_waves(local, vectors, phases, amplitudes, colours):
    # colours (3,n): sin(π/2 · Σ amplitude · sin(vector · local + phase) + first phase); local (3,n); float32.
    x, y, z = local
    fold = np.float32(np.pi / 2)
    for channel in range(3):
        sums = np.zeros(len(x), np.float32)
        for k in range(len(amplitudes)):
            a, b, c = vectors[channel, k]
            for i in range(len(x)):
                sums[i] += amplitudes[k] * _sine(a * x[i] + b * y[i] + c * z[i] + phases[channel, k])
        for i in range(len(x)):
            colours[channel, i] = _sine(fold * sums[i] + phases[channel, 0])


def mesh_texture(positions: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Return `solid_texture` (n,3) float32 at world positions (n,3), for the mesh's own bounding sphere."""
    return solid_texture(positions, mesh.centre, mesh.radius)


@lru_cache(maxsize=1)
def _waves() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return wave vectors (3,k,3), phases (3,k) and amplitudes (k,), float32: the same on every machine."""
    generator = stream(0, "solid texture")
    count = WAVES_PER_OCTAVE * len(OCTAVES)
    # numpy's own normals: of these 81, none is so large (3.65) that it takes a logarithm of the C library.
    directions = generator.standard_normal((3, count, 3))
    directions /= arithmetic.norm(directions)[..., None]
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
