"""NeRF-style cameras (transforms.json) with images → COLMAP scene; cloud by visual hull, or random.

The format is that of NeRF's synthetic scenes and of instant-ngp: `camera_angle_x` or `fl_x`, `fl_y`, `cx`,
`cy`; per frame a `file_path` and a 4×4 camera-to-world `transform_matrix` with x right, y up, z backward.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from paper_artifact import __version__
from paper_artifact.errors import InputError
from paper_artifact.files import inside, load_json, write_json
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import Camera
from paper_artifact.scene.colmap import FARTHEST, LARGEST, Intrinsics, Model, Pose, write_model
from paper_artifact.scene.folder import DESCRIPTION
from paper_artifact.scene.ground_truth import background_colour
from paper_artifact.scene.hull import hull_cloud, view_box
from paper_artifact.scene.images import has_transparency, opened, sizes_told
from paper_artifact.scene.whole import holds, whole_folder

FORMAT = 1  # raised whenever the same file would give another scene
CLOUDS = ("hull", "random")
ENDINGS = ("", ".png", ".jpg", ".jpeg", ".JPG", ".webp")  # tried after a frame's file_path, in this order
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
OPAQUE = 26  # of 255: the alpha from which on a pixel may show the object
SHORTEST, LONGEST = 0.01, 1e4  # focal lengths of real cameras, in widths of the image
RIGHT_ANGLED = 0.1  # the least volume that a pose's three axes of length 1 span; a rotation's span 1


@dataclass(frozen=True)
class TransformsConfig:
    """How a transforms.json becomes a scene. Raises InputError for values out of range."""

    size: int = 400  # longest side of the scene's images, pixels; images are never made larger
    views: int | None = None  # as many frames, evenly chosen in the file's order; None: all
    cloud: str = "hull"  # what the soup starts from: "hull", of the images' transparency, or "random"
    points: int = 40000  # of the cloud
    background: str = "white"  # behind transparent pixels; or "black"
    seed: int = 0  # of the cloud

    def __post_init__(self) -> None:
        lowest = {"size": 22, "points": 4, "seed": 0}
        for name, least in lowest.items():
            if not least <= getattr(self, name) <= 10**7:
                raise InputError(
                    f"the scene's {name} must be from {least} to 10000000, got {getattr(self, name)}"
                )
        if self.views is not None and self.views < 2:
            raise InputError(f"the scene's views must be at least 2, got {self.views}")
        if self.cloud not in CLOUDS:
            raise InputError(f"unknown cloud {self.cloud!r}; choose one of {', '.join(CLOUDS)}")
        background_colour(self.background)


def read_transforms(file: Path | str, views: int | None = None) -> list[tuple[Path, Camera]]:
    """Return (image file, camera at the image's full size) of `views` frames of a transforms.json, None: all.

    Raises InputError for a missing or damaged file, lens distortion, images that are missing, or fewer than
    two frames.
    """
    file = Path(file)
    try:
        content = load_json(file)
        frames = [
            (str(each["file_path"]), np.array(each["transform_matrix"], np.float64))
            for each in content["frames"]
        ]
        values = {name: float(value) for name, value in content.items() if isinstance(value, (int, float))}
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}; give a transforms.json") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{file} is damaged or no transforms.json ({error}); export it again") from error
    bent = [name for name in DISTORTION if values.get(name)]
    if bent:
        raise InputError(f"{file} has lens distortion ({', '.join(bent)}); undistort the images first")
    if len(frames) < 2:
        raise InputError(f"{file} has {len(frames)} frames; at least 2 are needed, one of them is held out")
    if views is not None and views < len(frames):
        frames = [frames[index] for index in np.linspace(0, len(frames) - 1, views).round().astype(int)]
    return [_frame(file, name, matrix, values) for name, matrix in frames]


def transforms_scene(
    file: Path | str, folder: Path | str, config: TransformsConfig | None = None, progress: bool = False
) -> Path:
    """Write the COLMAP scene of a transforms.json to `folder` and return the folder.

    Contents: images/00000.png … (RGBA stay so), sparse/0/, scene.json (background, radius of the cloud). All
    or nothing; a folder that holds this very scene is returned as it is. Raises InputError as
    `read_transforms` does, for images of several sizes, a hull of opaque images, or a folder that holds
    anything else.
    """
    folder, config = Path(folder), config or TransformsConfig()
    frames = read_transforms(file, config.views)
    sizes = Counter((camera.width, camera.height) for _, camera in frames)
    if len(sizes) > 1:
        raise InputError(f"{file} lists images of several sizes, {sizes_told(sizes)}; bring them to one size")
    key = _key(Path(file), frames, config)
    if holds(folder, key):
        return folder
    with whole_folder(folder, key) as temporary:
        (temporary / "images").mkdir()
        cameras, masks = [], []
        for index, (path, camera) in enumerate(
            tqdm(frames, desc="images", unit="view", disable=not progress)
        ):
            with opened(path, path) as read:
                image = read.convert("RGBA" if has_transparency(read) else "RGB")
            image.thumbnail((config.size, config.size), Image.Resampling.LANCZOS)
            image.save(temporary / "images" / f"{index:05d}.png")
            cameras.append(_resized(camera, *image.size))
            alpha = np.asarray(image.getchannel("A")) if image.mode == "RGBA" else None
            masks.append(None if alpha is None else alpha >= OPAQUE)
        try:
            points = _cloud(cameras, masks, config)
        except InputError as error:
            raise InputError(f"{file}: {error}") from error
        write_model(_model(cameras, points), temporary / "sparse" / "0")
        description = {
            "format": FORMAT,
            "package": __version__,
            "key": key,
            "config": asdict(config),
            "background": background_colour(config.background).tolist(),
            "radius": float(np.linalg.norm(np.ptp(points, axis=0))) / 2,
        }
        write_json(temporary / DESCRIPTION, description)
    return folder


def _frame(file: Path, name: str, matrix: np.ndarray, values: dict[str, float]) -> tuple[Path, Camera]:
    """Return a frame's image file and its camera; `matrix` is camera → world."""
    try:
        path = next((p for p in (inside(file.parent, name + end) for end in ENDINGS) if p.is_file()), None)
    except OSError as error:  # a name that no file system takes
        raise InputError(
            f"{file} lists an image that cannot be: {error.strerror}; export it again"
        ) from error
    if path is None:
        raise InputError(f"{file} lists the image {name}, which is not there; copy the images too")
    if matrix.shape != (4, 4) or not np.abs(matrix).max() < FARTHEST:
        raise InputError(f"{file}: the transform_matrix of {name} is no pose; export it again")
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    if np.linalg.det(axes) < RIGHT_ANGLED:
        raise InputError(f"{file}: the transform_matrix of {name} is no pose; export it again")
    with opened(path, path) as image:
        width, height = image.size
    focal_x = values.get("fl_x") or (
        width / 2 / np.tan(values["camera_angle_x"] / 2) if 0 < values.get("camera_angle_x", 0) < np.pi else 0
    )
    if not focal_x > 0:
        raise InputError(f"{file} has neither camera_angle_x nor fl_x; export it again")
    scale = width / values["w"] if values.get("w") else 1.0
    if not values.get("fl_x"):
        scale = 1.0
    rotation = np.diag([1.0, -1.0, -1.0]) @ axes.T  # y up, z backward → y down, z forward
    camera = Camera(
        width=width,
        height=height,
        focal_x=float(focal_x * scale),
        focal_y=float((values.get("fl_y") or focal_x) * scale),
        centre_x=float(values["cx"] * scale) if "cx" in values else width / 2,
        centre_y=float(values["cy"] * scale) if "cy" in values else height / 2,
        quaternion=tuple(map(float, Rotation.from_matrix(rotation).as_quat(scalar_first=True))),
        translation=tuple(map(float, -rotation @ matrix[:3, 3])),
    )
    focal, centre = (camera.focal_x, camera.focal_y), (camera.centre_x, camera.centre_y)
    if not all(SHORTEST < each / width < LONGEST for each in focal) or not np.abs(centre).max() < LARGEST:
        raise InputError(
            f"{file}: focal lengths {focal[0]:.4g}, {focal[1]:.4g} and centre {centre[0]:.4g}, "
            f"{centre[1]:.4g} are none of a camera of {width} pixels; export it again"
        )
    return path, camera


def _resized(camera: Camera, width: int, height: int) -> Camera:
    across, down = width / camera.width, height / camera.height
    return Camera(
        width=width,
        height=height,
        focal_x=camera.focal_x * across,
        focal_y=camera.focal_y * down,
        centre_x=camera.centre_x * across,
        centre_y=camera.centre_y * down,
        quaternion=camera.quaternion,
        translation=camera.translation,
    )


def _cloud(
    cameras: Sequence[Camera], masks: Sequence[np.ndarray | None], config: TransformsConfig
) -> np.ndarray:
    draws = stream(config.seed, "transforms cloud")
    if config.cloud == "random":
        centre, half = view_box(cameras)
        return centre + half * draws.uniform(-1, 1, (config.points, 3))
    clear = [(camera, mask) for camera, mask in zip(cameras, masks, strict=True) if mask is not None]
    if not clear or all(mask.all() for _, mask in clear):
        raise InputError("no image is transparent anywhere, so there is no outline; take --cloud random")
    return hull_cloud(*zip(*clear, strict=True), config.points, draws)


def _model(cameras: Sequence[Camera], points: np.ndarray) -> Model:
    """Return the sparse model of these views; its cloud is grey, since nothing reads the colours."""
    return Model(
        cameras={
            index + 1: Intrinsics(
                "PINHOLE", c.width, c.height, (c.focal_x, c.focal_y, c.centre_x, c.centre_y)
            )
            for index, c in enumerate(cameras)
        },
        images={
            index + 1: Pose(f"{index:05d}.png", index + 1, c.quaternion, c.translation)
            for index, c in enumerate(cameras)
        },
        point_ids=np.arange(1, len(points) + 1),
        positions=points,
        colours=np.full((len(points), 3), 128, np.uint8),
        errors=np.zeros(len(points)),
    )


def _key(file: Path, frames: Sequence[tuple[Path, Camera]], config: TransformsConfig) -> str:
    """Return the sha256 (hex) of everything that the scene's files depend on."""
    digests = [
        hashlib.sha256(each.read_bytes()).hexdigest() for each in (file, *(path for path, _ in frames))
    ]
    content = {"format": FORMAT, "config": asdict(config), "files": digests}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
