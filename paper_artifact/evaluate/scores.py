"""Targets and dumps: one reconstruction measured against one ground truth (paper §4, "Metrics and verdict").

A target is 20,000 area-weighted samples of the ground-truth mesh with their diagram; a dump is the same
number of α×area-weighted samples of a soup (or any samples) compared with it. Everything in a dump is
dimensionless: lengths are divided by the ground truth's bounding-box diagonal, births and deaths are radii.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import Diagram, bottlenecks, diagram_of, longest_bars, significant_counts
from paper_artifact.evaluate.geometry import point_distances
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_soup, sample_surface
from paper_artifact.topology.floor import measurement_floor

SAMPLES = 20_000
TAIL_DUMPS = 3  # a tail is the mean of the last dumps (paper §4)
DIGITS = 7  # significant digits kept in a dump: far below sampling noise, and a record stays small


@dataclass(frozen=True, eq=False)
class Target:
    """A ground truth as the metrics see it."""

    name: str  # of the mesh
    samples: np.ndarray  # (n,3) float64 points of the surface, world units
    diagonal: float  # of the bounding box, world units
    diagram: Diagram  # finite bars of the samples per dimension, radius / diagonal
    floor: float  # 6·r_med / diagonal of the samples
    dimension: int  # the judged one: 0, 1 or 2
    seed: int  # of the samples

    @property
    def counts(self) -> tuple[int, int, int]:
        """The numbers of significant finite bars per dimension."""
        return significant_counts(self.diagram, self.floor)


def make_target(mesh: Mesh, count: int = SAMPLES, seed: int = 0, dimension: int | None = None) -> Target:
    """Return the Target of `mesh` from `count` area-weighted samples drawn with `seed`.

    dimension: the judged one; None takes the study's for its shapes, else `discriminating_dimension`'s rule.
    Raises InputError for a dimension outside 0..2 or a mesh that cannot be sampled.
    """
    if dimension not in (None, 0, 1, 2):
        raise InputError(f"the discriminating dimension must be 0, 1 or 2, got {dimension}")
    samples = sample_surface(mesh.vertices, mesh.faces, count, stream(seed, "target samples"))[0]
    diagram, floor = diagram_of(samples, mesh.diagonal), measurement_floor(samples, mesh.diagonal)
    if dimension is None:
        row = shape_row(mesh.name)
        dimension = (
            row.judged if row else discriminating_dimension(mesh.betti, significant_counts(diagram, floor))
        )
    return Target(mesh.name, samples, mesh.diagonal, diagram, floor, dimension, seed)


def discriminating_dimension(betti: Sequence[int] | None, counts: Sequence[int]) -> int:
    """Return the dimension to judge a shape in that is none of the study's: components, loops, then voids.

    betti: (b0, b1, b2) where known, else None, and the significant finite `counts` of its samples decide.
    """
    components, loops = (betti[0] - 1, betti[1]) if betti is not None else (counts[0], counts[1])
    return 0 if components > 0 else 1 if loops > 0 else 2


def soup_samples(
    vertices: np.ndarray, opacity: np.ndarray, count: int, generator: np.random.Generator
) -> np.ndarray:
    """Return the points (count,3) float64 of `sampling.sample_soup`; arguments and errors are the same."""
    return sample_soup(vertices, opacity, count, generator)[0]


def evaluate_samples(samples: np.ndarray, target: Target) -> dict:
    """Return how far `samples` (n,3) float, world units, are from `target`; to be fair, n is the target's.

    The dict is JSON-ready: "bottleneck" [3] (per dimension, finite bars), "counts" [3] (significant at the
    samples' own floor) and "floor", "counts_at_target_floor" [3], "chamfer", "chamfer_sum", "hausdorff95",
    "bars" (per dimension the longest [birth, death], at least 8 if there are, all longer than half the floor
    up to 24). Raises InputError as its parts do.
    """
    diagram = diagram_of(samples, target.diagonal)
    floor = measurement_floor(samples, target.diagonal)
    result = {
        "bottleneck": [_rounded(value) for value in bottlenecks(diagram, target.diagram)],
        "counts": list(significant_counts(diagram, floor)),
        "counts_at_target_floor": list(significant_counts(diagram, target.floor)),
        "floor": _rounded(floor),
        "bars": [[[_rounded(x) for x in bar] for bar in longest_bars(bars, floor)] for bars in diagram],
    }
    distances = point_distances(samples, target.samples, target.diagonal)
    return result | {name: _rounded(value) for name, value in distances.items()}


def evaluate_soup(
    vertices: np.ndarray, opacity: np.ndarray, target: Target, seed: int = 0, step: int = 0
) -> dict:
    """Return `evaluate_samples` of a soup, with "step"; vertices (T,3,3) world units, opacity (T,3) in [0,1].

    The samples are as many as the target's, drawn from the stream of (seed, step).
    """
    samples = soup_samples(vertices, opacity, len(target.samples), stream(seed, "evaluation samples", step))
    return {"step": int(step)} | evaluate_samples(samples, target)


def evaluate_alone(
    vertices: np.ndarray, opacity: np.ndarray, diagonal: float, count: int, seed: int = 0, step: int = 0
) -> dict:
    """Return what a soup shows without a ground truth: "step", "counts" [3], "floor", "bars" and "margins".

    As `evaluate_soup`, from `count` samples, with lengths divided by `diagonal` (world units), for example
    `frame_diagonal` of the SfM cloud. margins: per dimension the `bars`' lifetimes over the floor; a bar
    counts where its margin exceeds 1. Raises InputError as its parts do.
    """
    samples = soup_samples(vertices, opacity, count, stream(seed, "evaluation samples", step))
    diagram = diagram_of(samples, diagonal)
    floor = measurement_floor(samples, diagonal)
    longest = [longest_bars(bars, floor) for bars in diagram]
    return {
        "step": int(step),
        "counts": list(significant_counts(diagram, floor)),
        "floor": _rounded(floor),
        "bars": [[[_rounded(x) for x in bar] for bar in bars] for bars in longest],
        "margins": [[_rounded((death - birth) / floor) for birth, death in bars] for bars in longest],
    }


def tail(dumps: Sequence[Mapping], dimension: int, last: int = TAIL_DUMPS) -> float:
    """Return the mean bottleneck in `dimension` of the last dumps (2300, 2400, 2500 in the study; paper §4).

    Raises InputError for fewer than `last` dumps.
    """
    if len(dumps) < last:
        raise InputError(
            f"a tail is the mean of the last {last} dumps, but the run has {len(dumps)}; train it to the end"
        )
    chosen = sorted(dumps, key=lambda dump: dump["step"])[-last:]
    return float(np.mean([dump["bottleneck"][dimension] for dump in chosen]))


def tails(dumps: Sequence[Mapping], last: int = TAIL_DUMPS) -> dict:
    """Return the last dumps' "steps", mean "bottleneck" [3], "chamfer" and "hausdorff95", and last "counts"
    [3]; without a ground truth (`evaluate_alone`) the last "steps" and "counts" alone.

    Raises InputError for fewer than `last` dumps.
    """
    if dumps and "bottleneck" not in dumps[-1]:
        final = max(dumps, key=lambda dump: dump["step"])
        return {"steps": [final["step"]], "counts": list(final["counts"])}
    bottleneck = [_rounded(tail(dumps, dimension, last)) for dimension in range(3)]
    chosen = sorted(dumps, key=lambda dump: dump["step"])[-last:]
    means = {
        name: _rounded(float(np.mean([dump[name] for dump in chosen]))) for name in ("chamfer", "hausdorff95")
    }
    return {
        "steps": [dump["step"] for dump in chosen],
        "bottleneck": bottleneck,
        "counts": list(chosen[-1]["counts"]),
    } | means


def _rounded(value: float) -> float:
    return float(f"{float(value):.{DIGITS}g}")
