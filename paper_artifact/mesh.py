"""Triangle meshes: the one dataclass, exact welding, validation, and reading files through trimesh."""

from __future__ import annotations

import hashlib
import json
import logging
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from paper_artifact.errors import InputError
from paper_artifact.files import check_archive
from paper_artifact.frame import SAME, Frame
from paper_artifact.sampling import face_areas

# Below this fraction of diagonal² the total area is round-off, not a surface.
AREA_FLOOR = 1e-12
MOST_FACES = 20_000_000  # of a file, its instances counted each time


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
        return float(np.linalg.norm(self.vertices.max(axis=0) - self.vertices.min(axis=0)))

    @property
    def centre(self) -> np.ndarray:
        """Centre of the bounding box, (3,) float64, world units."""
        return (self.vertices.max(axis=0) + self.vertices.min(axis=0)) / 2

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere around `centre`, world units; 1 for the unit sphere."""
        return float(np.linalg.norm(self.vertices - self.centre, axis=1).max())

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

    Return vertices (V',3) float64 and faces (F',3) int64: points that no face uses and faces that came to
    use one point twice are dropped, both are no part of the surface (an unused point would move the bounding
    box).
    """
    vertices = np.asarray(vertices, dtype=np.float64) + 0.0  # + 0.0 turns -0.0 into 0.0
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    faces = first[inverse.reshape(-1)[faces]].reshape(-1, 3)
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    used, faces = np.unique(faces[proper], return_inverse=True)
    return vertices[used], faces.reshape(-1, 3).astype(np.int64)


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
    vertices = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise InputError(f"{name} has no triangles; give a surface mesh, not points or curves")
    _check_indices(vertices, faces, name)
    if not np.isfinite(vertices).all():
        count = int((~np.isfinite(vertices).all(axis=1)).sum())
        raise InputError(
            f"{name} has {count} vertices with NaN or infinite coordinates; repair or export it again"
        )
    kept_vertices, kept_faces = weld(vertices, faces) if welded else (vertices, faces)
    extent = np.ptp(kept_vertices, axis=0) if len(kept_faces) else np.zeros(3)
    with np.errstate(over="ignore", invalid="ignore"):
        diagonal = float(np.linalg.norm(extent))
        area = float(face_areas(kept_vertices, kept_faces).sum()) if len(kept_faces) else 0.0
    if not (np.isfinite(diagonal) and np.isfinite(area)):
        raise InputError(f"{name} has coordinates too large for double precision areas; scale it down")
    if area <= AREA_FLOOR * diagonal**2:
        raise InputError(f"{name} has only triangles of zero area; give a mesh with a surface")
    return Mesh(kept_vertices, kept_faces, name, betti)


def load_mesh(path: Path | str, welded: bool = True) -> Mesh:
    """Read any mesh file that trimesh reads; the Mesh is named after the file, its `betti` is None.

    Faces are indexed by position alone: equal points are welded exactly, so texture seams (OBJ `v/vt`) and
    STL's separate corners do not cut the surface open. Polygons are triangulated by the fan 0-2, the parts of
    a scene file (GLB) are placed by their transforms and concatenated. `welded=False` keeps the file's own
    vertices.

    Raises InputError for a missing, unreadable, truncated or foreign file and for what `checked_mesh`
    refuses.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"no mesh file at {path}; check the path, or fetch the meshes first")
    kind = path.suffix.lower().lstrip(".")
    if kind not in trimesh.exchange.load.mesh_formats() | {"zip"}:
        raise InputError(
            f"{path}: '{path.suffix}' is no mesh format that trimesh reads; use OBJ, PLY, OFF, STL or GLB"
        )
    try:
        if kind in ("obj", "off"):
            _check_whole(path, kind)
        _check_declared(path, kind)
        with _silent_trimesh():
            parts = _scene_parts(trimesh.load_scene(path, process=False, maintain_order=True))
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{path} does not fit into memory; simplify it first") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check its permissions") from error
    except Exception as error:  # trimesh's parsers raise whatever their parsing meets
        raise InputError(
            f"{path} is damaged or no {kind.upper()} mesh ({type(error).__name__}: {_short(error)}); "
            "export it again or correct its extension"
        ) from error
    if not parts:
        raise InputError(
            f"{path} has no triangles; it is empty, damaged, or holds points or curves instead of a surface"
        )
    if kind == "zip" and len(parts) > 1:
        raise InputError(f"{path} holds {len(parts)} meshes; unpack it and name one of them")
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    for vertices, faces in parts:
        _check_indices(vertices, faces, str(path))
    mesh = checked_mesh(
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)]),
        str(path),
        welded=welded,
    )
    return Mesh(mesh.vertices, mesh.faces, path.stem)


def _check_indices(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    wrong = faces[(faces < 0) | (faces >= len(vertices))]
    if wrong.size:
        raise InputError(
            f"{name} has a face that refers to vertex {wrong[0]} of {len(vertices)}; "
            "the file is damaged or cut off, export it again"
        )


def _scene_parts(scene: trimesh.Scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the scene's meshes as (vertices, faces), each placed by its node's transform; no points, no
    curves.
    """
    parts, count = [], 0
    for node in sorted(scene.graph.nodes_geometry):
        transform, key = scene.graph[node]
        geometry = scene.geometry[key]
        count += len(getattr(geometry, "faces", ()))
        if count > MOST_FACES:
            raise ValueError(f"it has more than {MOST_FACES} triangles")
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        faces = np.asarray(geometry.faces, dtype=np.int64)
        if not np.array_equal(transform, np.eye(4)):
            vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
            if np.linalg.det(transform[:3, :3]) < 0:
                faces = faces[:, ::-1]  # a mirroring transform turns the winding inside out
        parts.append((vertices, faces))
    return parts


def _check_whole(path: Path, kind: str) -> None:
    """Refuse OBJ and OFF texts that were cut off: trimesh reads what is left of them without a word."""
    lines = [
        line.split("#")[0].split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()
    ]
    lines = [line for line in lines if line]
    if not lines:
        raise InputError(f"{path} is empty; give a mesh file with vertices and faces")
    whole = True
    if kind == "obj":
        keyword, count = lines[-1][0], len(lines[-1]) - 1
        whole = not (keyword in ("v", "f", "vn") and count < 3)
    elif lines[0][0].upper().endswith("OFF"):
        header = lines[0][1:] + (lines[1] if len(lines[0]) == 1 and len(lines) > 1 else [])
        rows = lines[1:] if len(lines[0]) > 1 else lines[2:]
        if len(header) >= 2 and header[0].isdigit() and header[1].isdigit() and int(header[1]) > 0:
            rows = rows[: int(header[0]) + int(header[1])]
            whole = (
                len(rows) == int(header[0]) + int(header[1])
                and rows[-1][0].isdigit()
                and (len(rows[-1]) > int(rows[-1][0]))
            )
    if not whole:
        raise InputError(
            f"{path} is cut off: its last line or its number of lines is short; copy or export it again"
        )


def _check_declared(path: Path, kind: str) -> None:
    """Raise ValueError for a file that makes trimesh ask for far more memory than the file has bytes."""
    if kind == "zip":
        with zipfile.ZipFile(path) as archive:
            check_archive(archive)
    if kind not in ("glb", "gltf"):
        return
    data = path.read_bytes()
    text = data
    if kind == "glb":
        chunks, place = [], 12
        while place + 8 <= len(data):
            length = int.from_bytes(data[place : place + 4], "little")
            chunks.append(data[place + 8 : place + 8 + length])
            place += 8 + length
        if place > len(data) or not chunks:
            raise ValueError(f"it ends before its byte {place}")
        text = chunks[0]
    header = json.loads(text)
    empty = sum(each["count"] for each in header.get("accessors", ()) if "bufferView" not in each)
    if empty > len(data):
        raise ValueError(f"it names {empty} values that it does not hold")


@contextmanager
def _silent_trimesh() -> Iterator[None]:
    """Keep trimesh's log lines and warnings from the terminal while it parses."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or "no message"
