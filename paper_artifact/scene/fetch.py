"""External meshes and photographs: where each file is, at a pinned commit; fetch, check, put in place.

No mesh and no photograph is part of the project. data_scripts/meshes.csv and photographs.csv say for each
file where it is, what its bytes hash to, and its licence. `mesh_path("spot")` is what other code calls: it
returns the path of the verified mesh file and fetches it if needed.

A file is read from the folder `mirror` or the one that the environment variable PAPER_ARTIFACT_MIRROR names,
else pooch downloads it from https://raw.githubusercontent.com. A mirror has the layout
<owner>+<repository>/<path>. Files land in the git-ignored data_scripts/downloads/ in the same layout, whole
and with the right sha256. An archive (horse.zip) is kept and its mesh unpacked beside it.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import os
import shutil
import urllib.parse
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, atomic_path, file_digest, plain, write_bytes, write_failure

DOWNLOADS = REPOSITORY / "data_scripts" / "downloads"
MIRROR_VARIABLE = "PAPER_ARTIFACT_MIRROR"
RAW = "https://raw.githubusercontent.com"
TIMEOUT = 30.0  # seconds without a byte
MIRROR_LAYOUT = "<owner>+<repository>/<path>"
OFFLINE_HINT = (
    f"check the network, or point --mirror or {MIRROR_VARIABLE} to a folder that holds {MIRROR_LAYOUT}"
)
TABLE = REPOSITORY / "data_scripts" / "meshes.csv"
ROLES = ("used", "set aside", "rejected", "comparison", "not obtainable")
PHOTO_TABLE = REPOSITORY / "data_scripts" / "photographs.csv"
THERE = "already there"  # the origin of a file that was not fetched now


@dataclass(frozen=True)
class Source:
    """One external file: a row of the table.

    Of the roles, "used", "set aside" and "rejected" are the paper's dispositions; "comparison" files are
    other copies, kept to check the first three; "not obtainable" has no repository.
    """

    key: str  # its name on the command line
    name: str  # spelled out
    repository: str  # owner/name on GitHub
    commit: str  # full hash
    path: str  # of the file in the repository
    sha256: str  # of the file, hex
    bytes: int  # of the file
    licence: str  # as its source states it
    role: str  # one of ROLES
    member: str = ""  # of a zip: the file inside that holds the mesh
    member_sha256: str = ""  # of that file, hex
    notes: str = ""  # where it comes from, or why it is not obtainable

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
        name = PurePosixPath(self.member or self.path).name
        return self.relative_path.with_name(name)


class PhotoSet(NamedTuple):
    """One set: its files, all of one repository."""

    name: str  # on the command line
    files: tuple[Source, ...]  # as the table orders them
    licence: str  # as its source states it; stands in the set's first row

    @property
    def relative_folder(self) -> Path:
        """The folder, below a mirror or the downloads, that holds all the files."""
        parents = {file.relative_path.parent for file in self.files}
        return min(parents, key=lambda parent: len(parent.parts))


def _rows(table: Path) -> list[Source]:
    """Return the rows of a table of meshes or of photographs; the key of a photograph is SET/FILE."""
    try:
        with open(plain(table), newline="", encoding="utf-8") as handle:
            rows = list(csv.DictReader(handle))
    except OSError as error:
        raise InputError(
            f"cannot read {table}: {error.strerror}; external meshes need a checkout of the repository"
        ) from error
    except (ValueError, csv.Error) as error:
        raise InputError(f"{table} is damaged ({error}); restore it with git") from error
    result = []
    for number, row in enumerate(rows, start=2):
        try:
            given: dict[str, Any] = row | {"bytes": int(row["bytes"] or 0)}
            if "set" in given:
                name = Path(row["path"]).name
                given |= {"key": f"{given.pop('set')}/{name}", "name": name, "role": "comparison"}
            result.append(Source(**given))
        except (TypeError, ValueError, KeyError) as error:
            raise InputError(f"line {number} of {table} is damaged; restore it with git") from error
        if result[-1].role not in ROLES:
            raise InputError(
                f"line {number} of {table} has the unknown role '{result[-1].role}'; "
                f"use one of {', '.join(ROLES)}"
            )
    return result


@cache
def sources(table: Path = TABLE) -> dict[str, Source]:
    """Return the meshes (key → Source, in file order).

    Raises InputError when the table is missing or a row does not parse.
    """
    return {entry.key: entry for entry in _rows(table)}


def source(key: str) -> Source:
    """Return the mesh `key`. Raises InputError for an unknown key, with the nearest known ones."""
    known = sources()
    if key not in known:
        near = difflib.get_close_matches(key, known, n=3, cutoff=0.5)
        near = [*near, "…"] if near else list(known)
        raise InputError(
            f"no mesh is called '{key}'; known are {', '.join(near)} "
            "(all: python -m paper_artifact fetch --list)"
        )
    return known[key]


@cache
def photo_sets(table: Path = PHOTO_TABLE) -> dict[str, PhotoSet]:
    """Return the sets of photographs by name; none where there is no table, as in an installed package.

    Raises InputError for a damaged row.
    """
    files: dict[str, list[Source]] = {}
    for entry in _rows(table) if table.is_file() else ():
        files.setdefault(entry.key.rpartition("/")[0], []).append(entry)
    return {name: PhotoSet(name, tuple(entries), entries[0].licence) for name, entries in files.items()}


class Unreachable(InputError):
    """The server could not be reached at all, so the next file would fail likewise."""


class Fetched(NamedTuple):
    """A mesh or a set of photographs that is in place."""

    path: Path  # of the mesh file, or of the folder of the set
    origin: str  # where its bytes came from: "already there", a folder, or a URL


def mesh_path(key: str) -> Path:
    """Return the verified file of a mesh, fetched if needed; raises InputError as `fetch` does."""
    return fetch(key, quiet=True).path


def fetch(
    key: str, mirror: Path | str | None = None, downloads: Path = DOWNLOADS, quiet: bool = False
) -> Fetched:
    """Return the file of a mesh, or the folder of a set of photographs, fetched if needed, and its origin.

    mirror: a local folder to read from instead of the network (see the module's docstring); quiet: no bars.
    What is there already stays, so that a second call goes on with a set. Raises InputError for an unknown
    or not obtainable key, a wrong sha256, a file missing in the mirror, an interrupted download, or no
    network.
    """
    if not isinstance(key, str):
        raise InputError(f"a mesh is named by its key, not by {key!r:.60}")
    chosen = photo_sets().get(key)
    if chosen is None:
        return _fetched(source(key), mirror, downloads, quiet)
    bar = tqdm(chosen.files, desc=f"fetch {key}", unit="file", leave=False, disable=quiet)
    origins = {_fetched(entry, mirror, downloads, quiet=True).origin for entry in bar} - {THERE}
    return Fetched(downloads / chosen.relative_folder, min(origins, default=THERE))


def _fetched(entry: Source, mirror: Path | str | None, downloads: Path, quiet: bool) -> Fetched:
    if not entry.obtainable:
        raise InputError(f"the mesh '{entry.key}' is not obtainable: {entry.notes}; leave it out")
    archive, mesh = downloads / entry.relative_path, downloads / entry.relative_mesh_path
    if _has_hash(mesh, entry.member_sha256 or entry.sha256):
        return Fetched(mesh, THERE)
    whole = _has_hash(archive, entry.sha256)
    for path in (mesh, archive):
        if path.is_file() and not (whole and path == archive):
            raise InputError(
                f"{path} is no longer the file that was fetched; move it elsewhere and give its path, or "
                f"delete it to fetch '{entry.key}' again"
            )
    origin = THERE if whole else _retrieved(entry, mirror, archive, quiet)
    if entry.member:
        try:
            with zipfile.ZipFile(archive) as opened:
                data = opened.read(entry.member)
        except (zipfile.BadZipFile, KeyError) as error:
            raise InputError(f"{archive} does not hold {entry.member}; restore {TABLE} with git") from error
        if hashlib.sha256(data).hexdigest() != entry.member_sha256:
            raise InputError(
                f"{entry.member} in {archive} is not the pinned one (sha256 {entry.member_sha256} expected); "
                f"restore {TABLE} with git, delete the archive and fetch again"
            )
        write_bytes(mesh, data)
    return Fetched(mesh, origin)


def _retrieved(entry: Source, mirror: Path | str | None, target: Path, quiet: bool) -> str:
    """Put the file of a row at `target`, which appears only with the right sha256, and return its origin."""
    import pooch  # with requests: only when something is fetched
    from requests import exceptions as network

    pooch.get_logger().setLevel("ERROR")
    asked = mirror if mirror is not None else os.environ.get(MIRROR_VARIABLE) or None
    if asked is None:
        place = f"{RAW}/{entry.repository}/{entry.commit}/{urllib.parse.quote(entry.path)}"
        origin, reader = place, pooch.HTTPDownloader(progressbar=not quiet, timeout=TIMEOUT)
    else:
        folder = Path(os.path.expanduser(asked))
        place, origin, reader = str(folder / entry.relative_path), str(folder), _copy
        if not folder.is_dir():
            raise InputError(f"the mirror {folder} is no folder; give the folder that holds {MIRROR_LAYOUT}")
        if not (Path(place).is_file() and os.access(place, os.R_OK)):  # no folder, pipe or device
            raise InputError(
                f"the mirror {folder} has no readable {entry.relative_path} (for '{entry.key}'); "
                "add the file, or leave the mirror out to download it"
            )
    try:
        with atomic_path(target) as partial:
            reader(place, str(partial), None)
            if not _has_hash(partial, entry.sha256):
                raise InputError(
                    f"{place} is not the pinned file of '{entry.key}' (sha256 {entry.sha256} expected), "
                    "nothing was kept; the transfer broke off, or a proxy or a changed mirror altered it: "
                    "run the same command again, or fetch it elsewhere"
                )
    except network.HTTPError as error:
        if error.response is not None:
            error.response.close()
        raise InputError(
            f"the server answers {error}, so '{entry.key}' was not fetched; "
            f"try again later, or use a mirror: {OFFLINE_HINT}"
        ) from error
    except network.ConnectionError as error:
        raise Unreachable(
            f"{place} cannot be reached ({type(error).__name__}), so '{entry.key}' was not fetched; "
            f"{OFFLINE_HINT}"
        ) from error
    except network.RequestException as error:
        raise InputError(
            f"the download of {place} broke off ({type(error).__name__}), so '{entry.key}' was not kept; "
            f"run the same command again, or {OFFLINE_HINT}"
        ) from error
    except OSError as error:
        raise write_failure(target, error) from error
    return origin


def _copy(place: str, output_file: str, _: object) -> None:
    """Copy a file of a mirror: in place of pooch's downloader."""
    shutil.copyfile(place, output_file)


def _has_hash(path: Path, sha256: str) -> bool:
    return path.is_file() and file_digest(path) == sha256
