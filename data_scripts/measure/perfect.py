"""The score of a perfect surface: the ground truth sampled again, held against the target, 20 seeds.

One row per shape and seed: bottleneck distances h0, h1, h2 (radius / D), the count of significant bars in the
judged dimension, Chamfer / D. Notebook 14 reads it. Some minutes of CPU.
"""

from common import options, write

import pandas as pd

from paper_artifact.catalogue import SHAPES
from paper_artifact.evaluate.scores import evaluate_samples, make_target
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface

SEEDS = range(20)


def rows_of(shape: str, seeds: range = SEEDS) -> list[dict]:
    """Return the rows of one shape."""
    mesh, target = surface(shape), make_target(surface(shape))
    rows = []
    for seed in seeds:
        generator = stream(seed, "perfect surface")
        points = sample_surface(mesh.vertices, mesh.faces, len(target.samples), generator)[0]
        found = evaluate_samples(points, target)
        row = {"shape": shape, "seed": seed}
        row |= {f"h{dimension}": value for dimension, value in enumerate(found["bottleneck"])}
        rows.append(row | {"count": found["counts"][target.dimension], "chamfer": found["chamfer"]})
    return rows


if __name__ == "__main__":
    folder = options(__doc__).out
    write(pd.DataFrame([row for shape in SHAPES for row in rows_of(shape.name)]), folder / "perfect.csv")
