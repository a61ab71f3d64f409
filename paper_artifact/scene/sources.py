"""The table of external meshes: data_scripts/meshes.csv, one row per file at a pinned commit.

The project ships no mesh. `source("spot")` says where spot comes from, what its bytes hash to and under which
licence it stands; `paper_artifact.scene.fetch` brings the file.
"""

from __future__ import annotations

import csv
import difflib
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY

TABLE = REPOSITORY / "data_scripts" / "meshes.csv"
ROLES = ("used", "set aside", "rejected", "comparison", "not obtainable")


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
            entry = Source(**{**row, "bytes": int(row["bytes"] or 0)})
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
