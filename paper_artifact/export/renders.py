"""Pictures of a soup, from cameras around it or from a scene's held-out views; as PNG files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from paper_artifact.errors import InputError
from paper_artifact.export.models import THRESHOLD
from paper_artifact.files import write_bytes
from paper_artifact.frame import SAME, Frame
from paper_artifact.mesh import Mesh
from paper_artifact.scene.cameras import FAR, NEAR, fibonacci_cameras, world_to_clip
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup, reframed, render_views


def orbit_renders(soup: Soup, count: int, size: int) -> list[np.ndarray]:
    """Return `count` images (size,size,3) float32 in [0,1] of the soup over white, seen from all around.

    The cameras are a Fibonacci sphere's, as in the study's scenes: 3 bounding radii away, 50 degrees.
    """
    corners = soup.vertices.detach().numpy().astype(np.float64)
    visible = soup.corner_opacity().mean(axis=1) >= THRESHOLD
    corners = (corners[visible] if visible.any() else corners).reshape(-1, 3)
    cloud = Mesh(corners, np.arange(len(corners)).reshape(-1, 3), "soup")
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
