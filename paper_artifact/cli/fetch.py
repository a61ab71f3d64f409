"""`python -m paper_artifact fetch [KEY …]`: external meshes, sets of photographs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.scene.fetch import DOWNLOADS, MIRROR_VARIABLE, Unreachable, fetch
from paper_artifact.scene.photo_sets import fetch_set, photo_sets
from paper_artifact.scene.sources import source, sources


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "key",
        nargs="*",
        help="meshes to fetch (default: all that the paper uses, sets aside or rejects), "
        f"or sets of photographs: {', '.join(photo_sets())}",
    )
    parser.add_argument(
        "--all", action="store_true", help="also the other copies that were compared with these"
    )
    parser.add_argument(
        "--mirror",
        type=Path,
        metavar="DIR",
        help=f"read from this folder (layout <owner>+<repository>/<path>) instead of the network; "
        f"the environment variable {MIRROR_VARIABLE} does the same",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=DOWNLOADS,
        metavar="DIR",
        help="where to put them (default: data_scripts/downloads)",
    )
    parser.add_argument(
        "--list",
        action="store_true",
        help="print key, role, source and licence of every mesh and fetch nothing",
    )


def run(arguments: argparse.Namespace) -> int:
    """Fetch, with a line per mesh; a failing one is named, the others go on.

    Returns 0, or 1 if one failed.
    """
    if arguments.list:
        for entry in sources().values():
            place = f"{entry.repository}@{entry.commit[:8]}:{entry.path}" if entry.obtainable else entry.notes
            print(f"{entry.key:<17}{entry.role:<15}{place}\n{'':<17}licence: {entry.licence or '-'}")
        for each in photo_sets().values():
            first = each.files[0]
            size = sum(file.bytes for file in each.files) / 1e6
            print(
                f"{each.name:<17}{'photographs':<15}{first.repository}@{first.commit[:8]}:"
                f"{Path(first.path).parent} ({len(each.files)} files, {size:.0f} MB)\n"
                f"{'':<17}licence: {each.licence}"
            )
        return 0
    keys = arguments.key or [
        entry.key
        for entry in sources().values()
        if entry.obtainable and (arguments.all or entry.role != "comparison")
    ]
    for key in keys:
        if key not in photo_sets():
            source(key)  # a mistyped key stops before any download
    failed = 0
    for key in keys:
        try:
            bring = fetch_set if key in photo_sets() else fetch
            fetched = bring(key, mirror=arguments.mirror, downloads=arguments.out, quiet=arguments.quiet)
        except Unreachable:
            raise
        except InputError as error:
            failed += 1
            print(f"{key}: {error}", file=sys.stderr)
        else:
            print(
                f"{key:<17}{_size(key, fetched.path) / 1e6:6.2f} MB  {_shown(fetched.path)}  "
                f"({fetched.origin})"
            )
    if failed:
        print(f"paper_artifact: {failed} of {len(keys)} meshes could not be fetched", file=sys.stderr)
    return 1 if failed else 0


def _size(key: str, path: Path) -> int:
    """Return the bytes of a mesh file, or of a set's files."""
    return sum(file.bytes for file in photo_sets()[key].files) if key in photo_sets() else path.stat().st_size


def _shown(path: Path) -> Path:
    return path.relative_to(REPOSITORY) if path.is_relative_to(REPOSITORY) else path
