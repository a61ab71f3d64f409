"""The folders that the package reads and writes, and atomic writes.

In a checkout, `REPOSITORY` is its top and results go to its results/. An installed package has no checkout:
both are of the current folder then, and what only a checkout holds (data_scripts/meshes.csv,
results/published/, notebooks/) is not there.

A reader of a path written here sees either the old content or the new one, never a part: the data go to a
temporary file in the same folder, are flushed to disk, and take the final name in one rename.
"""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from paper_artifact.errors import InputError

RESULTS_VARIABLE = "PAPER_ARTIFACT_RESULTS"
FIGURES_VARIABLE = "PAPER_ARTIFACT_FIGURES"  # where a notebook's figures go: folder/name, "_key.svg" is added


def find_checkout(package: Path) -> Path | None:
    """Return the top of the checkout that the folder `package` lies in, None where there is no checkout."""
    above = package.resolve().parent
    return above if (above / "data_scripts" / "meshes.csv").is_file() else None


REPOSITORY = find_checkout(Path(__file__).parent) or Path.cwd()
RESULTS = Path(os.environ.get(RESULTS_VARIABLE) or REPOSITORY / "results").absolute()  # runs are written here


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on a clean exit it takes the name `path`, else it is removed.

    Raises InputError when the folder cannot be made or written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=".partial" + path.suffix, dir=path.parent
        )
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror}; choose a folder that you can write to"
        ) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write `data` to `path` atomically. Raises InputError when the folder is not writable."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write UTF-8 `text` to `path` atomically. Raises InputError when the folder is not writable."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as JSON (sorted keys, no NaN) atomically. Raises InputError as `write_bytes` does."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n")


def load_npz(path: Path | str) -> dict[str, Any]:
    """Return the arrays of the .npz file at `path` by name.

    Raises OSError when the file cannot be read, ValueError when it is damaged, no archive, or holds pickles.
    """
    import numpy as np  # only here: this module is imported by verbs that need no numbers

    try:
        # Opened here, because numpy leaves the file open when it is no sound archive.
        with open(path, "rb") as handle:
            if not zipfile.is_zipfile(handle):
                raise ValueError("it is cut off or no .npz archive")
            handle.seek(0)
            with np.load(handle) as stored:
                return dict(stored)
    except OSError:
        raise
    except Exception as error:  # numpy, zipfile and zlib raise many kinds
        raise ValueError(str(error) or type(error).__name__) from error
