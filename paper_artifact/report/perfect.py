"""Notebook 14: what a perfect surface scores: the ground truth sampled again, compared with the target as a
reconstruction is. No tail can be expected below it, and one of its size has no error left that is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pandas as pd

from paper_artifact.catalogue import SHAPES, shape_row
from paper_artifact.evaluate.scores import evaluate_samples
from paper_artifact.randomness import stream
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.records import Collected, target_of
from paper_artifact.report.kit.text import short, span
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface
from paper_artifact.study.verdict import BASELINE, LOSS

SEEDS = range(20)


def perfect_scores(shapes: Iterable[str], seeds: Iterable[int] = SEEDS) -> pd.DataFrame:
    """Return one row per shape and seed: shape, seed, h0, h1, h2 (bottleneck distances to the target, radius
    / D), count (significant bars in the judged dimension) and chamfer (/ D), of as many area-weighted samples
    of the clean surface as the target has."""
    rows, seeds = [], tuple(seeds)
    for shape in shapes:
        mesh, target = surface(shape), target_of(shape)
        for seed in seeds:
            generator = stream(seed, "perfect surface")
            samples = sample_surface(mesh.vertices, mesh.faces, len(target.samples), generator)[0]
            found = evaluate_samples(samples, target)
            distances = {f"h{dimension}": value for dimension, value in enumerate(found["bottleneck"])}
            count = found["counts"][target.dimension]
            rows.append(
                {"shape": shape, "seed": seed} | distances | {"count": count, "chamfer": found["chamfer"]}
            )
    return pd.DataFrame(rows)


def measure_perfect(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return `perfect_scores` of every shape of the catalogue; some minutes."""
    tables = []
    for row in SHAPES:
        tables.append(perfect_scores([row.name]))
        if progress is not None:
            progress(row.name)
    return pd.concat(tables, ignore_index=True)


def perfect_table(scores: pd.DataFrame, collected: Collected) -> pd.DataFrame:
    """Return per shape the perfect surface's bottleneck in the judged dimension (mean, least–largest over the
    seeds), our tails of C0 and C1 beside it, how many times the perfect one C1 is, and the paper's C1."""
    ours = frames.arms(collected).set_index(frames.ARM)["mean"]
    printed = frames.paper_arms().set_index(frames.ARM)["printed"]
    rows = {}
    for shape, own in scores.groupby("shape", sort=False):
        values = own[f"h{shape_row(shape).judged}"]
        row = {"perfect": short(values.mean()), "least–largest": span(values, 4)}
        for name in (BASELINE, LOSS):
            mean = ours.get((shape, name))
            row[name] = "" if pd.isna(mean) else short(mean)
        loss = ours.get((shape, LOSS))
        row[f"{LOSS} / perfect"] = "" if pd.isna(loss) else f"{loss / values.mean():.1f}"
        rows[shape] = row | {f"{LOSS}, paper": printed.get((shape, LOSS), "")}
    return pd.DataFrame.from_dict(rows, orient="index")
