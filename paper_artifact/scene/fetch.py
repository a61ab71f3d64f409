"""External meshes and photographs: where each file is, at a pinned commit; fetch, check, put in place.

No mesh and no photograph is part of the project. data_scripts/meshes.csv and photographs.csv say for each
file where it is, what its bytes hash to, and its licence. `mesh_path("spot")` is what other code calls: it
returns the path of the verified mesh file and fetches it if needed.

A file is read from `mirror` or the folder that the environment variable PAPER_ARTIFACT_MIRROR names, else
from https://raw.githubusercontent.com. A mirror has the layout <owner>+<repository>/<path>. Files land in the
git-ignored data_scripts/downloads/ in the same layout, whole and with the right sha256. An archive
(horse.zip) is kept and its mesh unpacked beside it.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import http.client
import os
import urllib.error
import urllib.parse
import urllib.request
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, NamedTuple

from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, atomic_path, write_bytes

DOWNLOADS = REPOSITORY / "data_scripts" / "downloads"
MIRROR_VARIABLE = "PAPER_ARTIFACT_MIRROR"
RAW = "https://raw.githubusercontent.com"
TIMEOUT = 30.0  # seconds without a byte
CHUNK = 1 << 16  # bytes read at once
MIRROR_LAYOUT = "<owner>+<repository>/<path>"
OFFLINE_HINT = (
    f"check the network, or point --mirror or {MIRROR_VARIABLE} to a folder that holds {MIRROR_LAYOUT}"
)
TABLE = REPOSITORY / "data_scripts" / "meshes.csv"
ROLES = ("used", "set aside", "rejected", "comparison", "not obtainable")
PHOTO_TABLE = REPOSITORY / "data_scripts" / "photographs.csv"


@dataclass(frozen=True)
class Source:
    """One external file: a row of the table.

    Of the roles, "used", "set aside" and "rejected" are the paper's dispositions; "comparison" files are
    other copies, kept to check the first three; "not obtainable" has no repository.
    """

    key: str  # its name on the command line
    name: str  # in words
    repository: str  # owner/name on GitHub
    commit: str  # full hash
    path: str  # of the file in the repository
    sha256: str  # of the file, hex
    bytes: int  # of the file
    licence: str  # as its source states it
    role: str  # one of ROLES
    member: str  # of a zip: the file inside that holds the mesh; else ""
    member_sha256: str  # of that file, hex; else ""
    notes: str  # where it comes from, or why it cannot be had

    @property
    def obtainable(self) -> bool:
        """Whether there is a repository to fetch from."""
        return self.role != "not obtainable"

    @property
    def relative_path(self) -> Path:
        """Where the file lies below a mirror and below the downloads folder: <owner>+<repository>/<path>."""
        return Path(self.repository.replace("/", "+")) / self.path

    @property
    def relative_mesh_path(self) -> Path:
        """Where the mesh lies below the downloads folder: the file, or its unpacked member beside it."""
        return (
            self.relative_path.with_name(PurePosixPath(self.member).name)
            if self.member
            else self.relative_path
        )


@cache
def sources(table: Path = TABLE) -> dict[str, Source]:
    """Return the table (key → Source, in file order).

    Raises InputError when it is missing or a row does not parse.
    """
    try:
        with open(table, newline="", encoding="utf-8") as handle:
            rows = list(csv.DictReader(handle))
    except OSError as error:
        raise InputError(
            f"cannot read the mesh table {table}: {error.strerror}; "
            "external meshes need a checkout of the repository"
        ) from error
    result = {}
    for number, row in enumerate(rows, start=2):
        try:
            given: dict[str, Any] = row | {"bytes": int(row["bytes"] or 0)}
            entry = Source(**given)
        except (TypeError, ValueError, KeyError) as error:
            raise InputError(
                f"line {number} of the mesh table {table} is damaged; restore it with git"
            ) from error
        if entry.role not in ROLES:
            raise InputError(
                f"line {number} of the mesh table {table} has the unknown role '{entry.role}'; "
                f"use one of {', '.join(ROLES)}"
            )
        result[entry.key] = entry
    return result


def source(key: str, table: Path = TABLE) -> Source:
    """Return the row of `key`. Raises InputError for an unknown key, with the nearest known ones."""
    known = sources(table)
    if key not in known:
        near = difflib.get_close_matches(key, known, n=3, cutoff=0.5) or list(known)
        raise InputError(
            f"no mesh is called '{key}'; known are {', '.join(near)} "
            "(all: python -m paper_artifact fetch --list)"
        )
    return known[key]


class PhotoSet(NamedTuple):
    """One set: its files, all of one repository."""

    name: str  # on the command line
    files: tuple[Source, ...]  # as the table orders them
    licence: str  # as its source states it

    @property
    def relative_folder(self) -> Path:
        """The folder, below a mirror or the downloads, that holds all the files."""
        parents = {file.relative_path.parent for file in self.files}
        return min(parents, key=lambda parent: len(parent.parts))


@cache
def photo_sets(table: Path = PHOTO_TABLE) -> dict[str, PhotoSet]:
    """Return the sets of the table by name; none where there is no table, as in an installed package.

    The licence stands in a set's first row. Raises InputError for a damaged row.
    """
    if not table.is_file():
        return {}
    files: dict[str, list[Source]] = {}
    licences: dict[str, str] = {}
    with open(table, newline="", encoding="utf-8") as handle:
        for number, row in enumerate(csv.DictReader(handle), start=2):
            try:
                name, licence = row.pop("set"), row["licence"]
                path = Path(row["path"]).name
                given: dict[str, Any] = row | {"bytes": int(row["bytes"])}
                entry = Source(
                    **given,
                    key=f"{name}/{path}",
                    name=path,
                    role="comparison",
                    member="",
                    member_sha256="",
                    notes="",
                )
            except (TypeError, ValueError, KeyError) as error:
                raise InputError(f"line {number} of {table} is damaged; restore it with git") from error
            licences.setdefault(name, licence)
            files.setdefault(name, []).append(entry)
    return {name: PhotoSet(name, tuple(entries), licences[name]) for name, entries in files.items()}


class Unreachable(InputError):
    """The server could not be reached at all, so the next file would fail likewise."""


class Fetched(NamedTuple):
    """A mesh that is in place."""

    path: Path  # of the mesh file
    origin: str  # where its bytes came from: "already there", a folder, or a URL


def mesh_path(key: str, *, mirror: Path | str | None = None, downloads: Path = DOWNLOADS) -> Path:
    """Return the verified mesh file of `key` (a key of data_scripts/meshes.csv), fetching it if needed.

    mirror: a local folder to read from instead of the network (module docstring). Raises InputError for an
    unknown or not obtainable key, a wrong sha256, a file missing in the mirror, an interrupted download, or
    no network.
    """
    return fetch(key, mirror=mirror, downloads=downloads, quiet=True).path


def fetch(
    key: str,
    *,
    mirror: Path | str | None = None,
    downloads: Path = DOWNLOADS,
    quiet: bool = False,
    base_url: str = RAW,
) -> Fetched:
    """Return the mesh file as `mesh_path` does, and its origin. quiet: no bar; base_url: another raw-file
    server.
    """
    return fetch_file(source(key), mirror=mirror, downloads=downloads, quiet=quiet, base_url=base_url)


def fetch_set(
    name: str, *, mirror: Path | str | None = None, downloads: Path = DOWNLOADS, quiet: bool = False
) -> Fetched:
    """Return the folder of a set, each file fetched and verified as `fetch` does, and their origin.

    Files that are there already stay. Raises InputError as `fetch` does; run again, it goes on.
    """
    chosen = photo_sets()[name]
    origins = [
        fetch_file(entry, mirror=mirror, downloads=downloads, quiet=True, base_url=RAW).origin
        for entry in tqdm(chosen.files, desc=f"fetch {name}", unit="file", leave=False, disable=quiet)
    ]
    came = [origin for origin in origins if origin != "already there"]
    return Fetched(downloads / chosen.relative_folder, came[0] if came else "already there")


def fetch_file(
    entry: Source, *, mirror: Path | str | None, downloads: Path, quiet: bool, base_url: str
) -> Fetched:
    """Return the file of one row in place, and its origin; see `fetch`."""
    if not entry.obtainable:
        raise InputError(f"the mesh '{entry.key}' cannot be had: {entry.notes}; leave it out")
    archive = downloads / entry.relative_path
    mesh = downloads / entry.relative_mesh_path
    if _has_hash(mesh, entry.member_sha256 if entry.member else entry.sha256):
        return Fetched(mesh, "already there")
    origin = "already there"
    if not _has_hash(archive, entry.sha256):
        origin = _bring(entry, archive, mirror, quiet, base_url)
    if entry.member:
        _unpack(entry, archive, mesh)
    return Fetched(mesh, origin)


def _bring(entry: Source, target: Path, mirror: Path | str | None, quiet: bool, base_url: str) -> str:
    asked = mirror if mirror is not None else os.environ.get(MIRROR_VARIABLE) or None
    if asked is not None:
        folder = Path(asked).expanduser()
        if not folder.is_dir():
            raise InputError(f"the mirror {folder} is no folder; give the folder that holds {MIRROR_LAYOUT}")
    else:
        return _download(entry, target, quiet, base_url)
    file = folder / entry.relative_path
    try:
        handle = open(file, "rb")  # noqa: SIM115 — only the opening may fail here, `with` below closes it
    except OSError as error:
        raise InputError(
            f"the mirror {folder} has no readable {entry.relative_path} (for '{entry.key}'); "
            "add the file, or leave the mirror out to download it"
        ) from error
    with handle:
        _receive(entry, handle, target, str(file), quiet)
    return str(folder)


def _download(entry: Source, target: Path, quiet: bool, base_url: str) -> str:
    url = f"{base_url}/{entry.repository}/{entry.commit}/{urllib.parse.quote(entry.path)}"
    request = urllib.request.Request(url, headers={"User-Agent": "paper_artifact"})
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as response:
            _receive(entry, response, target, url, quiet)
    except urllib.error.HTTPError as error:
        error.close()
        raise InputError(
            f"{url} answers {error.code} {error.reason}, so '{entry.key}' was not fetched; "
            f"try again later, or use a mirror: {OFFLINE_HINT}"
        ) from error
    except (http.client.IncompleteRead, ConnectionError, TimeoutError) as error:
        raise InputError(
            f"the download of {url} broke off ({type(error).__name__}), so '{entry.key}' was not kept; "
            f"run the same command again, or {OFFLINE_HINT}"
        ) from error
    except urllib.error.URLError as error:
        raise Unreachable(
            f"{url} cannot be reached ({error.reason}), so '{entry.key}' was not fetched; {OFFLINE_HINT}"
        ) from error
    return url


def _receive(entry: Source, stream: BinaryIO, target: Path, origin: str, quiet: bool) -> None:
    """Copy `stream` to `target`, which appears only if length and sha256 are those of the table."""
    digest, length = hashlib.sha256(), 0
    with (
        atomic_path(target) as temporary,
        open(temporary, "wb") as out,
        tqdm(
            total=entry.bytes,
            desc=f"fetch {entry.key}",
            unit="B",
            unit_scale=True,
            leave=False,
            disable=quiet,
        ) as bar,
    ):
        # One byte more than announced is enough to know that the file is another one.
        while length <= entry.bytes and (chunk := stream.read(min(CHUNK, entry.bytes + 1 - length))):
            _write(out, chunk, target)
            digest.update(chunk)
            length += len(chunk)
            bar.update(len(chunk))
        if length < entry.bytes:
            raise InputError(
                f"{origin} ended after {length} of {entry.bytes} bytes, so '{entry.key}' was not kept; "
                "run the same command again, or replace the file if it is in a mirror"
            )
        if length > entry.bytes or digest.hexdigest() != entry.sha256:
            raise InputError(
                f"{origin} is not the pinned file of '{entry.key}' (sha256 {entry.sha256} expected, "
                f"{'a longer file' if length > entry.bytes else digest.hexdigest()} found), "
                "nothing was kept; a proxy or a changed mirror may have altered it: fetch it elsewhere"
            )


def _write(out: BinaryIO, chunk: bytes, target: Path) -> None:
    try:
        out.write(chunk)
    except OSError as error:
        raise InputError(
            f"cannot write {target}: {error.strerror}; free some space, or choose another folder"
        ) from error


def _unpack(entry: Source, archive: Path, mesh: Path) -> None:
    try:
        with zipfile.ZipFile(archive) as opened:
            data = opened.read(entry.member)
    except (zipfile.BadZipFile, KeyError, OSError) as error:
        raise InputError(
            f"{archive} does not hold {entry.member}; delete the file and fetch again"
        ) from error
    if hashlib.sha256(data).hexdigest() != entry.member_sha256:
        raise InputError(
            f"{entry.member} in {archive} is not the pinned one (sha256 {entry.member_sha256} expected); "
            "restore data_scripts/meshes.csv with git, delete the archive and fetch again"
        )
    write_bytes(mesh, data)


def _has_hash(path: Path, sha256: str) -> bool:
    if not path.is_file():
        return False
    with open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest() == sha256
