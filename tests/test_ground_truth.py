"""Ground-truth images and the opaque raster against trimesh's ray casting."""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_dilation, binary_erosion

from paper_artifact.mesh import Mesh
from paper_artifact.raster.view import rasterize_opaque
from paper_artifact.scene.cameras import FAR, NEAR, Camera, fibonacci_cameras, world_to_clip
from paper_artifact.scene.ground_truth import background_colour, mesh_texture, render_ground_truth
from paper_artifact.scene.shapes import make_shape

SIZE = 40


def coarse_shape(name: str) -> Mesh:
    """Few enough triangles for trimesh's plain-numpy ray casting, and self-occlusion in the torus."""
    if name == "cube":
        return make_shape("cube")
    ring = trimesh.creation.torus(major_radius=1.0, minor_radius=0.38, major_sections=24, minor_sections=12)
    return Mesh(np.asarray(ring.vertices, float), np.asarray(ring.faces, np.int64), "ring")


def cast(mesh: Mesh, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hit of the ray through every pixel centre: world positions (H,W,3), NaN where missed, and
    depths (H,W).
    """
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x, y = (column - camera.centre_x) / camera.focal_x, (row - camera.centre_y) / camera.focal_y
    rays = np.dstack([x, y, np.ones_like(x)]).reshape(-1, 3) @ camera.rotation
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    starts = np.tile(camera.position, (len(rays), 1))
    hits, ray, _ = surface.ray.intersects_location(starts, rays, multiple_hits=True)
    depth = (hits - camera.position) @ camera.rotation[2]
    positions, depths = np.full((len(rays), 3), np.nan), np.full(len(rays), np.inf)
    for index in np.argsort(-depth):  # the nearest is written last
        positions[ray[index]], depths[ray[index]] = hits[index], depth[index]
    return positions.reshape(camera.height, camera.width, 3), depths.reshape(camera.height, camera.width)


@pytest.mark.parametrize("name", ["cube", "ring"])
def test_coverage_depth_and_positions_agree_with_ray_casting(name):
    mesh = coarse_shape(name)
    pixels = covered = differing = 0
    for camera in fibonacci_cameras(mesh, 9, SIZE)[::4]:
        near, far = NEAR * mesh.radius, FAR * mesh.radius
        matrix = world_to_clip(camera, near, far)
        clip = (mesh.vertices @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32)
        triangle, b0, b1, depth = rasterize_opaque(clip, mesh.faces.astype(np.int32), SIZE, SIZE)
        positions, depths = cast(mesh, camera)
        both = (triangle > 0) & np.isfinite(depths)
        pixels, covered = pixels + SIZE * SIZE, covered + int(both.sum())
        corner = mesh.vertices[mesh.faces[triangle[both] - 1]]
        weights = np.stack([b0[both], b1[both], 1 - b0[both] - b1[both]], axis=1)
        raster = (corner * weights[:, :, None]).sum(axis=1)
        ndc = (far + near) / (far - near) - 2 * far * near / (far - near) / depths[both]
        away = np.linalg.norm(raster - positions[both], axis=1) > 1e-3 * mesh.radius
        away |= np.abs(depth[both] - ndc) > 2e-6
        # A pixel centre on a silhouette may fall to either side: counted, not excused.
        differing += int(((triangle > 0) != np.isfinite(depths)).sum() + away.sum())
    assert covered > 0.1 * pixels
    assert differing <= 2, f"{differing} of {pixels} pixels differ"


def test_the_image_shows_the_texture_inside_and_the_background_outside():
    mesh = coarse_shape("cube")
    camera = fibonacci_cameras(mesh, 5, SIZE)[2]
    positions, depths = cast(mesh, camera)
    hit, around = np.isfinite(depths), np.ones((3, 3))
    outside, inside = ~binary_dilation(hit, around), binary_erosion(hit, around, border_value=1)
    for name in ("white", "black"):
        background = background_colour(name)
        image = render_ground_truth(mesh, camera, background, supersample=4)
        assert image.shape == (SIZE, SIZE, 3) and image.dtype == np.float32
        assert np.abs(image[outside] - background).max() < 1e-6
        assert np.abs(image[inside] - mesh_texture(positions[inside], mesh)).mean() < 0.01


def test_supersampling_gives_the_covered_fraction_at_the_edge():
    mesh = make_shape("sphere")
    camera = fibonacci_cameras(mesh, 3, SIZE)[1]
    colours = map(background_colour, ("white", "black"))
    white, black = (render_ground_truth(mesh, camera, each, supersample=4) for each in colours)
    uncovered = (white - black)[..., 0]
    np.testing.assert_allclose(uncovered * 16, np.round(uncovered * 16), atol=1e-4)
    # The sphere's outline is a circle of angular radius asin(1/3).
    radius = camera.focal_x * np.tan(np.arcsin(1 / 3))
    assert (1 - uncovered).sum() == pytest.approx(np.pi * radius**2, rel=0.01)
