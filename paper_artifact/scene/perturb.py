"""What photographs do to a scene: noise in images, cameras and cloud, outliers, gaps, patterns behind it.

Only what is trained on suffers: training views, their poses, the SfM cloud. Held-out views and the ground
truth stay clean. Each draw is a function of the view's place, not of order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import Camera
from paper_artifact.scene.texture import solid_texture

SEED = 0  # of everything here: the runs of all seeds see one scene
GAPS = 3  # places in which the cloud is cut out
OUTLIER_BOX = 1.5  # outliers lie in the cloud's box, that much larger
PATTERN = 1.0  # of the surrounding: wave numbers of the meshes' texture on the sphere of directions


@dataclass(frozen=True)
class Perturbation:
    """How much of each; checked where a run is configured (`paper_artifact.config.NOISES`)."""

    image_noise: float = 0.0  # standard deviation per pixel and channel, colours in [0,1]
    camera_noise: float = 0.0  # standard deviation per axis of a camera's centre, / diagonal
    cloud_noise: float = 0.0  # standard deviation per axis of a point, / diagonal
    cloud_outliers: float = 0.0  # share of points that lie anywhere
    cloud_missing: float = 0.0  # share of points that is cut out


CLEAN = Perturbation()


def noisy_image(image: np.ndarray, perturbation: Perturbation, view: int) -> np.ndarray:
    """Return `image` (H,W,3) in [0,1] with Gaussian noise, clipped to [0,1]; view: its place."""
    if perturbation.image_noise == 0:
        return image
    noise = stream(SEED, "image noise", view).standard_normal(image.shape)
    return np.clip(image + perturbation.image_noise * noise, 0.0, 1.0)


def moved_camera(camera: Camera, perturbation: Perturbation, diagonal: float, view: int) -> Camera:
    """Return `camera` with its centre displaced and its orientation kept.

    What lies at the scene's distance is displaced in the image as if it had moved by the same length.
    diagonal: the mesh's, world units; view: its place.
    """
    if perturbation.camera_noise == 0:
        return camera
    step = perturbation.camera_noise * diagonal * stream(SEED, "camera noise", view).standard_normal(3)
    x, y, z = (np.asarray(camera.translation) - camera.rotation @ step).tolist()
    return replace(camera, translation=(x, y, z))


def perturbed_cloud(
    positions: np.ndarray, colours: np.ndarray, perturbation: Perturbation, diagonal: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (positions (m,3), colours (m,3)) of an SfM cloud (n,3): gaps first, then noise, then outliers.

    A gap holds the points nearest to one of the cloud, drawn by chance. diagonal: the mesh's, world units.
    """
    if perturbation.cloud_missing > 0:
        draws = stream(SEED, "cloud gaps")
        total = round(perturbation.cloud_missing * len(positions))
        for count in np.diff(np.linspace(0, total, GAPS + 1).round().astype(int)):
            centre = positions[draws.integers(len(positions))]
            order = np.argsort(np.linalg.norm(positions - centre, axis=1), kind="stable")
            kept = np.sort(order[count:])
            positions, colours = positions[kept], colours[kept]
    low, high = positions.min(axis=0), positions.max(axis=0)
    if perturbation.cloud_noise > 0:
        noise = stream(SEED, "cloud noise").standard_normal(positions.shape)
        positions = positions + perturbation.cloud_noise * diagonal * noise
    if perturbation.cloud_outliers > 0:
        draws = stream(SEED, "cloud outliers")
        chosen = draws.permutation(len(positions))[: round(perturbation.cloud_outliers * len(positions))]
        positions = positions.copy()
        anywhere = OUTLIER_BOX * (draws.random((len(chosen), 3)) - 0.5)
        positions[chosen] = (low + high) / 2 + anywhere * (high - low)
    return positions, colours


def surrounding(camera: Camera) -> np.ndarray:
    """Return the image (H,W,3) float32 in [0,1] of a pattern infinitely far away, one for all cameras."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack(
        [
            (columns - camera.centre_x) / camera.focal_x,
            (rows - camera.centre_y) / camera.focal_y,
            np.ones(rows.shape),
        ],
        axis=-1,
    )
    directions = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3) @ camera.rotation
    return solid_texture(directions, np.zeros(3), 1.0, PATTERN).reshape(*rows.shape, 3)
