"""The soup before training, judged like a dump: step 0 of the trajectories (notebooks 01, 06, 08, 12, 13).

It depends on shape and seed alone, so every arm that starts as the study does shares it; the records begin
at the first dump. Kept by `python -m paper_artifact measure starts`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any

import pandas as pd

from paper_artifact.catalogue import SHAPES, shape_row, study_config
from paper_artifact.evaluate.scores import evaluate_soup
from paper_artifact.files import RESULTS
from paper_artifact.pipeline import prepare_scene
from paper_artifact.report import measured
from paper_artifact.report.kit.records import target_of
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.train.backend import CpuBackend
from paper_artifact.train.loop import start_state

SEEDS = range(5)  # of the study
# Settings that make another start; the study has the same for all shapes, but for the budget in its row.
CLOUD = ("cloud_noise", "cloud_outliers", "cloud_missing")


def start_rows(shape: str, seeds: Iterable[int] = SEEDS) -> pd.DataFrame:
    """Return one row per seed of a shape's start: shape, seed, bottleneck (radius / D) and count in the
    judged dimension, chamfer (/ D, mean of both directions)."""
    target, rows = target_of(shape), []
    for seed in seeds:
        config = study_config(shape, seed=seed)
        scene = prepare_scene(config, find_mesh(shape), RESULTS / "scenes")
        soup = start_state(scene, config, CpuBackend(scene, scene.train)).soup
        corners = soup.vertices.detach().numpy()
        found = evaluate_soup(corners, soup.corner_opacity(), target, seed)
        row = {"shape": shape, "seed": seed, "bottleneck": found["bottleneck"][target.dimension]}
        rows.append(row | {"count": found["counts"][target.dimension], "chamfer": found["chamfer"]})
    return pd.DataFrame(rows)


def measure_starts(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return `start_rows` of every shape of the catalogue; two minutes of CPU."""
    tables = []
    for row in SHAPES:
        tables.append(start_rows(row.name))
        if progress is not None:
            progress(row.name)
    return pd.concat(tables, ignore_index=True)


@cache
def stored_starts() -> Mapping[tuple[str, int], Mapping[str, float]]:
    """Return {(shape, seed): the stored row's bottleneck, count and chamfer}; empty where none is stored."""
    table = measured.find("starts")
    return {} if table.empty else table.set_index(["shape", "seed"]).to_dict("index")


def start_of(config: Mapping[str, Any]) -> Mapping[str, float] | None:
    """Return the stored start of a record's configuration; None where it starts otherwise than the study
    does, or none is stored."""
    row, usual = shape_row(config["shape"]), study_config(config["shape"])
    allocation = config.get("allocation") or {}
    other = (
        row is None
        or config["budget"] != usual.budget
        or config["initial_ratio"] != usual.initial_ratio
        or allocation.get("levers") == "start"
        or any(config.get(name) for name in CLOUD)
    )
    return None if other else stored_starts().get((config["shape"], config["seed"]))
