"""Bars that noise, outliers and gaps bear in SfM clouds, and what trimming, averaging and projecting change.

One row per shape, trouble, filter, M and dimension. noise: lifetime over the cloud's own floor of the longest
bar beyond the classes that the clean surface shows; wanted: of the shortest of these classes (empty where
there is none). Notebook 16 reads it. One minute of CPU.
"""

from collections.abc import Callable, Iterator

from common import options, write

import numpy as np
import pandas as pd

from paper_artifact.alpha import alpha_persistence
from paper_artifact.catalogue import shape_row
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.build import Perturbation, SceneConfig, perturbed_cloud
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.topology.loss import smoothed
from paper_artifact.topology.statement import cleaned, trimmed

SHAPES = ("sphere", "torus", "two_spheres", "double_torus", "bob")  # they have no class but the stated ones
SAMPLES = (2048, 8192)
TROUBLES = {
    "clean": Perturbation(),
    "noise .25 %": Perturbation(cloud_noise=0.0025),
    "noise .75 %": Perturbation(cloud_noise=0.0075),
    "outliers 5 %": Perturbation(cloud_outliers=0.05),
    "noise .75 %, outliers 5 %": Perturbation(cloud_noise=0.0075, cloud_outliers=0.05),
    "20 % missing": Perturbation(cloud_missing=0.2),
    "all three": Perturbation(cloud_noise=0.0075, cloud_outliers=0.05, cloud_missing=0.2),
}
FILTERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as it is": lambda points: points,
    "trimmed": trimmed,
    "trimmed, averaged": lambda points: smoothed(trimmed(points)),
    "trimmed, projected": cleaned,
}


def rows_of(shape: str) -> Iterator[dict]:
    """Yield the rows of one shape."""
    mesh, row = find_mesh(shape), shape_row(shape)
    count = SceneConfig().points
    clean = sample_surface(mesh.vertices, mesh.faces, count, stream(0, "sfm cloud"))[0]
    for trouble, perturbation in TROUBLES.items():
        dirty, _ = perturbed_cloud(clean, clean, perturbation, mesh.diagonal)
        for name, chosen in FILTERS.items():
            points = chosen(dirty)
            for size in SAMPLES:
                own = points[stream(0, "density", size).permutation(len(points))[:size]]
                for dimension, margins in enumerate(margins_of(own)):
                    wanted = row.features[dimension]
                    key = {"shape": shape, "trouble": trouble, "filter": name, "M": size}
                    found = {"noise": margins[wanted], "wanted": margins[wanted - 1] if wanted else np.nan}
                    yield key | {"dimension": dimension} | found


def margins_of(points: np.ndarray) -> list[np.ndarray]:
    """Return, per dimension, the lifetimes over the floor, longest first, with zeros behind them."""
    floor = measurement_floor(points, 1.0)
    pairs = alpha_persistence(points)
    return [np.pad(np.sort(each.deaths - each.births)[::-1] / floor, (0, 9)) for each in pairs]


if __name__ == "__main__":
    folder = options(__doc__).out
    write(pd.DataFrame([row for shape in SHAPES for row in rows_of(shape)]), folder / "dirty.csv")
