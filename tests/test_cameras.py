"""Camera conventions: COLMAP's pixel coordinates, clip space and NDC, Fibonacci viewpoints, and the solid
texture.
"""

import numpy as np
import pytest

from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import (
    Camera,
    fibonacci_cameras,
    fibonacci_directions,
    look_at,
    world_to_clip,
)
from paper_artifact.scene.ground_truth import mesh_texture, solid_texture
from paper_artifact.scene.shapes import make_shape


def project(camera: Camera, point, near: float = 0.01, far: float = 100.0) -> tuple[np.ndarray, float]:
    clip = world_to_clip(camera, near, far) @ [*point, 1.0]
    return clip[:3] / clip[3], clip[3]


def test_a_point_to_the_right_and_below_lands_in_the_lower_right():
    camera = look_at(np.array([0.0, -3.0, 0.0]), np.zeros(3), 200)  # looks along +y; +x is right, -z is down
    ndc, depth = project(camera, [0.0, 0.0, 0.0])
    np.testing.assert_allclose([*ndc[:2], depth], [0, 0, 3], atol=1e-12)
    ndc, depth = project(camera, [0.3, 0.0, -0.2])
    slope = np.tan(np.radians(25))
    np.testing.assert_allclose([*ndc[:2], depth], [0.1 / slope, 0.2 / 3 / slope, 3], atol=1e-12)


def test_ndc_agrees_with_colmap_pixels():
    camera = Camera(640, 480, 500.0, 510.0, 310.0, 250.0, (0.5, 0.5, -0.5, 0.5), (0.1, -0.2, 4.0))
    point = np.array([0.4, -0.3, 0.7])
    seen = camera.rotation @ point + camera.translation
    u, v = 500 * seen[0] / seen[2] + 310, 510 * seen[1] / seen[2] + 250
    ndc, depth = project(camera, point)
    row, column = v - 0.5, u - 0.5  # COLMAP: the first pixel's centre is (.5, .5)
    np.testing.assert_allclose(ndc[:2], [(2 * column + 1) / 640 - 1, (2 * row + 1) / 480 - 1], atol=1e-12)
    assert depth == pytest.approx(seen[2])
    np.testing.assert_allclose(camera.rotation @ camera.position + camera.translation, 0, atol=1e-12)


def test_depth_runs_from_minus_one_at_near_to_one_at_far():
    camera = look_at(np.array([1.0, 2.0, 0.5]), np.zeros(3), 64)
    forward = -camera.position / np.linalg.norm(camera.position)
    for depth, expected in ((0.5, -1.0), (8.0, 1.0)):
        ndc, w = project(camera, camera.position + depth * forward, near=0.5, far=8.0)
        assert (ndc[2], w) == pytest.approx((expected, depth), abs=1e-9)


@pytest.mark.parametrize("count", [1, 24, 72])
def test_fibonacci_views_are_spread_evenly(count):
    directions = fibonacci_directions(count)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    if count > 1:
        np.testing.assert_allclose(directions.mean(axis=0), 0, atol=2 / count)
        angles = np.arccos(np.clip(directions @ directions.T, -1, 1)) + 9 * np.eye(count)
        assert angles.min() > 0.7 * np.sqrt(4 * np.pi / count)


def test_cameras_follow_the_mesh_in_place_and_scale():
    ball = make_shape("sphere")
    moved = Mesh(10 * ball.vertices + [5, 6, 7], ball.faces, "ball")
    for camera in fibonacci_cameras(moved, 24, 100):
        assert np.linalg.norm(camera.position - [5, 6, 7]) == pytest.approx(30)
        clip = np.insert(moved.vertices, 3, 1, axis=1) @ world_to_clip(camera, 0.1, 1000).T
        assert np.abs(clip[:, :2] / clip[:, 3:]).max() < 1, "the whole mesh is in the image"


def test_bad_cameras_are_refused():
    with pytest.raises(InputError, match="views must be at least 1, got 0"):
        fibonacci_directions(0)
    with pytest.raises(InputError, match="z axis"):
        look_at(np.array([0.0, 0.0, 3.0]), np.zeros(3), 64)


def test_texture_has_contrast_everywhere_and_stays_off_the_backgrounds():
    points = stream(0, "texture test").standard_normal((3000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    colours = solid_texture(points, np.zeros(3), 1.0)
    assert colours.dtype == np.float32 and colours.min() >= 0.079 and colours.max() <= 0.921
    assert (colours.max(axis=0) - colours.min(axis=0) > 0.8).all()
    near = np.linalg.norm(points[:, None] - points[None, :200], axis=2) < 0.5
    contrast = [np.ptp(colours[near[:, patch]], axis=0).max() for patch in range(200)]
    assert min(contrast) > 0.3, "every patch of half a radius shows something"


def test_texture_is_smooth_and_follows_the_scale():
    mesh = make_shape("torus")
    moved = Mesh(mesh.vertices * 4 + [1, 2, 3], mesh.faces, "torus")
    colours = mesh_texture(mesh.vertices, mesh)
    np.testing.assert_allclose(mesh_texture(moved.vertices, moved), colours, atol=2e-4)
    step = 1e-3 * mesh.radius
    assert np.abs(mesh_texture(mesh.vertices + [step, 0, 0], mesh) - colours).max() < 0.05
