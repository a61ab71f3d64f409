"""Notebook 19: what is usually done instead, on the same soups: voxels with marching cubes, and Poisson.

Both take the opaque triangles that `solidify` takes, with one fixed setting and no knowledge of what is
wanted. pymeshlab is no dependency: measured in a side environment (README, "Beside other libraries").
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import trimesh

from paper_artifact.certify.certificate import certify
from paper_artifact.errors import InputError
from paper_artifact.export.solid import SAMPLES, distances_to, opaque_mesh
from paper_artifact.export.triangles import soup_triangles
from paper_artifact.files import RESULTS, write_text
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.randomness import stream
from paper_artifact.report.solids import ARMS, RUN, shapes_of_solids, soups_of, wanted_for
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.find import surface
from paper_artifact.soup.state import load_soup

CSV = RESULTS / "measured" / "solid_peers.csv"
PITCH = 1 / 128  # voxel side / diagonal
DEPTH = 8  # of Poisson's octree, pymeshlab's default
LARGE = "poisson, large pieces"
WAYS = ("voxels", "poisson", LARGE)
TRUTH = "truth"  # the condition of a row that was given the ground truth's surface: can the way do it at all?

Surface = tuple[np.ndarray, np.ndarray]  # vertices (V,3), faces (F,3)


def voxels(soup: Mesh) -> Surface:
    """Return trimesh's voxels of the soup at PITCH, filled, by marching cubes."""
    grid = trimesh.Trimesh(soup.vertices, soup.faces, process=False).voxelized(PITCH * soup.diagonal).fill()
    made = grid.marching_cubes.apply_transform(grid.transform)
    return np.asarray(made.vertices), np.asarray(made.faces)


def poisson(soup: Mesh, pymeshlab: ModuleType) -> dict[str, Surface]:
    """Return pymeshlab's screened Poisson surface of SAMPLES points of the soup, and the same without the
    pieces below a tenth of the diagonal; normals by its own filter for point clouds, one thread (more of them
    spin on a busy machine), all other settings its defaults."""
    points = sample_surface(soup.vertices, soup.faces, SAMPLES, stream(0, "solid: poisson"))[0]
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=points))
    meshes.compute_normal_for_point_clouds()
    meshes.generate_surface_reconstruction_screened_poisson(depth=DEPTH, threads=1)
    surfaces = {}
    for way in WAYS[1:]:
        if way == LARGE:
            meshes.meshing_remove_connected_component_by_diameter()
        made = meshes.current_mesh()
        surfaces[way] = np.array(made.vertex_matrix()), np.array(made.face_matrix())
    return surfaces


def judged(shape: str, made: Surface, name: str) -> dict:
    """Return a made surface's row: verdict of its certificate, Betti numbers, genus, whether it passes with
    the wanted ones, and its Chamfer and Hausdorff95 to the ground truth."""
    mesh = checked_mesh(*made, name)
    found = certify(mesh.vertices, mesh.faces, name)
    distance = distances_to(mesh, surface(shape))
    return {
        "passes": found.passed,
        **dict(zip(("b0", "b1", "b2"), found.betti, strict=True)),
        "genus": found.genus,
        "meets": found.passed and found.betti == wanted_for(shape).betti,
        "triangles": len(mesh.faces),
        "chamfer": distance["chamfer"],
        "hausdorff95": distance["hausdorff95"],
    }


def measure_solid_peers(
    progress: Callable[[str], None] | None = None,
    soups: Path | None = None,
    arms: Iterable[str] = ARMS,
    seeds: Iterable[int] = (0,),
    path: Path = CSV,
) -> pd.DataFrame:
    """Return one row per run and way (WAYS), and of each shape's true surface (TRUTH): shape, condition,
    seed, way, library with version, CPU seconds (Poisson's both ways together), and `judged`'s columns.

    soups: the folder of final soups, None for results/retrained/soups; runs that it lacks are left out. What
    `path` holds already is kept. Raises InputError where pymeshlab is missing, or no soup is found.
    """
    try:
        pymeshlab = importlib.import_module("pymeshlab")
    except ImportError as error:
        raise InputError(
            f"pymeshlab cannot be imported ({error}); `pip install pymeshlab` in a side environment that "
            "borrows this one's packages (README, 'Beside other libraries')"
        ) from error
    meshlab = f"pymeshlab {version('pymeshlab')}"
    trimesh_and_skimage = f"trimesh {version('trimesh')}, scikit-image {version('scikit-image')}"
    table = pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=RUN)
    known = set(table[RUN].itertuples(index=False, name=None))
    given: list[tuple[str, str, int, Path | None]] = [*soups_of(shapes_of_solids(), arms, seeds, soups)]
    given += [(shape, TRUTH, 0, None) for shape in shapes_of_solids()]
    for shape, arm, seed, file in given:
        if (shape, arm, seed) not in known and (file is None or file.is_file()):
            soup = opaque_mesh(soup_triangles(load_soup(file)), shape) if file else surface(shape)
            start = time.process_time()
            made = {WAYS[0]: voxels(soup)}
            middle = time.process_time()
            made |= poisson(soup, pymeshlab)
            seconds = (middle - start, *[time.process_time() - middle] * 2)
            rows = [
                dict(zip(RUN, (shape, arm, seed), strict=True))
                | {"way": way, "library": trimesh_and_skimage if way == WAYS[0] else meshlab}
                | {"seconds": taken}
                | judged(shape, made[way], f"{shape} by {way}")
                for way, taken in zip(WAYS, seconds, strict=True)
            ]
            table = pd.concat([table, pd.DataFrame(rows)], ignore_index=True)
            write_text(path, table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))
        if progress is not None:
            progress(f"{shape} {arm} {seed}")
    if (table["condition"] == TRUTH).all():
        raise InputError("no soup was found; name a folder of final soups with --soups")
    return table


def truth_table(peers: pd.DataFrame) -> pd.DataFrame:
    """Return per way how many of the true surfaces come out with the wanted topology, which do not, and the
    median Chamfer (percent of D)."""
    own = peers[peers["condition"] == TRUTH]
    rows = {
        way: {
            "shapes": len(each),
            "wanted topology": int(each["meets"].astype(bool).sum()),
            "not": ", ".join(each["shape"][~each["meets"].astype(bool)]),
            "Chamfer %": f"{100 * each['chamfer'].median():.2f}",
        }
        for way, each in own.groupby("way", sort=False)
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("way, on the true surface")
