"""Where a 3-D view is first looked at from: of a scene's cameras, of a shape of the study, or of anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from paper_artifact.catalogue import Shape
from paper_artifact.scene.load import Scene

Vector = tuple[float, float, float]
DISTANCE = 2.6  # of a camera that frames everything, in bounding radii
FROM, UP = (0.78, 0.53, 0.34), (0.0, 0.0, 1.0)  # where nothing else is known: towards the camera, upwards


@dataclass(frozen=True)
class Viewpoint:
    """A camera position of the viewer, world units."""

    eye: Vector  # where the camera is
    target: Vector  # what it looks at, and what the view turns around
    up: Vector  # upwards in the picture, and the axis that the view turns about; any length


def framing(points: np.ndarray, direction: Sequence[float] = FROM, up: Sequence[float] = UP) -> Viewpoint:
    """Return the viewpoint that frames the points (n,3), world units, seen from `direction` (towards the
    camera, any length)."""
    low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0
    towards = np.asarray(direction, dtype=float)
    return Viewpoint(
        _vector(centre + DISTANCE * radius * towards / np.linalg.norm(towards)), _vector(centre), _vector(up)
    )


def shape_viewpoint(shape: Shape, points: np.ndarray) -> Viewpoint:
    """Return the viewpoint that frames the points as the study's pictures of that shape do."""
    return framing(points, shape.view, shape.up)


def scene_viewpoint(scene: Scene) -> Viewpoint:
    """Return the scene's first training camera, turning around the point of its optical axis at the median
    depth of the SfM cloud, about the mean of all cameras' upward directions."""
    forward = scene.world_to_clip[:, 3, :3].astype(float)
    down = scene.world_to_clip[:, 1, :3].astype(float)
    down -= (down * forward).sum(axis=1, keepdims=True) * forward  # the principal point's share
    up = -(down / np.linalg.norm(down, axis=1, keepdims=True)).mean(axis=0)
    first = int(scene.train[0])
    eye, ahead = scene.camera_centres[first].astype(float), forward[first]
    depths = (scene.points - eye) @ ahead
    depth = float(np.median(depths[depths > 0])) if (depths > 0).any() else scene.radius
    if np.linalg.norm(up) < 1e-6 or np.linalg.norm(np.cross(up, ahead)) < 1e-6:  # no common upwards
        up = -down[first]
    return Viewpoint(_vector(eye), _vector(eye + depth * ahead), _vector(up / np.linalg.norm(up)))


def _vector(values: Sequence[float] | np.ndarray) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
