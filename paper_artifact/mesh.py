"""Triangle meshes: the one dataclass, exact welding, validation, and reading files."""

from __future__ import annotations

import hashlib
import os
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.archives import check_archive
from paper_artifact.arithmetic import norm
from paper_artifact.errors import InputError
from paper_artifact.files import partial_folder
from paper_artifact.formats.gltf import read_gltf
from paper_artifact.formats.polygons import read_obj, read_off, read_ply, read_stl
from paper_artifact.frame import SAME, Frame
from paper_artifact.sampling import check_arrays, check_indices, face_areas

# Below this fraction of diagonal² the total area is round-off, not a surface.
AREA_FLOOR = 1e-12
FAR = 1e75  # extent beyond which, and below whose inverse, products of four lengths leave float64
READERS: dict[str, Any] = {
    "obj": read_obj,
    "ply": read_ply,
    "off": read_off,
    "stl": read_stl,
    "glb": None,
    "gltf": None,
}

# What Betti numbers and bars of dimension 0, 1 and 2 count.
FEATURES = (("component", "components"), ("loop", "loops"), ("void", "voids"))


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in world units."""

    vertices: np.ndarray  # (V,3) float64 positions, world units
    faces: np.ndarray  # (F,3) int64 vertex indices, counter-clockwise seen from outside
    name: str  # for messages and file names
    betti: tuple[int, int, int] | None = None  # (b0, b1, b2) where known by construction, else None

    @property
    def diagonal(self) -> float:
        """Length of the bounding-box diagonal, world units: the D that reported lengths are divided by."""
        return float(norm(self.vertices.max(axis=0) - self.vertices.min(axis=0)))

    @property
    def centre(self) -> np.ndarray:
        """Centre of the bounding box, (3,) float64, world units."""
        return (self.vertices.max(axis=0) + self.vertices.min(axis=0)) / 2

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere around `centre`, world units; 1 for the unit sphere."""
        return float(norm(self.vertices - self.centre).max())

    def framed(self, frame: Frame) -> Mesh:
        """Return the mesh in the coordinates of a run with this frame; itself where they are equal."""
        return self if frame == SAME else replace(self, vertices=frame.inward(self.vertices))


def mesh_hash(mesh: Mesh) -> str:
    """Return the sha256 (hex) of the mesh's vertices and faces; the name does not count."""
    digest = hashlib.sha256(f"{len(mesh.vertices)} {len(mesh.faces)} ".encode())
    digest.update(np.ascontiguousarray(mesh.vertices, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(mesh.faces, dtype="<i8").tobytes())
    return digest.hexdigest()


def weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge exactly equal points (no tolerance), in the order of first appearance.

    Return vertices (V',3) float64 and faces (F',3) int64: points that no face uses and faces that now
    use one point twice are dropped, both are no part of the surface (an unused point would move the bounding
    box).
    """
    vertices = np.asarray(vertices, dtype=np.float64) + 0.0  # + 0.0 turns -0.0 into 0.0
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    faces = first[inverse.reshape(-1)[faces]].reshape(-1, 3)
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    used, faces = np.unique(faces[proper], return_inverse=True)
    return vertices[used], faces.reshape(-1, 3).astype(np.int64)


def check_scale(vertices: np.ndarray, name: str) -> None:
    """Raise InputError, naming `name`, where areas of vertices (V,3), V > 0, leave double precision."""
    with np.errstate(over="ignore"):
        extent = float(np.ptp(vertices, axis=0).max())
    if extent and not 1 / FAR < extent < FAR:
        word = "large" if extent > 1 else "small"
        raise InputError(f"{name} extends over {extent:.1g}, too {word} for areas; scale it")


def checked_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    name: str,
    betti: tuple[int, int, int] | None = None,
    welded: bool = True,
) -> Mesh:
    """Return the Mesh of vertices (V,3) and faces (F,3), welded exactly unless `welded` is False.

    Raises InputError, naming `name`, for no faces, indices out of range, NaN or infinite coordinates, or a
    surface of no area.
    """
    vertices, faces = check_arrays(vertices, faces, name)
    kept_vertices, kept_faces = weld(vertices, faces) if welded else (vertices.copy(), faces.copy())
    if len(kept_faces):
        check_scale(kept_vertices, name)
    diagonal = float(norm(np.ptp(kept_vertices, axis=0))) if len(kept_faces) else 0.0
    if float(face_areas(kept_vertices, kept_faces).sum()) <= AREA_FLOOR * diagonal**2:
        raise InputError(
            f"{name} has only triangles of zero area, or next to none beside its extent of {diagonal:.3g}; "
            "give a mesh with a surface, without points far away"
        )
    return Mesh(kept_vertices, kept_faces, name, betti)


def load_mesh(path: Path | str, welded: bool = True) -> Mesh:
    """Read an OBJ, PLY, OFF, STL, glTF or GLB file, or a zip that holds one; the Mesh is named after the
    file, its `betti` is None.

    Faces are indexed by position alone: equal points are welded exactly, so texture seams (OBJ `v/vt`) and
    STL's separate corners do not cut the surface open. Polygons are triangulated (`formats.polygons`), the
    parts of a glTF scene placed by their transforms and concatenated. `welded=False` keeps the file's own
    vertices.

    Raises InputError for a missing, unreadable, truncated or foreign file, for a part of a format that is not
    read, and for what `checked_mesh` refuses.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"a mesh is named by its file's path, not by {path!r:.60}")
    path = Path(path)
    if not isfile(path):  # False for a name that is too long
        if exists(path) and not isdir(path):
            raise InputError(f"{path} is a pipe or a device; save the mesh in a file")
        if not os.access(path.parent, os.X_OK) and isdir(path.parent):
            raise InputError(f"cannot enter {path.parent}; check its permissions")
        raise InputError(f"no mesh file at {path}; check the path, or fetch the meshes first")
    kind = path.suffix.lower().lstrip(".")
    if kind == "zip":
        return replace(_zipped(path, welded), name=path.stem)
    if kind not in READERS:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh format that is read; use OBJ, PLY, OFF, STL, GLB or glTF"
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check its permissions") from error
    if not data.strip():
        raise InputError(f"{path} is empty; give a mesh file with vertices and faces")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # `checked_mesh` refuses what comes of it
            parts = read_gltf(path, data) if kind in ("glb", "gltf") else [READERS[kind](data)]
    except InputError as error:
        raise InputError(f"{path} is not read: {error}") from error
    except MemoryError as error:
        raise InputError(f"{path} does not fit into memory; simplify it first") from error
    except OSError as error:
        raise InputError(f"cannot read what {path} refers to: {str(error):.200}") from error
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())[:150]
        raise InputError(
            f"{path} is damaged or no {kind.upper()} mesh ({reason}); "
            "export it again or correct its extension"
        ) from error
    if not sum(len(faces) for _, faces in parts):
        raise InputError(
            f"{path} has no triangles; it is empty, damaged, or holds points or curves instead of a surface"
        )
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    for vertices, faces in parts:
        check_indices(vertices, faces, str(path))
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)])
    used, finite = np.zeros(len(vertices), bool), np.isfinite(vertices).all(axis=1)
    used[faces] = True
    if not (finite | used).all():  # scanners write NaN for pixels without depth; no face uses them
        kept = finite | used
        vertices, faces = vertices[kept], (np.cumsum(kept) - 1)[faces]
    return replace(checked_mesh(vertices, faces, str(path), welded=welded), name=path.stem)


def _zipped(path: Path, welded: bool) -> Mesh:
    """Return the one mesh of a zip archive."""
    try:
        with zipfile.ZipFile(path) as archive, partial_folder() as temporary:
            folder = temporary / "archive"
            check_archive(archive)
            names = [
                name
                for name in archive.namelist()
                if Path(name).suffix.lower()[1:] in READERS and not name.startswith("__MACOSX/")
                if not name.endswith("/")
            ]
            if len(names) != 1:
                raise InputError(f"{path} holds {len(names)} meshes; unpack it and name one of them")
            archive.extractall(folder)
            return load_mesh(archive.extract(names[0], folder), welded)  # as it was named here
    except InputError as error:
        raise InputError(str(error).replace(f"{folder}/", f"{path}: ")) from error
    except (RuntimeError, NotImplementedError) as error:  # zipfile's for a password, and for a compression
        raise InputError(
            f"{path} cannot be unpacked here ({error}); unpack it and name the mesh in it"
        ) from error
    except (OSError, ValueError, EOFError, struct.error, zlib.error, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is damaged or no zip archive ({error}); copy it again") from error


def betti_text(betti: Sequence[int]) -> str:
    """Return three Betti numbers as text: "1 component, 2 loops, 1 void"."""
    return ", ".join(
        f"{number} {one if number == 1 else more}"
        for number, (one, more) in zip(betti, FEATURES, strict=True)
    )
