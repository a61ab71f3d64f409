"""The final soups of the study beside their ground truth, one page a shape (`export.viewer`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from paper_artifact import results
from paper_artifact.audit.marks import light_mesh
from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.export.models import mesh_triangles, soup_triangles
from paper_artifact.export.viewer import shape_viewpoint, write_html
from paper_artifact.mesh import FEATURES
from paper_artifact.scene.shapes import surface
from paper_artifact.soup.state import load_soup

SEED = 0  # whose soups are committed
MOST = 40_000  # triangles of a ground truth in a page


@dataclass(frozen=True)
class View:
    """One page of soups."""

    shape: str
    file: str  # its name in the book's folder soups/
    arms: tuple[str, ...]  # "C1, 1 of 1 voids, tail .0071", in the order of the page
    note: str  # what is missing, "" for nothing


def write_views(tables: results.Results, runs: pd.DataFrame, folder: Path) -> list[View]:
    """Write a page for every shape of `runs` that has a soup of seed 0, and return them in the order of the
    catalogue. Where the ground truth is not available, the page shows the soups alone."""
    made = []
    for shape, own in runs[runs["seed"] == SEED].groupby("shape", observed=True):
        kept = own[own["run"].map(lambda run: tables.soup_path(run).is_file())].sort_values("condition")
        if not len(kept):
            continue
        parts, lines, note = {}, [], ""
        try:
            truth = surface(shape)
            parts["ground truth"] = mesh_triangles(light_mesh(truth, MOST))
            if len(truth.faces) > MOST:
                note = f"The ground truth has {len(truth.faces)} triangles; a coarser copy is shown."
        except InputError as error:
            note = f"The ground truth is not shown: {error}."
        for run in kept.itertuples():
            name = f"{run.condition}, {run.count:.0f} of {run.expected:.0f} {FEATURES[run.dimension][1]}"
            parts[name] = soup_triangles(load_soup(tables.soup_path(run.run)))
            lines.append(f"{name}, tail {run.tail:.4f}")
        missing = sorted(set(own["condition"]) - set(kept["condition"]))
        note += f" No soup of {', '.join(missing)} is kept." if missing else ""
        points = np.concatenate([each.visible().vertices.reshape(-1, 3) for each in parts.values()])
        row = shape_row(shape)
        view = None if row is None else shape_viewpoint(row, points)
        write_html(folder / f"{shape}.html", parts, shape, view, ("../soups.html", "← the book"))
        made.append(View(str(shape), f"{shape}.html", tuple(lines), note.strip()))
    return made
