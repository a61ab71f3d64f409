"""A scene's folder: where its parts are, what scene.json says of it, and the digest of what it holds."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from os.path import isdir
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.files import (
    clear_partials,
    file_digest,
    inside,
    load_json,
    partial_folder,
    plain,
    write_failure,
)
from paper_artifact.formats.named import find_file
from paper_artifact.scene.colmap import FARTHEST, FILES, model_files, read_model
from paper_artifact.scene.images import mask_of, read_file

DESCRIPTION = "scene.json"
GROUND_TRUTH = "ground_truth.npz"
# Where models and photographs lie, the usual place first; model folders may hold the model in a folder 0, 1 …
MODEL_FOLDERS = ("sparse", "colmap/sparse", ".")
SMALLER_IMAGES = ("images_2", "images_4", "images_8")
IMAGE_FOLDERS = ("images", "input", *SMALLER_IMAGES)
UNDISTORTED = "dense"  # what COLMAP and pycolmap call the folder of the undistorted photographs


def scene_root(path: Path | str) -> Path:
    """Return the folder with the photographs and the sparse model, of what people give for it, resolved.

    The folder itself; the one above, for its sparse/, sparse/0 or images; and dense/ in it, COLMAP's name for
    the undistorted photographs, whose own camera models could not be read. Raises InputError when there is no
    such folder, and for sparse/1 or images_2 where sparse/0 or images is what is read.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"a scene is named by its folder's path, not by {path!r:.60}")
    path = Path(path)
    if not isdir(path):  # False for a name that is too long
        raise InputError(f"no scene folder at {path}; make one with `python -m paper_artifact scene`")
    path = path.resolve()
    above = [path, path.parent] if path.name in ("sparse", *IMAGE_FOLDERS) else [path]
    if path.parent.name == "sparse":
        above.append(path.parent.parent)
    for folder in above:
        for each in (folder / UNDISTORTED, folder):
            model = model_folder(each)
            if any((each / name).is_dir() for name in IMAGE_FOLDERS) and _has_model(model):
                read = each / (_images_of(each) or "") if path.name in IMAGE_FOLDERS else model
                if each == folder != path and path.name != "sparse" and path != read.resolve():
                    raise InputError(
                        f"{path} is not the folder that is read, which is {read}; move the others away"
                    )
                return each
    return path


def model_folder(root: Path) -> Path:
    """Return the folder of the sparse model, the first of MODEL_FOLDERS that has one, in itself or in a
    numbered folder; sparse/0, or sparse/, where none has."""
    for name in MODEL_FOLDERS:
        place = inside(root, name)
        numbered = _numbered(place) if name != "." and place.is_dir() else []
        for folder in (*(inside(root, str(each.relative_to(root))) for each in numbered), place):
            if _has_model(folder):
                return folder
    first = inside(root, "sparse/0")
    return first if first.is_dir() else inside(root, "sparse")


def other_models(folder: Path) -> list[str]:
    """Return the names of the other numbered models beside a numbered one."""
    numbered = _numbered(folder.parent) if folder.name[:1].isdecimal() else []
    return [each.name for each in numbered if each != folder and _has_model(each)]


def _numbered(place: Path) -> list[Path]:
    """Return what is in a folder and begins with a number, as 0, 1, …, 10."""
    return sorted(place.glob("[0-9]*"), key=lambda each: (len(each.name), each.name))


def _has_model(folder: Path) -> bool:
    return any((folder / f"cameras{ending}").is_file() for ending in (".bin", ".txt"))


def image_files(root: Path, names: Iterable[str]) -> Iterator[Path | None]:
    """Yield the photographs that a scene's model calls so, see `find_file`; None where there is none. All are
    in the first of IMAGE_FOLDERS that holds anything: others may hold distorted or smaller ones."""
    folder = _images_of(root)
    for name in names:
        found = None if folder is None else find_file(inside(root, folder), name)
        yield None if found is None else inside(root, str(found.relative_to(root)))


def _images_of(root: Path) -> str | None:
    """Return the first of IMAGE_FOLDERS that holds anything, None where there is none."""
    held = (each for each in IMAGE_FOLDERS if (root / each).is_dir() and any((root / each).iterdir()))
    return next(held, None)


def scene_name(root: Path) -> str:
    """Return what a scene is called: its folder's name, or that of the one above for COLMAP's dense/."""
    return (root.parent.name if root.name == UNDISTORTED else root.name) or "scene"


def read_description(root: Path) -> dict:
    """Return what scene.json says, {} where there is none.

    Raises InputError unless it is sound: background [r, g, b] in [0,1], radius > 0, holdout a text.
    """
    file = inside(root, DESCRIPTION)
    if not os.path.lexists(file):
        return {}
    try:
        description = load_json(file)
        background = np.array(description["background"], dtype=np.float64)
        sound = (
            background.shape == (3,)
            and background.min() >= 0
            and background.max() <= 1
            and 0 < description["radius"] < FARTHEST
            and isinstance(description.get("files", {}), dict)
            and isinstance(description.get("holdout", ""), str)
        )
        if not sound:
            raise ValueError("a background, radius or holdout (a text) out of range")
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}; check its permissions") from error
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(
            f"{file} is damaged or another program's ({error}); move it away, or build the scene again"
        ) from error
    return description


def check_files(root: Path, description: dict) -> None:
    """Raise InputError when a file of a built scene is not what scene.json ("files") says of it; scenes of
    others, and of older versions, say nothing."""
    for name, expected in description.get("files", {}).items():
        file = inside(root, name)
        if file.is_file() and file_digest(file) != expected:
            raise InputError(
                f"{file} is not as it was built (its sha256 is not that in {DESCRIPTION}); remove the "
                f'scene and build it again, or, if it was changed on purpose, "files" in {DESCRIPTION}'
            )


def check_same(files: Mapping[Path, str]) -> None:
    """Raise InputError when one of the files, {path: sha256 (hex)}, was replaced, changed or removed since it
    was hashed."""
    for file, digest in files.items():
        if not file.is_file() or file_digest(file) != digest:
            raise InputError(f"{file} was saved anew or removed while it was read; start again")


def scene_digest(root: Path) -> str:
    """Return the sha256 (hex) of all that a run takes from a scene's folder: model, photographs, masks, and
    background, radius and held-out rule of scene.json; not where it lies or what it is called.

    Raises InputError as `read_model` and `read_file` do.
    """
    folder = model_folder(root)
    names = sorted(pose.name for pose in read_model(folder).images.values())
    files = zip(FILES, model_files(folder), strict=True)
    held = {f"model/{name}": file_digest(file) for name, file in files}
    for name, file in zip(names, image_files(root, names), strict=True):
        if file is None:
            continue  # `load_scene` leaves such views out
        held[f"images/{name}"] = _sha256_of(read_file(file))
        if (mask := mask_of(root, name)) is not None:
            held[f"masks/{name}"] = _sha256_of(read_file(mask))
    description = read_description(root)
    said = {key: description.get(key) for key in ("background", "radius", "holdout")}
    said["own"] = "key" in description
    return value_digest([held, said])


def value_digest(value: Any) -> str:
    """Return the sha256 (hex) of a value that JSON can write."""
    return _sha256_of(json.dumps(value, sort_keys=True).encode())


def _sha256_of(data: bytes) -> str:
    """Return the sha256 (hex) of `data`."""
    return hashlib.sha256(data).hexdigest()


def holds(folder: Path, key: str) -> bool:
    """Return whether `folder` holds the scene with this key; False where it is missing or empty.

    Raises InputError when it holds anything else, which is never overwritten, or has lost images.
    """
    clear_partials(folder)
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return False
    try:
        held = load_json(folder / DESCRIPTION)["key"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder} exists and is no scene of this package; choose another folder") from error
    if held != key:
        raise InputError(
            f"{folder} holds a scene of other images, or of another mesh or configuration; "
            "choose another folder or remove it"
        )
    check_files(folder, read_description(folder))
    names = [pose.name for pose in read_model(model_folder(folder)).images.values()]
    if not all((folder / "images" / name).is_file() for name in names):
        raise InputError(
            f"the scene in {folder} has lost some of its files; remove the folder to build it again"
        )
    return True


@contextmanager
def whole_folder(folder: Path, key: str) -> Iterator[Path]:
    """Yield a temporary folder of the same name, which takes the place of `folder` on a clean exit and is
    removed otherwise.

    Where another process made the scene of the same key meanwhile, that one stays. Raises InputError when it
    cannot be written, for the current folder or a mount point, whose place nothing can take, or when anything
    else appeared at `folder`.
    """
    try:
        folder = plain(folder)
        if os.path.ismount(folder) or folder == Path.cwd():
            raise InputError(f"{folder} is the current folder or a mount point; name a folder in it")
        with partial_folder(folder.parent) as held:
            (temporary := held / folder.name).mkdir()
            yield temporary
            try:
                os.rename(temporary, folder)
            except OSError:
                if not holds(folder, key):
                    raise
    except OSError as error:
        raise write_failure(f"the scene to {folder}", error) from error
