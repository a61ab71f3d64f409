"""What a scene's photographs are of: the ball that all cameras look at, without the plane it stands on.

A soup of photographs holds the table and the room as well; a closed mesh is wanted of the thing in the
middle. Both are read off the cameras and the SfM cloud, never off the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import Camera
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.folder import model_folder, scene_root

RADIUS = 0.6  # of the ball, in half widths of the picture at the subject's distance
GROUND = 0.03  # what lies lower than this above the plane is ground, in the same unit; 0 keeps the ground
PLANE = 0.01  # points this near to a plane are on it, in the same unit
DRAWS = 1000  # planes through three points that are tried


@dataclass(frozen=True)
class Subject:
    """A ball, cut by a plane; world units of the cameras."""

    centre: np.ndarray  # (3,) float64: the point nearest to all optical axes
    radius: float
    up: np.ndarray  # (3,) float64 unit normal of the ground, towards the cameras
    lowest: float  # points with up·x below this are ground; -inf: the ground is kept

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Return for points (…,3) whether each belongs to the subject, (…) bool."""
        near = np.linalg.norm(points - self.centre, axis=-1) <= self.radius
        return near & (points @ self.up >= self.lowest)


def subject_of_scene(scene: Path | str, radius: float = RADIUS, ground: float = GROUND) -> Subject:
    """Return `subject_of` for the COLMAP scene in a folder, in the files' coordinates. Raises InputError also
    for missing or damaged files."""
    model = read_model(model_folder(scene_root(scene)))
    return subject_of([model.camera(image) for image in model.images], model.positions, radius, ground)


def subject_of(
    cameras: Sequence[Camera], cloud: np.ndarray, radius: float = RADIUS, ground: float = GROUND
) -> Subject:
    """Return what the cameras look at; cloud (P,3) is the SfM cloud, radius and ground are in half widths of
    the picture at the subject's distance (means over the cameras).

    Raises InputError for a radius that is not positive, a negative ground, or cameras that look at no common
    point.
    """
    if not radius > 0 or not ground >= 0:
        raise InputError(
            f"the ball's radius must be positive and the ground at least 0, got {radius}, {ground}"
        )
    places = np.array([camera.position for camera in cameras])
    axes = np.array([camera.rotation[2] for camera in cameras])
    # The point with the least sum of squared distances to the axes: Σ (I - a aᵀ)(x - p) = 0.
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    if np.linalg.cond(across.sum(0)) > 1e6:
        raise InputError("the cameras look along parallel axes, so at no common point; leave out --scene")
    centre = np.linalg.solve(across.sum(0), (across @ places[:, :, None]).sum(0)[:, 0])
    depth = np.einsum("ij,ij->i", axes, centre - places)
    if (depth <= 0).mean() > 0.5:
        raise InputError("most cameras look away from each other, so at no common point; leave out --scene")
    width = np.mean(
        [abs(d) * camera.width / (2 * camera.focal_x) for d, camera in zip(depth, cameras, strict=True)]
    )
    up, lowest = np.array([0.0, 0.0, 1.0]), -np.inf
    if ground > 0:
        near = cloud[np.linalg.norm(cloud - centre, axis=1) <= width]
        up, height = _plane(near.astype(np.float64), PLANE * width)
        if (places @ up).mean() < height:
            up, height = -up, -height
        lowest = height + ground * width
    return Subject(centre, float(radius * width), up, float(lowest))


def _plane(points: np.ndarray, near: float) -> tuple[np.ndarray, float]:
    """Return normal n (3,) and height h of the plane n·x = h with the most of `points` (P,3) within `near`
    (RANSAC, Fischler and Bolles 1981; then least squares over those)."""
    if len(points) < 3:
        raise InputError(
            f"the SfM cloud has {len(points)} points around what the cameras look at, too few for a ground "
            "plane; --ground 0 keeps the ground"
        )
    random = stream(0, "ground plane")
    triples = points[random.integers(0, len(points), (DRAWS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, sizes, out=np.zeros_like(normals), where=sizes > 0)
    heights = np.einsum("ij,ij->i", normals, triples[:, 0])
    counts = [
        int((np.abs(points @ normal - height) <= near).sum()) if normal.any() else 0
        for normal, height in zip(normals, heights, strict=True)
    ]
    best = int(np.argmax(counts))
    on = points[np.abs(points @ normals[best] - heights[best]) <= near]
    normal = np.linalg.svd(on - on.mean(0), full_matrices=False)[2][2]
    return normal, float(normal @ on.mean(0))
