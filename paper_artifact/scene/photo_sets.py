"""Sets of photographs that others published: data_scripts/photographs.csv, one row per file at a pinned
commit.

Neither photographs nor pictures made of them are part of this project; `fetch castle` brings a set.
"""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.scene.fetch import DOWNLOADS, RAW, Fetched, fetch_file
from paper_artifact.scene.sources import Source

TABLE = REPOSITORY / "data_scripts" / "photographs.csv"


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
def photo_sets(table: Path = TABLE) -> dict[str, PhotoSet]:
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
                entry = Source(
                    **{**row, "bytes": int(row["bytes"])},
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


def fetch_set(
    name: str,
    *,
    mirror: Path | str | None = None,
    downloads: Path = DOWNLOADS,
    quiet: bool = False,
    base_url: str = RAW,
) -> Fetched:
    """Return the folder of a set, each file fetched and verified as `fetch.fetch` does, and their origin.

    Files that are there already stay. Raises InputError as `fetch.fetch` does; run again, it goes on.
    """
    chosen = photo_sets()[name]
    origins = [
        fetch_file(entry, mirror=mirror, downloads=downloads, quiet=True, base_url=base_url).origin
        for entry in tqdm(chosen.files, desc=f"fetch {name}", unit="file", leave=False, disable=quiet)
    ]
    came = [origin for origin in origins if origin != "already there"]
    return Fetched(downloads / chosen.relative_folder, came[0] if came else "already there")
