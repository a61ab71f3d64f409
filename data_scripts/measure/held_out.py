"""Stated Betti numbers on shapes that chose nothing: which design is frozen first, then tried once.

    python data_scripts/measure/held_out.py --table pilots      # what the design T3 was chosen on: pilots.csv
    python data_scripts/measure/held_out.py --table held_out    # ten procedural shapes, frozen before any ran

One row per shape, arm and seed: bottleneck to the truth per dimension (radius / D, tails), counts, Chamfer,
PSNR of the views held out, CPU seconds. M = 8192 and N = 1500 for every shape of our own. Runs that are
recorded in --runs are read, not trained; about 100 s of CPU each. Notebook 16 reads the tables.
"""

from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

from common import options, write

import numpy as np
import pandas as pd
import trimesh
from damaged import Field, cylinder, ellipsoid, meshed, ring, union, without

from paper_artifact.catalogue import shape_row, study_config
from paper_artifact.errors import InputError
from paper_artifact.evaluate.scores import make_target
from paper_artifact.files import atomic_path
from paper_artifact.mesh import load_mesh
from paper_artifact.pipeline import run
from paper_artifact.study.studies import STRONG

OWN: dict[str, Any] = {"budget": 1500}
SAMPLES = 8192
UPRIGHT = (0, 2, 1)  # a ring turned into the plane of x and z
Betti = tuple[int, int, int]
Shapes = dict[str, tuple[Field, Betti]]


def moved(field: Field, *by: float) -> Field:
    """The field, moved."""
    return lambda p: field(p - np.array(by))


def box(x: float, y: float, z: float) -> Field:
    """A box of these half sides."""
    return lambda p: (np.abs(p) - (x, y, z)).max(axis=1)


def drilled(block: Field, places: list[tuple[float, float]], radius: float) -> Field:
    """A block with holes along z."""
    for x, y in places:
        block = without(block, moved(cylinder(radius, -2, 2), x, y, 0))
    return block


LINK, GRIP = ring(0.6, 0.13, (0, 0, 0), UPRIGHT), ring(0.65, 0.09, (0, 0, 0.45), UPRIGHT)
BALLS = (
    moved(ellipsoid(0.5, 0.4, 0.4), -0.9, 0, 0),
    ellipsoid(0.3, 0.5, 0.3),
    moved(ellipsoid(0.4, 0.4, 0.6), 0.9, 0, 0),
)
PILOTS: Shapes = {
    "chain": (union(ring(0.6, 0.13, (-0.82, 0, 0)), LINK, ring(0.6, 0.13, (0.82, 0, 0))), (3, 6, 3)),
    "slab": (drilled(box(1.6, 0.6, 0.25), [(-1, 0), (0, 0), (1, 0)], 0.38), (1, 6, 1)),
}
HELD_OUT: Shapes = {
    "two links": (union(ring(0.8, 0.2), ring(0.8, 0.2, (0.8, 0, 0), UPRIGHT)), (2, 4, 2)),
    "ball in a ring": (union(ring(1.0, 0.18), ellipsoid(0.4, 0.4, 0.4)), (2, 2, 2)),
    "three balls": (union(*BALLS), (3, 0, 3)),
    "nested shells": (without(ellipsoid(1, 0.9, 0.8), ellipsoid(0.5, 0.5, 0.4)), (2, 0, 2)),
    "grid": (drilled(box(1.1, 1.1, 0.2), list(product((-0.5, 0.5), repeat=2)), 0.33), (1, 8, 1)),
    "pipe": (without(cylinder(0.5, -1, 1), cylinder(0.42, -2, 2)), (1, 2, 1)),
    "basket": (without(union(cylinder(0.7, -0.5, 0.5), GRIP), cylinder(0.6, -0.4, 0.5)), (1, 2, 1)),
    "plate": (ellipsoid(1, 0.8, 0.12), (1, 0, 1)),
    "three rings": (union(*(ring(0.5, 0.14, (x, 0, 0)) for x in (-1, 0, 1))), (1, 6, 1)),
    "frame": (drilled(box(0.9, 0.9, 0.9), [(0, 0)], 0.6), (1, 2, 1)),
}
# Arm: condition, changes of its loss. The wrong numbers have one loop too many.
DESIGNS: dict[str, tuple[str, dict[str, Any]]] = {name: (name, {}) for name in ("C0", "C1", "T1", "T3")}
ARMS = DESIGNS | {
    "C2": ("C2", {}),
    "T2": ("T2", {}),
    "T2, aim=none": ("T2", {"aim": "none"}),
    "T2, wrong": ("T2", {}),
    "B5, strong": ("B5", {}),
}
ORDER = (("C0", "T3"), ("C1", "T1"), tuple(ARMS)[4:])  # what is asked first


def cases(table: str) -> Iterator[tuple[str, Betti | None, str, int]]:
    """Yield (shape, Betti numbers of a shape of ours, arm, seed) of every run of a table."""
    if table == "pilots":
        for shape in ("sphere", "torus", "pot", *PILOTS):
            for arm in DESIGNS:
                yield shape, PILOTS[shape][1] if shape in PILOTS else None, arm, 7
        for arm in DESIGNS:
            yield "horse", None, arm, 1  # the seed at which T1 never acts
    else:
        for seed, arms in product((7, 8, 9), ORDER):
            for shape, arm in product(HELD_OUT, arms):
                yield shape, HELD_OUT[shape][1], arm, seed


def mesh_file(shape: str, folder: Path) -> Path:
    """Return the PLY of one of our shapes, made where it does not exist."""
    path = folder / f"{shape.replace(' ', '_')}.ply"
    if not path.is_file():
        field, betti = (PILOTS | HELD_OUT)[shape]
        mesh = meshed(field, shape, betti)
        with atomic_path(path) as new:
            trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(new, file_type="ply")
    return path


@cache
def clean_counts(mesh: Path) -> tuple[int, ...]:
    """Return the significant bars per dimension of 20,000 samples of the surface itself."""
    return make_target(load_mesh(mesh)).counts


def row_of(shape: str, betti: Betti | None, arm: str, seed: int, folder: Path) -> dict[str, Any]:
    """Return one row of a table: a run, trained or read."""
    condition, loss = ARMS[arm]
    named: dict[str, Any] = {} if betti is None else OWN
    if betti is not None and condition[0] in "CT" and condition != "C0":
        loss = {"samples": SAMPLES} | loss
    if betti is not None and condition[0] == "T":
        loss = {"betti": (betti[0], betti[1] + ("wrong" in arm), betti[2])} | loss
    name = shape if betti is None else str(mesh_file(shape, folder))
    allocation = STRONG if condition == "B5" else None
    config = study_config(name, condition, seed, loss=loss, allocation=allocation, **named)
    row: dict[str, Any] = {"shape": shape, "arm": arm, "seed": seed}
    if betti is not None:
        row["clean"] = ",".join(map(str, clean_counts(mesh_file(shape, folder))))
    try:
        record = run(config, results=folder, device="cpu")
    except InputError as error:
        return row | {"refused": str(error).split(";")[0]}
    known, tails = shape_row(shape), record["tails"]
    row |= {"judged": "" if known is None else known.judged, "chamfer": tails["chamfer"]}
    row |= {f"bottleneck_{k}": tails["bottleneck"][k] for k in range(3)}
    row |= {f"count_{k}": tails["counts"][k] for k in range(3)}
    return row | {"psnr": record["images"]["psnr"], "cpu": record["cpu_seconds"]}


if __name__ == "__main__":
    given = options(
        __doc__,
        table={"choices": ("pilots", "held_out"), "required": True},
        runs={
            "type": Path,
            "default": Path("results/own/held_out"),
            "help": "folder of the runs (%(default)s)",
        },
    )
    given.runs.mkdir(parents=True, exist_ok=True)
    rows = []
    for case in cases(given.table):
        rows.append(row_of(*case, given.runs))
        print(rows[-1], flush=True)
        write(pd.DataFrame(rows), given.out / f"{given.table}.csv")
