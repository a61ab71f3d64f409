"""Bring external meshes: download at the pinned commit or copy from a mirror, check, put in place atomically.

`mesh_path("spot")` is what other code calls: it returns the path of the verified mesh file and fetches it if
needed.

Where a file comes from, first hit wins: `mirror`; the environment variable PAPER_ARTIFACT_MIRROR; the folder
../shared/meshes beside the repository, if it holds the file; https://raw.githubusercontent.com. A mirror has
the layout <owner>+<repository>/<path>. Files land in the git-ignored data_scripts/downloads/ in the same
layout; a file appears there only whole and with the right sha256. An archive (horse.zip) is kept and its mesh
unpacked beside it.
"""

from __future__ import annotations

import hashlib
import http.client
import os
import urllib.error
import urllib.parse
import urllib.request
import zipfile
from pathlib import Path
from typing import BinaryIO, NamedTuple

from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, atomic_path, write_bytes
from paper_artifact.scene.sources import Source, source

DOWNLOADS = REPOSITORY / "data_scripts" / "downloads"
SIBLING_MIRROR = REPOSITORY.parent / "shared" / "meshes"
MIRROR_VARIABLE = "PAPER_ARTIFACT_MIRROR"
RAW = "https://raw.githubusercontent.com"
TIMEOUT = 30.0  # seconds without a byte
CHUNK = 1 << 16  # bytes read at once
MIRROR_LAYOUT = "<owner>+<repository>/<path>"
OFFLINE_HINT = (
    f"check the network, or point --mirror or {MIRROR_VARIABLE} to a folder that holds {MIRROR_LAYOUT}"
)


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
    elif (SIBLING_MIRROR / entry.relative_path).is_file():
        folder = SIBLING_MIRROR
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
