"""Options of several verbs that say how a scene of one's own is read, and what they are as settings."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from paper_artifact.cli.options import Options, Source, WrongUsage, shown, usage_checked
from paper_artifact.config import GivenConfig, with_changes
from paper_artifact.files import run_record

READING = ("downscale", "background", "holdout")


@dataclass(frozen=True, kw_only=True)
class ReadingOptions(Options):
    """A COLMAP scene, and how its photographs are read.

    scene DIR: a COLMAP scene: images/ (undistorted) and sparse/, as COLMAP and the verb scene write it;
        transparent pixels and what is black in masks/ are taken out; a soup's scene is read as the run's
        record beside the soup (../runs) has it, unless the next options are given
    downscale F: make the photographs smaller by this factor
    background COLOUR: white, black, mean (of the photographs) or #rrggbb: the colour where nothing is, as
        the sky (default: the scene's, else white)
    holdout RULE: views to judge by: K (every K-th), none, names (a.jpg,b.jpg), or auto: one of about eight,
        the one that its neighbours surround most closely, since a walk's extreme views show little
        (default: auto; every 8th for scenes of the verb scene)
    """

    scene: Source | None = None
    downscale: float | None = None
    background: str | None = None
    holdout: str | None = None

    @property
    def reading(self) -> dict[str, Any]:
        """{setting: value} of the reading options that were given. Raises WrongUsage for such options without
        --scene, or out of range."""
        said = {name: value for name in READING if (value := getattr(self, name)) is not None}
        if self.scene is None and said:
            raise WrongUsage(f"--{' and --'.join(said)} without --scene DIR; give the scene's folder too")
        with usage_checked():
            with_changes(GivenConfig(), said)
        return said

    def reading_of_run(self, soup: Path) -> dict[str, Any]:
        """Return `reading`; what was not given is taken from the run's record, where there is one.

        The record of soups/NAME.npz is runs/NAME.json beside it. One line on stderr names what is taken, or
        that the record is of another scene, of which nothing is taken. Raises InputError also for a damaged
        record.
        """
        said = self.reading
        file = run_record(soup)
        if self.scene is None or not file.is_file():
            return said
        from paper_artifact.record.store import config_of, read_record
        from paper_artifact.scene.folder import scene_digest, scene_root

        given = config_of(read_record(file)).given
        if given is None:
            return said
        of_run = {name: getattr(given, name) for name in READING if name not in said}
        taken = {name: value for name, value in of_run.items() if value != getattr(GivenConfig(), name)}
        if not taken:
            return said
        words = " ".join(f"--{name} {shown(value)}" for name, value in taken.items())
        if given.digest != scene_digest(scene_root(self.scene)):
            print(f"{file} is of another scene than {self.scene}: its {words} not taken", file=sys.stderr)
            return said
        print(f"{words}, as the run was trained ({file}); give others to change that", file=sys.stderr)
        return said | taken


@dataclass(frozen=True, kw_only=True)
class OwnSceneOptions(ReadingOptions):
    """A scene to train on, and what the loss acts towards.

    target MESH|bundle.json: what C1 and C2 act towards: a mesh in the scene's own frame, which is also
        evaluated against, or a bundle of the verb audit in the scene's unit of length
    """

    target: Source | None = None

    @property
    def given(self) -> GivenConfig | None:
        """The scene of one's own, None without --scene. Raises WrongUsage for its options without it."""
        said = self.reading
        if self.scene is None and self.target is not None:
            raise WrongUsage("--target belongs to --scene DIR: a shape or mesh is its own target")
        return None if self.scene is None else with_changes(GivenConfig(target=self.target), said)
