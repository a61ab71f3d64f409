"""Options of several verbs that say how a scene of one's own is read, and what they are as settings."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from paper_artifact.config import GivenConfig, with_changes
from paper_artifact.errors import InputError

READING = ("downscale", "background", "holdout")


def add_reading_arguments(group: Any) -> None:
    """Declare how photographs are read on an argparse parser or group."""
    group.add_argument(
        "--downscale", type=float, metavar="F", help="make the photographs smaller by this factor"
    )
    group.add_argument(
        "--background",
        metavar="COLOUR",
        help="white, black, mean (of the photographs) or #rrggbb: where nothing is, as the sky "
        "(default: the scene's, else white)",
    )
    group.add_argument(
        "--holdout",
        metavar="RULE",
        help="views to judge by: K (every K-th), none, names (a.jpg,b.jpg), or auto: one of about eight, the "
        "one that its neighbours surround most closely, since a walk's extreme views tell nothing "
        "(default: auto; every 8th for scenes of the verb scene)",
    )


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say which scene of one's own is trained on, and how it is read."""
    group = parser.add_argument_group("one's own photographs, instead of a shape")
    group.add_argument(
        "--scene",
        metavar="DIR",
        help="a COLMAP scene: images/ (undistorted) and sparse/, as COLMAP and the verb scene write "
        "it; transparent pixels and what is black in masks/ are taken out",
    )
    group.add_argument(
        "--target",
        metavar="MESH|bundle.json",
        help="what C1 and C2 act towards: a mesh in the scene's own frame, which is also evaluated against, "
        "or a bundle of the verb audit in the scene's unit of length",
    )
    add_reading_arguments(group)


def reading(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return {setting: value} of the reading options that were given."""
    return {name: value for name in READING if (value := getattr(arguments, name)) is not None}


def reading_of_scene(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return `reading`. Raises InputError for reading options without --scene, or out of range."""
    said = reading(arguments)
    if arguments.scene is None and said:
        raise InputError(f"--{' and --'.join(said)} belong to --scene DIR; give the scene's folder too")
    with_changes(GivenConfig(), said)
    return said


def reading_of_run(arguments: argparse.Namespace, soup: Path) -> dict[str, Any]:
    """Return `reading_of_scene`; what was not given is taken from the run's record, where there is one.

    The record of soups/NAME.npz is runs/NAME.json beside it. What is taken is told in one line on stderr, and
    so is a record of another scene, of which nothing is. Raises InputError also for a damaged record.
    """
    said = reading_of_scene(arguments)
    file = soup.parent.parent / "runs" / f"{soup.stem}.json"
    if arguments.scene is None or not file.is_file():
        return said
    from paper_artifact.record.store import config_of, read_record
    from paper_artifact.scene.folder import scene_digest, scene_root

    given, default = config_of(read_record(file)).given, GivenConfig()
    values = {name: getattr(given, name) for name in READING} if given is not None else {}
    taken = {name: value for name, value in values.items() if value != getattr(default, name)}
    taken = {name: value for name, value in taken.items() if name not in said}
    if given is None or not taken:
        return said
    words = " ".join(
        f"--{name} {value:g}" if name == "downscale" else f"--{name} {value}" for name, value in taken.items()
    )
    if given.digest != scene_digest(scene_root(arguments.scene)):
        print(f"{file} is of another scene than {arguments.scene}: its {words} not taken", file=sys.stderr)
        return said
    print(f"{words}, as the run was trained ({file}); give others to change that", file=sys.stderr)
    return said | taken


def given_of(arguments: argparse.Namespace) -> GivenConfig | None:
    """Return what the options of `add_scene_arguments` say, None without --scene. InputError when they say it
    of no scene."""
    said = reading_of_scene(arguments)
    if arguments.scene is None:
        if arguments.target is not None:
            raise InputError("--target belongs to --scene DIR: a shape or mesh is its own target")
        return None
    return with_changes(GivenConfig(target=arguments.target), said)
