"""The folders that the package reads and writes, and atomic writes.

In a checkout, `REPOSITORY` is its top and results go to its results/. An installed package has no checkout:
both are of the current folder then, and what only a checkout holds (data_scripts/meshes.csv,
results/published/, notebooks/) is not there.

A reader of a path written here sees either the old content or the new one, never a part: the data go to a
temporary file in the same folder, are flushed to disk, and take the final name in one rename.
"""

from __future__ import annotations

import errno
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from paper_artifact.errors import InputError

RESULTS_VARIABLE = "PAPER_ARTIFACT_RESULTS"
DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})  # EFBIG: the process's own limit
LARGEST = 2**30  # bytes that an archive may unpack to: eight times a soup of a million triangles
DISK_BROKEN = frozenset({errno.EIO, errno.EROFS})
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
FIGURES_VARIABLE = "PAPER_ARTIFACT_FIGURES"  # where a notebook's figures go: folder/name, "_key.svg" is added


def find_checkout(package: Path) -> Path | None:
    """Return the top of the checkout that the folder `package` lies in, None where there is no checkout."""
    above = package.resolve().parent
    return above if (above / "data_scripts" / "meshes.csv").is_file() else None


REPOSITORY = find_checkout(Path(__file__).parent) or Path.cwd()
RESULTS = Path(os.environ.get(RESULTS_VARIABLE) or REPOSITORY / "results").absolute()  # runs are written here
OWN = RESULTS / "own"  # runs on one's own data; git-ignored, and the same from whatever folder one calls


def write_failure(path: Path | str, error: OSError) -> InputError:
    """Return the InputError for what could not be written (a path, or words for it) because of `error`."""
    why = error.strerror or str(error)
    if error.errno in DISK_FULL:
        return InputError(f"cannot write {path}: {why}; free some space and run the same command again")
    return InputError(f"cannot write {path}: {why}; choose a folder that you can write to")


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on a clean exit it takes the name `path`, else it is removed.

    Raises InputError when the folder cannot be made or written, or when the disk is full or fails, be it at
    the first byte or the last; what was at `path` before is still there then.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=".partial" + path.suffix, dir=path.parent
        )
    except OSError as error:
        raise write_failure(path, error) from error
    os.close(handle)
    temporary = Path(name)
    try:
        try:
            yield temporary
        except OSError as error:
            # Only the disk's own errors: the caller may be reading from a network or another file as well.
            if error.errno in DISK_FULL | DISK_BROKEN:
                raise write_failure(path, error) from error
            raise
        try:
            with open(temporary, "rb") as written:
                os.fsync(written.fileno())
            temporary.chmod(0o644)
            os.replace(temporary, path)
        except OSError as error:
            raise write_failure(path, error) from error
    finally:
        with suppress(OSError):  # on a disk that fails, the error above is the one to tell
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


def load_json(path: Path | str) -> Any:
    """Return what the JSON file at `path` holds.

    Raises OSError when it cannot be read, ValueError when it is damaged, holds NaN or is nested without end.
    """
    try:
        return json.loads(decoded(Path(path).read_bytes()), parse_constant=_refuse_constant)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def write_npz(path: Path | str, arrays: Mapping[str, Any], compressed: bool = True) -> None:
    """Write arrays by name as .npz to `path`, atomically. Raises InputError as `write_bytes` does."""
    import numpy as np  # only here: this module is imported by verbs that need no numbers

    # In memory first: an archive that meets a full disk half-way complains once more when it is cleared away.
    content = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(content, **arrays)
    write_bytes(path, content.getvalue())


def load_npz(path: Path | str) -> dict[str, Any]:
    """Return the arrays of the .npz file at `path` by name.

    Every byte is held against the archive's checksums. Raises OSError when the file cannot be read,
    ValueError when it is damaged, no archive, holds pickles or unpacks to more than LARGEST bytes.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            check_archive(archive)
            return {name.removesuffix(".npy"): _array(archive.read(name)) for name in archive.namelist()}
    except zipfile.BadZipFile as error:
        raise ValueError(f"it is damaged, cut off or no .npz archive: {error}") from error
    except (OSError, ValueError):
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many kinds
        raise ValueError(str(error) or type(error).__name__) from error


def check_archive(archive: zipfile.ZipFile) -> None:
    """Raise ValueError when a zip archive says that it unpacks to more than LARGEST bytes, or cannot be held
    to that."""
    members = archive.infolist()
    size = sum(member.file_size for member in members)
    if size > LARGEST:
        raise ValueError(f"it unpacks to {size} bytes, more than the {LARGEST} that are read")
    # The size that is given binds the reader for these two only.
    if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
        raise ValueError("it is packed by a method that is not read")


def inside(folder: Path, name: str) -> Path:
    """Return the path of `name` below `folder`; it need not be there.

    Raises InputError when the name, or a symbolic link on the way, leads out of the folder.
    """
    path = folder / name
    try:
        leads_out = not path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, a name with a zero byte
        raise InputError(f"{folder} names a file {name!r}, which is no path; export it again") from error
    if leads_out:
        raise InputError(
            f"{folder} names the file {name}, which lies outside of it; copy the file into the folder, "
            "without '..' and without a symbolic link"
        )
    return path


def find_file(folder: Path, name: str, endings: tuple[str, ...] = ("",)) -> Path | None:
    """Return the file that another file in `folder` names, None where there is none.

    The name is taken as written, then with % escapes resolved and a backslash as /, each with every ending of
    `endings` added. Where that is no file, a name that differs only in case or in its image ending is taken,
    if there is just one. An absolute name, or one with '..', is looked for by its last parts. Raises
    InputError as `inside` does.
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
    for start in tails:
        found = _nearly(folder, parts[start:], endings)
        if len(found) == 1:
            return inside(folder, str(found[0].relative_to(folder)))
    return None


def _leads_out(name: str) -> bool:
    return name.startswith(("/", "\\")) or name[1:2] == ":" or ".." in name.replace("\\", "/").split("/")


def _nearly(folder: Path, parts: list[str], endings: tuple[str, ...]) -> list[Path]:
    """Return the files below `folder` that `parts` name but for case and, at the end, image ending."""
    places = [folder]
    for number, part in enumerate(parts):
        last, wanted = number == len(parts) - 1, part.casefold()
        images = wanted.endswith(IMAGE_ENDINGS)
        names = {wanted, *(wanted + ending.casefold() for ending in endings)} if last else {wanted}
        if last and images:
            names |= {wanted.rpartition(".")[0] + ending for ending in IMAGE_ENDINGS}
        try:
            entries = [entry for place in places for entry in sorted(place.iterdir())]
        except OSError:
            return []
        named = [entry for entry in entries if entry.name.casefold() in names]
        exact = [entry for entry in named if entry.name == part]
        places = [entry for entry in exact or named if (entry.is_file() if last else entry.is_dir())]
    return places


def decoded(data: bytes) -> str:
    """Return a text file's bytes as text: UTF-16 with a byte-order mark, UTF-8 with or without one.

    Every line ends in a line feed. Bytes that are no UTF-8 are kept, as `os.fsdecode` keeps those of names.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        text = data.decode("utf-8-sig", errors="surrogateescape")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def whole(word: str) -> int:
    """Return the whole number that a word states, as 64, 64.0 or 6.4e1. Raises ValueError for any other."""
    try:
        return int(word)
    except ValueError:
        value = float(word)
    if not value.is_integer():
        raise ValueError(f"{word} is no whole number")
    return int(value)


def _array(data: bytes) -> Any:
    """Return the array of a .npy file's bytes: never more memory than they take."""
    import numpy as np

    stream = io.BytesIO(data)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_columns, kind = header[np.lib.format.read_magic(stream)](stream)
    if kind.hasobject:
        raise ValueError("it holds pickled objects, which are not read")
    flat = np.frombuffer(data, kind, offset=stream.tell())
    return flat.reshape(shape, order="F" if by_columns else "C").copy()


def _refuse_constant(name: str) -> None:
    raise ValueError(f"it holds {name}, which JSON does not know")
