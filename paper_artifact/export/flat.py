"""Pictures: surfaces in one neutral material, drawn by the rasterizer (`raster.visibility`), and soups in
their colours, from cameras around them or of a scene; as PNG files.

Flat Lambert shading with one normal per face, turned towards the camera: a soup's triangles have no common
winding.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image
from scipy.spatial.transform import Rotation

from paper_artifact.errors import InputError, require_memory
from paper_artifact.export.models import THRESHOLD
from paper_artifact.files import write_bytes
from paper_artifact.frame import SAME, Frame
from paper_artifact.mesh import Mesh
from paper_artifact.raster.view import rasterize_opaque, to_clip
from paper_artifact.scene.cameras import FAR, NEAR, Camera, fibonacci_cameras, look_at, world_to_clip
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup, reframed, render_views

MATERIAL = (0.86, 0.84, 0.80)  # neutral, RGB in [0,1]
CUT = (0.75, 0.36, 0.24)  # of what a cut lays bare
AMBIENT = 0.34
# Towards the light, camera frame (x right, y down, z forward): over the viewer's left shoulder.
LIGHT = (-0.45, -0.65, -1.0)
FIELD_OF_VIEW = 30.0  # degrees
MARGIN = 1.04  # of the image around the framed points
SUPERSAMPLING = 2
BYTES_PER_PIXEL = 50  # of a view and its place in the sheet: RGB as float32 four times, and as bytes


def _framed_camera(points: np.ndarray, direction: np.ndarray, size: int) -> Camera:
    """Return the square camera of `size` pixels whose image the points (n,3), world units, seen from
    `direction` (3,), just fill; z upwards.

    direction: from the points towards the camera, any length. Raises InputError for a direction along z.
    """
    unit = direction / np.linalg.norm(direction)
    rotation = look_at(unit, np.zeros(3), size, FIELD_OF_VIEW).rotation
    seen = points @ rotation.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    x, y, z = (seen - middle).T
    # A point at offset x and depth distance + z is in view if |x| <= tan(angle / 2) · (distance + z).
    distance = float((MARGIN * np.maximum(abs(x), abs(y)) / np.tan(np.radians(FIELD_OF_VIEW) / 2) - z).max())
    target = rotation.T @ middle
    return look_at(target + distance * unit, target, size, FIELD_OF_VIEW)


def render_flat(
    vertices: np.ndarray,
    faces: np.ndarray,
    size: int = 256,
    *,
    direction: tuple[float, float, float] = (0.9, -1.3, 0.8),
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    frame: np.ndarray | None = None,
    material: tuple[float, float, float] | np.ndarray = MATERIAL,
    inside: tuple[float, float, float] | None = None,
) -> np.ndarray:
    """Return an image (size,size,3) float32 in [0,1] of opaque triangles over white.

    vertices (V,3) world units, faces (F,3). direction: from the object towards the camera, up: upwards in the
    image; world axes, any length. frame: points (n,3), world units, that the image is fitted to (default: the
    object's own), so that pictures of one shape agree. material: RGB, or one per face (F,3). inside: a second
    colour, unshaded, for faces seen from behind (a closed surface that was cut open then shows its cut
    filled). Raises InputError for arrays of other shapes, nothing to draw or no direction.
    """
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or not len(faces):
        shapes = f"{vertices.shape} and {faces.shape}"
        raise InputError(f"a picture needs vertices (V,3) and faces (F,3), at least one, got {shapes}")
    if size < 1:
        raise InputError(f"a picture needs at least one pixel, got {size}")
    turn = upright(np.asarray(up, dtype=np.float64))
    vertices, towards = vertices @ turn.T, turn @ np.asarray(direction, dtype=np.float64)
    if not np.isfinite(vertices).all() or not 0 < np.linalg.norm(towards) < np.inf:
        raise InputError("a picture needs finite vertices and a direction that is not zero")
    used = vertices[np.unique(faces)]
    camera = _framed_camera(
        used if frame is None else np.asarray(frame, dtype=np.float64) @ turn.T, towards, size * SUPERSAMPLING
    )
    colours = _face_colours(vertices[faces], camera, material, inside)
    reach = float(np.linalg.norm(used - camera.position, axis=1).max())
    clip = world_to_clip(camera, 0.02 * reach, 1.01 * reach).astype(np.float32)
    hit = rasterize_opaque(to_clip(vertices.astype(np.float32), clip), faces, camera.height, camera.width)[0]
    image = np.concatenate([np.ones((1, 3)), colours])[hit]
    return image.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, 3).mean(axis=(1, 3)).astype(np.float32)


def _face_colours(
    corners: np.ndarray, camera: Camera, material: ArrayLike, inside: ArrayLike | None
) -> np.ndarray:
    """RGB (F,3) of triangles (F,3,3), world units, seen from the camera."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    facing = np.einsum("ij,ij->i", normals, camera.position - corners[:, 0])
    light = camera.rotation.T @ (np.asarray(LIGHT) / np.linalg.norm(LIGHT))
    lambert = np.clip((np.where(facing < 0, -1.0, 1.0)[:, None] * normals) @ light, 0, 1)
    own = np.broadcast_to(np.asarray(material, dtype=np.float64), normals.shape)
    colours = own * (AMBIENT + (1 - AMBIENT) * lambert)[:, None]
    return colours if inside is None else np.where((facing < 0)[:, None], np.asarray(inside), colours)


def upright(up: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3,3) that takes `up` (3,), any length, to +z, upwards for the cameras.
    Raises InputError for no direction."""
    length = np.linalg.norm(up)
    if not 0 < length < np.inf:
        raise InputError("up must be a direction that is not zero")
    return Rotation.align_vectors([[0.0, 0.0, 1.0]], [up / length])[0].as_matrix()


def orbit_renders(soup: Soup, count: int, size: int) -> list[np.ndarray]:
    """Return `count` images (size,size,3) float32 in [0,1] of the soup over white, seen from all around.

    The cameras are a Fibonacci sphere's, as in the study's scenes: 3 bounding radii away, 50 degrees. Raises
    InputError for a soup without extent.
    """
    require_memory(
        count * BYTES_PER_PIXEL * size**2, f"{count} views of {size}×{size} pixels", "ask for less"
    )
    corners = soup.vertices.detach().numpy().astype(np.float64)
    visible = soup.corner_opacity().mean(axis=1) >= THRESHOLD
    corners = (corners[visible] if visible.any() else corners).reshape(-1, 3)
    cloud = Mesh(corners, np.arange(len(corners)).reshape(-1, 3), "soup")
    if not cloud.radius > 0:
        raise InputError("the soup's triangles are all at one point, which no view shows; train it again")
    cameras = fibonacci_cameras(cloud, count, size)
    matrices = np.stack(
        [world_to_clip(camera, NEAR * cloud.radius, FAR * cloud.radius) for camera in cameras]
    ).astype(np.float32)
    scene = Scene(
        path=Path(),
        names=tuple(f"view {i}" for i in range(count)),
        images=np.full((count, 3, size, size), 255, dtype=np.uint8),
        world_to_clip=matrices,
        camera_centres=np.stack([camera.position for camera in cameras]).astype(np.float32),
        background=np.ones(3, dtype=np.float32),
        points=np.zeros((0, 3), dtype=np.float32),
        train=np.arange(count),
        holdout=np.arange(0),
        radius=cloud.radius,
    )
    return list(render_views(soup, scene, np.arange(count)))


def scene_renders(soup: Soup, scene: Scene, frame: Frame = SAME) -> list[list[np.ndarray]]:
    """Return two rows of images (H,W,3) float32 in [0,1]: the scene's held-out photographs (all where
    none is held out), the soup's renders. frame: of the soup's coordinates.
    """
    soup = reframed(soup, frame, scene.frame)
    views = scene.holdout if len(scene.holdout) else scene.train
    return [list(scene.colours(views)), list(render_views(soup, scene, views))]


def write_png(path: Path | str, image: np.ndarray) -> None:
    """Write `image` (H,W,3) or (H,W,4) float as an 8-bit PNG: clipped to [0,1], rounded to the nearest level.

    Raises InputError for another shape, values that are not finite, or a path that is not writable.
    """
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] not in (3, 4) or 0 in image.shape:
        raise InputError(f"an image has shape (H, W, 3) or (H, W, 4), got {image.shape}")
    if not np.isfinite(image).all():
        raise InputError(
            f"the image for {path} holds values that are not finite; the soup it shows has diverged"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(buffer, format="PNG")
    write_bytes(path, buffer.getvalue())


def sheet(rows: Sequence[Sequence[np.ndarray]], gap: int = 4) -> np.ndarray:
    """Return one white image (H',W',3) float32 with rows of equal (H,W,3) images, `gap` pixels apart.

    Raises InputError for no images or images of different shapes.
    """
    shapes = {np.shape(image) for row in rows for image in row}
    if len(shapes) != 1:
        raise InputError(f"a sheet needs images of one shape, got {sorted(shapes)}")
    height, width, channels = shapes.pop()
    columns = max(len(row) for row in rows)
    page = np.ones(
        (len(rows) * (height + gap) - gap, columns * (width + gap) - gap, channels), dtype=np.float32
    )
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            page[i * (height + gap) :, j * (width + gap) :][:height, :width] = image
    return page
