"""Scene folders that appear whole or not at all, and are not built twice: each remembers its key in
scene.json."""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.files import load_json, write_failure
from paper_artifact.scene.folder import DESCRIPTION

STALE = 3600.0  # seconds


def holds(folder: Path, key: str) -> bool:
    """Return whether `folder` holds the scene with this key; False where it is missing or empty.

    Raises InputError when it holds anything else, which is never overwritten.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return False
    try:
        held = load_json(folder / DESCRIPTION)["key"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder} exists and is no scene of this package; choose another folder or remove it"
        ) from error
    if held != key:
        raise InputError(
            f"{folder} holds a scene of other images, or of another mesh or configuration; "
            "choose another folder or remove it"
        )
    return True


def clear_stale(folder: Path) -> None:
    """Remove what killed builds of the same scene have left: temporary folders that nothing was written to
    for STALE seconds. Others may be in the making by another process."""
    for left in folder.parent.glob(f".{glob.escape(folder.name)}-*.partial"):
        written = max(each.stat().st_mtime for each in (left, *left.glob("*")))
        if time.time() - written > STALE:
            shutil.rmtree(left, ignore_errors=True)


@contextmanager
def whole_folder(folder: Path, key: str) -> Iterator[Path]:
    """Yield a temporary folder beside `folder`, which takes its name on a clean exit and is removed
    otherwise.

    Where another process made the scene of the same key meanwhile, that one stays. Raises InputError when it
    cannot be written, or when anything else appeared at `folder`.
    """
    temporary = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        clear_stale(folder)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", suffix=".partial", dir=folder.parent))
        yield temporary
        temporary.chmod(0o755)
        try:
            os.rename(temporary, folder)
        except OSError:
            if not holds(folder, key):
                raise
    except OSError as error:
        raise write_failure(f"the scene to {folder}", error) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
