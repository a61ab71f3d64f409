"""PLY and GLB files of coloured triangles, through trimesh. Positions are world units, as trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.ply import export_ply

from paper_artifact.export.triangles import Triangles
from paper_artifact.files import write_bytes


def write_ply(path: Path | str, triangles: Triangles) -> None:
    """Write all triangles as binary PLY: per corner x y z, red green blue (sRGB bytes), alpha (opacity byte).

    Raises InputError when `path` is not writable.
    """
    write_bytes(path, export_ply(_trimesh(triangles, triangles.colours, triangles.opacity)))


def write_glb(path: Path | str, triangles: Triangles) -> None:
    """Write the triangles of mean opacity ≥ .5 as binary glTF 2.0, unlit, double-sided, with vertex colours.

    glTF wants COLOR_0 linear, so the bytes are the colours after the inverse sRGB curve; a conforming viewer
    shows the trained colours. Opacity is left out: soups blended without sorting look wrong. Raises
    InputError as `Triangles.visible` does, and when `path` is not writable.
    """
    shown = triangles.visible()
    mesh = _trimesh(shown, srgb_to_linear(shown.colours), np.ones_like(shown.opacity))
    write_bytes(path, export_glb(mesh.scene(), include_normals=False, tree_postprocessor=unlit))


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
