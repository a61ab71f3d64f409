"""Shells as files: exact in float32, certified from what was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.ply import export_ply
from trimesh.exchange.stl import export_stl

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.files import atomic_path
from paper_artifact.mesh import Mesh, load_mesh

FORMATS = (".ply", ".obj", ".stl")


def check_format(path: Path | str) -> None:
    """Raise InputError unless the path ends in a format that holds float32 points exactly."""
    if Path(path).suffix.lower() not in FORMATS:
        raise InputError(f"cannot write a shell as {path}: its name must end in {', '.join(FORMATS)}")


def write_shell(path: Path | str, shell: Mesh) -> Certificate:
    """Write a Mesh whose vertices are float32 values, by the path's ending; return the certificate of what
    was written.

    The formats are binary PLY, OBJ and binary STL. The file appears only when it reads back to the same
    points and passes the certificate. Raises InputError otherwise, for another ending, and when the folder is
    not writable.
    """
    check_format(path)
    return write_certified(path, shell, _encoded(shell, Path(path).suffix.lower()))


def write_certified(path: Path | str, shell: Mesh, data: bytes) -> Certificate:
    """Write `data`, a mesh file that holds `shell` (float32 values); return the certificate of what was
    written, reading and raising as `write_shell` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
        again = load_mesh(temporary, welded=False)
        certificate = certify_mesh(Mesh(again.vertices, again.faces, Path(path).stem))
        if not np.array_equal(np.unique(again.vertices, axis=0), np.unique(shell.vertices, axis=0)):
            raise InputError(f"{path} would not hold the shell's points exactly; write PLY instead")
        if not certificate.passed:
            raise InputError(
                f"the shell fails its certificate ({'; '.join(certificate.reasons)}), so {path} was not "
                "written; try another offset or more cells per offset"
            )
    return certificate


def _encoded(shell: Mesh, ending: str) -> bytes:
    if ending == ".obj":
        points = [f"v {x} {y} {z}" for x, y, z in shell.vertices.astype(np.float32)]
        return "\n".join(
            points + [f"f {a} {b} {c}" for a, b, c in (shell.faces + 1).tolist()] + [""]
        ).encode()
    mesh = trimesh.Trimesh(shell.vertices, shell.faces, process=False)
    return export_ply(mesh, vertex_normal=False) if ending == ".ply" else export_stl(mesh)
