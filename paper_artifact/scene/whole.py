"""Scene folders that appear whole or not at all, and are not built twice: each remembers its key in
scene.json."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.scene.folder import DESCRIPTION


def holds(folder: Path, key: str) -> bool:
    """Return whether `folder` holds the scene with this key; False where it is missing or empty.

    Raises InputError when it holds anything else, which is never overwritten.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return False
    try:
        held = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))["key"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder} exists and is no scene of this package; choose another folder or remove it"
        ) from error
    if held != key:
        raise InputError(
            f"{folder} holds a scene of other images or settings; choose another folder or remove it"
        )
    return True


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `folder`, which takes its name on a clean exit and is removed
    otherwise.

    Raises InputError when it cannot be written, or when something appeared at `folder` meanwhile.
    """
    temporary = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", suffix=".partial", dir=folder.parent))
        yield temporary
        temporary.chmod(0o755)
        os.rename(temporary, folder)
    except OSError as error:
        raise InputError(
            f"cannot write the scene to {folder}: {error.strerror or error}; "
            "choose a folder that you can write to"
        ) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
