"""One name for every mesh: an analytic shape, an external mesh's key, the pot's stand-in, or a file."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh, load_mesh
from paper_artifact.scene.fetch import mesh_path
from paper_artifact.scene.shapes import SHAPES, make_shape
from paper_artifact.scene.sources import TABLE, sources

POT = "pot"  # the ingested shell of the procedural hot pot, in the role of the paper's pot


def is_named(shape: str) -> bool:
    """Return whether find_mesh knows `shape` by name, whatever files of that name there are."""
    # Without a checkout there is no table; the study's own names are worth its error, others may be files.
    return (
        shape in SHAPES or shape == POT or bool((TABLE.is_file() or shape_row(shape)) and shape in sources())
    )


def find_mesh(shape: str, welded: bool = True) -> Mesh:
    """Return the mesh of an analytic shape, an external mesh's key (fetched if needed), the pot, or a mesh
    file.

    welded=False keeps a file's own vertices, for a certificate that counts them. Raises InputError when the
    name is none of these, or the file cannot be had.
    """
    if shape in SHAPES:
        return make_shape(shape)
    if shape == POT:
        # scikit-image and compiled kernels: only when needed
        from paper_artifact.ingest.hot_pot import pot_solid

        return replace(pot_solid().shell, name=shape)
    if is_named(shape):
        return replace(load_mesh(mesh_path(shape), welded=welded), name=shape)
    if Path(shape).suffix or Path(shape).is_file():
        return load_mesh(Path(shape), welded=welded)
    raise InputError(
        f"unknown shape {shape!r}; choose one of {', '.join(SHAPES)}, {POT}, "
        "a key of `python -m paper_artifact fetch --list`, or the path of a mesh file"
    )


@cache
def surface(shape: str) -> Mesh:
    """Return the mesh of a name as `find_mesh` does, read once per process."""
    return find_mesh(shape)
