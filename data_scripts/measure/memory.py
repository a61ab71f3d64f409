"""Prints peak memory of training on large photographs, and time and memory of a million points' persistence.

Each is a process by itself. Photographs are synthetic: coloured noise as smooth as a picture, written as a
COLMAP scene, then loaded and trained on as anyone's scene is. What they show does not matter to memory. Five
minutes and 5 GB of memory.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

from common import Clock, in_own_process

import numpy as np
import pandas as pd
from cost import CLOUDS, points_of
from PIL import Image

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.catalogue import study_config
from paper_artifact.files import partial_folder
from paper_artifact.randomness import stream
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.record.environment import peak_memory_mib
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.cameras import fibonacci_cameras
from paper_artifact.scene.colmap import Intrinsics, Model, Pose, write_model
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.train.loop import train

POINTS = 15_000  # of the SfM cloud, and the budget N: as many as DiffSoup starts with
PHOTOGRAPHS = ((48, 800), (100, 1600))  # views, side in pixels
LARGE = 1_000_000  # points of the largest cloud


def write_photographs(folder: Path, views: int, size: int) -> None:
    """Write a COLMAP scene of `views` synthetic images of size × size pixels around a sphere to `folder`."""
    mesh = make_shape("sphere")
    draws = stream(0, "synthetic photographs", size)
    cameras = fibonacci_cameras(mesh, views, size)
    (folder / "images").mkdir(parents=True)
    names = [f"view_{index:03d}.jpg" for index in range(views)]
    for name in names:
        coarse = Image.fromarray(draws.integers(0, 256, (size // 16 + 2, size // 16 + 2, 3), np.uint8))
        coarse.resize((size, size), Image.Resampling.BICUBIC).save(folder / "images" / name)
    positions, _, _ = sample_surface(mesh.vertices, mesh.faces, POINTS, draws)
    first = cameras[0]
    parameters = (first.focal_x, first.focal_y, first.centre_x, first.centre_y)
    model = Model(
        cameras={1: Intrinsics("PINHOLE", size, size, parameters)},
        images={
            index + 1: Pose(name, 1, camera.quaternion, camera.translation)
            for index, (name, camera) in enumerate(zip(names, cameras, strict=True))
        },
        point_ids=np.arange(1, POINTS + 1),
        positions=positions,
        colours=np.full((POINTS, 3), 128, np.uint8),
        errors=np.zeros(POINTS),
    )
    write_model(model, folder / "sparse" / "0")


def photographs_row(folder: str, views: int, size: int, budget: int = POINTS, steps: int = 12) -> dict:
    """Return MiB after loading and at most, and CPU seconds, of some steps on photographs in `folder`."""
    write_photographs(Path(folder), views, size)
    scene = load_scene(Path(folder))
    loaded = peak_memory_mib()
    config = study_config("sphere", budget=budget, steps=steps, initial_ratio=1.0, dump_steps=())
    with Clock() as clock, one_torch_thread():
        train(scene, config, device="cpu")
    row = {"what": f"{views} photographs of {size} px", "loaded MiB": loaded, "peak MiB": peak_memory_mib()}
    return row | {"CPU s": clock.cpu}


def cloud_row(size: int = LARGE, cloud: str = "soup") -> dict:
    """Return CPU seconds and MiB at most of our persistence of one large cloud."""
    alpha_persistence(points_of(CLOUDS, cloud, 100))  # the kernels are loaded
    points = points_of(CLOUDS, cloud, size)
    with Clock() as clock:
        alpha_persistence(points)
    return {"what": f"{cloud}, {size} points", "peak MiB": peak_memory_mib(), "CPU s": clock.cpu}


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    with partial_folder() as folder:
        rows = [
            in_own_process(photographs_row, f"{folder}/{views}", views, size) for views, size in PHOTOGRAPHS
        ]
    rows.append(in_own_process(cloud_row))
    print(pd.DataFrame(rows).round(1).to_string(index=False))
