"""Notebook 09: the gallery (Fig. 1, Fig. S8, the group wave's figure): ground truth and final soups, each
with its measured count.

The soups of seed 0 are committed (`results/soups/`), so the pictures are drawn, and the counts measured
again, from the very triangles that the records speak of.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_artifact.catalogue import colour_of, shape_row
from paper_artifact.evaluate.diagram import diagram_of, significant_counts
from paper_artifact.evaluate.scores import SAMPLES, soup_samples
from paper_artifact.export.flat import render_flat
from paper_artifact.export.models import THRESHOLD, soup_triangles
from paper_artifact.plot import PAGE, new_figure
from paper_artifact.randomness import stream
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import image_axis
from paper_artifact.report.kit.records import Collected, soup_path
from paper_artifact.report.kit.text import NOT_RECORDED, blank
from paper_artifact.scene.shapes import surface
from paper_artifact.soup.state import Soup, load_soup
from paper_artifact.study.verdict import LOSS
from paper_artifact.topology.floor import measurement_floor

WRONG = "#a63c00"  # fill of the badge of a wrong count


def soup_of(collected: Collected, shape: str, condition: str, seed: int = 0) -> tuple[dict, Soup] | None:
    """Return (record, its final soup), or None where the run is not recorded or its soup is not kept."""
    for record in collected.of(shape, condition, seed):
        path = soup_path(record, collected.results)
        if path.is_file():
            return record, load_soup(path)
    return None


def soup_picture(soup: Soup, shape: str, size: int = 200) -> np.ndarray:
    """Return the soup (size,size,3) in one material, without the triangles of mean opacity below one half,
    framed like its ground truth."""
    corners = soup_triangles(soup).visible(THRESHOLD).vertices
    faces, frame = np.arange(3 * len(corners)).reshape(-1, 3), surface(shape).vertices
    row = shape_row(shape)
    return render_flat(corners.reshape(-1, 3), faces, size, direction=row.view, up=row.up, frame=frame)


def gallery_figure(
    collected: Collected,
    shapes: Sequence[str],
    conditions: Sequence[str] = (),
    seed: int = 0,
    size: int = 240,
) -> Figure:
    """Return one row per shape: ground truth and the soup of every condition (default: all); badge: how
    many bars are significant in the judged dimension, on the ground truth the expected number, on a soup the
    measured one (last step, 20,000 samples), filled orange where it is not that."""
    conditions, runs = list(conditions) or frames.conditions(collected), frames.runs(collected)
    figure, axes = new_figure(len(shapes), 1 + len(conditions), PAGE / 4, PAGE / 4)
    for shape, (first, *others) in zip(shapes, axes, strict=True):
        row, mesh, expected = shape_row(shape), surface(shape), runs[runs["shape"] == shape]["expected"].max()
        truth = render_flat(mesh.vertices, mesh.faces, size, direction=row.view, up=row.up)
        image_axis(first, truth, "ground truth")
        first.set_ylabel(f"{shape}, H{row.judged}")
        if pd.notna(expected):
            _badge(first, int(expected), True)
        for condition, axis in zip(conditions, others, strict=True):
            found = soup_of(collected, shape, condition, seed)
            if found is None:
                image_axis(axis, np.ones((size, size, 3)), f"{condition}: {NOT_RECORDED}")
                continue
            record, soup = found
            count = record["tails"]["counts"][row.judged]
            image_axis(axis, soup_picture(soup, shape, size), condition)
            _badge(axis, count, count == expected)
    return figure


def gallery_table(
    collected: Collected, shapes: Sequence[str], conditions: Sequence[str] = (), seed: int = 0
) -> pd.DataFrame:
    """Return the gallery's numbers: per shape and condition the expected count, the record's, the count
    measured again on the soup that is shown (same samples), the seeds whose count is right, tail and
    Chamfer (%)."""
    runs, rows = frames.runs(collected).set_index(frames.ARM).sort_index(), {}
    for shape, condition in product(shapes, conditions or frames.conditions(collected)):
        found = soup_of(collected, shape, condition, seed)
        rows[shape, condition] = {"record": NOT_RECORDED}
        if found is None:
            continue
        own = runs.loc[[(shape, condition)]]
        run = next(own[own["seed"] == seed].itertuples())
        rows[shape, condition] = {
            "dimension": f"H{run.dimension}",
            "expected": run.expected,
            "record": str(run.count),
            "soup": str(_counts(*found)[run.dimension]),
            "right in seeds": f"{(own['count'] == own['expected']).sum()} of {len(own)}",
            "tail": f"{run.tail:.4f}",
            "Chamfer %": f"{100 * run.chamfer:.3f}",
        }
    return blank(pd.DataFrame.from_dict(rows, orient="index").rename_axis(["shape", "arm"]))


def _counts(record: dict, soup: Soup) -> tuple[int, int, int]:
    """Significant counts of the soup by the evaluation's own samples of the last step."""
    step, diagonal = record["dumps"][-1]["step"], record["mesh"]["diagonal"]
    generator = stream(record["config"]["seed"], "evaluation samples", step)
    samples = soup_samples(soup.vertices.detach().numpy(), soup.corner_opacity(), SAMPLES, generator)
    return significant_counts(diagram_of(samples, diagonal), measurement_floor(samples, diagonal))


def _badge(axis: Axes, count: int, right: bool) -> None:
    edge = colour_of(LOSS) if right else WRONG
    box = {"boxstyle": "round,pad=0.3", "linewidth": 1.4, "edgecolor": edge}
    axis.text(
        0.5,
        -0.03,
        f"# significant: {count}",
        transform=axis.transAxes,
        ha="center",
        va="top",
        color=edge if right else "white",
        bbox=box | {"facecolor": "white" if right else WRONG},
    )
