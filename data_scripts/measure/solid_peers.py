"""What is usually done to make a solid of a soup: voxels with marching cubes, and Poisson, on the same soups.

Both take the opaque triangles that `solidify` takes, with one fixed setting and no knowledge of what is
wanted; the same certificate judges them. One row per run and way, and per shape and way of the ground truth's
surface (condition "truth": can the way do it at all?). CPU seconds; Poisson's both ways share theirs.
Notebook 19 reads it. Ten minutes.

pymeshlab is no dependency: run it in a side environment (docs/study.md). --soups: a folder of final soups,
default results/retrained/soups; runs that it lacks are left out. The script goes on from the rows that are
stored.
"""

from importlib.metadata import version
from pathlib import Path
from types import ModuleType

from common import Clock, import_pymeshlab, kept, options, write

import numpy as np
import pandas as pd
import trimesh
from solids import NAMES, RUN, SEED, betti_of, soups_of

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.export.models import soup_triangles
from paper_artifact.export.solid import SAMPLES, distances_to, opaque_mesh
from paper_artifact.ingest.solidify import wanted_of
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface
from paper_artifact.soup.state import load_soup

PITCH = 1 / 128  # voxel side / diagonal
DEPTH = 8  # of Poisson's octree, pymeshlab's default
LARGE = "poisson, large pieces"
WAYS = ("voxels", "poisson", LARGE)
TRUTH = "truth"  # the condition of a row of the ground truth's surface

Surface = tuple[np.ndarray, np.ndarray]  # vertices (V,3), faces (F,3)


def voxels(soup: Mesh) -> Surface:
    """Return trimesh's voxels of the soup at PITCH, filled, by marching cubes."""
    grid = trimesh.Trimesh(soup.vertices, soup.faces, process=False).voxelized(PITCH * soup.diagonal).fill()
    made = grid.marching_cubes.apply_transform(grid.transform)
    return np.asarray(made.vertices), np.asarray(made.faces)


def poisson(soup: Mesh, pymeshlab: ModuleType) -> dict[str, Surface]:
    """Return pymeshlab's screened Poisson surface of SAMPLES points of the soup, and the same without the
    pieces below a tenth of the diagonal; normals by its filter for point clouds, one thread (more of them
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
    """Return the certificate's verdict on a made surface, its Betti numbers and genus, whether it is what is
    wanted, and its distances to the ground truth."""
    mesh = checked_mesh(*made, name)
    found = certify_mesh(mesh)
    distance = distances_to(mesh, surface(shape))
    return {
        "passes": found.passed,
        **dict(zip(("b0", "b1", "b2"), found.betti, strict=True)),
        "genus": found.genus,
        "meets": found.passed and found.betti == wanted_of(betti_of(shape)).betti,
        "triangles": len(mesh.faces),
        "chamfer": distance["chamfer"],
        "hausdorff95": distance["hausdorff95"],
    }


def rows_of(shape: str, arm: str, soup: Mesh, pymeshlab: ModuleType) -> pd.DataFrame:
    """Return one row per way."""
    with Clock() as ours:
        made = {WAYS[0]: voxels(soup)}
    with Clock() as theirs:
        made |= poisson(soup, pymeshlab)
    libraries = {WAYS[0]: f"trimesh {version('trimesh')}, scikit-image {version('scikit-image')}"}
    rows = []
    for way in WAYS:
        row = {"shape": shape, "condition": arm, "seed": SEED, "way": way}
        row |= {"library": libraries.get(way, f"pymeshlab {version('pymeshlab')}")}
        row |= {"seconds": ours.cpu if way == WAYS[0] else theirs.cpu}
        rows.append(row | judged(shape, made[way], f"{shape} by {way}"))
    return pd.DataFrame(rows)


def main() -> None:
    """Measure what is missing in the CSV."""
    given = options(__doc__, soups={"type": Path, "help": "folder of final soups"})
    pymeshlab = import_pymeshlab()
    path = given.out / "solid_peers.csv"
    table = kept(path, RUN)
    known = set(table[RUN].itertuples(index=False, name=None))
    files: list[tuple[str, str, Path | None]] = [each for each in soups_of(given.soups) if each[2].is_file()]
    if not files:
        raise InputError("no soup was found; name a folder of final soups with --soups")
    for shape, arm, file in [*files, *((shape, TRUTH, None) for shape in NAMES)]:
        if (shape, arm, SEED) in known:
            continue
        soup = opaque_mesh(soup_triangles(load_soup(file)), shape) if file else surface(shape)
        own = rows_of(shape, arm, soup, pymeshlab)
        table = pd.concat([table, own], ignore_index=True) if len(table) else own
        write(table, path)


if __name__ == "__main__":
    main()
