"""Structure from motion by pycolmap: a folder of pictures → undistorted pictures and a sparse model.

pycolmap is COLMAP itself as a Python package (Schönberger and Frahm, "Structure-from-Motion Revisited", CVPR
2016). It is imported here alone, and only when asked for.
"""

from __future__ import annotations

import re
import signal
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.photos.pictures import LEAST, relative_exposures

SEED = 0  # of COLMAP's RANSACs, which take a new one each time otherwise
BLOCK = re.compile(rb"Processing block \[")  # in pycolmap's log, once for each block of pairs
HINTS = (
    "take more photographs, each overlapping its neighbours by two thirds, in steps of at most 15 degrees; "
    "keep sharp ones of a scene that does not move, with texture on or around the object (a patterned "
    "tablecloth, a newspaper)"
)


class Registered(NamedTuple):
    """What structure from motion found; the undistorted pictures and the model lie in `folder`."""

    folder: Path  # holds images/ and sparse/ with cameras, images, points3D
    model: Path  # of pycolmap, with distortion
    names: tuple[str, ...]  # of the registered pictures
    points: int  # of the sparse cloud
    error: float  # mean reprojection error, pixels of the undistorted pictures' originals
    track: float  # mean number of pictures that see a point
    exposures: dict[str, float]  # of the registered pictures by name, relative to their geometric mean


def need_pycolmap() -> Any:
    """Return the module pycolmap. SIGTERM ends the process as before, without a C++ stack. Raises InputError
    where it is not installed."""
    try:
        import pycolmap
    except ImportError as error:
        raise InputError(
            "registering photographs needs pycolmap, which is not installed here; "
            "`pip install pycolmap` or `pip install '.[photos]'`"
        ) from error
    with suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM) or signal.SIG_DFL)
    return pycolmap


def log_to(start: Path | None) -> None:
    """Send pycolmap's own lines to a file whose path begins with `start`, those of a fatal error to stderr
    too; None: nowhere."""
    log = need_pycolmap().logging
    log.logtostderr, log.alsologtostderr, log.minloglevel = False, False, 0 if start else 3
    log.stderrthreshold = log.FATAL.value
    for level in (log.INFO, log.WARNING, log.ERROR, log.FATAL):
        log.set_log_destination(level, "" if start is None or level != log.INFO else str(start))


def register(
    pictures: Path, groups: Sequence[Sequence[str]], masks: Path, work: Path, size: int, progress: bool
) -> Registered:
    """Register the pictures in the folder `pictures` and write the undistorted ones under `work`.

    groups: file names, those of one camera (intrinsics are shared) in one group. size: longest side of an
    undistorted picture, pixels. SIFT features, exhaustive matching, incremental mapping with COLMAP's own
    settings, camera model SIMPLE_RADIAL; of several models the largest. Every random choice is seeded.
    masks: a folder with NAME.png, black where the picture NAME does not count, for some of the pictures.
    progress shows a bar per stage. pycolmap's lines go to work/log…; its database is opened by pycolmap alone
    (two copies of SQLite in one process damage it). Raises InputError when fewer than `LEAST` pictures
    register, or pycolmap is missing.
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
        reading = colmap.ImageReaderOptions()
        reading.mask_path = masks if (masks / f"{name}.png").is_file() else ""
        colmap.extract_features(database, pictures, image_names=[name], reader_options=reading)
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    blocks = -((-len(names) // colmap.ExhaustivePairingOptions().block_size) ** 2)
    _stage(
        ("matching", "block", blocks),
        lambda token: colmap.match_exhaustive(
            database, verification_options=verification, cancellation_token=token
        ),
        lambda: sum(len(BLOCK.findall(file.read_bytes())) for file in work.glob("log*")) - 1,
        progress,
    )
    options = colmap.IncrementalPipelineOptions()
    options.min_model_size = LEAST
    for seeded in (options, options.mapper, options.triangulation):
        seeded.random_seed = SEED
    for summed in (options, options.mapper):  # threads add up in an order of their own; the time is the same
        summed.num_threads = 1
    seen: list[int] = []  # photographs that each callback brought
    found = _stage(
        ("mapping", "photo", len(names)),
        lambda token: colmap.incremental_mapping(
            database,
            pictures,
            work / "models",
            options=options,
            initial_image_pair_callback=lambda: seen.append(2),
            next_image_callback=lambda: seen.append(1),
            cancellation_token=token,
        ),
        lambda: sum(seen),
        progress,
    )
    best = max(found, key=lambda index: found[index].num_reg_images(), default=None)
    if best is None or found[best].num_reg_images() < LEAST:
        registered = 0 if best is None else found[best].num_reg_images()
        raise InputError(f"{registered} of {len(names)} photographs register with one another; {HINTS}")
    model = found[best]
    out = work / "undistorted"
    undistort(pictures, work / "models" / str(best), out, size, model.num_reg_images(), progress)
    return Registered(
        out,
        work / "models" / str(best),
        tuple(sorted(image.name for image in model.images.values() if image.has_pose)),
        model.num_points3D(),
        model.compute_mean_reprojection_error(),
        model.compute_mean_track_length(),
        relative_exposures(model, pictures),
    )


def undistort(pictures: Path, model: Path, out: Path, size: int, count: int, progress: bool) -> None:
    """Write the `count` registered pictures of a pycolmap model without distortion to out/images, and their
    model; size: longest side, pixels."""
    colmap = need_pycolmap()
    options = colmap.UndistortCameraOptions()
    options.max_image_size = size
    _stage(
        ("undistorting", "photo", count),
        lambda token: colmap.undistort_images(
            out, model, pictures, undistort_options=options, jpeg_quality=95, cancellation_token=token
        ),
        lambda: len(list((out / "images").glob("*"))),
        progress,
    )


def _stage(
    title: tuple[str, str, int], call: Callable[[Any], Any], count: Callable[[], int], progress: bool
) -> Any:
    """Return what `call`, given a cancellation token, returns from compiled code in a thread of its own.

    This thread shows a bar (title: what, unit, total) that follows `count`, and cancels the call on Ctrl-C.
    It waits for the call's end, which a second Ctrl-C would trouble: that one ends the process at once.
    """
    token = need_pycolmap().CancellationToken()
    what, unit, total = title
    before = signal.getsignal(signal.SIGINT)
    try:
        with (
            ThreadPoolExecutor(1) as pool,
            tqdm(total=total, desc=what, unit=unit, disable=not progress) as bar,
        ):
            running = pool.submit(call, token)
            try:
                while wait([running], 0.5).not_done:
                    bar.update(min(total, count()) - bar.n)
                result = running.result()
            except KeyboardInterrupt:  # only the main thread gets it
                signal.signal(signal.SIGINT, signal.SIG_DFL)
                tqdm.write(
                    f"{what} stops after its present block; Ctrl-C again ends it at once", file=sys.stderr
                )
                raise
            finally:
                token.cancel()
            bar.update(total - bar.n)
    finally:
        if signal.getsignal(signal.SIGINT) != before:
            signal.signal(signal.SIGINT, before)
    return result
