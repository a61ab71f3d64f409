"""COLMAP scene on disk → arrays for training and evaluation; reads this package's scenes and anyone's."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from paper_artifact.errors import InputError
from paper_artifact.files import inside, load_json, load_npz
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.scene.build import DESCRIPTION, GROUND_TRUTH
from paper_artifact.scene.cameras import FAR, NEAR, world_to_clip
from paper_artifact.scene.colmap import FARTHEST, read_model

HOLDOUT_EVERY = 8
IMAGE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")  # not all of PIL's: some start other programs
MOST_PIXELS = 2**27  # of one image: 134 million, more than any camera gives


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene as the trainer sees it; `n` views in the order of their names.

    Every 8th view, from the first on, is held out, as in Mip-NeRF 360 and DiffSoup.
    """

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

    def colours(self, views: np.ndarray | int) -> np.ndarray:
        """Return the images of these views, (…,H,W,3) float32 in [0,1]."""
        return np.moveaxis(self.images[views], -3, -1) / np.float32(255)


def load_scene(path: Path | str) -> Scene:
    """Return the COLMAP scene in the folder `path`: `images/`, and `sparse/0/` or `sparse/`, binary or text.

    Background and radius come from scene.json where there is one; else the background is white and the radius
    half the diagonal of the cloud's central 98 % box. Transparent pixels are composited over the background.

    Raises InputError for missing or damaged files, images of unequal size or of another aspect than their
    camera, fewer than two views, an SfM cloud of fewer than four points.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"no scene folder at {path}; make one with `python -m paper_artifact scene`")
    sparse = inside(path, "sparse/0")
    model = read_model(sparse if sparse.is_dir() else inside(path, "sparse"))
    order = sorted(model.images, key=lambda image: model.images[image].name)
    names = tuple(model.images[image].name for image in order)
    if len(names) < 2:
        raise InputError(f"{path} has {len(names)} views; at least 2 are needed, one of them is held out")
    if len(set(names)) < len(names):
        raise InputError(f"{path} lists an image name twice; export the COLMAP model again")
    if len(model.positions) < 4:
        raise InputError(
            f"{path} has an SfM cloud of {len(model.positions)} points; at least 4 are needed to start from"
        )
    description = _description(path)
    background = np.array(description.get("background", (1.0, 1.0, 1.0)), dtype=np.float32)
    radius = float(description.get("radius", 0.0)) or _cloud_radius(model.positions)
    cameras = [model.camera(image) for image in order]
    images = [
        _read_image(inside(path, f"images/{name}"), camera.width / camera.height, background)
        for name, camera in zip(names, cameras, strict=True)
    ]
    sizes = sorted({image.shape[1:] for image in images})
    if len(sizes) > 1:
        (h0, w0), (h1, w1) = sizes[:2]
        raise InputError(f"{path} mixes images of {w0}×{h0} and {w1}×{h1} pixels; bring them to one size")
    indices = np.arange(len(names))
    return Scene(
        path=path,
        names=names,
        images=np.stack(images),
        world_to_clip=np.stack(
            [world_to_clip(camera, NEAR * radius, FAR * radius) for camera in cameras]
        ).astype(np.float32),
        camera_centres=np.stack([camera.position for camera in cameras]).astype(np.float32),
        background=background,
        points=model.positions.astype(np.float32),
        train=indices[indices % HOLDOUT_EVERY != 0],
        holdout=indices[indices % HOLDOUT_EVERY == 0],
        radius=radius,
    )


def load_ground_truth(path: Path | str) -> Mesh:
    """Return the mesh that the scene in the folder `path` was made of, world units.

    Raises InputError when the scene has none (a scene of photographs) or the file is damaged.
    """
    file = inside(Path(path), GROUND_TRUTH)
    if not file.is_file():
        raise InputError(
            f"{path} has no {GROUND_TRUTH}: only scenes made with `python -m paper_artifact scene` know "
            "their surface; make one of a mesh"
        )
    try:
        stored = load_npz(file)
        vertices, faces, name, betti = (stored[key] for key in ("vertices", "faces", "name", "betti"))
        known = tuple(int(value) for value in betti)
        vertices, faces = vertices.astype(np.float64), faces.astype(np.int64)
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(
            f"{file} is damaged ({error}); remove the scene's folder and build it again"
        ) from error
    if vertices.ndim != 2 or faces.ndim != 2 or not vertices.shape[1] == faces.shape[1] == 3:
        raise InputError(f"{file} holds no mesh; remove the scene's folder and build it again")
    mesh = checked_mesh(vertices, faces, str(file), known if len(known) == 3 else None, welded=False)
    return replace(mesh, name=str(name))


def _description(path: Path) -> dict:
    file = inside(path, DESCRIPTION)
    if not file.is_file():
        return {}
    try:
        description = load_json(file)
        background = np.array(description["background"], dtype=np.float64)
        sound = (
            background.shape == (3,)
            and background.min() >= 0
            and background.max() <= 1
            and 0 < description["radius"] < FARTHEST
        )
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(
            f"{file} is damaged ({error}); remove the scene's folder and build it again"
        ) from error
    if not sound:
        raise InputError(
            f"{file} has a background or radius out of range; remove the scene's folder and build it again"
        )
    return description


def _cloud_radius(positions: np.ndarray) -> float:
    """Return half the diagonal of the box of the 1st to 99th percentile: real SfM clouds have far outliers.

    World units.
    """
    low, high = np.percentile(positions, [1, 99], axis=0)
    radius = float(np.linalg.norm(high - low)) / 2
    if radius <= 0:
        raise InputError("the SfM cloud is a single point; export the COLMAP model again")
    return radius


def _read_image(file: Path, aspect: float, background: np.ndarray) -> np.ndarray:
    """Return an image (3,H,W) uint8, over the background where it is transparent.

    aspect: the camera's width / height, which it must have; resized copies are welcome.
    """
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(file, formats=IMAGE_FORMATS) as opened:
            width, height = opened.size
            _check_size(file, width, height, aspect)
            if opened.mode in ("RGBA", "LA", "PA") or "transparency" in opened.info:
                rows = np.array_split(np.asarray(opened.convert("RGBA")), -(-height // 256))
                pixels = np.concatenate([_over(each, background) for each in rows])
            elif opened.mode in ("RGB", "L", "P", "1", "CMYK", "YCbCr"):
                pixels = np.asarray(opened.convert("RGB"))
            else:
                raise InputError(f"{file} has pixels of type {opened.mode}; convert it to 8-bit RGB")
    except FileNotFoundError as error:
        raise InputError(
            f"no image at {file}, which the COLMAP model lists; copy the images folder too"
        ) from error
    except InputError:
        raise
    except Exception as error:  # PIL's decoders raise whatever their decoding meets
        raise InputError(f"{file} is damaged or no image ({_short(error)}); copy it again") from error
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _check_size(file: Path, width: int, height: int, aspect: float) -> None:
    if width * height > MOST_PIXELS:
        raise InputError(f"{file} has {width}×{height} pixels, too many to be a photograph; scale it down")
    if abs(width - height * aspect) > max(1.0, aspect):
        raise InputError(
            f"{file} has {width}×{height} pixels, another aspect than its camera; use the undistorted images"
        )


def _over(rgba: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Return pixels (h,W,4) uint8 over the background, (h,W,3) uint8."""
    pixels = rgba.astype(np.float32) / 255
    return np.rint(255 * (pixels[..., :3] * pixels[..., 3:] + background * (1 - pixels[..., 3:]))).astype(
        np.uint8
    )


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
