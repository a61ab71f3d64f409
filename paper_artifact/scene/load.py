"""COLMAP scene on disk → arrays for training and evaluation; reads this package's scenes and anyone's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact import arithmetic
from paper_artifact.errors import InputError, real, require_memory
from paper_artifact.frame import SAME, Frame, frame_for
from paper_artifact.scene.cameras import FAR, NEAR, framed, picture_radii, world_to_clip
from paper_artifact.scene.colmap import Model, read_model
from paper_artifact.scene.folder import (
    check_files,
    image_files,
    model_folder,
    other_models,
    read_description,
    scene_root,
)
from paper_artifact.scene.ground_truth import background_colour
from paper_artifact.scene.images import (
    Pixels,
    composited,
    is_blank,
    mask_of,
    read_pixels,
    sizes_told,
    tell_some,
)

MEAN = "mean"  # as a background: the mean colour of the photographs
EVERY = 8  # of that many views one is held out, as in Mip-NeRF 360 and DiffSoup
AUTO, NONE = "auto", "none"


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene as the trainer sees it; `n` views in the order of their names."""

    path: Path  # its folder
    names: tuple[str, ...]  # of the images' files
    images: np.ndarray  # (n,3,H,W) uint8, row 0 on top; `colours` gives them in [0,1]
    world_to_clip: np.ndarray  # (n,4,4) float32, see `cameras.world_to_clip`
    camera_centres: np.ndarray  # (n,3) float32, world units
    background: np.ndarray  # (3,) float32 RGB in [0,1]
    points: np.ndarray  # (P,3) float32, the SfM cloud, world units
    train: np.ndarray  # (k,) int64, indices of the views to train on
    holdout: np.ndarray  # (m,) int64, indices of the views held out
    radius: float = 1.0  # bounding radius, world units: the unit of learning rates and of near and far
    frame: Frame = SAME  # of the world units here, which are the files' unless those are far, huge or tiny
    rendered: bool = True  # of a mesh by this package, or photographs: `units`

    def units(self, vertices: np.ndarray) -> np.ndarray:
        """Return what `vertex_lr` is per unit of at each vertex (…,3), over `radius`: (…) float32.

        A step is as long in the pictures of any scene as in the study's, near and far: `picture_radii`. A
        rendered scene states its radius, which is that of its centre, for all.
        """
        if self.rendered:
            return np.ones(vertices.shape[:-1], np.float32)
        found, _ = picture_radii(vertices, self.world_to_clip[self.train])
        return np.where(np.isfinite(found), found / self.radius, 1).astype(np.float32)

    def colours(self, views: np.ndarray | list[int] | int) -> np.ndarray:
        """Return the images of these views, (…,H,W,3) float32 in [0,1]."""
        return np.moveaxis(self.images[views], -3, -1) / np.float32(255)


def load_scene(
    path: Path | str,
    *,
    downscale: float = 1.0,
    background: str | None = None,
    holdout: str | int | None = None,
) -> Scene:
    """Return the COLMAP scene in the folder `path` (see `scene_root`): photographs, and a sparse model,
    binary or text. Views without photograph are left out, which a line on stderr says.

    Radius and, where `background` is None, the background come from scene.json where there is one; else the
    background is white and the radius half the diagonal of the cloud's central 98 % box. background: "white",
    "black", "mean" (of the training photographs) or "#rrggbb"; what is transparent, or black in `masks/`, is
    composited over it. downscale: see `images.composited`. holdout: see `held_out`; None takes
    scene.json's, which is every 8th for this package's scenes, else "auto". One image is read at a time.

    Raises InputError for a downscale below 1, missing or damaged files, images of unequal size or of another
    aspect than their camera, fewer than two views, an SfM cloud of fewer than four points.
    """
    if not 1 <= real(downscale) < np.inf:
        raise InputError(f"downscale is {downscale!r:.60}; give a number of at least 1")
    path = scene_root(path)
    description = read_description(path)
    check_files(path, description)
    folder = model_folder(path)
    model, others = read_model(folder), other_models(folder)
    tell_some(path, others, len(others) + 1, f"models are not read, {folder.name} is")
    found = _views(path, model, complete="key" in description)
    names, files = tuple(model.images[image].name for image in found), [*found.values()]
    if len(names) < 2:
        raise InputError(f"{path} has {len(names)} views; at least 2 are needed, one of them is held out")
    if len(set(names)) < len(names):
        raise InputError(f"{path} lists an image name twice; export the COLMAP model again")
    if len(model.positions) < 4:
        raise InputError(
            f"{path} has an SfM cloud of {len(model.positions)} points; at least 4 are needed to start from"
        )
    centre, radius = _cloud_ball(model.positions)
    radius = float(description.get("radius", 0.0)) or radius
    frame = frame_for(centre, radius)
    radius = frame.length(radius)
    cameras = [framed(model.camera(image), frame) for image in found]
    centres = np.stack([camera.position for camera in cameras])
    own = str(EVERY) if "key" in description else AUTO  # the study's scenes keep their held-out views
    chosen = held_out(description.get("holdout", own) if holdout is None else str(holdout), names, centres)
    indices = np.arange(len(names))
    train = indices[~np.isin(indices, chosen)]

    def pixels(view: int) -> Pixels:
        file, camera = files[view], cameras[view]
        return read_pixels(file, camera.width / camera.height, mask_of(path, names[view]))

    if isinstance(background, str) and background == MEAN:
        colour = _mean_colour(pixels(int(view)) for view in train)
    elif background is not None:
        colour = background_colour(str(background))
    else:
        colour = np.array(description.get("background", (1.0, 1.0, 1.0)), dtype=np.float32)
    first = composited(pixels(0), colour, downscale)
    require_memory(
        len(names) * first.nbytes, f"the {len(names)} images of {path}", "make them smaller (--downscale)"
    )
    images = np.empty((len(names), *first.shape), np.uint8)
    images[0] = first
    sizes = Counter([first.shape[:0:-1]])
    for view in range(1, len(names)):
        image = composited(pixels(view), colour, downscale)
        sizes[image.shape[:0:-1]] += 1
        if len(sizes) == 1:
            images[view] = image
    if len(sizes) > 1:
        raise InputError(
            f"{path} mixes images of several sizes, {sizes_told(sizes)}, and training takes one: give the "
            "photographs to `python -m paper_artifact photos`, which brings them to one"
        )
    blank = [name for name, image in zip(names, images, strict=True) if is_blank(image)]
    tell_some(path, blank, len(names), "photographs are of a single colour and show nothing")
    return Scene(
        path=path,
        names=names,
        images=images,
        world_to_clip=np.stack(
            [world_to_clip(camera, NEAR * radius, FAR * radius) for camera in cameras]
        ).astype(np.float32),
        camera_centres=centres.astype(np.float32),
        background=colour,
        points=frame.inward(model.positions).astype(np.float32),
        train=train,
        holdout=chosen,
        radius=radius,
        frame=frame,
        rendered="camera_distance_in_radii" in description,
    )


def _views(path: Path, model: Model, complete: bool) -> dict[int, Path]:
    """Return the photographs that are there by image, in the order of their names; a line tells the others.

    complete: raise InputError for the first that is not there, as for fewer than two views left.
    """
    poses = sorted(model.images.items(), key=lambda each: each[1].name)
    found = image_files(path, [pose.name for _, pose in poses])
    files = {image: file for (image, _), file in zip(poses, found, strict=True)}
    exact = {image for image, pose in poses if str(files[image]).endswith(f"/{pose.name}")}
    taken = {files[image] for image in exact}  # by the image that is called so, of all that nearly are
    files = {image: file if image in exact or file not in taken else None for image, file in files.items()}
    owners: dict[Path, str] = {}
    for image, pose in poses:
        if (file := files[image]) is not None and (owner := owners.setdefault(file, pose.name)) != pose.name:
            raise InputError(
                f"{file} would be the photograph of two images, {owner} and {pose.name}; copy the "
                "photographs with their folders and endings"
            )
    missing = [pose.name for image, pose in poses if files[image] is None]
    if missing and (complete or len(missing) > len(poses) - 2):
        raise InputError(
            f"no image at {path / 'images' / missing[0]}, which the COLMAP model lists ({len(missing)} of "
            f"{len(poses)} are missing); copy the images folder too"
        )
    tell_some(path, missing, len(poses), "views are left out, their images are not there")
    return {image: file for image, file in files.items() if file is not None}


def _mean_colour(pictures: Iterable[Pixels]) -> np.ndarray:
    """Return the mean colour (3,) float32 in [0,1] of what counts in the pictures."""
    total, weight = np.zeros(3), 0.0
    for each in pictures:
        alpha = np.full(each.colours.shape[:2], 255, np.uint8) if each.alpha is None else each.alpha
        total += np.einsum("hwc,hw->c", each.colours, alpha, dtype=np.float64)
        weight += float(alpha.sum(dtype=np.float64))
    if weight == 0:
        raise InputError("the masks leave nothing of the photographs; check that white is what counts")
    return (total / weight / 255).astype(np.float32)


def _cloud_ball(positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the centre (3,) and half the diagonal of the box of the 1st to 99th percentile: real SfM clouds
    have far outliers.

    World units.
    """
    low, high = np.percentile(positions, [1, 99], axis=0)
    radius = float(arithmetic.norm(high - low)) / 2
    if radius <= 0:
        raise InputError("the SfM cloud is a single point; export the COLMAP model again")
    return (low + high) / 2, radius


def held_out(rule: str, names: Sequence[str], centres: np.ndarray) -> np.ndarray:
    """Return the indices (m,) int64 of the views that are held out, increasing.

    names: of the views, sorted; centres (n,3): their cameras', world units. rule: "none"; a number k (every
    k-th from the first on); names with commas between; or "auto" (`_surrounded`). Raises InputError for
    another rule, an unknown name, or a rule that leaves no view to train on.
    """
    if (rule := rule if rule in names else rule.strip()) == NONE:
        return np.arange(0)
    if rule == AUTO:
        return _surrounded(centres)
    if rule.isdecimal():
        chosen = np.arange(0, len(names), max(1, int(rule)) if len(rule) < 19 else len(names))
    else:
        asked = [rule] if rule in names else [name.strip() for name in rule.split(",") if name.strip()]
        unknown = [name for name in asked if name not in names]
        if unknown or not asked:
            raise InputError(
                f"no view is called {', '.join(unknown) or repr(rule)}; hold out every k-th (a number), "
                f"{NONE}, {AUTO}, or names such as {names[0]},{names[-1]}"
            )
        chosen = np.array(sorted({list(names).index(name) for name in asked}))
    if len(chosen) == len(names):
        raise InputError(f"holding out {rule!r} leaves no view to train on; hold out fewer of {len(names)}")
    return chosen


def _surrounded(centres: np.ndarray) -> np.ndarray:
    """Return of about eight consecutive views each the one whose second nearest camera is nearest, (m,).

    Photographs are taken along a walk, whose first view, which "every 8th" would hold out, is often the
    extreme one: nothing else has seen what it sees, and its score says nothing of the soup. The rule looks at
    cameras alone, never at pictures. Ties go to the middle of the eight; two cameras (n,3) hold out one.
    """
    count = len(centres)
    if count < 3:
        return np.arange(count - 1, count)
    distance = cKDTree(centres).query(centres, k=3)[0][:, 2]
    rank = np.round(distance / distance.max(), 3) if distance.max() > 0 else distance
    found = []
    for block in np.array_split(np.arange(count), max(1, round(count / EVERY))):
        middle = np.abs(block - block.mean())
        found.append(int(block[np.lexsort((block, middle, rank[block]))[0]]))
    return np.array(found)
