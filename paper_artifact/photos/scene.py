"""A folder of photographs → COLMAP scene: scaled, registered (`register`), cropped to one size, checked.

The photographs' EXIF orientation is ignored: structure from motion does not care, and a phone's upright and
level pictures stay one camera with one size. The scene's frame is turned so that +z is up in the mean
picture.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from paper_artifact import __version__
from paper_artifact.errors import InputError
from paper_artifact.files import load_json, write_json
from paper_artifact.photos.exposure import even_out
from paper_artifact.photos.register import HINTS, LEAST, Registered, need_pycolmap, register
from paper_artifact.scene.cameras import world_to_clip
from paper_artifact.scene.colmap import Model, read_model, write_model
from paper_artifact.scene.folder import DESCRIPTION
from paper_artifact.scene.holdout import AUTO
from paper_artifact.scene.images import opened
from paper_artifact.scene.whole import holds, whole_folder

FORMAT = 1  # raised whenever the same photographs would give another scene
ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")
QUALITY = 95  # of JPEG files written between photograph and scene
LARGEST_ERROR = 1.5  # pixels of reprojection above which a model is doubtful
FEWEST_POINTS = 300  # of the cloud, below which a model is doubtful


@dataclass(frozen=True)
class PhotosConfig:
    """How photographs become a scene. Raises InputError for values out of range."""

    size: int = 800  # longest side of the scene's images, pixels
    features: int = 1600  # longest side of the pictures that features are found on, pixels
    even: bool = True  # bring the photographs to one exposure, see `photos.exposure`

    def __post_init__(self) -> None:
        for name in ("size", "features"):
            value = getattr(self, name)
            if not 64 <= value <= 16384:
                raise InputError(f"--{name} must be from 64 to 16384 pixels, got {value}")


def photographs_in(folder: Path | str) -> tuple[Path, ...]:
    """Return the pictures in a folder, by name. Raises InputError for no folder or fewer than three
    pictures."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"no folder at {folder}; give the folder that holds the photographs")
    files = sorted(each for each in folder.iterdir() if each.is_file() and not each.name.startswith("."))
    photographs = tuple(each for each in files if each.suffix.lower() in ENDINGS)
    if len(photographs) < LEAST:
        others = sorted({each.suffix.lower() for each in files} - {*ENDINGS, ""})
        seen = f" (it also has {', '.join(others)}: convert them to JPEG)" if others else ""
        raise InputError(
            f"{folder} has {len(photographs)} photographs of the kinds {' '.join(ENDINGS)}{seen}; "
            f"at least {LEAST} are needed, 20 to 100 are good"
        )
    stems = [each.stem for each in photographs]
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
    if twice:
        raise InputError(f"{folder} has two photographs called {twice[0]}; give each a name of its own")
    return photographs


def photographs_scene(
    source: Path | str,
    folder: Path | str,
    config: PhotosConfig | None = None,
    progress: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> Registered:
    """Make the COLMAP scene of the photographs in `source` at `folder`, and return what was found.

    Contents: images/, sparse/0/, scene.json (background: `empty_colour`; radius; what was registered). All or
    nothing; a folder that holds the scene of these very photographs is returned as it is. tell is called with
    each doubt about the model. Raises InputError for unreadable photographs, too few that register, missing
    pycolmap, or a folder that holds anything else.
    """
    folder, config = Path(folder), config or PhotosConfig()
    photographs = photographs_in(source)
    key = _key(photographs, config)
    if holds(folder, key):
        held = load_json(folder / DESCRIPTION)["photographs"]
        return Registered(folder, **{**held, "names": tuple(held["names"])})
    colmap = need_pycolmap()
    with whole_folder(folder, key) as temporary:
        work = temporary / "work"
        groups = prepared(photographs, work / "pictures", config.features, progress)
        found = register(work / "pictures", groups, work, config.size, progress)
        for doubt in doubts(found, [each.stem + ".jpg" for each in photographs]):
            tell(doubt)
        model = upright(read_model(found.folder / "sparse"))
        (temporary / "images").mkdir()
        model = _cropped(model, found.folder / "images", temporary / "images")
        if config.even:
            even_out(temporary / "images", found.exposures)
        write_model(model, temporary / "sparse" / "0")
        shutil.rmtree(work)
        low, high = np.percentile(model.positions, [1, 99], axis=0)
        facts = {name: value for name, value in found._asdict().items() if name != "folder"}
        description = {
            "format": FORMAT,
            "package": __version__,
            "pycolmap": colmap.__version__,
            "key": key,
            "config": asdict(config),
            "holdout": AUTO,
            "background": empty_colour(model, temporary / "images"),
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


def upright(model: Model) -> Model:
    """Return the model turned about the origin so that the mean of the pictures' up directions is +z."""
    rotations = {index: _rotation(pose.quaternion) for index, pose in model.images.items()}
    up = -sum(each.as_matrix()[1] for each in rotations.values())  # a row of R is a camera axis in the world
    if np.linalg.norm(up) < 1e-6 * len(rotations):
        return model
    turn, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    images = {
        index: replace(
            pose, quaternion=tuple(map(float, (rotations[index] * turn.inv()).as_quat(scalar_first=True)))
        )
        for index, pose in model.images.items()
    }
    return replace(model, images=images, positions=turn.apply(model.positions))


def _rotation(quaternion: tuple[float, ...]) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


def _key(photographs: Sequence[Path], config: PhotosConfig) -> str:
    """Return the sha256 (hex) of what the scene depends on; pycolmap's version is told, not asked for."""
    digests = [(each.name, hashlib.sha256(each.read_bytes()).hexdigest()) for each in photographs]
    content = {"format": FORMAT, "config": asdict(config), "photographs": digests}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def prepared(photographs: Sequence[Path], folder: Path, size: int, progress: bool) -> list[list[str]]:
    """Write the photographs as JPEG of at most `size` pixels a side to `folder`; return their names by
    camera.

    Photographs of one size, camera and focal length (EXIF) are of one camera.
    """
    folder.mkdir(parents=True)
    cameras: dict[tuple, list[str]] = defaultdict(list)
    for file in tqdm(photographs, desc="reading", unit="photo", disable=not progress):
        with opened(file, file) as read:
            exif = read.getexif()
            own = exif.get_ifd(ExifTags.IFD.Exif)
            exif.pop(ExifTags.Base.Orientation, None)
            read.draft("RGB", (size, size))
            picture = read.convert("RGB")
            picture.thumbnail((size, size), Image.Resampling.LANCZOS)
            picture.save(content := io.BytesIO(), "JPEG", quality=QUALITY, subsampling=0, exif=exif)
        target = folder / f"{file.stem}.jpg"
        target.write_bytes(content.getvalue())
        focal = str(own.get(ExifTags.Base.FocalLength))
        cameras[(picture.size, exif.get(ExifTags.Base.Model), focal)].append(target.name)
    if len({size[0] >= size[1] for size, *_ in cameras}) > 1:
        raise InputError(
            f"{photographs[0].parent} mixes upright and level pictures; turn them all to one format"
        )
    return list(cameras.values())


def _cropped(model: Model, source: Path, target: Path) -> Model:
    """Write the model's pictures to `target`, cropped about their middle to the smallest size among them.

    Returns the model with cameras that fit.
    """
    width = min(camera.width for camera in model.cameras.values())
    height = min(camera.height for camera in model.cameras.values())
    corners = {
        index: ((camera.width - width) // 2, (camera.height - height) // 2)
        for index, camera in model.cameras.items()
    }
    cameras = {}
    for index, camera in model.cameras.items():
        *focal, x, y = camera.parameters
        moved = (*focal, x - corners[index][0], y - corners[index][1])
        cameras[index] = replace(camera, width=width, height=height, parameters=moved)
    for pose in model.images.values():
        whole, (left, top) = model.cameras[pose.camera], corners[pose.camera]
        if (whole.width, whole.height) == (width, height):
            shutil.copyfile(source / pose.name, target / pose.name)
            continue
        with Image.open(source / pose.name) as picture:
            box = (left, top, left + width, top + height)
            picture.convert("RGB").crop(box).save(target / pose.name, quality=QUALITY, subsampling=0)
    return replace(model, cameras=cameras)


def empty_colour(model: Model, images: Path) -> list[float]:
    """Return the median colour, RGB in [0,1], of what lies far from every point of the cloud: sky, or a wall.

    Far: a tenth of the picture's width. It stands behind the soup, where no triangle starts. Where the cloud
    is everywhere it is the median of the whole pictures.
    """
    far, all_of_them = [], []
    for index, pose in model.images.items():
        camera = model.camera(index)
        with Image.open(images / pose.name) as picture:
            small = np.asarray(picture.convert("RGB").reduce(8), np.float64) / 255
        matrix = world_to_clip(camera, 1e-3, 1e3)
        clip = model.positions @ matrix[[0, 1, 3], :3].T + matrix[[0, 1, 3], 3]
        clip = clip[clip[:, 2] > 0]
        seen = (clip[:, :2] / clip[:, 2:] + 1) / 2
        seen = seen[((seen >= 0) & (seen < 1)).all(1)]
        empty = np.ones(small.shape[:2], bool)
        height, width = empty.shape
        empty[(seen[:, 1] * height).astype(int), (seen[:, 0] * width).astype(int)] = False
        distance = distance_transform_edt(empty) if not empty.all() else np.full(empty.shape, np.inf)
        far.append(small[distance > width / 10])
        all_of_them.append(small.reshape(-1, 3))
    pixels = np.concatenate(far)
    if not len(pixels):
        pixels = np.concatenate(all_of_them)
    return [round(float(value), 4) for value in np.median(pixels, axis=0)]
