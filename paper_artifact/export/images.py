"""Images as PNG files, and many of them on one sheet."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from paper_artifact.errors import InputError
from paper_artifact.files import write_bytes


def write_png(path: Path | str, image: np.ndarray) -> None:
    """Write `image` (H,W,3) or (H,W,4) float as an 8-bit PNG: clipped to [0,1], rounded to the nearest level.

    Raises InputError for another shape, values that are not finite, or a path that is not writable.
    """
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] not in (3, 4) or 0 in image.shape:
        raise InputError(f"an image has shape (H, W, 3) or (H, W, 4), got {image.shape}")
    if not np.isfinite(image).all():
        raise InputError(
            f"the image for {path} holds values that are not finite; the soup it shows has diverged"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(buffer, format="PNG")
    write_bytes(path, buffer.getvalue())


def sheet(rows: Sequence[Sequence[np.ndarray]], gap: int = 4) -> np.ndarray:
    """Return one white image (H',W',3) float32 with rows of equal (H,W,3) images, `gap` pixels apart.

    Raises InputError for no images or images of different shapes.
    """
    shapes = {np.shape(image) for row in rows for image in row}
    if len(shapes) != 1:
        raise InputError(f"a sheet needs images of one shape, got {sorted(shapes)}")
    height, width, channels = shapes.pop()
    columns = max(len(row) for row in rows)
    page = np.ones(
        (len(rows) * (height + gap) - gap, columns * (width + gap) - gap, channels), dtype=np.float32
    )
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            page[i * (height + gap) :, j * (width + gap) :][:height, :width] = image
    return page
