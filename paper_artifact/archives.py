"""Archives of arrays (.npz): written atomically, and read against their checksums, whatever they declare."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.files import write_bytes

LARGEST = 2**30  # bytes that an archive may unpack to: eight times a soup of a million triangles


def write_npz(path: Path | str, arrays: Mapping[str, Any], compressed: bool = True) -> None:
    """Write arrays by name as .npz to `path`, atomically. Raises InputError as `write_bytes` does."""
    content = io.BytesIO()  # in memory first: an archive that meets a full disk complains twice
    (np.savez_compressed if compressed else np.savez)(content, **arrays)
    write_bytes(path, content.getvalue())


def load_npz(path: Path | str) -> dict[str, Any]:
    """Return the arrays of the .npz file at `path` by name, every byte held against its checksums. Raises
    OSError when it cannot be read, ValueError when it is damaged, no archive, holds pickles or unpacks to
    more than LARGEST bytes."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_archive(archive)
            return {name.removesuffix(".npy"): _array(archive.read(name)) for name in archive.namelist()}
    except (OSError, ValueError):
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many kinds
        raise ValueError(f"it is damaged, cut off or no .npz archive: {error!r}") from error


def check_archive(archive: zipfile.ZipFile) -> None:
    """Raise ValueError when a zip archive unpacks to more than LARGEST bytes, or says not how many."""
    members = archive.infolist()
    if (size := sum(member.file_size for member in members)) > LARGEST:
        raise ValueError(f"it unpacks to {size} bytes, more than the {LARGEST} that are read")
    # The size that is given binds the reader for these two only.
    if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
        raise ValueError("it is packed by a method that is not read")


def _array(data: bytes) -> Any:
    """Return the array of a .npy file's bytes: never more memory than they take."""
    stream = io.BytesIO(data)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_columns, kind = header[np.lib.format.read_magic(stream)](stream)
    if kind.hasobject:
        raise ValueError("it holds pickled objects, which are not read")
    flat = np.frombuffer(data, kind, offset=stream.tell())
    return flat.reshape(shape, order="F" if by_columns else "C").copy()
