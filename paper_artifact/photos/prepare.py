"""A folder of photographs → pictures as structure from motion takes them: of one format, scaled, by camera.

A phone's upright and level photographs are one camera with one size: their EXIF orientation is not applied,
and where it was applied already the fewer are turned on their side, which structure from motion does not care
about.
"""

from __future__ import annotations

import io
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from PIL import ExifTags, Image
from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.photos.register import LEAST
from paper_artifact.scene.images import opened, sizes_told

ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")
QUALITY = 95  # of JPEG files written between photograph and scene
LEAST_KEPT = 0.5  # part of the most frequent size's pixels that the common size must have, or it is told
LEVEL = (0.0, -1.0)  # where up is in a picture that stands right: x to the right, y down
UP = {3: (0.0, 1.0), 4: (0.0, 1.0), 5: (-1.0, 0.0), 6: (-1.0, 0.0), 7: (1.0, 0.0), 8: (1.0, 0.0)}
"""Where up is in the stored picture, by EXIF orientation; the others are LEVEL."""


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


class Prepared(NamedTuple):
    """Photographs as structure from motion takes them."""

    groups: list[list[str]]  # file names by camera
    up: dict[str, tuple[float, float]]  # by file name, see `upright`
    sizes: Counter[tuple[int, int]]  # photographs by (width, height) as they are, pixels; turned ones turned


def prepared(photographs: Sequence[Path], folder: Path, size: int, progress: bool) -> Prepared:
    """Write the photographs as JPEG of at most `size` pixels a side to `folder`; return what they are.

    All become level, or upright where more are that: the others are turned by a quarter. Photographs of one
    size, camera and focal length (EXIF) are of one camera. Raises InputError for what is no photograph.
    """
    folder.mkdir(parents=True)
    shapes = []
    for file in photographs:
        with opened(file, file) as read:
            shapes.append(read.size)
    level = sum(width > height for width, height in shapes)
    tall = sum(width < height for width, height in shapes) > level
    cameras: dict[tuple, list[str]] = defaultdict(list)
    ready = Prepared([], {}, Counter())
    for file, shape in zip(
        tqdm(photographs, desc="reading", unit="photo", disable=not progress), shapes, strict=True
    ):
        turned = shape[0] > shape[1] if tall else shape[0] < shape[1]
        with opened(file, file) as read:
            exif = read.getexif()
            own = exif.get_ifd(ExifTags.IFD.Exif)
            x, y = UP.get(exif.pop(ExifTags.Base.Orientation, 1), LEVEL)
            read.draft("RGB", (size, size))
            picture = read.convert("RGB")
            picture.thumbnail((size, size), Image.Resampling.LANCZOS)
            if turned:
                picture, x, y = picture.transpose(Image.Transpose.ROTATE_90), y, -x  # counter-clockwise
            picture.save(content := io.BytesIO(), "JPEG", quality=QUALITY, subsampling=0, exif=exif)
        target = folder / f"{file.stem}.jpg"
        target.write_bytes(content.getvalue())
        focal = str(own.get(ExifTags.Base.FocalLength))
        cameras[(picture.size, exif.get(ExifTags.Base.Model), focal)].append(target.name)
        ready.up[target.name] = (x, y)
        ready.sizes[shape[::-1] if turned else shape] += 1
    ready.groups.extend(cameras.values())
    return ready


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
