"""Pictures of a soup: from cameras around it, or from a scene's held-out views beside the photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from paper_artifact.export.triangles import THRESHOLD
from paper_artifact.frame import SAME, Frame
from paper_artifact.mesh import Mesh
from paper_artifact.scene.cameras import FAR, NEAR, fibonacci_cameras, world_to_clip
from paper_artifact.scene.load import Scene
from paper_artifact.soup.render import render_views
from paper_artifact.soup.state import Soup, reframed


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
