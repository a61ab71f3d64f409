"""Where the thing in the middle is: the ball that all cameras look at, without the ground; the visual hull.

A soup of photographs holds the table and the room as well; a closed mesh is wanted of the subject alone. Ball
and ground are computed from the cameras and the SfM cloud, without the pictures. The visual hull is where a
surface can be, as the outlines in many views allow (Laurentini, 1994); a cloud on it is a start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from paper_artifact import arithmetic
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import Camera
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.folder import model_folder, scene_root

if TYPE_CHECKING:
    from paper_artifact.scene.load import Scene

RADIUS = 0.6  # of the ball, in half widths of the picture at the subject's distance
EDGE = 1.0  # of the ball that cuts nothing which the pictures show whole, in the same unit
GROUND = 0.03  # what lies lower than this above the plane is ground, in the same unit; 0 keeps the ground
PLANE = 0.01  # points this near to a plane are on it, in the same unit
DRAWS = 1000  # planes through three points that are tried
ON = 0.1  # share of the points around the subject that a ground holds at least
BELOW = 0.15  # share of them that may lie under it: nothing is seen through a ground, some beside it
TILT = 0.7  # cosine between the ground's normal and the pictures' mean up, at least
COARSE, FINE = 48, 144  # cells per side of the box that is carved: to find the hull, then to find its skin


@dataclass(frozen=True)
class Subject:
    """A ball, cut by a plane; world units of the cameras."""

    centre: np.ndarray  # (3,) float64: the point nearest to all optical axes
    radius: float
    up: np.ndarray  # (3,) float64 unit normal of the ground, towards the cameras
    lowest: float  # points with up·x below this are ground; -inf: the ground is kept, or there is none

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Return for points (…,3) whether each belongs to the subject, (…) bool."""
        near = arithmetic.norm(points - self.centre) <= self.radius
        return near & (arithmetic.product(points, self.up) >= self.lowest)


def subject_of_scene(scene: Path | str, radius: float = RADIUS, ground: float = GROUND) -> Subject:
    """Return `subject_of` for the COLMAP scene in a folder, in the files' coordinates. Raises InputError also
    for missing or damaged files."""
    model = read_model(model_folder(scene_root(scene)))
    return subject_of([model.camera(image) for image in model.images], model.positions, radius, ground)


def within(scene: Scene) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return the function of points (…,3), world units of a run on `scene`, that says which of them are the
    subject's, (…) bool; None where all are: rendered scenes, and photographs without a ground or without a
    common point. The ball reaches to the pictures' edge, so that it cuts nothing that they show whole. Points
    of which it holds none, as of a flat wall, all count."""
    if scene.rendered:
        return None
    try:
        subject = subject_of_scene(scene.path, EDGE)
    except InputError:  # cameras without a common point
        return None
    if np.isinf(subject.lowest):
        return None

    def holds(points: np.ndarray) -> np.ndarray:
        held = subject.holds(scene.frame.outward(points))
        return held if held.any() else ~held

    return holds


def subject_of(
    cameras: Sequence[Camera], cloud: np.ndarray, radius: float = RADIUS, ground: float = GROUND
) -> Subject:
    """Return what the cameras look at; cloud (P,3) is the SfM cloud, radius and ground are in half widths of
    the picture at the subject's distance (means over the cameras).

    Ground is a plane that holds a tenth of the points around the subject, has the cameras above it and hardly
    a point below, and whose normal is near the pictures' mean up (or down: all may lie on their head); a wall
    or a trunk is none. Raises InputError for a radius that is not positive, a negative ground, or cameras
    that look at no common point.
    """
    if not radius > 0 or not ground >= 0:
        raise InputError(
            f"the ball's radius must be positive and the ground at least 0, got {radius}, {ground}"
        )
    places = np.array([camera.position for camera in cameras])
    axes = np.array([camera.rotation[2] for camera in cameras])
    centre = _common_point(places, axes)
    if centre is None:
        raise InputError("the cameras look along parallel axes, so at no common point; leave out --scene")
    depth = arithmetic.dot(axes, centre - places)
    if (depth <= 0).mean() > 0.5:
        raise InputError("most cameras look away from each other, so at no common point; leave out --scene")
    width = np.mean(
        [abs(d) * camera.width / (2 * camera.focal_x) for d, camera in zip(depth, cameras, strict=True)]
    )
    up, lowest = np.array([0.0, 0.0, 1.0]), -np.inf
    if ground > 0:
        near = cloud[arithmetic.norm(cloud - centre) <= width]
        mean_up = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
        plane = _ground(near.astype(np.float64), PLANE * width, places.mean(0), mean_up)
        if plane is not None:
            up, lowest = plane[0], plane[1] + ground * width
    return Subject(centre, float(radius * width), up, float(lowest))


def _common_point(places: np.ndarray, axes: np.ndarray) -> np.ndarray | None:
    """Return the point (3,) with the least sum of squared distances to the lines through `places` (n,3) along
    unit `axes` (n,3), Σ (I - a aᵀ)(x - p) = 0; None where they are parallel."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    system = across.sum(0)
    spread = arithmetic.symmetric_eigen(system[None])[0][0]
    if spread[2] > 1e6 * spread[0]:
        return None
    adjugate, determinant = arithmetic.adjugate(system)
    return arithmetic.product(adjugate, arithmetic.dot(across, places[:, None]).sum(0)) / determinant


def _ground(
    points: np.ndarray, near: float, above: np.ndarray, mean_up: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Return normal n (3,), towards the point `above`, and height h of the plane n·x = h that is a ground
    (see `subject_of`) with the most of `points` (P,3) within `near`; None where no plane is one.

    RANSAC (Fischler and Bolles 1981), then least squares over those. mean_up (3,): mean of unit vectors;
    where they cancel out, as in pictures taken from above, no direction is asked for.
    """
    if len(points) < 3:
        raise InputError(
            f"the SfM cloud has {len(points)} points around what the cameras look at, too few for a ground "
            "plane; --ground 0 keeps the ground"
        )
    random = stream(0, "ground plane")
    triples = points[random.integers(0, len(points), (DRAWS, 3))]
    best, most = None, ON * len(points)
    tilted = TILT * arithmetic.norm(mean_up) if arithmetic.norm(mean_up) > 0.5 else 0.0
    for first, second, third in triples:
        normal = np.cross(second - first, third - first)
        if not normal.any():
            continue
        normal = normal / arithmetic.norm(normal)
        normal = normal if arithmetic.dot(normal, above - first) > 0 else -normal
        if abs(arithmetic.dot(normal, mean_up)) < tilted:
            continue
        height = arithmetic.product(points, normal) - arithmetic.dot(normal, first)
        on = np.abs(height) <= near
        if on.sum() > most and (height < -2 * near).mean() <= BELOW:
            best, most = on, on.sum()
    if best is None:
        return None
    on = points[best]
    middle = on.mean(0)
    normal = arithmetic.symmetric_eigen(arithmetic.spreads((on - middle)[None]))[1][0, 0]
    normal = normal if arithmetic.dot(normal, above - middle) > 0 else -normal
    return normal, float(arithmetic.dot(normal, middle))


def hull_cloud(
    cameras: Sequence[Camera], masks: Sequence[np.ndarray], count: int, draws: np.random.Generator
) -> np.ndarray:
    """Return points (count,3) float64, world units, in the cells of the visual hull's skin.

    masks: one (H,W) bool per camera and of its size, True where the object may be; outside of a picture
    nothing is known, and what half of them do not show is left out. Every skin cell gets as many points as
    any other, up to one. Raises InputError when the outlines leave nothing, which a wrong pose or mask does.
    """
    centre, half = view_box(cameras)
    low, high = centre - half, centre + half
    for cells in (COARSE, FINE):
        step = (high - low) / cells
        inside = _carved(low, step, cells, cameras, masks, step.max() if cells == COARSE else 0.0)
        if not inside.any():
            raise InputError(
                "the outlines of the views leave no room for an object; check the poses and the images' "
                "transparency, or take --cloud random"
            )
        if cells == COARSE:
            taken = np.argwhere(inside)
            low, high = low + (taken.min(0) - 1) * step, low + (taken.max(0) + 2) * step
    padded = np.pad(inside, 1)
    buried = inside.copy()
    for axis in range(3):
        for turn in (-1, 1):
            buried &= np.roll(padded, turn, axis)[1:-1, 1:-1, 1:-1]
    skin = np.argwhere(inside & ~buried)
    rounds = -(-count // len(skin))
    chosen = np.concatenate([draws.permutation(len(skin)) for _ in range(rounds)])[:count]
    return low + (skin[chosen] + draws.random((count, 3))) * step


def view_box(cameras: Sequence[Camera]) -> tuple[np.ndarray, float]:
    """Return (centre (3,), half side) of a cube that holds what all the cameras look at, world units.

    The centre is nearest to all optical axes; the half side reaches to the edges of the widest view there.
    Raises InputError for parallel axes, which have no such point.
    """
    axes = np.stack([camera.rotation[2] for camera in cameras])
    positions = np.stack([camera.position for camera in cameras])
    centre = _common_point(positions, axes)
    if centre is None:
        raise InputError(
            "the cameras look along one direction, which leaves depth open; use views from around"
        )
    reach = [
        arithmetic.norm(centre - position)
        * max(camera.width / camera.focal_x, camera.height / camera.focal_y)
        / 2
        for camera, position in zip(cameras, positions, strict=True)
    ]
    return centre, float(max(reach))


def _carved(
    low: np.ndarray,
    step: np.ndarray,
    cells: int,
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    blur: float,
) -> np.ndarray:
    """Return which cells (cells,)*3 bool no view rules out and at least half of the views show.

    blur: distance (world units) that a cell's middle may miss an outline by.
    """
    from scipy.ndimage import maximum_filter  # only here: runs need the ball alone

    index = np.indices((cells,) * 3).reshape(3, -1).T
    points = low + (index + 0.5) * step
    left = np.arange(len(points))
    shown = np.zeros(len(points), np.int64)
    for camera, mask in zip(cameras, masks, strict=True):
        if not len(left):
            break
        seen = arithmetic.product(points[left], camera.rotation.T) + np.asarray(camera.translation)
        depth = np.maximum(seen[:, 2], 1e-12)
        column = np.floor(camera.focal_x * seen[:, 0] / depth + camera.centre_x).astype(np.int64)
        row = np.floor(camera.focal_y * seen[:, 1] / depth + camera.centre_y).astype(np.int64)
        known = (
            (seen[:, 2] > 0) & (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        )
        if blur:
            reach = min(int(np.ceil(blur * camera.focal_x / depth.min())), max(mask.shape))  # pixels
            mask = maximum_filter(mask, size=2 * reach + 1)
        shown[left] += known
        known[known] = ~mask[row[known], column[known]]
        left = left[~known]
    inside = np.zeros(cells**3, bool)
    inside[left[2 * shown[left] >= len(cameras)]] = True
    return inside.reshape((cells,) * 3)
