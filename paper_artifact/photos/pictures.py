"""Photographs as structure from motion takes them, and pictures brought to one exposure.

A phone's upright and level photographs are one camera with one size: their EXIF orientation is not applied,
and where it was applied already the fewer are turned on their side, which structure from motion does not care
about. A camera left alone exposes each photograph anew, and a soup has one colour per place: what two
photographs show differently bright it can only average. The points of the cloud say by how much, since each
is seen in several.
"""

from __future__ import annotations

import io
import os
import re
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import ExifTags, Image
from scipy.ndimage import laplace
from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.scene.folder import DESCRIPTION, SMALLER_IMAGES, UNDISTORTED
from paper_artifact.scene.images import LIGHT, has_transparency, is_blank, opened, sizes_told

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".3gp", ".mpg", ".mpeg", ".wmv")
FRAMES = 60  # of a video that are taken about, unless it is said how many
COMPLETE = 0.95  # of the frames, or the length, that a video declares; some end a few short
SHARPNESS_WIDTH = 320  # pixels of the frames that sharpness is compared on
LEAST = 3  # photographs that a model is made of at least; fewer give no surface
ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2")
UNREAD = (".heic", ".heif", ".avif", ".jxl", ".jp2", ".gif", *RAW)
DERIVED = ("masks", "mask", UNDISTORTED, "undistorted", *SMALLER_IMAGES, "thumbs", "thumbnails")
QUALITY = 95  # of JPEG files written between photograph and scene
LEAST_KEPT = 0.5  # part of the most frequent size's pixels that the common size must have, or it is told
LENS_TAGS = (
    ExifTags.Base.FocalLength,
    ExifTags.Base.FocalLengthIn35mmFilm,
    ExifTags.Base.FocalPlaneXResolution,
    ExifTags.Base.FocalPlaneYResolution,
    ExifTags.Base.FocalPlaneResolutionUnit,
    ExifTags.Base.ExifImageWidth,
    ExifTags.Base.ExifImageHeight,
)
LEVEL = (0.0, -1.0)  # where up is in a picture that stands right: x to the right, y down
UP = {3: (0.0, 1.0), 4: (0.0, 1.0), 5: (-1.0, 0.0), 6: (-1.0, 0.0), 7: (1.0, 0.0), 8: (1.0, 0.0)}
"""Where up is in the stored picture, by EXIF orientation; the others are LEVEL."""
LONGEST_NAME = 240  # bytes; with the endings of pictures and masks a file system's 255
ROUNDS = 20  # of the alternating fit
SMALLEST = 0.03  # log of an exposure below which a picture is left as it is
DARK, BRIGHT = 0.02, 0.9  # linear light: darker is noise, brighter may be clipped


def photographs_in(folder: Path | str) -> dict[str, Path]:
    """Return the pictures in a folder and its sub-folders, by name: "stem", or "sub-folder_stem".

    What is hidden is left out, and sub-folders with a scene that was made of them or that are DERIVED. A name
    that is no UTF-8 is read as Latin-1. Raises InputError for no folder, fewer than three pictures, and
    pictures whose names differ by their ending alone.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            f"no folder and no video file at {folder}; give the folder that holds the photographs, or a video"
        )
    files = _files(folder)
    photographs: dict[str, Path] = {}
    for each in files:
        if each.suffix.lower() in ENDINGS:
            name = _readable("_".join(each.relative_to(folder).with_suffix("").parts))
            if name in photographs:
                raise InputError(f"{folder} has two photographs called {name}; give each a different name")
            if len(os.fsencode(name)) > LONGEST_NAME:
                raise InputError(
                    f"{each.relative_to(folder)}: sub-folder and name have more than {LONGEST_NAME} bytes "
                    "together; give shorter ones"
                )
            photographs[name] = each
    if len(photographs) < LEAST:
        others = sorted({each.suffix.lower() for each in files} - {*ENDINGS, ""})
        seen = f" (it also has {', '.join(others)}; convert what is a picture to JPEG)" if others else ""
        seen += "".join(f" ({each})" for each in unread(folder) if each.startswith("left out"))
        raise InputError(
            f"{folder} has {len(photographs)} photographs of the kinds {' '.join(ENDINGS)}{seen}; "
            f"at least {LEAST} are needed, 20 to 100 are good"
        )
    return photographs


def _files(folder: Path) -> list[Path]:
    """Return what may be photographs: nothing hidden, of a scene made before, or in a folder DERIVED."""
    made = {each.parent for each in folder.rglob(DESCRIPTION)} - {folder}
    return [
        each
        for each in _shown(folder)
        if each.is_file() and not made.intersection(each.parents) and not _derived(folder, each)
    ]


def _shown(folder: Path) -> list[Path]:
    """Return what is in a folder and its sub-folders and not hidden."""
    found = [(each, each.relative_to(folder).parts) for each in sorted(folder.rglob("*"))]
    return [each for each, parts in found if not any(part.startswith(".") for part in parts)]


def _derived(folder: Path, file: Path) -> list[str]:
    return [part for part in file.relative_to(folder).parts[:-1] if part.lower() in DERIVED]


def unread(folder: Path) -> list[str]:
    """Return what is left out of a folder of photographs, a sentence for each reason."""
    endings = Counter(each.suffix.lower() for each in _files(folder))
    found = [ending for ending in (*UNREAD, *VIDEOS) if endings[ending]]
    count = sum(endings[ending] for ending in found)
    told = [f"{count} file{'s' * (count > 1)} ({' '.join(found)}) not read; convert to JPEG"] if found else []
    copies = {part for each in folder.rglob("*.*") for part in _derived(folder, each)}
    if copies:
        told.append(f"left out as copies or masks: {', '.join(sorted(copies))}; give such a folder by itself")
    shown = _shown(folder)
    lost = [each.name for each in shown if each.suffix.lower() in ENDINGS and not os.path.exists(each)]
    closed = [each.name for each in shown if each.is_dir() and not os.access(each, os.R_OK | os.X_OK)]
    for names, what in ((lost, "links that lead nowhere"), (closed, "folders that may not be read")):
        if names:
            told.append(f"left out, as {what}: {', '.join(names[:4])}{' …' * (len(names) > 4)}; see to them")
    return told


def _readable(name: str) -> str:
    """Return a file's name as text that every program takes."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return os.fsencode(name).decode("latin-1")
    return name


def video_frames(video: Path, every: int | None, folder: Path, progress: bool) -> int:
    """Write the sharpest of every `every` frames of a video to the new folder, as JPEG; return `every`.

    None: as many as leave about `FRAMES`. Sharp: the variance of the Laplacian of its grey picture. Frames
    are turned as the file says. PyAV decodes. Raises InputError where PyAV is missing, the file is no video
    or is cut off, or `every` leaves fewer than three.
    """
    try:
        import av
    except ImportError as error:
        raise InputError(
            "reading a video needs PyAV, which is not installed here; `pip install av` or "
            "`pip install '.[photos]'`"
        ) from error
    folder.mkdir(parents=True)
    try:
        with av.open(video) as container:
            if not container.streams.video:
                raise InputError(
                    f"{video} has no picture, only sound; give a video, or a folder of photographs"
                )
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            total = stream.frames or int(float((container.duration or 0) / 1e6 * (stream.average_rate or 0)))
            every = every or max(1, total // FRAMES)
            best, taken, seen, time = -1.0, None, 0, 0.0
            for seen, frame in enumerate(
                tqdm(container.decode(stream), "frames", total or None, unit="frame", disable=not progress), 1
            ):
                height = max(8, SHARPNESS_WIDTH * frame.height // frame.width)
                grey = frame.reformat(SHARPNESS_WIDTH, height, "gray").to_ndarray().astype(np.float64)
                time = frame.time or time
                if (sharp := float(laplace(grey).var())) > best:
                    best, taken = sharp, frame
                if seen % every == 0 and taken is not None:
                    _write_frame(taken, folder, seen)
                    best, taken = -1.0, None
            if taken is not None and seen % every > every // 2:
                _write_frame(taken, folder, seen)
            end = time + float(1 / stream.average_rate if stream.average_rate else 0)
            if seen < COMPLETE * stream.frames or (not stream.frames and end < COMPLETE * _length(stream)):
                raise InputError(f"{video} is cut off: it says {total} frames and has {seen}; copy it again")
    except InputError:
        raise
    except (av.FFmpegError, ValueError) as error:
        raise InputError(
            f"{video} is not a video that can be decoded ({error}); convert it to MP4 (H.264)"
        ) from error
    written = len(list(folder.iterdir()))
    if written < LEAST:
        raise InputError(
            f"one of every {every} frames of {video} gives {written}, at least {LEAST} are needed and 20 to "
            f"100 are good: it has {seen} frames; give "
            + ("a smaller --every" if every > 1 else "a longer video")
        )
    return every


def _length(stream: Any) -> float:
    """Return how many seconds of pictures a video's stream declares; 0.0 where the file says so only of its
    longest stream, which may be the sound."""
    if said := re.fullmatch(r"(\d+):(\d+):([\d.]+)", stream.metadata.get("DURATION", "")):  # of Matroska
        return 3600 * int(said[1]) + 60 * int(said[2]) + float(said[3])
    if stream.duration:
        return float(stream.duration * stream.time_base)
    return 0.0 if stream.container.streams.audio else (stream.container.duration or 0) / 1e6


def _write_frame(frame: Any, folder: Path, number: int) -> None:
    picture = frame.to_image()
    if frame.rotation:
        picture = picture.rotate(frame.rotation, expand=True)  # both counter-clockwise
    picture.save(folder / f"frame_{number:06d}.jpg", quality=QUALITY, subsampling=0)


class Prepared(NamedTuple):
    """Photographs as structure from motion takes them."""

    groups: list[list[str]]  # file names by camera
    up: dict[str, tuple[float, float]]  # by file name, see `upright`
    sizes: Counter[tuple[int, int]]  # photographs by (width, height) as they are, pixels; turned ones turned
    masked: set[str]  # file names of those with transparent parts
    blank: list[str]  # file names of those of a single colour


def prepared(
    photographs: Mapping[str, Path], folder: Path, masks: Path, size: int, progress: bool
) -> Prepared:
    """Write the photographs as JPEG of at most `size` pixels a side to `folder`; return what they are.

    All become level, or upright where more are that: the others are turned by a quarter. Photographs of one
    size, camera and focal length (EXIF) are of one camera. The opacity of one with transparent parts is
    written to masks/NAME.jpg.png. Raises InputError that names all files which are no photographs.
    """
    folder.mkdir(parents=True)
    masks.mkdir(parents=True)
    shapes, faults = {}, []
    for name, file in photographs.items():
        try:
            with opened(file) as read:
                shapes[name] = read.size
        except InputError as error:
            faults.append(str(error))
    level = sum(width > height for width, height in shapes.values())
    tall = sum(width < height for width, height in shapes.values()) > level
    cameras: dict[tuple, list[str]] = defaultdict(list)
    ready = Prepared([], {}, Counter(), set(), [])
    for name, shape in tqdm(shapes.items(), desc="reading", unit="photo", disable=not progress):
        turned = shape[0] > shape[1] if tall else shape[0] < shape[1]
        target = folder / f"{name}.jpg"
        try:
            with opened(photographs[name], io.BytesIO(photographs[name].read_bytes())) as read:
                exif, orientation = _camera_tags(read)
                x, y = UP.get(orientation, LEVEL)
                read.draft("RGB", (size, size))
                picture = read.convert("RGBA" if has_transparency(read) else "RGB")
        except InputError as error:
            faults.append(str(error))
            continue
        picture.thumbnail((size, size), Image.Resampling.LANCZOS)
        if turned:
            picture, x, y = picture.transpose(Image.Transpose.ROTATE_90), y, -x  # counter-clockwise
        if picture.mode == "RGBA" and picture.getchannel("A").getextrema() != (255, 255):
            if 0 < (most := np.asarray(picture.getchannel("A")).max()) < LIGHT:
                faults.append(f"{photographs[name]} is nowhere opaque, alpha is at most {most} of 255")
            picture.getchannel("A").save(masks / f"{target.name}.png")
            ready.masked.add(target.name)
        picture = picture.convert("RGB")
        picture.save(target, quality=QUALITY, subsampling=0, exif=exif)
        if is_blank(np.asarray(picture).transpose(2, 0, 1)):
            ready.blank.append(target.name)
        focal = str(exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLength))
        cameras[(picture.size, exif.get(ExifTags.Base.Model), focal)].append(target.name)
        ready.up[target.name] = (x, y)
        ready.sizes[shape[::-1] if turned else shape] += 1
    if faults:
        count = f"{len(faults)} of {len(photographs)} files are no photographs: " if len(faults) > 1 else ""
        raise InputError(count + "; ".join(faults))
    ready.groups.extend(cameras.values())
    return ready


def _camera_tags(picture: Image.Image) -> tuple[Image.Exif, int]:
    """Return the EXIF tags that say which camera it was (a JPEG file holds 64 KiB of them), and the
    orientation (1: as it stands; PIL turns a TIFF file itself)."""
    try:
        exif = picture.getexif()
        own = exif.get_ifd(ExifTags.IFD.Exif)
    except Exception:  # PIL raises many kinds for damaged tags, without which a photograph is still one
        return Image.Exif(), 1
    kept = Image.Exif()
    for tag in (ExifTags.Base.Make, ExifTags.Base.Model):
        if isinstance(exif.get(tag), str):
            kept[tag] = exif[tag][:100]
    kept.get_ifd(ExifTags.IFD.Exif).update({tag: own[tag] for tag in LENS_TAGS if tag in own})
    return kept, 1 if picture.format == "TIFF" else exif.get(ExifTags.Base.Orientation, 1)


def size_doubts(sizes: Mapping[tuple[int, int], int], size: int) -> list[str]:
    """Return what speaks against bringing photographs to one size, at most one sentence.

    sizes: how many have each (width, height), pixels; size: longest side of the scene's images.
    """
    scales = {(width, height): min(1.0, size / max(width, height)) for width, height in sizes}
    small = {each: (each[0] * scale, each[1] * scale) for each, scale in scales.items()}
    width, height = (min(sides) for sides in zip(*small.values(), strict=True))
    most = small[max(sizes, key=lambda each: sizes[each])]
    if width * height >= LEAST_KEPT * most[0] * most[1]:
        return []
    return [
        f"the photographs are of the sizes {sizes_told(sizes)}, of which about {width:.0f}×{height:.0f} is "
        "common at the scene's size: all are scaled and cropped to that; leave out the smallest or "
        "narrowest, if the others show everything without them"
    ]


def _to_linear(shown: np.ndarray) -> np.ndarray:
    """Return linear light of sRGB values, both in [0,1]."""
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def to_shown(light: np.ndarray) -> np.ndarray:
    """Return sRGB values in [0,1] of linear light, which is clipped to [0,1]."""
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def relative_exposures(model: Any, pictures: Path) -> dict[str, float]:
    """Return each registered picture's exposure by name, relative to the geometric mean of all.

    model: a pycolmap Reconstruction with tracks; pictures: the folder that it was made of. The brightness of
    every observed point is exposure × the point's own, fitted by medians per picture.
    """
    names, pairs = [], []
    for image in model.images.values():
        seen = [(point.point3D_id, point.xy) for point in image.points2D if point.has_point3D()]
        if not seen:
            continue
        with Image.open(pictures / image.name) as picture:
            light = _to_linear(np.asarray(picture.convert("RGB").reduce(2), np.float64) / 255).mean(2)
        place = (np.array([xy for _, xy in seen]) / 2).astype(int)
        row, column = place[:, 1].clip(0, light.shape[0] - 1), place[:, 0].clip(0, light.shape[1] - 1)
        pairs.append((np.array([index for index, _ in seen]), light[row, column]))
        names.append(image.name)
    return dict(zip(names, fitted_exposures(pairs), strict=True))


def fitted_exposures(pairs: list[tuple[np.ndarray, np.ndarray]]) -> list[float]:
    """Return one exposure per picture, geometric mean 1, of (ids (n,), linear light (n,)) of its points."""
    picture = np.repeat(np.arange(len(pairs)), [len(ids) for ids, _ in pairs])
    light = np.concatenate([values for _, values in pairs])
    _, point = np.unique(np.concatenate([ids for ids, _ in pairs]), return_inverse=True)
    sound = (light > DARK) & (light < BRIGHT)
    picture, point, logs = picture[sound], point[sound], np.log(light[sound])
    exposure, count = np.zeros(len(pairs)), np.maximum(np.bincount(point), 1)
    for _ in range(ROUNDS):
        own = np.bincount(point, logs - exposure[picture], len(count)) / count
        for index in range(len(pairs)):
            mine = picture == index
            if mine.any():
                exposure[index] = np.median(logs[mine] - own[point[mine]])
        exposure -= exposure.mean()
    return [float(each) for each in np.exp(exposure)]


def evened(picture: Image.Image, exposure: float) -> Image.Image:
    """Return an RGB picture as if it had been exposed like the mean; one within 3 % of it as it is."""
    if abs(np.log(exposure)) < SMALLEST:
        return picture
    light = _to_linear(np.asarray(picture, np.float64) / 255) / exposure
    return Image.fromarray(np.rint(255 * to_shown(light)).astype(np.uint8))
