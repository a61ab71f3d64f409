"""The folders that the package reads and writes, and atomic writes.

In a checkout, `REPOSITORY` is its top and results go to its results/. Of an installed package both are of the
current folder, without what only a checkout holds (data_scripts/meshes.csv, results/published/).

A reader of a path written here sees the old content or the new one, never a part: the data go to a temporary
folder beside it, are flushed to disk, and take the final name in one rename. The writer holds a lock on that
folder; what a killed process left is not locked, and the next write beside it removes it. Links are followed;
devices and pipes are refused. A folder is cleared only of files that its manifest lists (`renewed_folder`).
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from paper_artifact.errors import InputError

RESULTS_VARIABLE = "PAPER_ARTIFACT_RESULTS"
SPACE = "free some space and run the same command again"
LIMIT = "raise the file size limit (ulimit -f), or use another file system, and run the same command again"
DISK_FULL = {errno.ENOSPC: SPACE, errno.EDQUOT: SPACE, errno.EFBIG: LIMIT, errno.ENOTBLK: "name a file"}
DISK_FULL[errno.EBADF] = "open it for writing"  # as `1</dev/null` does not
LONGEST_NAMED = 150  # bytes of a name that other files are named after, of the 255 that file systems take
DISK_BROKEN = frozenset({errno.EIO, errno.EROFS})
PATIENCE = 60.0  # seconds that a command waits for another one that moves files into the same folder
PARTIAL = ".paper_artifact-partial-"  # what temporary folders are called, and nothing of others
LOCK = "lock"  # the file in one that its owner has locked
WIDE = (b"\xff\xfe", b"\xfe\xff")  # byte-order marks of UTF-16
MANIFEST = ".paper_artifact.json"  # in a folder: {command or part of it: names of the files that it wrote}
FIGURES_VARIABLE = "PAPER_ARTIFACT_FIGURES"  # where a notebook's figures go: folder/name, "_key.svg" is added


def _current_folder() -> Path:
    """Return the current folder, the root where it was deleted: the command line says so then."""
    with suppress(FileNotFoundError):
        return Path.cwd()
    return Path(os.sep)


_ABOVE = Path(__file__).resolve().parents[1]  # the top of the checkout, if this is one
REPOSITORY = _ABOVE if (_ABOVE / "data_scripts" / "meshes.csv").is_file() else _current_folder()
RESULTS = Path(os.environ.get(RESULTS_VARIABLE) or REPOSITORY / "results").absolute()  # runs are written here
OWN = RESULTS / "own"  # runs on one's own data; git-ignored, and the same from whatever folder one calls


def write_failure(path: Path | str, error: OSError) -> InputError:
    """Return the InputError for what could not be written (a path, or words for it) because of `error`."""
    advice = DISK_FULL.get(error.errno or 0, "choose a folder that you can write to")
    shown = re.sub(rf"{re.escape(PARTIAL)}[^/]*/(new/)?", "", str(path))  # where it was to be moved to
    return InputError(f"cannot write {shown}: {error.strerror or error}; {advice}")


@contextmanager
def partial_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a new temporary folder in `parent` (None: the system's), locked by this process, and remove it
    afterwards; what killed processes left in `parent` is removed before. Raises OSError when `parent` cannot
    be made or written, InputError for what failed in the block because somebody removed the folder.

    One file or folder with its final name is to be made in it, beside the lock, and moved out.
    """
    parent = parent or Path(tempfile.gettempdir())
    parent.mkdir(parents=True, exist_ok=True)
    clear_partials(parent)
    folder, lock = _locked_folder(parent)
    try:
        yield folder
    except Exception as error:  # of many kinds: C libraries work there too
        if folder.exists():
            raise
        raise InputError(f"{folder} was removed while this command worked in it; run it again") from error
    finally:
        _remove(folder)
        os.close(lock)


def clear_partials(parent: Path) -> None:
    """Remove the temporary folders in `parent` whose owners are gone: their locks can be taken. Where the
    file system has no locks, and in folders without one, nothing is removed."""
    for left in parent.glob(f"{PARTIAL}*"):
        if left.is_symlink():  # ours never are: it is somebody's, and what it points to too
            continue
        with suppress(OSError):  # live, removed by another process meanwhile, or of somebody else
            try:
                lock = os.open(left / LOCK, os.O_RDWR)
            except FileNotFoundError:
                left.rmdir()  # killed before it was locked; not empty: no temporary folder
                continue
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(left)
            finally:
                os.close(lock)


def _remove(folder: Path) -> None:
    with suppress(OSError):  # the lock last: by it the next command knows what a kill leaves
        for each in sorted(folder.iterdir(), key=lambda each: each.name == LOCK):
            shutil.rmtree(each) if each.is_dir() and not each.is_symlink() else each.unlink()
        folder.rmdir()


def _locked_folder(parent: Path) -> tuple[Path, int]:
    """Return a new temporary folder and the descriptor that holds its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=parent))
        try:
            lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT)
        except FileNotFoundError:  # another process took it for one that was left
            continue
        with suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        if os.fstat(lock).st_nlink:
            return folder, lock
        os.close(lock)  # as above


def plain(path: Path | str) -> Path:
    """Return the path behind symbolic links. Raises OSError for a device, a pipe, or links in a circle."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError(errno.ENOTBLK, "it is a device or a pipe")
    if os.path.islink(place := os.path.realpath(path)):
        raise OSError(errno.ELOOP, "it is a link in a circle")
    return Path(place)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise write_failure(path, error) from error


def _place(path: Path) -> Path:
    """Return the path behind symbolic links. Raises OSError for what may not be written or replaced there."""
    place = plain(path)
    if place.exists() and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, "it is write-protected")
    return place


def check_writable(path: Path) -> None:
    """Make the folder of the file `path`. Raises InputError when no file can be written there."""
    with _writing(path), partial_folder(_place(path).parent):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path with the same name; on a clean exit the file there takes the place of `path`.

    Raises InputError when the folder cannot be made or written, or when the disk is full or fails, be it at
    the first byte or the last; what was at `path` before is still there then.
    """
    path = Path(path)
    with ExitStack() as stack:
        with _writing(path):
            place = _place(path)
            temporary = stack.enter_context(partial_folder(place.parent)) / path.name
        try:
            yield temporary
        except OSError as error:
            # Only of the disk, or of the name: the caller may be reading from a network or another file too.
            if error.errno in {*DISK_FULL, *DISK_BROKEN} or error.filename in (temporary, str(temporary)):
                raise write_failure(path, error) from error
            raise
        with _writing(path):
            with open(temporary, "rb") as written:
                os.fsync(written.fileno())
            if place.exists():
                shutil.copymode(place, temporary)
            os.replace(temporary, place)


@contextmanager
def renewed_folder(folder: Path, part: str, names: Collection[str] | None = None) -> Iterator[Path]:
    """Yield an empty temporary folder; on a clean exit its files move into `folder`, and what an earlier call
    for the same part moved there and this one did not is removed. All other files in `folder` stay.

    The folder's MANIFEST lists what was moved, by part, with its SHA-256; one process at a time changes it.
    Raises InputError, before and after the block, when one of the files `names`, or one that was made, exists
    and is not listed; for None, when any file exists that is not listed, unless the folder was written for
    this part before; when a listed file of the part was changed since. Also as `atomic_path` does."""
    folder = Path(folder)
    with ExitStack() as stack:
        with _writing(folder):
            with _alone_in(folder):
                _check_own(folder, part, names)
            (new := stack.enter_context(partial_folder(folder)) / "new").mkdir()
        yield new
        with _writing(folder), _alone_in(folder):
            files = (each for each in new.rglob("*") if each.is_file())
            made = {each.relative_to(new).as_posix(): file_digest(each) for each in files}
            for each in (names, made):
                _check_own(folder, part, each)
            _move_in(new, made, folder, part)


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Let nobody else on this machine into this block for the same folder; without locks, anybody. Raises
    InputError where another program keeps it locked: ours do so while they move files in."""
    folder.mkdir(parents=True, exist_ok=True)
    lock, until = os.open(folder, os.O_RDONLY), time.monotonic() + PATIENCE
    try:
        with suppress(OSError):
            while not _locked(lock):
                if time.monotonic() > until:
                    raise InputError(
                        f"another program keeps {folder} locked; end it, or choose another folder"
                    )
                time.sleep(0.05)
        yield
    finally:
        os.close(lock)


def _locked(lock: int) -> bool:
    """Return whether the lock of a descriptor could be taken. Raises OSError where there are no locks."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _check_own(folder: Path, part: str, names: Collection[str] | None) -> None:
    """Raise InputError where `renewed_folder` does."""
    before = listed(folder).get(part)
    if names is not None:
        unlisted = (folder / name for name in names if name not in (before or ()))
        foreign = next((path for path in unlisted if os.path.lexists(path)), None)
    else:
        foreign = _unlisted(folder) if before is None else None
    if foreign is not None:
        raise InputError(
            f"{foreign} is there and was not written by this command; choose a new or an empty folder"
        )
    for name, digest in (before or {}).items():
        if digest and (path := inside(folder, name)).is_file() and file_digest(path) not in digest.split():
            raise InputError(
                f"{path} was changed since this command wrote it; move it elsewhere, or choose another folder"
            )


def file_digest(path: Path) -> str:
    """Return the sha256 (hex) of a file's bytes. Raises OSError when it cannot be read."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _move_in(new: Path, made: dict[str, str], folder: Path, part: str) -> None:
    parts = listed(folder)
    before = parts.pop(part, {})
    gone = {*before} - {*made}.union(*parts.values())
    # A kill from here on leaves each file with the old content or with the new one: both are listed.
    both = {name: old and f"{old} {made.get(name, '')}" for name, old in before.items()}
    write_json(folder / MANIFEST, parts | {part: made | both})
    for name in made:
        target = inside(folder, name)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(new / name, target)
    for name in gone:
        inside(folder, name).unlink(missing_ok=True)
    write_json(folder / MANIFEST, parts | {part: made})


def listed(folder: Path) -> dict[str, dict[str, str]]:
    """Return the folder's manifest, names and digests ("": not known, as of names alone) by part; empty
    where there is none or it is damaged."""
    try:
        read = load_json(folder / MANIFEST)
        kept = {
            key: each if isinstance(each, dict) else dict.fromkeys(each, "") for key, each in read.items()
        }
        sound = all(isinstance(word, str) for each in kept.values() for pair in each.items() for word in pair)
    except (OSError, ValueError, AttributeError, TypeError):
        return {}
    return kept if sound else {}


def _unlisted(folder: Path) -> Path | None:
    """Return a file below `folder` that no manifest lists, in the folder, above or below; None for none."""

    def own(place: Path) -> set[Path]:
        return {place / MANIFEST} | {place / name for names in listed(place).values() for name in names}

    known = {path for place in folder.resolve().parents for path in own(place)}
    for here, folders, files in os.walk(folder.resolve()):
        place = Path(here)
        known |= own(place)
        folders[:] = [name for name in folders if not name.startswith(PARTIAL)]
        for name in files:
            if place / name not in known:
                return place / name
    return None


def run_record(soup: Path) -> Path:
    """Return where the record of a run's soup lies: runs/NAME.json beside soups/NAME.npz."""
    return soup.parent.parent / "runs" / f"{soup.stem}.json"


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write `data` to `path` atomically. Raises InputError when the folder is not writable."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write UTF-8 `text`, half letters as \\udcff, as `write_bytes` does."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as JSON (sorted keys, no NaN) atomically. Raises InputError as `write_bytes` does."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n")


def load_json(path: Path | str) -> Any:
    """Return what the JSON file at `path` holds. Raises OSError when it cannot be read, ValueError when it is
    damaged, holds NaN or is nested too deeply."""
    try:
        return json.loads(decoded(plain(path).read_bytes()), parse_constant=_refuse_constant)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def cut_name(name: str) -> str:
    """Return a file's name, its beginning alone where it leaves no room for what others add to it."""
    data = os.fsencode(name)
    return name if len(data) <= LONGEST_NAMED else data[:LONGEST_NAMED].decode("utf-8", "ignore")


def inside(folder: Path, name: str) -> Path:
    """Return the path of `name` below `folder`; it need not be there. Raises InputError when the name, or a
    symbolic link on the way, leads out of the folder."""
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


def decoded(data: bytes) -> str:
    """Return a text file's bytes as text: UTF-16 with a byte-order mark, UTF-8 with or without one. Every
    line ends in a line feed. Bytes that are no UTF-8 are kept, as `os.fsdecode` keeps those of names."""
    code, errors = ("utf-16", "replace") if data[:2] in WIDE else ("utf-8-sig", "surrogateescape")
    return data.decode(code, errors).replace("\r\n", "\n").replace("\r", "\n")


def _refuse_constant(name: str) -> None:
    raise ValueError(f"it holds {name}, which JSON does not know")
