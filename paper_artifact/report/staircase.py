"""Density staircases: which bars of a clean surface clear the measurement floor 6·r_med(M) at which sampling density (App. B, §6).

Bars, lifetimes and floors are radii divided by the surface's bounding-box diagonal; a margin is a lifetime divided by the floor.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from paper_artifact.evaluate.diagram import Diagram, diagram_of, lifetimes
from paper_artifact.mesh import Mesh, face_areas
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.topology.floor import measurement_floor, uniform_spacing

MULTIPLIER = 6.0
KEPT = 4  # longest bars kept per dimension: no surface of the study has more classes than that


def measure(mesh: Mesh, samples: int, seed: int) -> tuple[Diagram, float]:
    """Return (diagram, floor) of `samples` area-weighted points of the mesh, exactly the bundle's points for this seed."""
    points = sample_surface(mesh.vertices, mesh.faces, samples, stream(seed, "bundle-samples"))[0]
    return diagram_of(points, mesh.diagonal), measurement_floor(points, mesh.diagonal, MULTIPLIER)


def longest(bars: np.ndarray, count: int = KEPT) -> np.ndarray:
    """Return the `count` longest lifetimes of the bars (k,2), longest first, filled up with 0."""
    lengths = np.sort(lifetimes(bars))[::-1][:count]
    return np.pad(lengths, (0, count - len(lengths)))


def staircase(mesh: Mesh, densities: Iterable[int], seeds: Iterable[int]) -> pd.DataFrame:
    """Return one line per density and seed: shape, samples, seed, floor, law (the closed form's floor for a uniform sample), and
    h0_1 … h2_4, the longest lifetimes per dimension."""
    area = float(face_areas(mesh.vertices, mesh.faces).sum())
    rows = []
    for samples in densities:
        law = MULTIPLIER * uniform_spacing(area, samples) / mesh.diagonal
        for seed in seeds:
            diagram, floor = measure(mesh, samples, seed)
            row = {"shape": mesh.name, "samples": samples, "seed": seed, "floor": floor, "law": law}
            for dimension in range(3):
                row |= {f"h{dimension}_{rank + 1}": value for rank, value in enumerate(longest(diagram[dimension]))}
            rows.append(row)
    return pd.DataFrame(rows)


def counts(table: pd.DataFrame, dimension: int, multiplier: float = MULTIPLIER) -> pd.Series:
    """Return the number of significant bars per line of a staircase (at most KEPT), for the floor multiplier·r_med."""
    lengths = table[[f"h{dimension}_{rank}" for rank in range(1, KEPT + 1)]].to_numpy()
    return pd.Series((lengths > table["floor"].to_numpy()[:, None] * multiplier / MULTIPLIER).sum(axis=1), index=table.index)


def signature_table(table: pd.DataFrame, columns: Sequence[str] = ("samples",)) -> pd.DataFrame:
    """Return per shape and density the significant counts (H0 with its infinite bar, H1, H2) of every seed, seeds that agree written once."""
    signs = [f"({1 + a},{b},{c})" for a, b, c in zip(counts(table, 0), counts(table, 1), counts(table, 2))]
    rows = table[["shape", *columns]].assign(signature=signs)
    grouped = rows.groupby(["shape", *columns], sort=False)["signature"]
    return grouped.agg(lambda s: s.iloc[0] if s.nunique() == 1 else " ".join(f"{n}×{k}" for k, n in s.value_counts(sort=False).items())).unstack("samples")


@lru_cache(maxsize=None)
def _surface(shape: str) -> Mesh:
    from paper_artifact.train.run import find_mesh

    return find_mesh(shape)


def second_void_table(shape: str, densities: Iterable[int] = (2048, 4096, 8192, 20_000), seed: int = 0) -> pd.DataFrame:
    """Return the two longest H2 bars of a clean surface against the density: significant count, margins (lifetime / floor), and half the
    second bar's lifetime, which is what leaving it unmatched costs in bottleneck distance."""
    table = staircase(_surface(shape), densities, (seed,))
    return pd.DataFrame({"samples": table["samples"], "significant H2": counts(table, 2), "first bar / floor": (table["h2_1"] / table["floor"]).round(2),
                         "second bar / floor": (table["h2_2"] / table["floor"]).round(2), "half first bar": (table["h2_1"] / 2).round(4),
                         "half second bar": (table["h2_2"] / 2).round(4)}).set_index("samples")
