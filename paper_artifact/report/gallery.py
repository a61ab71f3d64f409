"""The gallery (Fig. 1, Fig. S8 and the group wave's figure): ground truth and the final soups under C0, C2, C1, every cell with
the significant count that is measured on it.

The soups of seed 0 are committed (`results/soups/`), so the pictures are drawn, and the counts measured again, from the very
triangles that the records speak of.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row
from paper_artifact.evaluate.diagram import diagram_of, significant_counts
from paper_artifact.evaluate.scores import SAMPLES, soup_samples
from paper_artifact.export.triangles import THRESHOLD, soup_triangles
from paper_artifact.files import RESULTS
from paper_artifact.randomness import stream
from paper_artifact.report.figures import new_figure
from paper_artifact.report.generality import SHAPES, expected_count
from paper_artifact.report.render import render_flat
from paper_artifact.report.runs import RETRAINED, Collected, soup_path
from paper_artifact.scene.find import surface
from paper_artifact.soup.state import Soup, load_soup
from paper_artifact.topology.floor import measurement_floor

ARMS = ("C0", "C2", "C1")  # the paper's order of columns
BLUE, ORANGE = "#1f5fbf", "#e67e22"
# From the object towards the camera, and upwards in the image (world axes): y is up in most of the files.
VIEWS = {
    "bob": ((0.8, 1.3, 0.8), (0, 1, 0)),
    "rocker-arm": ((1.0, 0.2, 0.6), (0, 1, 0)),
    "eight": ((0.3, 1.0, 0.4), (0, 0, 1)),
    "spot": ((0.9, 0.5, -1.3), (0, 1, 0)),
    "fandisk": ((0.9, -0.9, 0.8), (0, 0, 1)),
    "pot": ((0.9, -1.3, 0.9), (0, 0, 1)),
    "armadillo": ((0.3, 0.2, -1.3), (0, 1, 0)),
    "horse": ((1.3, -0.6, 0.3), (0, 0, 1)),
}


def soup_of(
    collected: Collected, shape: str, condition: str, seed: int = 0, profile: str = "recorded"
) -> tuple[dict, Soup] | None:
    """Return (record, its final soup), or None where the run is not recorded or its soup is not kept."""
    for record in collected.of(shape, condition):
        path = soup_path(record, RETRAINED if profile == "full" else RESULTS)
        if record["config"]["seed"] == seed and Path(path).is_file():
            return record, load_soup(path)
    return None


def soup_picture(soup: Soup, shape: str, size: int = 200) -> np.ndarray:
    """Return the soup (size,size,3) in one material, without the triangles of mean opacity below one half, framed like its
    ground truth."""
    corners = soup_triangles(soup).visible(THRESHOLD).vertices
    direction, up = VIEWS[shape]
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return render_flat(
        corners.reshape(-1, 3), faces, size, direction=direction, up=up, frame=surface(shape).vertices
    )


def gallery_figure(
    collected: Collected,
    shapes: Sequence[str] = SHAPES,
    seed: int = 0,
    profile: str = "recorded",
    size: int = 200,
) -> Figure:
    """Return one row per shape: ground truth, C0, C2, C1; badge: measured count in the discriminating dimension at step 2500
    (20,000 samples), blue outline where it is the bundle's, filled orange where it is not."""
    figure, axes = new_figure(len(shapes), 1 + len(ARMS), 1.9, 1.9)
    for shape, line in zip(shapes, axes, strict=True):
        dimension, expected = shape_row(shape).judged, expected_count(shape)
        direction, up = VIEWS[shape]
        mesh = surface(shape)
        _show(
            line[0], render_flat(mesh.vertices, mesh.faces, size, direction=direction, up=up), "ground truth"
        )
        line[0].set_ylabel(f"{shape} (H{dimension})", fontsize=8)
        _badge(line[0], dimension, expected, True)
        for condition, axis in zip(ARMS, line[1:], strict=True):
            found = soup_of(collected, shape, condition, seed, profile)
            if found is None:
                _show(axis, np.ones((size, size, 3)), f"{condition}: not recorded")
                continue
            record, soup = found
            count = record["tails"]["counts"][dimension]
            _show(axis, soup_picture(soup, shape, size), condition)
            _badge(axis, dimension, count, count == expected)
    return figure


def gallery_table(
    collected: Collected, shapes: Sequence[str] = SHAPES, seed: int = 0, profile: str = "recorded"
) -> pd.DataFrame:
    """Return the gallery's numbers: per shape and arm the expected count, the record's, the count measured again on the soup that
    is shown (same samples), the seeds whose count is right, tail and Chamfer (%)."""
    rows = []
    for shape in shapes:
        dimension, expected = shape_row(shape).judged, expected_count(shape)
        for condition in ARMS:
            found = soup_of(collected, shape, condition, seed, profile)
            every = [record["tails"]["counts"][dimension] for record in collected.of(shape, condition)]
            row = {"shape": shape, "arm": condition, "dimension": f"H{dimension}", "expected": expected}
            if found is None:
                rows.append(row | {"record": "not recorded"})
                continue
            record, soup = found
            rows.append(
                row
                | {
                    "record": str(record["tails"]["counts"][dimension]),
                    "soup": str(_counts(record, soup)[dimension]),
                    "right in seeds": f"{sum(count == expected for count in every)} of {len(every)}",
                    "tail": f"{record['tails']['bottleneck'][dimension]:.4f}",
                    "Chamfer %": f"{100 * record['tails']['chamfer']:.3f}",
                }
            )
    return pd.DataFrame(rows).set_index(["shape", "arm"]).fillna("")


def _counts(record: dict, soup: Soup) -> tuple[int, int, int]:
    """Significant counts of the soup by the evaluation's own samples of the last step."""
    step, diagonal = record["dumps"][-1]["step"], record["mesh"]["diagonal"]
    generator = stream(record["config"]["seed"], "evaluation samples", step)
    samples = soup_samples(soup.vertices.detach().numpy(), soup.corner_opacity(), SAMPLES, generator)
    return significant_counts(diagram_of(samples, diagonal), measurement_floor(samples, diagonal))


def _show(axis: Axes, image: np.ndarray, title: str) -> None:
    axis.imshow(np.clip(image, 0, 1), interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    axis.set_title(title, fontsize=8)
    for side in axis.spines.values():
        side.set_visible(False)


def _badge(axis: Axes, dimension: int, count: int, right: bool) -> None:
    style = {"facecolor": "white", "edgecolor": BLUE} if right else {"facecolor": ORANGE, "edgecolor": ORANGE}
    axis.text(
        0.97,
        0.04,
        f"$\\beta_{dimension}$ = {count}",
        transform=axis.transAxes,
        fontsize=8,
        ha="right",
        color=BLUE if right else "white",
        bbox={"boxstyle": "round,pad=0.3", "linewidth": 1.4} | style,
    )
