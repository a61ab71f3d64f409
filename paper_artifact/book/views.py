"""The final soups of the study beside their ground truth, each shape a page of its own (`export.viewer`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from paper_artifact.audit.view import light_mesh
from paper_artifact.book.front import ARMS, main_runs
from paper_artifact.book.sources import Sources
from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.export.triangles import mesh_triangles, soup_triangles
from paper_artifact.export.viewer import write_html
from paper_artifact.export.viewpoint import shape_viewpoint
from paper_artifact.report.gallery import soup_of
from paper_artifact.report.kit import frames
from paper_artifact.scene.find import surface

SEED = 0  # whose soups are committed
MOST = 40_000  # triangles of a ground truth in a page
DIMENSIONS = ("components", "loops", "voids")


@dataclass(frozen=True)
class View:
    """One page of soups."""

    shape: str
    file: str  # its name in the book's folder soups/
    runs: tuple[str, ...]  # the names of the soups' records
    arms: tuple[str, ...]  # "C1: tail .0071, 1 of 1 voids", in the order of the page
    note: str  # what is missing, "" for nothing


def write_views(sources: Sources, folder: Path) -> list[View]:
    """Write a page for every shape that has a committed soup of seed 0 under C0, C1 or C2, and return them in
    the catalogue's order. Where the ground truth cannot be had the page shows the soups alone."""
    collected, made = main_runs(sources), []
    runs = frames.runs(collected).set_index([*frames.ARM, "seed"])
    for shape in frames.shapes(collected):
        found = [soup_of(collected, shape, arm, SEED) for arm in ARMS]
        if not any(found):
            continue
        parts, arms, names, note, row = {}, [], [], "", shape_row(shape)
        try:
            truth = surface(shape)
            parts["ground truth"] = mesh_triangles(light_mesh(truth, MOST))
            if len(truth.faces) > MOST:
                note = f"The ground truth has {len(truth.faces)} triangles; a coarser copy is shown."
        except InputError as error:
            note = f"The ground truth is not shown: {error}."
        for arm, each in zip(ARMS, found, strict=True):
            if each is None:
                note += f" No soup of {arm} is kept."
                continue
            run = runs.loc[(shape, arm, SEED)]
            name = f"{arm}, {run['count']:.0f} of {run['expected']:.0f} {DIMENSIONS[int(run['dimension'])]}"
            parts[name] = soup_triangles(each[1])
            arms.append(f"{name}, tail {run['tail']:.4f}")
            names.append(f"{shape}-{arm}-s{SEED}")
        points = np.concatenate([each.visible().vertices.reshape(-1, 3) for each in parts.values()])
        back = ("../soups.html", "← the book")
        write_html(folder / f"{shape}.html", parts, shape, shape_viewpoint(row, points), back)
        made.append(View(shape, f"{shape}.html", tuple(names), tuple(arms), note.strip()))
    return made
