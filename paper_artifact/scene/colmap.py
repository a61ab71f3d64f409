"""COLMAP's sparse model: cameras, images and points3D, as text and as binary.

Format: https://colmap.github.io/format.html. What a trainer needs is kept (cameras, poses, names, points with
colour and reprojection error); 2-D observations and tracks are read past, and written as empty.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.files import decoded, inside, write_bytes
from paper_artifact.formats.polygons import read_ply_elements, whole
from paper_artifact.scene.cameras import Camera

# COLMAP's camera models in the order of their numbers: how many parameters those have that are pinholes while
# their distortion is zero, and how many focal lengths. These come first, then the centre, then distortion.
MODELS = {
    "SIMPLE_PINHOLE": (3, 1),
    "PINHOLE": (4, 2),
    "SIMPLE_RADIAL": (4, 1),
    "RADIAL": (5, 1),
    "OPENCV": (8, 2),
    "OPENCV_FISHEYE": None,
    "FULL_OPENCV": (12, 2),
    "FOV": (5, 2),
    "SIMPLE_RADIAL_FISHEYE": None,
    "RADIAL_FISHEYE": None,
    "THIN_PRISM_FISHEYE": None,
    "RAD_TAN_THIN_PRISM_FISHEYE": None,
}
MOST_MODELS = 64  # a number beyond is damage, one in between a model newer than this list
PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")  # with one focal length, and with two
FILES = ("cameras", "images", "points3D")
FARTHEST = 1e25  # world units: matrices of what is larger are not finite in float32
SHORTEST = 1e-6  # a quaternion's length; one that turns has length 1
LARGEST = 1e9  # pixels, of a camera's size and parameters


@dataclass(frozen=True)
class Intrinsics:
    """One COLMAP camera."""

    model: str  # one of MODELS
    width: int  # pixels
    height: int  # pixels
    parameters: tuple[float, ...]  # pixels: (f, cx, cy) or (fx, fy, cx, cy)


@dataclass(frozen=True)
class Pose:
    """One COLMAP image."""

    name: str  # of its file
    camera: int  # id
    quaternion: tuple[float, float, float, float]  # (w, x, y, z), world → camera
    translation: tuple[float, float, float]  # world → camera, world units


@dataclass(frozen=True, eq=False)
class Model:
    """A sparse model: cameras, images and a cloud of P points."""

    cameras: dict[int, Intrinsics]  # by id
    images: dict[int, Pose]  # by id
    point_ids: np.ndarray  # (P,) int64
    positions: np.ndarray  # (P,3) float64, world units
    colours: np.ndarray  # (P,3) uint8 RGB
    errors: np.ndarray  # (P,) float64, reprojection error, pixels

    def camera(self, image: int) -> Camera:
        """Return the pinhole camera with pose of one image id."""
        pose = self.images[image]
        intrinsics = self.cameras[pose.camera]
        *focal, centre_x, centre_y = intrinsics.parameters
        return Camera(
            width=intrinsics.width,
            height=intrinsics.height,
            focal_x=focal[0],
            focal_y=focal[-1],
            centre_x=centre_x,
            centre_y=centre_y,
            quaternion=pose.quaternion,
            translation=pose.translation,
        )


def pinhole_model(
    views: Mapping[str, Camera], ids: Sequence[int], positions: np.ndarray, colours: np.ndarray
) -> Model:
    """Return the model of views by image name, with a cloud (P,3) in world units, colours (P,3) uint8 RGB.

    ids: of each view's camera; views with the same intrinsics may share one.
    """
    return Model(
        cameras={
            camera: Intrinsics("PINHOLE", c.width, c.height, (c.focal_x, c.focal_y, c.centre_x, c.centre_y))
            for camera, c in zip(ids, views.values(), strict=True)
        },
        images={
            number: Pose(name, camera, c.quaternion, c.translation)
            for number, (camera, (name, c)) in enumerate(zip(ids, views.items(), strict=True), start=1)
        },
        point_ids=np.arange(1, len(positions) + 1),
        positions=positions,
        colours=colours,
        errors=np.zeros(len(positions)),
    )


def read_model(folder: Path | str) -> Model:
    """Return the model that the `model_files` of a sparse folder hold.

    Raises InputError, naming the file, for missing or damaged files, camera models with distortion, and
    images that refer to a camera that is not there.
    """
    paths = model_files(folder)
    cameras, images = map(_read_part, paths[:2])
    for pose in images.values():
        if isinstance(refused := cameras.get(pose.camera), InputError):
            raise InputError(f"{paths[0]}: {refused}") from refused
        if pose.camera not in cameras:
            raise InputError(
                f"{paths[1]}: image {pose.name} refers to camera {pose.camera}, which {paths[0].name} lacks; "
                "export the model again"
            )
    sound = {camera: each for camera, each in cameras.items() if isinstance(each, Intrinsics)}
    return Model(sound, dict(images), *(each.copy() for each in _read_part(paths[2])))


def _read_part(path: Path) -> Any:
    """Return what one of a model's files holds; InputError as `read_model`."""
    try:
        return _parsed(_READERS[path.name], path.read_bytes())
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; check its permissions") from error
    except (ValueError, LookupError, OverflowError, struct.error) as error:
        raise InputError(f"{path} is damaged or no COLMAP file ({error}); export the model again") from error


@lru_cache(maxsize=len(FILES))  # a command reads its scene's model several times: digest, views, subject
def _parsed(reader: Callable[[bytes], Any], data: bytes) -> Any:
    return reader(data)


def model_files(folder: Path | str) -> list[Path]:
    """Return the files that hold cameras, images and points3D in a sparse folder, each .bin or else .txt, the
    points also .ply. Raises InputError where one is missing."""
    paths = []
    for part in FILES:
        places = [inside(Path(folder), name) for name in _READERS if name.startswith(part)]
        found = [path for path in places if path.is_file()]
        if not found:
            raise InputError(
                f"no COLMAP file at {Path(folder) / part}.bin or .txt; "
                "give the folder that holds sparse/0 with cameras, images and points3D"
            )
        paths.append(found[0])
    return paths


def write_model(model: Model, folder: Path | str) -> None:
    """Write the model's three binary files into `folder`, each atomically; floats are exact.

    Raises InputError when the folder is not writable.
    """
    for name, writer in zip(FILES, (_cameras_binary, _images_binary, _points_binary), strict=True):
        write_bytes(Path(folder) / f"{name}.bin", writer(model))


class _Bytes:
    """Little-endian structures, read one after another; short data raise struct.error."""

    def __init__(self, data: bytes) -> None:
        self.data, self.offset = data, 0

    def take(self, layout: str) -> tuple:
        values = struct.unpack_from("<" + layout, self.data, self.offset)
        self.offset += struct.calcsize("<" + layout)
        return values

    def skip(self, count: int) -> None:
        self.offset += count
        if self.offset > len(self.data):
            raise ValueError("the file ends too early")

    def name(self) -> str:
        end = self.data.index(b"\0", self.offset)
        name = os.fsdecode(self.data[self.offset : end])  # other encodings keep their bytes, as on the disk
        self.offset = end + 1
        return name

    def end(self) -> None:
        if self.offset != len(self.data):
            raise ValueError(f"{len(self.data) - self.offset} bytes follow the last entry")


def _pinhole(
    camera: int, model: str, width: float, height: float, numbers: Sequence[float]
) -> Intrinsics | InputError:
    """Return a camera without its distortion. For one that bends rays return the error that is raised where
    an image names it: where distortion is not zero, and any other model, those newer than this list too."""
    count, focal = MODELS.get(model) or (None, 0)
    if model in PINHOLES and len(numbers) != count:
        raise ValueError(f"{model} with {len(numbers)} parameters")
    if len(numbers) != count or any(numbers[focal + 2 :]):
        refused = InputError(
            f"camera {camera} is a {model} camera; undistort first (colmap image_undistorter), "
            f"only {' and '.join(reversed(PINHOLES))}, and zero distortion, are read"
        )
        if count is None:  # how many numbers it has, and where the next camera begins, is unknown
            raise refused
        return refused
    parameters = tuple(map(float, numbers[: focal + 2]))
    largest = np.abs([width, height, *parameters]).max()
    if width < 1 or height < 1 or not largest < LARGEST or min(parameters[:focal]) <= 0:
        raise ValueError(f"a camera of {width} x {height} pixels with parameters {parameters}")
    return Intrinsics(PINHOLES[focal - 1], int(width), int(height), parameters)


def _checked_pose(name: str, camera: int, numbers: tuple[float, ...]) -> Pose:
    if not name or len(numbers) != 7 or not np.abs(numbers).max() < FARTHEST:
        raise ValueError(f"image '{name}' has no valid pose")
    if math.hypot(*numbers[:4]) < SHORTEST:
        raise ValueError(f"image '{name}' has no valid pose: its quaternion is (almost) zero")
    # An absolute name, of another machine, is looked for by its last parts.
    if any(part in ("", ".", "..") for part in name.replace("\\", "/").removeprefix("/").split("/")):
        raise InputError(
            f"image '{name}' is no plain relative name, or lies outside of the scene; export the model with "
            "such names"
        )
    w, x, y, z, across, down, ahead = map(float, numbers)
    return Pose(name, int(camera), (w, x, y, z), (across, down, ahead))


def _points(ids: list[int], positions: list, colours: list, errors: list) -> tuple[np.ndarray, ...]:
    xyz = np.array(positions, dtype=np.float64).reshape(-1, 3)
    rgb = np.array(colours, dtype=np.int64).reshape(-1, 3)
    if xyz.size and not np.abs(xyz).max() < FARTHEST:
        raise ValueError(f"a point with coordinates that are NaN, infinite or beyond {FARTHEST:g}")
    if rgb.size and (rgb.min() < 0 or rgb.max() > 255):
        raise ValueError("a colour outside 0..255")
    return np.array(ids, dtype=np.int64), xyz, rgb.astype(np.uint8), np.array(errors, dtype=np.float64)


def _add(found: dict[int, Any], key: int, value: Any) -> None:
    if key in found:
        raise ValueError(f"the id {key} is there twice")
    found[key] = value


def _read_cameras_binary(data: bytes) -> dict[int, Intrinsics | InputError]:
    stream, cameras = _Bytes(data), dict[int, Intrinsics | InputError]()
    for _ in range(stream.take("Q")[0]):
        camera, number, width, height = stream.take("iiQQ")
        if not 0 <= number < MOST_MODELS:
            raise ValueError(f"unknown camera model {number}")
        model = [*MODELS][number] if number < len(MODELS) else f"number {number}"
        count, _ = MODELS.get(model) or (0, 0)
        _add(cameras, camera, _pinhole(camera, model, width, height, stream.take("d" * count)))
    stream.end()
    return cameras


def _read_images_binary(data: bytes) -> dict[int, Pose]:
    stream, images = _Bytes(data), dict[int, Pose]()
    for _ in range(stream.take("Q")[0]):
        image, *numbers, camera = stream.take("I7dI")
        _add(images, image, _checked_pose(stream.name(), camera, tuple(numbers)))
        stream.skip(24 * stream.take("Q")[0])
    stream.end()
    return images


def _read_points_binary(data: bytes) -> tuple[np.ndarray, ...]:
    stream = _Bytes(data)
    ids, positions, colours, errors = [], [], [], []
    for _ in range(stream.take("Q")[0]):
        point, x, y, z, red, green, blue, error, track = stream.take("Q3d3BdQ")
        stream.skip(8 * track)
        ids.append(point)
        positions.append((x, y, z))
        colours.append((red, green, blue))
        errors.append(error)
    stream.end()
    return _points(ids, positions, colours, errors)


def _read_points_ply(data: bytes) -> tuple[np.ndarray, ...]:
    vertex = read_ply_elements(data).get("vertex", {})
    positions = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    grey = np.full(len(positions), 128)
    colours = np.stack([vertex.get(name, grey) for name in ("red", "green", "blue")], axis=1)
    ids, errors = list(range(1, len(positions) + 1)), [0.0] * len(positions)
    return _points(ids, positions.tolist(), colours.tolist(), errors)


def _rows(data: bytes) -> list[str]:
    return [line for line in decoded(data).split("\n") if line.strip() and not line.lstrip().startswith("#")]


def _read_cameras_text(data: bytes) -> dict[int, Intrinsics | InputError]:
    cameras: dict[int, Intrinsics | InputError] = {}
    for row in _rows(data):
        camera, model, width, height, *parameters = row.split()
        if not model.replace("_", "").isupper():
            raise ValueError(f"unknown camera model {model}")
        numbers = [float(word) for word in parameters]
        _add(cameras, whole(camera), _pinhole(whole(camera), model, whole(width), whole(height), numbers))
    return cameras


def _read_images_text(data: bytes) -> dict[int, Pose]:
    images, after_pose = dict[int, Pose](), False
    for line in _rows(data):
        if after_pose and _is_observations(line):
            after_pose = False  # one such line may follow an image; files made by hand have none
            continue
        image, *rest = line.split(maxsplit=9)
        pose = _checked_pose(rest[8].rstrip(), whole(rest[7]), tuple(map(float, rest[:7])))
        _add(images, whole(image), pose)
        after_pose = True
    return images


def _is_observations(line: str) -> bool:
    """Whether a line of images.txt lists x, y and point id again and again, not an image: that has a name,
    and where its name is numbers a quaternion of length 1 in its second to fifth place."""
    words = line.split()
    try:
        numbers = [float(word) for word in (*words[:5], *words[9:30], words[-1])]
    except ValueError:
        return False
    image = len(words) > 9 and numbers[0].is_integer() and abs(math.hypot(*numbers[1:5]) - 1) < 0.01
    return len(words) % 3 == 0 and not image


def _read_points_text(data: bytes) -> tuple[np.ndarray, ...]:
    rows = [row.split() for row in _rows(data)]
    if any(len(row) < 8 for row in rows):
        raise ValueError("a point with fewer than 8 values")
    return _points(
        [whole(row[0]) for row in rows],
        [list(map(float, row[1:4])) for row in rows],
        [list(map(whole, row[4:7])) for row in rows],
        [float(row[7]) for row in rows],
    )


def _cameras_binary(model: Model) -> bytes:
    return struct.pack("<Q", len(model.cameras)) + b"".join(
        struct.pack(
            f"<iiQQ{len(c.parameters)}d", camera, [*MODELS].index(c.model), c.width, c.height, *c.parameters
        )
        for camera, c in model.cameras.items()
    )


def _images_binary(model: Model) -> bytes:
    return struct.pack("<Q", len(model.images)) + b"".join(
        struct.pack("<I7dI", image, *p.quaternion, *p.translation, p.camera)
        + os.fsencode(p.name)
        + b"\0"
        + struct.pack("<Q", 0)
        for image, p in model.images.items()
    )


def _points_binary(model: Model) -> bytes:
    columns = (model.point_ids, model.positions, model.colours, model.errors)
    return struct.pack("<Q", len(model.point_ids)) + b"".join(
        struct.pack("<Q3d3BdQ", point, *xyz, *rgb, error, 0)
        for point, xyz, rgb, error in zip(*(column.tolist() for column in columns), strict=True)
    )


_READERS: dict[str, Callable[[bytes], Any]] = {  # by file; of one part the first that is there is read
    "cameras.bin": _read_cameras_binary,
    "cameras.txt": _read_cameras_text,
    "images.bin": _read_images_binary,
    "images.txt": _read_images_text,
    "points3D.bin": _read_points_binary,
    "points3D.txt": _read_points_text,
    "points3D.ply": _read_points_ply,
}
