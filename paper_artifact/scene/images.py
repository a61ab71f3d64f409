"""Photographs from disk: pixels, transparency and masks, one file at a time, 8 bit a value.

OpenCV's lens distortion is taken out of pictures: the pinhole picture of the same camera, enlarged so far
that no corner stays empty.
"""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import ExifTags, Image, ImageChops, UnidentifiedImageError
from tqdm import tqdm

from paper_artifact.arithmetic import exp, log
from paper_artifact.errors import InputError
from paper_artifact.files import inside
from paper_artifact.scene.cameras import Camera

COLOURS = ("RGB", "RGBA", "P", "PA", "CMYK", "YCbCr")
TRANSPARENT, OPAQUE = ("RGBA", "LA", "PA"), ("RGB", "L", "P", "1", "CMYK", "YCbCr")
IMAGE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")  # not all of PIL's: some start other programs
PADDING = 64  # zeros at a file's end, at least, that are no part of a compressed picture
BLANK = 4  # of 255: a picture that varies by less in every colour shows nothing
LIGHT = 240  # of 255: a mask's white is at least this
COLOURED = 60  # of 255: what a grey pixel's channels differ by at most, a JPEG's too
MOST_PIXELS = 2**27  # of one image: 134 million
DISTORTION = ("k1", "k2", "k3", "p1", "p2")  # OpenCV's, see `_source`
MOST_ZOOM = 4.0
STEPS = 64  # along a side and along a ray, where a picture is checked


class Pixels(NamedTuple):
    """One picture as its file has it."""

    colours: np.ndarray  # (H,W,3) uint8
    alpha: np.ndarray | None  # (H,W) uint8, 255 opaque; None: all of it is


def read_pixels(file: Path, aspect: float, mask: Path | None = None) -> Pixels:
    """Return the picture in `file` with its transparency.

    aspect: the camera's width / height, which it must have; resized copies are welcome. mask: an image of the
    same size, see `_as_mask`. Raises InputError for what is no 8-bit image, another aspect, or a mask of
    another size.
    """
    picture = _decoded(file)
    if has_transparency(picture):
        both = np.asarray(picture.convert("RGBA"))
        colours, alpha = both[..., :3], both[..., 3]
    else:
        colours, alpha = np.asarray(picture.convert("RGB")), None
    height, width = colours.shape[:2]
    if abs(width - height * aspect) > max(1.0, aspect):
        raise InputError(
            f"{file} has {width}×{height} pixels, another aspect than its camera; use the undistorted images"
        )
    if mask is not None:
        kept = np.asarray(_as_mask(_decoded(mask), mask))
        if kept.shape != colours.shape[:2]:
            raise InputError(
                f"the mask {mask} has {kept.shape[1]}×{kept.shape[0]} pixels, its photograph "
                f"{width}×{height}; bring them to one size"
            )
        whole = np.uint16(255) if alpha is None else alpha.astype(np.uint16)
        alpha = (kept * whole // 255).astype(np.uint8)
    return Pixels(colours, alpha)


def composited(pixels: Pixels, background: np.ndarray, downscale: float = 1.0) -> np.ndarray:
    """Return the picture (3,H,W) uint8 over the colour `background` (3,) in [0,1], smaller by `downscale`.

    A smaller picture's pixel is the mean over its area.
    """
    colours = pixels.colours
    if pixels.alpha is not None:
        part = pixels.alpha[..., None].astype(np.float32) / 255
        over = colours.astype(np.float32) / 255 * part + background * (1 - part)
        colours = np.rint(255 * over).astype(np.uint8)
    if downscale != 1:
        height, width = (max(1, round(side / downscale)) for side in colours.shape[:2])
        colours = np.asarray(Image.fromarray(colours).resize((width, height), Image.Resampling.BOX))
    return np.ascontiguousarray(colours.transpose(2, 0, 1))


def is_blank(picture: np.ndarray) -> bool:
    """Return whether a picture (3,H,W) uint8 is of a single colour."""
    return bool(np.ptp(picture, axis=(1, 2)).max() < BLANK)


def mask_of(folder: Path, name: str) -> Path | None:
    """Return the mask of the image `name` in folder/masks: the same name, or it and .png (as COLMAP has it),
    or .png in the place of its ending; None where there is no such folder.

    Raises InputError when the folder has no mask for the image.
    """
    masks = folder / "masks"
    if not masks.is_dir():
        return None
    for each in (name, f"{name}.png", str(Path(name).with_suffix(".png"))):
        if (mask := inside(folder, f"masks/{each}")).is_file():
            return mask
    raise InputError(
        f"{masks} has no mask for {name} ({name}.png would be one); add it, white where the photograph "
        "counts, or move the folder away"
    )


def read_file(file: Path) -> bytes:
    """Return the bytes of an image file. Raises InputError when it is not there or cannot be read."""
    try:
        return file.read_bytes()
    except FileNotFoundError as error:
        raise InputError(
            f"no image at {file}, which the COLMAP model lists; copy the images folder too"
        ) from error
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}; check its permissions") from error


def _decoded(file: Path) -> Image.Image:
    with opened(file, io.BytesIO(read_file(file))) as picture:
        if picture.format == "TIFF" and picture.getexif().get(ExifTags.Base.Orientation, 1) != 1:
            raise InputError(
                f"{file} has an orientation tag, by which some programs turn a TIFF file and others do not; "
                "save the picture as its camera has it, without the tag"
            )
        picture.load()
        return picture.copy()


@contextmanager
def opened(file: Path, content: io.BytesIO | None = None) -> Iterator[Image.Image]:
    """Yield the picture in `file`, not yet decoded; content: its bytes, for a block that decodes it: then a
    picture that was cut is refused too.

    Raises InputError, which names `file`, for more than MOST_PIXELS, for pixels deeper than 8 bit, and for
    whatever goes wrong in the block.
    """
    source = content or file
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(source, formats=IMAGE_FORMATS) as picture:
            width, height = picture.size
            if width * height > MOST_PIXELS:
                many = f"{width}×{height} pixels, more than {MOST_PIXELS // 10**6} million"
                raise InputError(f"{file} has {many}; scale it down")
            if picture.mode not in TRANSPARENT + OPAQUE:
                raise InputError(f"{file} has pixels of type {picture.mode}; convert it to 8-bit RGB")
            if content is not None and _is_cut(str(picture.format), content.getvalue()):
                raise InputError(
                    f"{file} is damaged: it ends in zeros, as a copy that was cut; copy it again"
                )
            yield picture
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(
            f"{file} has more than {MOST_PIXELS // 10**6} million pixels; scale it down"
        ) from error
    except UnidentifiedImageError as error:
        raise InputError(
            f"{file} is no image of the kinds {', '.join(IMAGE_FORMATS)}, or its head is damaged; "
            "convert it, copy it again, or leave it out"
        ) from error
    except Exception as error:  # PIL's decoders raise whatever their decoding meets
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{file} is damaged or no image ({reason}); copy it again") from error


def _is_cut(form: str, data: bytes) -> bool:
    """Return whether zeros stand where a compressed picture should end, as in a copy that made room first;
    zeros and other data may follow the end."""
    zeros = bytes(PADDING)
    if not data.endswith(zeros) or form not in ("JPEG", "PNG", "WEBP"):
        return False
    if form == "PNG":
        return b"IEND\xaeB`\x82" not in data
    if form == "WEBP":
        return data[: 8 + int.from_bytes(data[4:8], "little")].endswith(zeros)
    place = 2
    while data[place : place + 2] not in (b"\xff\xda", b""):  # past the segments before the first scan
        filled = data[place + 1 : place + 2] == b"\xff"  # a marker may have fill bytes before it
        place += 1 if filled else 2 + int.from_bytes(data[place + 2 : place + 4], "big")
    return b"\xff\xd9" not in data[place:]


def has_transparency(picture: Image.Image) -> bool:
    """Return whether a picture has an alpha channel, or a colour that stands for one."""
    return picture.mode in TRANSPARENT or "transparency" in picture.info


def _as_mask(picture: Image.Image, file: Path) -> Image.Image:
    """Return a mask (type L): white where the photograph counts, black where it does not or where the mask is
    transparent, grey in between. Raises InputError for a coloured one, and for one that is neither black nor
    has white, as masks of the values 0 and 1."""
    if picture.mode in COLOURS and np.ptp(np.asarray(picture.convert("RGB")), axis=2).max() > COLOURED:
        raise InputError(f"the mask {file} is coloured; save white where the photograph counts")
    kept = picture.convert("L")
    if has_transparency(picture):
        kept = ImageChops.multiply(kept, picture.convert("RGBA").getchannel("A"))
    lightest = int(np.asarray(kept).max())
    if 0 < lightest < LIGHT:
        raise InputError(f"the mask {file} has values up to {lightest}; save what counts as white, 255")
    return kept


def tell_some(path: Path, names: Sequence[str], count: int, what: str) -> None:
    """Say on stderr what holds for `names`, some of the `count` that `path` lists; nothing for none."""
    if names:
        shown = ", ".join(names[:4]) + " …" * (len(names) > 4)
        tqdm.write(f"{path}: {len(names)} of {count} {what}: {shown}", file=sys.stderr)


def sizes_told(sizes: Mapping[tuple[int, int], int]) -> str:
    """Return sizes (width, height) in words, with how many pictures have each, the most frequent first."""
    ranked = sorted(sizes.items(), key=lambda item: (-item[1], item[0]))
    more = f" and {len(ranked) - 6} more" if len(ranked) > 6 else ""
    return ", ".join(f"{width}×{height} ({count})" for (width, height), count in ranked[:6]) + more


def least_zoom(lens: Camera, distortion: tuple[float, ...]) -> float | None:
    """Return the least enlargement, at least 1, whose undistorted picture the distorted one fills; None where
    the lens folds the picture, or more than MOST_ZOOM would be needed."""
    side = np.linspace(0, 1, STEPS + 1)
    u = np.concatenate([side, side, 0 * side, 0 * side + 1]) * lens.width
    v = np.concatenate([0 * side, 0 * side + 1, side, side]) * lens.height
    for zoom in exp(log(MOST_ZOOM) * np.arange(200) / 199).tolist():
        left, top = _source(lens, distortion, zoom, u, v)
        if min(left.min(), top.min()) < 0 or left.max() > lens.width or top.max() > lens.height:
            continue
        across = lens.centre_x + (u - lens.centre_x)[:, None] * side
        down = lens.centre_y + (v - lens.centre_y)[:, None] * side
        left, top = _source(lens, distortion, zoom, across, down)
        outward = np.diff((left - lens.centre_x) ** 2 + (top - lens.centre_y) ** 2, axis=1)
        return zoom if (outward >= 0).all() else None
    return None


def undistorted(
    image: Image.Image, lens: Camera, straight: Camera, distortion: tuple[float, ...]
) -> Image.Image:
    """Return the picture of the pinhole camera `straight`, of the same size, from that of the `lens`."""
    from scipy.ndimage import map_coordinates  # only here: most photographs are undistorted

    rows, columns = np.indices(image.size[::-1]) + 0.5
    left, top = _source(lens, distortion, straight.focal_x / lens.focal_x, columns, rows)
    pixels = np.asarray(image)
    channels = [
        map_coordinates(pixels[..., channel], (top - 0.5, left - 0.5), order=1, mode="nearest")
        for channel in range(pixels.shape[2])
    ]
    return Image.fromarray(np.stack(channels, axis=2))


def _source(
    lens: Camera, distortion: tuple[float, ...], zoom: float, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the distorted picture shows pixels (u, v) of the undistorted one, `zoom` times larger.

    https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html: radial k1, k2, k3, tangential p1, p2.
    """
    k1, k2, k3, p1, p2 = distortion
    x, y = (u - lens.centre_x) / (lens.focal_x * zoom), (v - lens.centre_y) / (lens.focal_y * zoom)
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    across = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    down = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return across * lens.focal_x + lens.centre_x, down * lens.focal_y + lens.centre_y
