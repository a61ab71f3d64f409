"""PLY and GLB files of coloured triangles, through trimesh, in the user's coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.ply import export_ply

from paper_artifact.export.triangles import Triangles
from paper_artifact.files import write_bytes
from paper_artifact.frame import SAME, Frame


def write_ply(path: Path | str, triangles: Triangles, frame: Frame = SAME) -> None:
    """Write all triangles as binary PLY: per corner x y z, red green blue (sRGB bytes), alpha (opacity byte).

    frame: of the triangles' coordinates, see `ply_bytes`. Raises InputError when `path` is not writable.
    """
    write_bytes(path, ply_bytes(_trimesh(triangles, triangles.colours, triangles.opacity), frame))


def write_glb(path: Path | str, triangles: Triangles, frame: Frame = SAME) -> None:
    """Write the triangles of mean opacity ≥ .5 as binary glTF 2.0, unlit, double-sided, with vertex colours.

    glTF wants COLOR_0 linear, so the bytes are the colours after the inverse sRGB curve; a conforming viewer
    shows the trained colours. Opacity is left out: soups blended without sorting look wrong. frame: of the
    triangles' coordinates, the node's transform where it is not the user's. Raises InputError as
    `Triangles.visible` does, and when `path` is not writable.
    """
    shown = triangles.visible()
    mesh = _trimesh(shown, srgb_to_linear(shown.colours), np.ones_like(shown.opacity))
    write_bytes(path, glb_bytes(mesh, frame))


def glb_bytes(mesh: trimesh.Trimesh, frame: Frame = SAME) -> bytes:
    """Return binary glTF of a mesh with linear colours, unlit; frame: of its coordinates, the node's
    transform where it is not the user's."""
    scene = mesh.scene()
    if frame != SAME:
        placed = np.diag([*(2.0**frame.exponent,) * 3, 1.0])
        placed[:3, 3] = frame.offset
        scene = trimesh.Scene()
        scene.add_geometry(mesh, transform=placed)
    return export_glb(scene, include_normals=False, tree_postprocessor=unlit)


def ply_bytes(mesh: trimesh.Trimesh, frame: Frame = SAME) -> bytes:
    """Return binary PLY of a mesh with vertex colours; frame: of its coordinates; where it is not the user's
    own, x y z are doubles, since floats may not resolve them."""
    data = export_ply(mesh, vertex_normal=False)
    return data if frame == SAME else _with_doubles(data, frame.outward(mesh.vertices))


def _with_doubles(ply: bytes, vertices: np.ndarray) -> bytes:
    """Return trimesh's binary PLY with other positions (n,3), as doubles."""
    end = ply.index(b"end_header\n") + len(b"end_header\n")
    header, body = ply[:end], ply[end:]
    for axis in (b"x", b"y", b"z"):
        header = header.replace(b"property float " + axis + b"\n", b"property double " + axis + b"\n")
    colour = [(name, "u1") for name in ("red", "green", "blue", "alpha")]
    old = np.frombuffer(body, np.dtype([("place", "<f4", 3), *colour]), len(vertices))
    new = np.empty(len(vertices), np.dtype([("place", "<f8", 3), *colour]))
    for name, _ in colour:
        new[name] = old[name]
    new["place"] = vertices
    return header + new.tobytes() + body[old.nbytes :]


def srgb_to_linear(colours: np.ndarray) -> np.ndarray:
    """Return linear light in [0,1] of sRGB values in [0,1] (IEC 61966-2-1)."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def _trimesh(triangles: Triangles, colours: np.ndarray, opacity: np.ndarray) -> trimesh.Trimesh:
    corners = len(triangles) * 3
    rgba = np.concatenate([colours.reshape(-1, 3), opacity.reshape(-1, 1)], axis=1)
    return trimesh.Trimesh(
        triangles.vertices.reshape(-1, 3),
        np.arange(corners).reshape(-1, 3),
        vertex_colors=np.rint(rgba * 255).astype(np.uint8),
        process=False,
    )


def unlit(tree: dict) -> None:
    """Give every primitive of a glTF tree one unlit, double-sided material, in place: a soup has no inside,
    its colours hold their light.
    """
    tree["materials"] = [
        {
            "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
            "doubleSided": True,
            "extensions": {"KHR_materials_unlit": {}},
        }
    ]
    tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", []), "KHR_materials_unlit"})
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
