"""The file that another file names: a texture, a buffer, a photograph."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path, PurePosixPath
from unicodedata import normalize
from urllib.parse import unquote

from paper_artifact.files import inside

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


def find_file(folder: Path, name: str, endings: tuple[str, ...] = ("",)) -> Path | None:
    """Return the file that another file in `folder` names, None where there is none.

    The name is taken as written, then with % escapes resolved and a backslash as /, each with every ending of
    `endings` added. Where that is no file, a name that differs only in case, in its accents' form
    or in its image ending is taken, if there is just one. An absolute name, or one with '..', is looked for
    by its last parts. Raises InputError as `inside` does.
    """
    plain = unquote(name).replace("\\", "/")
    spellings = [name, plain]
    if not name.isascii():  # a name in another encoding than the disk's
        for encoding in ("cp1252", "gbk", "shift_jis"):
            with suppress(UnicodeError):
                spellings.append(os.fsencode(name).decode(encoding))
    for each in spellings:
        for ending in endings:
            if not _leads_out(each) and (path := inside(folder, each + ending)).is_file():
                return path
    parts = [part for part in PurePosixPath(plain).parts if part not in ("/", ".", "..") and part[1:] != ":"]
    tails = range(len(parts)) if _leads_out(plain) else range(1)
    for start in tails if parts else ():
        found = _nearly(folder, parts[start:], endings)
        if len(found) == 1:
            return inside(folder, str(found[0].relative_to(folder)))
    return None


def _leads_out(name: str) -> bool:
    return name.startswith(("/", "\\")) or name[1:2] == ":" or ".." in name.replace("\\", "/").split("/")


def _alike(name: str) -> str:
    """Return a name without case, with composed accents: some disks keep them apart."""
    return normalize("NFC", name).casefold()


def _nearly(folder: Path, parts: list[str], endings: tuple[str, ...]) -> list[Path]:
    """Return the files below `folder` that `parts` name but for case and image ending."""
    places = [folder]
    for number, part in enumerate(parts):
        last, wanted = number == len(parts) - 1, _alike(part)
        names = {wanted, *(wanted + ending.casefold() for ending in endings)} if last else {wanted}
        if last and wanted.endswith(IMAGE_ENDINGS):
            names |= {wanted.rpartition(".")[0] + ending for ending in IMAGE_ENDINGS}
        try:
            entries = [entry for place in places for entry in sorted(place.iterdir())]
        except OSError:
            return []
        named = [entry for entry in entries if _alike(entry.name) in names]
        exact = [entry for entry in named if entry.name == part]
        places = [entry for entry in exact or named if (entry.is_file() if last else entry.is_dir())]
    return places
