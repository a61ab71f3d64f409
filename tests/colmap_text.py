"""COLMAP's text model, written: the package writes binary ones, and reads both."""

import os
from pathlib import Path

from paper_artifact.scene.colmap import Model


def write_text_model(model: Model, folder: Path) -> None:
    """Write cameras.txt, images.txt and points3D.txt into `folder`; floats are exact."""
    columns = (model.point_ids, model.positions, model.colours, model.errors)
    points = zip(*(column.tolist() for column in columns), strict=True)
    cameras, images = model.cameras.items(), model.images.items()
    lines = {
        "cameras": [f"{i} {c.model} {c.width} {c.height} {_exact(c.parameters)}" for i, c in cameras],
        "images": [f"{i} {_exact(p.quaternion + p.translation)} {p.camera} {p.name}\n" for i, p in images],
        "points3D": [
            f"{point} {_exact(xyz)} {' '.join(map(str, rgb))} {error!r}" for point, xyz, rgb, error in points
        ],
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in lines.items():
        (folder / f"{name}.txt").write_bytes(os.fsencode("\n".join(["# as COLMAP writes it", *rows]) + "\n"))


def _exact(values) -> str:
    return " ".join(repr(float(value)) for value in values)
