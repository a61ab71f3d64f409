"""Pinhole cameras in COLMAP's convention, viewpoints on a Fibonacci sphere, projection into clip space."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from paper_artifact import arithmetic
from paper_artifact.errors import InputError
from paper_artifact.frame import SAME, Frame
from paper_artifact.mesh import Mesh

CAMERA_DISTANCE = 3.0  # in bounding radii of the scene
FIELD_OF_VIEW = 50.0  # degrees, over the image's width
NEAR, FAR = 0.01, 100.0  # in bounding radii of the scene
HALF_PICTURE = 1.3989229744649955  # 3 tan 25°: half of a picture's side at the scene's centre, in such radii
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))  # radians


@dataclass(frozen=True)
class Camera:
    """A pinhole camera and its pose, as COLMAP writes them: x right, y down, z forward.

    The image's upper left corner is at (0, 0), the first pixel's centre at (.5, .5).
    """

    width: int  # pixels
    height: int  # pixels
    focal_x: float  # pixels
    focal_y: float  # pixels
    centre_x: float  # of the projection, pixels
    centre_y: float  # of the projection, pixels
    quaternion: tuple[float, float, float, float]  # (w, x, y, z) of R: world → camera
    translation: tuple[float, float, float]  # t in x_camera = R x_world + t, world units

    @property
    def rotation(self) -> np.ndarray:
        """The rotation matrix world → camera, (3,3) float64."""
        return arithmetic.quaternion_matrix(np.array(self.quaternion))

    @property
    def position(self) -> np.ndarray:
        """The camera's centre in world units, (3,) float64."""
        return -arithmetic.product(self.rotation.T, np.asarray(self.translation))


def framed(camera: Camera, frame: Frame) -> Camera:
    """Return a camera of the user's world in the coordinates of a run with this frame; itself where they are
    equal."""
    if frame == SAME:
        return camera
    moved = np.asarray(camera.translation) + arithmetic.product(camera.rotation, np.asarray(frame.offset))
    x, y, z = np.ldexp(moved, -frame.exponent).tolist()
    return replace(camera, translation=(x, y, z))


def unframed(camera: Camera, frame: Frame) -> Camera:
    """Return a camera of a run's coordinates in the user's world: the inverse of `framed`."""
    if frame == SAME:
        return camera
    scaled = np.ldexp(np.asarray(camera.translation), frame.exponent)
    x, y, z = (scaled - arithmetic.product(camera.rotation, np.asarray(frame.offset))).tolist()
    return replace(camera, translation=(x, y, z))


def world_to_clip(camera: Camera, near: float, far: float) -> np.ndarray:
    """Return the matrix (4,4) float64 with clip = M @ (x, y, z, 1) of a world position.

    w is the depth in front of the camera (world units), NDC = xyz / w: x right, y down, the centre of the
    pixel in row r, column c at ((2c+1)/width - 1, (2r+1)/height - 1); z runs from -1 at `near` to 1 at `far`
    (world units, depth along the viewing axis).
    """
    projection = np.array(
        [
            [2 * camera.focal_x / camera.width, 0, 2 * camera.centre_x / camera.width - 1, 0],
            [0, 2 * camera.focal_y / camera.height, 2 * camera.centre_y / camera.height - 1, 0],
            [0, 0, (far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, 1, 0],
        ]
    )
    view = np.eye(4)
    view[:3, :3] = camera.rotation
    view[:3, 3] = camera.translation
    return arithmetic.product(projection, view)


def picture_radii(points: np.ndarray, world_to_clip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for points (…,3) the radius (…) float64 of the ball that fills a picture there as the study's
    scenes fill theirs, world units, and whether any view shows the point, (…) bool.

    In one view: the point's depth times half the picture (geometric mean of both sides) at depth 1, over
    `HALF_PICTURE`; of the views (n,4,4) that show it, the median (the lower one of two). What no view shows
    has the smallest radius of what one does; inf where no view shows anything. Elementwise arithmetic only,
    so that all processors give the same bits.
    """
    x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0).reshape(3, -1)
    radii = np.full((len(world_to_clip), len(x)), np.inf)
    for radius, matrix in zip(radii, np.asarray(world_to_clip, np.float64), strict=True):
        across, down, _, depth = (a * x + b * y + c * z + d for a, b, c, d in matrix)
        inside = (depth > 0) & (np.abs(across) <= depth) & (np.abs(down) <= depth)
        radius[inside] = depth[inside] * (_half_picture(matrix) / HALF_PICTURE)
    views = np.isfinite(radii).sum(axis=0)
    found = np.sort(radii, axis=0)[np.maximum(views - 1, 0) // 2, np.arange(len(x))]
    shape = np.shape(points)[:-1]
    return np.where(views > 0, found, found.min()).reshape(shape), (views > 0).reshape(shape)


def _half_picture(matrix: np.ndarray) -> float:
    """Return the geometric mean of half width and half height of a picture at depth 1, by its
    `world_to_clip`."""
    (a, b, c), (d, e, f), (x, y, z) = matrix[[0, 1, 3], :3]
    ahead, aside = a * x + b * y + c * z, d * x + e * y + f * z  # of the principal point, off the centre
    wide = a * a + b * b + c * c - ahead * ahead
    high = d * d + e * e + f * f - aside * aside
    return float(1 / np.sqrt(np.sqrt(wide * high)))


def look_at(
    position: np.ndarray, target: np.ndarray, size: int, field_of_view: float = FIELD_OF_VIEW
) -> Camera:
    """Return a square camera of `size` pixels at `position` that looks at `target` (world units), +z upwards.

    field_of_view: degrees over the width. Raises InputError when the view is along the z axis, where up is
    undefined.
    """
    forward = np.asarray(target, dtype=np.float64) - position
    distance = arithmetic.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if arithmetic.norm(right) <= 1e-9 * distance:
        raise InputError(
            "a camera may not look along the z axis: its up direction is undefined; move it aside"
        )
    forward = forward / distance
    right = right / arithmetic.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    half = field_of_view * np.pi / 360
    focal = size / 2 * arithmetic.cos(half) / arithmetic.sin(half)
    across, down, ahead = (-arithmetic.product(rotation, position)).tolist()
    return Camera(
        width=size,
        height=size,
        focal_x=float(focal),
        focal_y=float(focal),
        centre_x=size / 2,
        centre_y=size / 2,
        quaternion=arithmetic.matrix_quaternion(rotation),
        translation=(across, down, ahead),
    )


def fibonacci_directions(count: int) -> np.ndarray:
    """Return unit vectors (count,3) float64, evenly spread: z = 1 - (2i+1)/count, azimuth i × golden angle.

    None is on the z axis. Raises InputError for fewer than one.
    """
    if count < 1:
        raise InputError(f"the number of views must be at least 1, got {count}")
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    ring = np.sqrt(1 - z * z)
    azimuth = GOLDEN_ANGLE * index
    return np.stack([ring * arithmetic.cos(azimuth), ring * arithmetic.sin(azimuth), z], axis=1)


def fibonacci_cameras(mesh: Mesh, count: int, size: int) -> tuple[Camera, ...]:
    """Return cameras on a Fibonacci sphere that look at the mesh's centre (paper, Experimental setup).

    Distance 3 bounding radii, 50 degrees, `size` × `size` pixels: the paper names neither distance nor angle.
    """
    return tuple(
        look_at(mesh.centre + CAMERA_DISTANCE * mesh.radius * direction, mesh.centre, size)
        for direction in fibonacci_directions(count)
    )
