"""Time of alpha persistence against the number of samples: ours beside gudhi's `safe` path, in turns.

One row per cloud and M: CPU milliseconds of every stage and of all, medians, the ratio, and the number of
Delaunay tetrahedra. gudhi's simplex tree is built within its filtration stage. Notebook 07 reads it. Three
minutes of CPU on an idle machine.
"""

from collections.abc import Callable

from common import in_turn, options, write

import numpy as np
import pandas as pd
from scipy.spatial import Delaunay

from paper_artifact.alpha.persistence import fast_persistence, gudhi_persistence
from paper_artifact.randomness import stream
from paper_artifact.record.environment import cpu_model, packages
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface

SIZES, TURNS = (2048, 4096, 8192, 20_000), 5
Draw = Callable[[int, np.random.Generator], np.ndarray]  # (M, generator) -> points (M,3)


def torus(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n points on the torus of radii 1 and 0.4."""
    u, v = rng.random((2, n)) * 2 * np.pi
    radius = 1 + 0.4 * np.cos(v)
    return np.column_stack([radius * np.cos(u), radius * np.sin(u), 0.4 * np.sin(v)])


def soup(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n uniform samples on 300 random triangles around the torus, of edge about 0.2: many coplanar."""
    corners = torus(300, rng)[:, None] + 0.1 * rng.normal(size=(300, 3, 3))
    return np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], n), corners[rng.integers(0, 300, n)])


def study_torus(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n area-weighted samples of the study's torus mesh, world units, as targets and bundles are."""
    mesh = surface("torus")
    return sample_surface(mesh.vertices, mesh.faces, n, rng)[0]


# What notebook 07 shows: samples of the study's torus, of triangles as the loss sees them, of an exact torus.
STUDY_CLOUDS: dict[str, Draw] = {"torus": study_torus, "soup": soup, "smooth torus": torus}
CLOUDS: dict[str, Draw] = {"torus": torus, "soup": soup, "uniform": lambda n, rng: rng.random((n, 3))}


def points_of(clouds: dict[str, Draw], cloud: str, size: int) -> np.ndarray:
    """Return the cloud (size,3) of that name, always the same one."""
    return clouds[cloud](size, stream(0, f"persistence benchmark {cloud}", size))


def row_of(cloud: str, size: int, turns: int = TURNS) -> dict:
    """Return the row of one cloud of STUDY_CLOUDS and M."""
    points = points_of(STUDY_CLOUDS, cloud, size)
    clocks: dict[str, list[dict[str, float]]] = {"gudhi": [], "fast": []}

    def new_clock(name: str) -> dict[str, float]:
        clocks[name].append({})
        return clocks[name][-1]

    calls = {
        "gudhi": lambda: gudhi_persistence(points, clock=new_clock("gudhi")),
        "fast": lambda: fast_persistence(points, clock=new_clock("fast")),
    }
    taken = in_turn(calls, turns)
    row = {"cloud": cloud, "M": size, "tetrahedra": len(Delaunay(points).simplices)}
    row |= {f"{name}_ms": 1e3 * clock["cpu"].median() for name, clock in taken.items()}
    row["ratio"] = row["gudhi_ms"] / row["fast_ms"]
    for name, stages in clocks.items():
        medians = 1e3 * pd.DataFrame(stages)[1:].median()
        row |= {f"{name}_{stage}_ms": value for stage, value in medians.items()}
    return row


if __name__ == "__main__":
    folder, versions = options(__doc__).out, packages()
    rows = [row_of(cloud, size) for cloud in STUDY_CLOUDS for size in SIZES]
    machine = {"cpu": cpu_model(), "gudhi": versions["gudhi"], "numba": versions["numba"]}
    write(pd.DataFrame(rows).assign(repetitions=TURNS, **machine), folder / "cost.csv")
