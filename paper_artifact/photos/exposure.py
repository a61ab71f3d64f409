"""Relative exposures of registered photographs, and pictures brought to one exposure.

A camera left alone exposes each photograph anew, and a soup has one colour per place: what two photographs
show differently bright it can only average. The points of the cloud say by how much, since each is seen in
several.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROUNDS = 20  # of the alternating fit
LEAST = 0.03  # log of an exposure below which a picture is left as it is
DARK, BRIGHT = 0.02, 0.9  # linear light: darker is noise, brighter may be clipped
QUALITY = 95  # of the JPEG files written


def to_linear(shown: np.ndarray) -> np.ndarray:
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
            light = to_linear(np.asarray(picture.convert("RGB").reduce(2), np.float64) / 255).mean(2)
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


def even_out(folder: Path, exposures: Mapping[str, float]) -> None:
    """Rewrite the pictures in `folder` as if all had been exposed alike; those within 3 % stay as they
    are."""
    for name, exposure in exposures.items():
        if abs(np.log(exposure)) < LEAST:
            continue
        with Image.open(folder / name) as picture:
            shown = np.asarray(picture.convert("RGB"), np.float64) / 255
        even = np.rint(255 * to_shown(to_linear(shown) / exposure)).astype(np.uint8)
        Image.fromarray(even).save(folder / name, quality=QUALITY, subsampling=0)
