"""Ground-truth images: the textured mesh, opaque, supersampled, over a plain background."""

from __future__ import annotations

import re

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh
from paper_artifact.raster.view import rasterize_opaque
from paper_artifact.scene.cameras import FAR, NEAR, Camera, world_to_clip
from paper_artifact.scene.texture import mesh_texture

BACKGROUNDS = {
    "white": (1.0, 1.0, 1.0),
    "black": (0.0, 0.0, 0.0),
    "texture": (0.5, 0.5, 0.5),  # what training and held-out views compose over; see `perturb.surrounding`
}


def background_colour(name: str) -> np.ndarray:
    """Return the RGB colour (3,) float32 in [0,1] of a background: white, black or "#rrggbb".

    Raises InputError for any other.
    """
    if re.fullmatch("#[0-9a-fA-F]{6}", name):
        return np.frombuffer(bytes.fromhex(name[1:]), np.uint8) / np.float32(255)
    if name not in BACKGROUNDS:
        raise InputError(f"unknown background '{name}'; choose one of {', '.join(BACKGROUNDS)}, or #rrggbb")
    return np.array(BACKGROUNDS[name], dtype=np.float32)


def render_ground_truth(
    mesh: Mesh, camera: Camera, background: np.ndarray, supersample: int = 4, texture_frequency: float = 1.0
) -> np.ndarray:
    """Return the image (H,W,3) float32 in [0,1] of the textured mesh.

    The scene is rasterized at `supersample` times the camera's resolution, coloured at each sample's surface
    position (world units, perspective-correct), composited over `background`, (3,) or (H,W,3), and averaged
    over boxes of supersample².
    """
    matrix = world_to_clip(camera, NEAR * mesh.radius, FAR * mesh.radius)
    clip = mesh.vertices @ matrix[:, :3].T + matrix[:, 3]
    height, width = camera.height * supersample, camera.width * supersample
    triangle, b0, b1, _ = rasterize_opaque(
        clip.astype(np.float32), mesh.faces.astype(np.int32), height, width
    )
    covered = np.flatnonzero(triangle)
    corner = mesh.vertices.astype(np.float32)[mesh.faces[triangle.reshape(-1)[covered] - 1]]
    first, second = b0.reshape(-1)[covered, None], b1.reshape(-1)[covered, None]
    positions = corner[:, 2] + first * (corner[:, 0] - corner[:, 2]) + second * (corner[:, 1] - corner[:, 2])
    colours = mesh_texture(positions, mesh, texture_frequency)
    pixel = covered // width // supersample * camera.width + covered % width // supersample
    pixels = camera.height * camera.width
    missed = supersample**2 - np.bincount(pixel, minlength=pixels)
    sums = np.stack([np.bincount(pixel, colours[:, channel], pixels) for channel in range(3)], axis=1)
    image = (sums + missed[:, None] * background.reshape(-1, 3)) / supersample**2
    return image.reshape(camera.height, camera.width, 3).astype(np.float32)
