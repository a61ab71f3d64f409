"""Notebook 16: bars that noise bears in dirty SfM clouds, and what trimming, averaging, projecting change.

A margin is a lifetime over the cloud's own floor. "Noise-born" is the longest bar beyond the classes that the
clean surface shows; what is not cleaned away must stay below the guard (.5) to be told from a wanted class.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.catalogue import shape_row
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.build import SceneConfig
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.perturb import Perturbation, perturbed_cloud
from paper_artifact.topology.aims import smoothed
from paper_artifact.topology.clean import cleaned, trimmed
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.topology.statement import NOISE_LEVEL

SHAPES = ("sphere", "torus", "two_spheres", "double_torus", "bob")  # that have no class but the stated ones
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


def measure_dirty(
    shapes: Sequence[str] = SHAPES,
    samples: Sequence[int] = SAMPLES,
    progress: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """Return per shape, trouble, filter, M and dimension: the noise-born margin, and the weakest wanted one
    (NaN where none is wanted); one minute of CPU."""
    rows = []
    for shape in shapes:
        mesh, row = find_mesh(shape), shape_row(shape)
        assert row is not None
        count = SceneConfig().points
        clean = sample_surface(mesh.vertices, mesh.faces, count, stream(0, "sfm cloud"))[0]
        for trouble, perturbation in TROUBLES.items():
            dirty, _ = perturbed_cloud(clean, clean, perturbation, mesh.diagonal)
            for name, chosen in FILTERS.items():
                points = chosen(dirty)
                for size in samples:
                    margins = _margins(points[stream(0, "density", size).permutation(len(points))[:size]])
                    for dimension, own in enumerate(margins):
                        wanted = row.features[dimension]
                        rows.append(
                            {
                                "shape": shape,
                                "trouble": trouble,
                                "filter": name,
                                "M": size,
                                "dimension": dimension,
                                "noise": own[wanted],
                                "wanted": own[wanted - 1] if wanted else np.nan,
                            }
                        )
            if progress is not None:
                progress(f"{shape}: {trouble}")
    return pd.DataFrame(rows)


def dirty_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return per trouble and filter the longest noise-born margin over all shapes, per dimension and M."""
    table = stored.pivot_table(
        index=["trouble", "filter"], columns=["M", "dimension"], values="noise", aggfunc="max", sort=False
    )
    table.columns = [f"H{dimension}, M = {size}" for size, dimension in table.columns]
    return table.round(2)


def dirty_text(stored: pd.DataFrame) -> str:
    """Return per filter under which troubles every noise-born bar stays below the guard, and by how much the
    weakest wanted class falls on average against the clean cloud (1: not at all)."""
    keys, lines = ["shape", "M", "dimension"], []
    clean = stored[(stored["trouble"] == "clean") & (stored["filter"] == "as it is")].set_index(keys)[
        "wanted"
    ]
    for name, own in stored.groupby("filter", sort=False):
        longest = own.groupby("trouble", sort=False)["noise"].max()
        safe = [trouble for trouble in longest.index if longest[trouble] <= NOISE_LEVEL]
        noisy = own[own["trouble"].isin(("noise .75 %", "noise .75 %, outliers 5 %"))].set_index(keys)[
            "wanted"
        ]
        kept = (noisy / clean.reindex(noisy.index)).mean()
        lines.append(
            f"{name}: noise-born bars below {NOISE_LEVEL:g} of the floor under {'; '.join(safe) or 'none'}; "
            f"wanted classes keep {kept:.2f} of their margin under noise of .75 %"
        )
    return "\n".join(lines)


def _margins(points: np.ndarray) -> list[np.ndarray]:
    """Return, per dimension, the lifetimes over the floor, longest first, with zeros behind them."""
    floor = measurement_floor(points, 1.0)
    pairs = alpha_persistence(points)
    return [np.pad(np.sort(each.deaths - each.births)[::-1] / floor, (0, 9)) for each in pairs]
