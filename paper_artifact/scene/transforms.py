"""NeRF-style cameras (transforms.json) with images → COLMAP scene; cloud by visual hull, given, or random.

The format is that of NeRF's synthetic scenes, instant-ngp and nerfstudio: a focal length (`camera_angle_x`,
`camera_angle_y`, `fl_x`, `fl_y`), `cx`, `cy`, `w`, `h` and a distortion `k1`, `k2`, `k3`, `p1`, `p2`, at the
root, or in a frame for this frame; per frame a `file_path`, a 4×4 or 3×4 camera-to-world `transform_matrix`
with x right, y up, z backward, and a `mask_path`; at the root a cloud, `ply_file_path`.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from tqdm import tqdm

from paper_artifact import __version__, arithmetic
from paper_artifact.errors import InputError
from paper_artifact.files import file_digest, load_json, write_json
from paper_artifact.formats.named import find_file
from paper_artifact.formats.polygons import read_ply_elements
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import Camera
from paper_artifact.scene.colmap import FARTHEST, LARGEST, pinhole_model, write_model
from paper_artifact.scene.folder import DESCRIPTION, check_same, holds, value_digest, whole_folder
from paper_artifact.scene.ground_truth import background_colour
from paper_artifact.scene.images import (
    DISTORTION,
    least_zoom,
    opened,
    read_pixels,
    sizes_told,
    tell_some,
    undistorted,
)
from paper_artifact.scene.subject import hull_cloud, view_box

FORMAT = 1  # raised whenever the same file would give another scene
CLOUDS = ("hull", "random")
ENDINGS = ("", ".png", ".jpg", ".jpeg", ".JPG", ".webp")  # tried after a frame's file_path, in this order
LENSES = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")  # of MODELS
MODELS = ("camera_model", "camera_type")
# Where one of these is not zero, rays run in a way that is not read.
OTHER_LENSES = (
    *("is_fisheye", "fisheye", "is_latlong", "latlong", "equirectangular", "is_equirectangular"),
    *("orthographic", "ftheta_p0", "rolling_shutter", "k4", "k5", "k6", "skew"),
)
UNREAD = {  # of instant-ngp and its kin, where they are there and not false: what to do instead
    **dict.fromkeys(
        ("white_transparent", "black_transparent", "mask_color"),
        "make these pixels transparent in the images instead",
    ),
    "fix_premult": "divide the images' colours by their alpha instead",
    "enable_ray_loading": "its images have rays of their own; make those of pinhole cameras of them",
    **dict.fromkeys(
        ("normal_mts_args", "from_mitsuba", "from_na"), "turn its poses into OpenGL's and take the key out"
    ),
}
OPENCV = ("k1", "k2", "k3", "k4", "p1", "p2")  # what nerfstudio lists as distortion_params
INTRINSICS = ("camera_angle_x", "camera_angle_y", "fl_x", "fl_y", "cx", "cy", "w", "h", *DISTORTION)
OPAQUE = 26  # of 255: the alpha from which on a pixel may show the object
SHORTEST, LONGEST = 0.01, 1e4  # focal lengths of real cameras, in widths of the image
RIGHT_ANGLED = 0.999  # the least volume that a pose's three axes of length 1 span; a rotation's span 1


@dataclass(frozen=True)
class TransformsConfig:
    """How a transforms.json becomes a scene. Raises InputError for values out of range."""

    size: int = 400  # longest side of the scene's images, pixels; images are never made larger
    views: int | None = None  # as many frames, evenly chosen in the file's order; None: all
    # What the soup starts from: "hull", the file's own cloud where it names one, else the visual hull of what
    # is not transparent; or "random".
    cloud: str = "hull"
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


class View(NamedTuple):
    """One frame of a transforms.json."""

    image: Path  # its file
    camera: Camera  # at the image's full size, without the distortion
    mask: Path | None  # an image of the same size, white where the picture counts
    distortion: tuple[float, ...]  # k1, k2, k3, p1, p2
    lens: Camera  # of the distorted image


def read_transforms(file: Path | str, views: int | None = None) -> list[View]:
    """Return `views` frames of a transforms.json, evenly chosen, None: all. Frames without image are left
    out, which a line on stderr says.

    Raises InputError for a missing or damaged file, lenses that are neither pinholes nor OpenCV's, an image
    in two frames, or fewer than two frames with an image.
    """
    file = Path(file)
    try:
        content = load_json(file)
        if content.get("frames") is None:
            raise ValueError("it has no frames")
        frames = [(each, _named(file, str(each["file_path"]), ENDINGS)) for each in content["frames"]]
        missing = [str(own["file_path"]) for own, path in frames if path is None]
        for path, count in Counter(path for _, path in frames if path is not None).items():
            if count > 1:
                raise InputError(f"{file} lists {path} in {count} frames; keep one of them")
        if len(frames) - len(missing) < 2:
            lost, way = "", ""
            if missing:
                lost = f", {len(missing)} of them without an image ({missing[0]} is not there)"
                way = ": copy the images too"
            raise InputError(
                f"{file} has {len(frames)} frames{lost}; at least 2 are needed, one of them is held out{way}"
            )
        tell_some(file, missing, len(frames), "frames are left out, their images are not there")
        kept = [(own, path) for own, path in frames if path is not None]
        if views is not None and views < len(kept):
            kept = [kept[index] for index in np.linspace(0, len(kept) - 1, views).round().astype(int)]
        return [_frame(file, content, own, path) for own, path in kept]
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}; give a transforms.json") from error
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise InputError(
            f"{file} is damaged or no transforms.json ({error!s:.150}); export it again"
        ) from error


def transforms_scene(
    file: Path | str, folder: Path | str, config: TransformsConfig | None = None, progress: bool = False
) -> Path:
    """Write the COLMAP scene of a transforms.json to `folder` and return the folder.

    Contents: images/00000.png … (undistorted; RGBA stay so, masks become transparency), sparse/0/, scene.json
    (background, radius of the cloud). All or nothing; a folder that holds this very scene is returned as it
    is. Raises InputError as `read_transforms` does, for images of several sizes, a hull of opaque images, or
    a folder that holds anything else.
    """
    folder, config = Path(folder), config or TransformsConfig()
    frames = read_transforms(file, config.views)
    given = _given_cloud(Path(file)) if config.cloud == CLOUDS[0] else None
    sizes = Counter((view.camera.width, view.camera.height) for view in frames)
    if len(sizes) > 1:
        raise InputError(f"{file} lists images of several sizes, {sizes_told(sizes)}; scale them to one size")
    files = [Path(file), *(view.image for view in frames), *(view.mask for view in frames), given]
    read = [each for each in files if each is not None]
    digests = [file_digest(each) for each in read]
    key = value_digest({"format": FORMAT, "config": asdict(config), "files": digests})
    if holds(folder, key):
        return folder
    with whole_folder(folder, key) as temporary:
        (temporary / "images").mkdir()
        cameras, masks = [], []
        for index, view in enumerate(tqdm(frames, desc="images", unit="view", disable=not progress)):
            image = _picture(view)
            image.thumbnail((config.size, config.size), Image.Resampling.LANCZOS)
            image.save(temporary / "images" / f"{index:05d}.png")
            cameras.append(_resized(view.camera, *image.size))
            alpha = np.asarray(image.getchannel("A")) if image.mode == "RGBA" else None
            masks.append(None if alpha is None else alpha >= OPAQUE)
        try:
            points = _cloud(cameras, masks, config) if given is None else _points_of(given)
        except InputError as error:
            raise InputError(f"{file}: {error}") from error
        views = {f"{index:05d}.png": camera for index, camera in enumerate(cameras)}
        grey = np.full((len(points), 3), 128, np.uint8)  # nothing reads the colours
        model = pinhole_model(views, range(1, len(views) + 1), points, grey)
        write_model(model, temporary / "sparse" / "0")
        check_same(dict(zip(read, digests, strict=True)))
        description = {
            "format": FORMAT,
            "package": __version__,
            "key": key,
            "config": asdict(config),
            "background": background_colour(config.background).tolist(),
            "radius": float(arithmetic.norm(np.ptp(points, axis=0))) / 2,
        }
        write_json(temporary / DESCRIPTION, description)
    return folder


def _named(file: Path, name: str, endings: tuple[str, ...] = ("",)) -> Path | None:
    """Return the file that a transforms.json names: in its own folder, or with '../' in the one above."""
    try:
        found = find_file(file.parent, name, endings)
        if found is None and name.replace("\\", "/").startswith("../"):
            found = find_file(file.resolve().parent.parent, name[3:], endings)
        return found
    except OSError as error:  # a name that no file system takes
        raise InputError(
            f"{file} lists an image that cannot be: {error.strerror}; export it again"
        ) from error


def _frame(file: Path, root: dict, own: dict, path: Path) -> View:
    """Return a frame, its image at `path`; `own`: what it says, `root`: what the file says of all frames."""
    name, matrix = str(own["file_path"]), np.array(own["transform_matrix"], np.float64)
    axes = np.zeros((3, 3))
    if matrix.shape in ((3, 4), (4, 4)) and np.abs(matrix).max() < FARTHEST:
        axes = matrix[:3, :3] / np.maximum(arithmetic.norm(matrix[:3, :3].T), 1e-30)
    if arithmetic.adjugate(axes)[1] < RIGHT_ANGLED:
        raise InputError(f"{file}: the transform_matrix of {name} is no pose; export it again")
    if not np.abs(matrix[3:] - (0, 0, 0, 1)).max(initial=0.0) < 1e-6:
        raise InputError(
            f"{file}: the transform_matrix of {name} ends with the row {matrix[3].tolist()}, not 0, 0, 0, 1; "
            "if it lists columns, transpose it"
        )
    both = root | own
    listed = both.get("distortion_params") or ()
    if len(listed) not in (0, len(OPENCV)):
        raise InputError(
            f"{file}: distortion_params of {name} has {len(listed)} numbers, not the six "
            f"{', '.join(OPENCV)}; give each under its own name instead"
        )
    both = dict(zip(OPENCV, listed, strict=False)) | both
    models = [each for each in MODELS if str(both.get(each) or LENSES[0]).upper() not in LENSES]
    rays = [each for each in OTHER_LENSES if np.any(both.get(each) or 0)]
    lens = next((f"{each} {both[each]!s:.60}" for each in rays + models), None)
    for each, advice in UNREAD.items():
        if both.get(each) not in (None, False, 0):
            raise InputError(f"{file} has {each}, which is not read; {advice}")
    if lens is not None:
        raise InputError(
            f"{file}: {name} has {lens}, which is not read; turn the images into those of pinhole cameras "
            "first (COLMAP's image_undistorter does so for fisheyes)"
        )
    mask = None
    if own.get("mask_path"):
        mask = _named(file, str(own["mask_path"]))
        if mask is None:
            raise InputError(f"{file} names the mask {own['mask_path']}, which is not there; copy it too")
    dynamic = path.with_name(f"dynamic_mask_{path.stem}.png")
    if dynamic.exists():  # instant-ngp's
        raise InputError(
            f"{file}: {dynamic.name} lies beside {name} and is not read; make its pixels transparent in the "
            "image, and move it away"
        )
    with opened(path) as image:
        width, height = image.size
    values = {key: float(both[key]) for key in INTRINSICS if both.get(key) is not None}
    for key, value in values.items():
        if not np.isfinite(value) or isinstance(both[key], bool) or (key in ("w", "h") and value <= 0):
            raise InputError(f"{file}: {key} of {name} is {both[key]}, which cannot be; export it again")
    stated = [side / values[key] for side, key in ((width, "w"), (height, "h")) if key in values]
    across, down = (stated or [1.0])[0], (stated or [1.0])[-1]
    if abs(down / across - 1) > max(0.01, 2 / min(width, height)):
        raise InputError(
            f"{file}: {name} has {width}×{height} pixels, and its w and h are {values['w']:g} and "
            f"{values['h']:g}, another aspect; give the images that the cameras are of"
        )
    sizes = (width, height, across, down)
    its_own = {key: values[key] for key in INTRINSICS[:4] if own.get(key) is not None}
    axes_told = [{key[-1] for key in INTRINSICS[:4] if key in told} for told in (its_own, values)]
    if its_own and axes_told[0] != axes_told[1]:
        raise InputError(
            f"{file}: {name} has {', '.join(its_own)} of its own, which leaves one axis to the focal length "
            "of all frames; give the frame fl_x and fl_y"
        )
    focal = _focal(its_own, *sizes) or _focal(values, *sizes)
    if focal is None:
        raise InputError(
            f"{file} has no focal length above 0 of {name} (fl_x, fl_y, camera_angle_x or camera_angle_y); "
            "export it again"
        )
    rotation = np.array([[1.0], [-1.0], [-1.0]]) * axes.T  # y up, z backward → y down, z forward
    right, below, ahead = (-arithmetic.product(rotation, matrix[:3, 3])).tolist()
    camera = Camera(
        width=width,
        height=height,
        focal_x=focal[0],
        focal_y=focal[1],
        centre_x=values["cx"] * across if "cx" in values else width / 2,
        centre_y=values["cy"] * down if "cy" in values else height / 2,
        quaternion=arithmetic.matrix_quaternion(rotation),
        translation=(right, below, ahead),
    )
    centre = (camera.centre_x, camera.centre_y)
    if not all(SHORTEST < each / width < LONGEST for each in focal) or not np.abs(centre).max() < LARGEST:
        raise InputError(
            f"{file}: focal lengths {focal[0]:.4g}, {focal[1]:.4g} and centre {centre[0]:.4g}, "
            f"{centre[1]:.4g} are none of a camera of {width} pixels; export it again"
        )
    if "cx" in values and "cy" in values and 0 < max(values["cx"], values["cy"]) <= 1:
        raise InputError(
            f"{file}: cx, cy of {name} are {values['cx']:g}, {values['cy']:g}; give them in pixels"
        )
    if not stated and not (0 <= centre[0] <= width and 0 <= centre[1] <= height):
        raise InputError(
            f"{file}: the centre cx, cy of {name} lies outside of its {width}×{height} pixels; add w and h, "
            "the size that it is for"
        )
    distortion = tuple(values.get(key, 0.0) for key in DISTORTION)
    zoom = least_zoom(camera, distortion) if any(distortion) else 1.0
    if zoom is None:
        raise InputError(
            f"{file}: {name} has a distortion {distortion} that folds its image; undistort the images "
            "first, as COLMAP's image_undistorter does"
        )
    straight = replace(camera, focal_x=camera.focal_x * zoom, focal_y=camera.focal_y * zoom)
    return View(path, straight, mask, distortion, camera)


def _focal(
    values: dict[str, float], width: int, height: int, across: float, down: float
) -> tuple[float, float] | None:
    """Return the focal lengths (x, y) in pixels that the values state, None where they state none."""
    x = values.get("fl_x", 0.0) * across or _of_angle(values.get("camera_angle_x"), width)
    y = values.get("fl_y", 0.0) * down or _of_angle(values.get("camera_angle_y"), height)
    return (x or y, y or x) if x > 0 or y > 0 else None


def _of_angle(angle: float | None, side: int) -> float:
    if angle is None or not 0 < angle < np.pi:
        return 0.0
    return side / 2 * float(arithmetic.cos(angle / 2)) / max(float(arithmetic.sin(angle / 2)), 1e-300)


def _picture(view: View) -> Image.Image:
    """Return a frame's picture, RGB or RGBA, with its mask, undistorted."""
    colours, alpha = read_pixels(view.image, view.camera.width / view.camera.height, view.mask)
    image = Image.fromarray(colours if alpha is None else np.dstack([colours, alpha]))
    return undistorted(image, view.lens, view.camera, view.distortion) if any(view.distortion) else image


def _given_cloud(file: Path) -> Path | None:
    """Return the cloud that a transforms.json names, None where it names none."""
    name = load_json(file).get("ply_file_path")
    if not name:
        return None
    path = _named(file, str(name))
    if path is None:
        raise InputError(
            f"{file} names the cloud {name}, which is not there; copy it too, or take --cloud random"
        )
    tqdm.write(f"{file}: the cloud is that of {path.name}", file=sys.stderr)
    return path


def _points_of(cloud: Path) -> np.ndarray:
    """Return the points (P,3) float64 of a PLY file, world units."""
    try:
        vertex = read_ply_elements(cloud.read_bytes())["vertex"]
        points = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    except (OSError, ValueError, LookupError, AttributeError) as error:
        raise InputError(f"the cloud {cloud} is damaged or no PLY file ({error}); export it again") from error
    points = points[np.isfinite(points).all(axis=1)]
    different = len(np.unique(points, axis=0))
    if different < 4 or not np.abs(points).max() < FARTHEST:
        raise InputError(f"the cloud {cloud} has {different} points that can be used; take --cloud random")
    return points


def _resized(camera: Camera, width: int, height: int) -> Camera:
    across, down = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        focal_x=camera.focal_x * across,
        focal_y=camera.focal_y * down,
        centre_x=camera.centre_x * across,
        centre_y=camera.centre_y * down,
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
    return hull_cloud([each for each, _ in clear], [mask for _, mask in clear], config.points, draws)
