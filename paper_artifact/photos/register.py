"""Structure from motion by pycolmap: a folder of pictures → undistorted pictures and a sparse model.

pycolmap is COLMAP itself as a Python package (Schönberger and Frahm, "Structure-from-Motion Revisited", CVPR
2016). It is imported here alone, and only when asked for.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.photos.exposure import relative_exposures

LEAST = 3  # photographs that a model is made of at least; fewer give no surface
SEED = 0  # of COLMAP's RANSACs, which take a new one each time otherwise
HINTS = (
    "take more photographs, each overlapping its neighbours by two thirds, in steps of at most 15 degrees; "
    "keep sharp ones of a scene that does not move, with texture on or around the object (a patterned "
    "tablecloth, a newspaper)"
)


class Registered(NamedTuple):
    """What structure from motion found; the undistorted pictures and the model lie in `folder`."""

    folder: Path  # holds images/ and sparse/ with cameras, images, points3D
    names: tuple[str, ...]  # of the registered pictures
    points: int  # of the sparse cloud
    error: float  # mean reprojection error, pixels of the undistorted pictures' originals
    track: float  # mean number of pictures that see a point
    exposures: dict[str, float]  # of the registered pictures by name, relative to their geometric mean


def need_pycolmap() -> Any:
    """Return the module pycolmap, made quiet. Raises InputError where it is not installed."""
    try:
        import pycolmap
    except ImportError as error:
        raise InputError(
            "registering photographs needs pycolmap, which is not installed here; "
            "`pip install pycolmap` or `pip install '.[photos]'`"
        ) from error
    pycolmap.logging.minloglevel = 3  # its remarks are not for this command's user
    return pycolmap


def register(
    pictures: Path, groups: Sequence[Sequence[str]], work: Path, size: int, progress: bool = False
) -> Registered:
    """Register the pictures in the folder `pictures` and write the undistorted ones under `work`.

    groups: file names, those of one camera (intrinsics are shared) in one group. size: longest side of an
    undistorted picture, pixels. SIFT features, exhaustive matching, incremental mapping with COLMAP's own
    settings, camera model SIMPLE_RADIAL; of several models the largest. Every random choice is seeded.
    progress shows a bar per stage. Raises InputError when fewer than `LEAST` pictures register, or pycolmap
    is missing.
    """
    colmap = need_pycolmap()
    names = [name for group in groups for name in group]
    database = work / "database.db"
    colmap.Database.open(database).close()
    for group in groups:
        colmap.import_images(
            database, pictures, camera_mode=colmap.CameraMode.SINGLE, image_names=list(group)
        )
    for name in tqdm(names, desc="features", unit="photo", disable=not progress):
        colmap.extract_features(database, pictures, image_names=[name])
    pairs = len(names) * (len(names) - 1) // 2
    with _watched("matching", "pair", pairs, lambda: _rows(database, "matches"), progress):
        verification = colmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = SEED
        colmap.match_exhaustive(database, verification_options=verification)
    options = colmap.IncrementalPipelineOptions()
    options.min_model_size = LEAST
    for seeded in (options, options.mapper, options.triangulation):
        seeded.random_seed = SEED
    for summed in (options, options.mapper):  # threads add up in an order of their own; the time is the same
        summed.num_threads = 1
    with tqdm(total=len(names), desc="mapping", unit="photo", disable=not progress) as bar:
        found = colmap.incremental_mapping(
            database,
            pictures,
            work / "models",
            options=options,
            initial_image_pair_callback=lambda: bar.update(2),
            next_image_callback=bar.update,
        )
    best = max(found, key=lambda index: found[index].num_reg_images(), default=None)
    if best is None or found[best].num_reg_images() < LEAST:
        count = 0 if best is None else found[best].num_reg_images()
        raise InputError(f"{count} of {len(names)} photographs register with one another; {HINTS}")
    model = found[best]
    undistortion = colmap.UndistortCameraOptions()
    undistortion.max_image_size = size
    out = work / "undistorted"
    count = model.num_reg_images()
    with _watched("undistorting", "photo", count, lambda: _files(out / "images"), progress):
        colmap.undistort_images(
            out, work / "models" / str(best), pictures, undistort_options=undistortion, jpeg_quality=95
        )
    return Registered(
        out,
        tuple(sorted(image.name for image in model.images.values() if image.has_pose)),
        model.num_points3D(),
        model.compute_mean_reprojection_error(),
        model.compute_mean_track_length(),
        relative_exposures(model, pictures),
    )


@contextmanager
def _watched(what: str, unit: str, total: int, count: Callable[[], int], progress: bool) -> Iterator[None]:
    """Show a bar that follows `count` twice a second while the block, one call of compiled code, runs."""
    done = threading.Event()
    with tqdm(total=total, desc=what, unit=unit, disable=not progress) as bar:

        def follow() -> None:
            while not done.wait(0.5):
                bar.update(count() - bar.n)

        watcher = threading.Thread(target=follow, daemon=True)
        if progress:
            watcher.start()
        try:
            yield
        finally:
            done.set()
            if progress:
                watcher.join()
        bar.update(total - bar.n)


def _rows(database: Path, table: str) -> int:
    """Return how many rows the table has; 0 while it is locked."""
    try:
        with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=0.1)) as connection:
            return int(connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
    except sqlite3.Error:
        return 0


def _files(folder: Path) -> int:
    return sum(1 for _ in folder.iterdir()) if folder.is_dir() else 0
