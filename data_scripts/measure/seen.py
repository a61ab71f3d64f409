"""What of a trained soup's topology the pictures show: all of its surface against what three views see.

    python data_scripts/measure/seen.py --table choose      # in how many views: five shapes, seed 0
    python data_scripts/measure/seen.py --table study       # the committed soups
    python data_scripts/measure/seen.py --table held_out    # the ten held-out shapes

One row per soup and number of views that must show a point (0: none, all of the surface, as everywhere else):
share of the points left, counts and bottleneck to the truth per dimension (radius / D) of 20,000 points
of the finished soup, Chamfer. `inside`: part of all points that lie deeper than .01 D in the body. Soups and
scenes are those in --runs (records of 0.3.0 for `choose`, `held_out.py`'s for `held_out`); four seconds of
CPU a row. seen_TABLE.csv; notebook 16 reads them.
"""

from __future__ import annotations

from pathlib import Path

from common import options, write

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from paper_artifact.config import RunConfig
from paper_artifact.evaluate.image import DRAWN, SEEN_IN, views_that_show
from paper_artifact.evaluate.scores import evaluate_samples, make_target
from paper_artifact.files import RESULTS
from paper_artifact.mesh import Mesh, load_mesh
from paper_artifact.pipeline import prepare_scene
from paper_artifact.randomness import stream
from paper_artifact.record.store import config_of, read_record
from paper_artifact.sampling import sample_soup, sample_surface
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.state import load_soup

CHOSEN_ON = ("sphere", "torus", "cube", "two_spheres", "spot")
ARMS = {"choose": ("C0", "C1"), "study": ("C0", "C1", "C2"), "held_out": ("C0", "C1", "T3")}
DEEP = 0.01  # of the diagonal


def lies_deep(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Return which points (n,3) lie deeper than DEEP diagonals in a closed mesh, wound either way, by
    the normals of the nearest of 100,000 samples."""
    nearest, face, _ = sample_surface(mesh.vertices, mesh.faces, 100_000, stream(0, "inside"))
    a, b, c = np.swapaxes(mesh.vertices[mesh.faces[face]], 0, 1)
    away, index = cKDTree(nearest).query(points)
    volume = np.linalg.det(mesh.vertices[mesh.faces] - mesh.centre).sum()
    behind = np.sign(volume) * ((points - nearest[index]) * np.cross(b - a, c - a)[index]).sum(1) < 0
    return behind & (away > DEEP * mesh.diagonal)


def rows_of(record: Path, config: RunConfig, views: tuple[int, ...]) -> list[dict]:
    """Return the rows of one run."""
    folder = record.parent.parent
    own = folder / config.shape if Path(config.shape).suffix else None
    mesh = find_mesh(config.shape) if own is None else load_mesh(folder / Path(config.shape).name)
    scene, target = prepare_scene(config, mesh, folder / "scenes"), make_target(mesh)
    soup, wanted = load_soup(folder / "soups" / f"{record.stem}.npz"), len(target.samples)
    draws = stream(0, "seen")
    points, triangles, _ = sample_soup(soup.vertices.numpy(), soup.corner_opacity(), DRAWN * wanted, draws)
    times = views_that_show(soup, scene, points, triangles)
    deep, rows = lies_deep(mesh, points), []
    for least in views:
        seen = times >= least
        kept = points[seen]
        found = evaluate_samples(kept[:wanted], target)
        row = {"shape": Path(config.shape).stem, "arm": config.condition, "seed": config.seed, "views": least}
        row |= {"share": len(kept) / len(points), "inside": deep[seen][:wanted].mean()}
        row |= {"truth": ",".join(map(str, target.counts)), "counts": ",".join(map(str, found["counts"]))}
        row |= {f"bottleneck_{k}": found["bottleneck"][k] for k in range(3)}
        rows.append(row | {"chamfer": found["chamfer"]})
        print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    given = options(
        __doc__, table={"choices": (*ARMS,), "required": True}, runs={"type": Path, "default": RESULTS}
    )
    choosing = given.table == "choose"
    found = []
    for record in sorted((given.runs / "runs").glob("*.json")):
        if not (given.runs / "soups" / f"{record.stem}.npz").is_file():
            continue
        config = config_of(read_record(record))
        chosen = config.shape in CHOSEN_ON and config.seed == 0
        if config.condition in ARMS[given.table] and (chosen or not choosing):
            found += rows_of(record, config, (0, 1, 2, 3, 5) if choosing else (0, SEEN_IN))
            write(pd.DataFrame(found), given.out / f"seen_{given.table}.csv")
    if not found:
        raise SystemExit(
            f"{given.runs} has no records with soups of this table; name another folder (--runs)"
        )
