"""COLMAP scene on disk → arrays for training and evaluation; reads this package's scenes and anyone's."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from paper_artifact.errors import InputError
from paper_artifact.files import load_npz
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.scene.build import DESCRIPTION, GROUND_TRUTH, HOLDOUT_EVERY
from paper_artifact.scene.cameras import FAR, NEAR, world_to_clip
from paper_artifact.scene.colmap import read_model


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
    sparse = path / "sparse" / "0"
    model = read_model(sparse if sparse.is_dir() else path / "sparse")
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
        _read_image(path / "images" / name, camera.width / camera.height, background)
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
    file = Path(path) / GROUND_TRUTH
    if not file.is_file():
        raise InputError(
            f"{path} has no {GROUND_TRUTH}: only scenes made with `python -m paper_artifact scene` know "
            "their surface; make one of a mesh"
        )
    try:
        stored = load_npz(file)
        vertices, faces, name, betti = (stored[key] for key in ("vertices", "faces", "name", "betti"))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{file} is damaged ({error}); remove the scene's folder and build it again"
        ) from error
    known = tuple(int(value) for value in betti)
    return checked_mesh(vertices, faces, str(name), known if len(known) == 3 else None, welded=False)


def _description(path: Path) -> dict:
    file = path / DESCRIPTION
    if not file.is_file():
        return {}
    try:
        description = json.loads(file.read_text(encoding="utf-8"))
        background = np.array(description["background"], dtype=np.float64)
        sound = (
            background.shape == (3,)
            and background.min() >= 0
            and background.max() <= 1
            and description["radius"] > 0
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
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
        with Image.open(file) as opened:
            if opened.mode in ("RGBA", "LA", "PA") or "transparency" in opened.info:
                pixels = np.asarray(opened.convert("RGBA"), dtype=np.float32) / 255
                pixels = pixels[..., :3] * pixels[..., 3:] + background * (1 - pixels[..., 3:])
                pixels = np.rint(255 * pixels).astype(np.uint8)
            elif opened.mode in ("RGB", "L", "P", "1", "CMYK", "YCbCr"):
                pixels = np.asarray(opened.convert("RGB"))
            else:
                raise InputError(f"{file} has pixels of type {opened.mode}; convert it to 8-bit RGB")
    except FileNotFoundError as error:
        raise InputError(
            f"no image at {file}, which the COLMAP model lists; copy the images folder too"
        ) from error
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{file} is damaged or no image; copy it again") from error
    height, width = pixels.shape[:2]
    if abs(width - height * aspect) > max(1.0, aspect):
        raise InputError(
            f"{file} has {width}×{height} pixels, another aspect than its camera; use the undistorted images"
        )
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))
