"""A folder of photographs → COLMAP scene: scaled, registered (`register`), brought to one size, checked.

The trainer has one size for all views: others are scaled and cropped to what is common. The scene's frame is
turned so that +z is up in the mean picture, as its EXIF orientation has it (`pictures` does not apply that).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from paper_artifact import __version__
from paper_artifact.errors import InputError, require_disk
from paper_artifact.files import file_digest, load_json, write_json
from paper_artifact.photos.pictures import (
    FRAMES,
    LEVEL,
    QUALITY,
    VIDEOS,
    evened,
    photographs_in,
    prepared,
    size_doubts,
    unread,
    video_frames,
)
from paper_artifact.photos.register import HINTS, Registered, log_to, need_pycolmap, register, undistort
from paper_artifact.scene.cameras import world_to_clip
from paper_artifact.scene.colmap import Model, read_model, write_model
from paper_artifact.scene.folder import DESCRIPTION, check_same, holds, value_digest, whole_folder
from paper_artifact.scene.load import AUTO

FORMAT = 4  # raised whenever the same photographs would give another scene
LARGEST_ERROR = 1.5  # pixels of reprojection above which a model is doubtful
FEWEST_POINTS = 300  # of the cloud, below which a model is doubtful
PER_PHOTOGRAPH = 4 * 2**20  # bytes that pictures, features and matches of one take while it is registered
CROPPED_ALONE = 0.9  # a picture that would be scaled by more than this is cropped only, which blurs nothing


@dataclass(frozen=True)
class PhotosConfig:
    """How photographs become a scene. Raises InputError for values out of range."""

    size: int = 800  # longest side of the scene's images, pixels
    features: int = 1600  # longest side of the pictures that features are found on, pixels
    even: bool = True  # bring the photographs to one exposure, see `photos.pictures`
    every: int | None = None  # of a video: one of this many frames, None: about `pictures.FRAMES` of all

    def __post_init__(self) -> None:
        for name in ("size", "features"):
            value = getattr(self, name)
            if not 64 <= value <= 16384:
                raise InputError(f"--{name} must be from 64 to 16384 pixels, got {value}")
        if self.every is not None and self.every < 1:
            raise InputError(f"--every must be at least 1, got {self.every}")


def photographs_scene(
    source: Path | str,
    folder: Path | str,
    config: PhotosConfig | None = None,
    progress: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> Registered:
    """Make the COLMAP scene of the photographs in `source`, a folder or a video, at `folder`; return what was
    found.

    Contents: images/, sparse/0/, scene.json (background: `empty_colour`; radius; what was registered). All or
    nothing; a folder that holds the scene of these very photographs is returned as it is. tell is called with
    each doubt about the model. Raises InputError for unreadable photographs, too few that register, missing
    pycolmap, or a folder that holds anything else.
    """
    folder, config = Path(folder), config or PhotosConfig()
    source = Path(source)
    video = source.is_file() and source.suffix.lower() in VIDEOS
    if config.every is not None and not video:
        raise InputError(f"--every belongs to a video ({' '.join(VIDEOS)}); {source} is none")
    photographs = {source.name: source} if video else photographs_in(source)
    digests = {name: file_digest(file) for name, file in photographs.items()}
    hashed = {file: digests[name] for name, file in photographs.items()}
    said = {name: value for name, value in asdict(config).items() if value is not None}
    key = value_digest({"format": FORMAT, "config": said, "photographs": digests})
    if holds(folder, key):
        try:
            held = load_json(folder / DESCRIPTION)["photographs"]
            exposures, numbers = held["exposures"].values(), (held["points"], held["error"], held["track"])
            if not all(isinstance(each, int | float) and each >= 0 for each in (*exposures, *numbers)):
                raise ValueError("numbers that are none")
            if config.even and not (exposures and all(exposures)):
                raise ValueError("exposures that are none")
            return Registered(folder, folder, **{**held, "names": tuple(held["names"])})
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise InputError(
                f"{folder / DESCRIPTION} is damaged ({error}); remove the scene's folder and build it again"
            ) from error
    colmap = need_pycolmap()
    with whole_folder(folder, key) as temporary:
        require_disk(PER_PHOTOGRAPH * (FRAMES if video else len(photographs)), folder.absolute().parent)
        (work := temporary / "work").mkdir()
        log_to(work / "log")
        if video:
            video_frames(source, config.every, work / "frames", progress)
            photographs = photographs_in(work / "frames")
        ready = prepared(photographs, work / "pictures", work / "masks", config.features, progress)
        check_same(hashed)
        for doubt in [
            *([] if video else unread(source)),
            *size_doubts(ready.sizes, config.size),
            *useless(ready.blank, digests),
        ]:
            tell(doubt)
        found = register(work / "pictures", ready.groups, work / "masks", work, config.size, progress)
        for doubt in doubts(found, [f"{name}.jpg" for name in photographs]):
            tell(doubt)
        distorted = upright(read_model(found.folder / "sparse"), ready.up)
        exposures = found.exposures if config.even else {}
        model, small = _of_one_size(distorted, found.folder / "images", temporary / "images", exposures)
        if ready.masked:
            masks = _undistorted_masks(ready.masked, found, work, config.size, progress)
            _of_one_size(distorted, masks, temporary / "masks", {})
        write_model(model, temporary / "sparse" / "0")
        log_to(None)
        with open(temporary / "colmap.log", "wb") as log:
            log.writelines(file.read_bytes() for file in sorted(work.glob("log*")))
        shutil.rmtree(work)
        low, high = np.percentile(model.positions, [1, 99], axis=0)
        facts = {name: value for name, value in found._asdict().items() if name not in ("folder", "model")}
        description = {
            "format": FORMAT,
            "package": __version__,
            "pycolmap": colmap.__version__,
            "key": key,
            "config": asdict(config),
            "holdout": AUTO,
            "background": [1.0] * 3 if ready.masked else empty_colour(model, small),
            "radius": float(np.linalg.norm(high - low)) / 2,
            "photographs": facts,
        }
        write_json(temporary / DESCRIPTION, description)
    return found._replace(folder=folder)


def doubts(found: Registered, names: Sequence[str]) -> list[str]:
    """Return what speaks against a registration, one sentence each; names: of all pictures given."""
    lost = sorted({*names} - {*found.names})
    result = []
    if lost:
        shown = ", ".join(lost[:5]) + (" …" if len(lost) > 5 else "")
        result.append(
            f"{len(found.names)} of {len(names)} photographs registered, not {shown}; if these show what you "
            f"want, {HINTS}"
        )
    if found.points < FEWEST_POINTS:
        result.append(f"the model has {found.points} points only, little to start from; {HINTS}")
    if found.error > LARGEST_ERROR:
        result.append(
            f"the model's points miss their pictures by {found.error:.2f} pixels in the mean, good ones by "
            "less than 1; leave out blurred photographs"
        )
    return result


def upright(model: Model, up_of: Mapping[str, tuple[float, float]] | None = None) -> Model:
    """Return the model turned about the origin so that the mean of the pictures' up directions is +z.

    up_of: where up is in a picture, by its name: x to the right, y down, `LEVEL` for those not named.
    """
    rotations = {
        index: Rotation.from_quat(pose.quaternion, scalar_first=True) for index, pose in model.images.items()
    }
    up = np.zeros(3)
    for index, rotation in rotations.items():
        x, y = (up_of or {}).get(model.images[index].name, LEVEL)
        right, down, _ = rotation.as_matrix()  # a row of R is a camera axis in the world
        up += x * right + y * down
    if np.linalg.norm(up) < 1e-6 * len(rotations):
        return model
    turn, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    images = {
        index: replace(pose, quaternion=_quaternion(rotations[index] * turn.inv()))
        for index, pose in model.images.items()
    }
    return replace(model, images=images, positions=turn.apply(model.positions))


def _quaternion(rotation: Rotation) -> tuple[float, float, float, float]:
    w, x, y, z = map(float, rotation.as_quat(scalar_first=True))
    return w, x, y, z


def useless(blank: Sequence[str], digests: Mapping[str, str]) -> list[str]:
    """Return what speaks against single photographs, one sentence each; blank: names of those of one colour;
    digests: of all files, by name."""
    result = [f"{name} is of a single colour and shows nothing; leave it out" for name in blank]
    first: dict[str, str] = {}
    for name, digest in digests.items():
        if first.setdefault(digest, name) != name:
            result.append(f"{name} and {first[digest]} are the same photograph; leave one out")
    return result


def _undistorted_masks(
    masked: Collection[str], found: Registered, work: Path, size: int, progress: bool
) -> Path:
    """Return a folder of grey pictures named as the registered ones: how opaque each is, without
    distortion."""
    (opacity := work / "opacity").mkdir()
    for name in found.names:
        with Image.open(work / "pictures" / name) as picture:
            grey = Image.new("L", picture.size, 255)
        if name in masked:
            with Image.open(work / "masks" / f"{name}.png") as mask:
                grey.paste(mask)
        grey.save(opacity / name, quality=QUALITY)
    out = work / "undistorted_masks"
    undistort(opacity, found.model, out, size, len(found.names), progress)
    return out / "images"


def _of_one_size(
    model: Model, source: Path, target: Path, exposures: Mapping[str, float]
) -> tuple[Model, dict[str, np.ndarray]]:
    """Write the model's pictures to the new folder `target`, all of the smallest width and height among them.

    Each is read once: scaled down to cover that size, unless hardly, cropped about its middle, and evened out
    by its exposure. Returns the model with cameras that fit, and each picture's colours (h,w,3) in [0,1], an
    eighth as large, by name.
    """
    target.mkdir(exist_ok=True)
    width = min(camera.width for camera in model.cameras.values())
    height = min(camera.height for camera in model.cameras.values())
    cameras, boxes = {}, {}
    for index, camera in model.cameras.items():
        scale = max(width / camera.width, height / camera.height)
        scale = 1.0 if scale > CROPPED_ALONE else scale
        across, down = max(width, round(scale * camera.width)), max(height, round(scale * camera.height))
        left, top = (across - width) // 2, (down - height) // 2
        ratios = across / camera.width, down / camera.height
        *focal, x, y = camera.parameters
        fitting = [value * ratio for value, ratio in zip(focal, ratios, strict=True)]
        moved = (*fitting, x * ratios[0] - left, y * ratios[1] - top)
        cameras[index] = replace(camera, width=width, height=height, parameters=moved)
        boxes[index] = (across, down), (left, top, left + width, top + height)
    small = {}
    for pose in model.images.values():
        whole, (scaled, box) = model.cameras[pose.camera], boxes[pose.camera]
        with Image.open(source / pose.name) as read:
            stored = read if read.mode == "L" else read.convert("RGB")
            stored.load()
        picture = stored
        if (whole.width, whole.height) != (width, height):
            resized = picture.resize(scaled, Image.Resampling.LANCZOS) if scaled != picture.size else picture
            picture = resized.crop(box)
        if pose.name in exposures:
            picture = evened(picture, exposures[pose.name])
        if picture is stored:
            shutil.copyfile(source / pose.name, target / pose.name)
        else:
            picture.save(target / pose.name, quality=QUALITY, subsampling=0)
        small[pose.name] = np.asarray(picture.convert("RGB").reduce(8), np.float64) / 255
    return replace(model, cameras=cameras), small


def empty_colour(model: Model, pictures: Mapping[str, np.ndarray]) -> list[float]:
    """Return the median colour, RGB in [0,1], of what lies far from every point of the cloud: sky, or a wall.

    pictures: small copies (h,w,3) in [0,1] by name. Far: a tenth of the picture's width. The colour stands
    behind the soup, where no triangle starts. Where the cloud is everywhere it is the median of the whole
    pictures.
    """
    far: list[np.ndarray] = []
    for index, pose in model.images.items():
        small, matrix = pictures[pose.name], world_to_clip(model.camera(index), 1e-3, 1e3)
        clip = model.positions @ matrix[[0, 1, 3], :3].T + matrix[[0, 1, 3], 3]
        clip = clip[clip[:, 2] > 0]
        seen = (clip[:, :2] / clip[:, 2:] + 1) / 2
        seen = seen[((seen >= 0) & (seen < 1)).all(1)]
        height, width = small.shape[:2]
        empty = np.ones((height, width), bool)
        empty[(seen[:, 1] * height).astype(int), (seen[:, 0] * width).astype(int)] = False
        distance = distance_transform_edt(empty) if not empty.all() else np.full(empty.shape, np.inf)
        far.append(small[distance > width / 10])
    pixels = np.concatenate(far)
    if not len(pixels):
        pixels = np.concatenate([each.reshape(-1, 3) for each in pictures.values()])
    return [round(float(value), 4) for value in np.median(pixels, axis=0)]
