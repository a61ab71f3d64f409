"""Scene folders that appear whole or not at all, and are not built twice: each remembers its key in
scene.json."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.files import clear_partials, load_json, partial_folder, write_failure
from paper_artifact.scene.folder import DESCRIPTION


def holds(folder: Path, key: str) -> bool:
    """Return whether `folder` holds the scene with this key; False where it is missing or empty.

    Raises InputError when it holds anything else, which is never overwritten.
    """
    clear_partials(folder)
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


@contextmanager
def whole_folder(folder: Path, key: str) -> Iterator[Path]:
    """Yield a temporary folder of the same name, which takes the place of `folder` on a clean exit and is
    removed otherwise.

    Where another process made the scene of the same key meanwhile, that one stays. Raises InputError when it
    cannot be written, or when anything else appeared at `folder`.
    """
    try:
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
