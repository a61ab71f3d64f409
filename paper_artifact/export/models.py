"""Coloured triangles with an opacity per corner, what every export starts from; PLY and GLB files of them, in
the user's coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.ply import export_ply

from paper_artifact.errors import InputError
from paper_artifact.files import write_bytes
from paper_artifact.formats.polygons import with_doubles
from paper_artifact.frame import SAME, Frame
from paper_artifact.mesh import Mesh
from paper_artifact.raster.twin import spherical_harmonics
from paper_artifact.soup.state import Soup

# Evaluation shows fragments of at least this opacity; formats without opacity per pixel drop triangles below.
THRESHOLD = 0.5
STONE = (0.72, 0.70, 0.66)  # colour of a mesh that has none


@dataclass(frozen=True, eq=False)
class Triangles:
    """T coloured triangles."""

    vertices: np.ndarray  # (T,3,3) float32, world units
    colours: np.ndarray  # (T,3,3) float32 RGB of each corner in [0,1], as shown on a screen (sRGB)
    opacity: np.ndarray  # (T,3) float32 of each corner in [0,1]

    def __len__(self) -> int:
        return len(self.vertices)

    def visible(self) -> Triangles:
        """Return the triangles whose mean opacity is at least THRESHOLD; InputError when none is left."""
        kept = self.opacity.mean(axis=1) >= THRESHOLD
        if not kept.any():
            raise InputError(
                f"no triangle has an opacity of at least {THRESHOLD}: the soup looks empty; train it further"
            )
        return Triangles(self.vertices[kept], self.colours[kept], self.opacity[kept])


def soup_triangles(soup: Soup) -> Triangles:
    """Return the soup's triangles with the colour of each corner baked in: viewers know no shading MLP.

    A corner's colour is the trained shading (base and MLP blended, DiffSoup) averaged over 14 directions to
    the camera, weighted with |cos| to the triangle's normal, so that the directions a triangle is seen from
    count most, from either side. Raises InputError where numbers of the soup are not finite or too large.
    """
    with torch.no_grad():
        vertices, features = soup.vertices.detach().cpu(), torch.sigmoid(soup.features.detach().cpu())
        axes = torch.cat(
            [torch.eye(3), torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3) / 3**0.5, -torch.eye(3)]
        )
        normals = torch.linalg.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
        # 1e-6: all directions count alike for a triangle without area
        weights = (torch.nn.functional.normalize(normals, dim=1) @ axes.T).abs() + 1e-6
        weights = weights / weights.sum(dim=1, keepdim=True)
        w1, c1, w2, c2, w3, c3 = (tensor.detach().cpu() for tensor in soup.mlp)
        shaded = torch.zeros(len(vertices), 3, 3)
        for direction, weight in zip(axes, weights.T, strict=True):
            harmonics = spherical_harmonics(direction).expand(len(vertices), 3, 9)
            hidden = torch.relu(torch.cat([features, harmonics], dim=2) @ w1.T + c1)
            shaded += weight[:, None, None] * torch.sigmoid(torch.relu(hidden @ w2.T + c2) @ w3.T + c3)
        blend = features[:, :, 3:4]
        colours = (1 - blend) * features[:, :, :3] + blend * shaded
    if not torch.isfinite(colours).all():
        raise InputError(
            "the soup's triangles are too large or not finite, so they have no colours; train it again"
        )
    return Triangles(vertices.numpy(), colours.clamp(0, 1).numpy(), soup.corner_opacity())


def mesh_triangles(mesh: Mesh) -> Triangles:
    """Return a mesh's faces as opaque triangles of the colour STONE."""
    return plain_triangles(np.asarray(mesh.vertices)[mesh.faces])


def plain_triangles(corners: np.ndarray, colour: tuple[float, ...] = STONE) -> Triangles:
    """Return opaque triangles of corners (T,3,3), world units, and one colour, sRGB in [0,1]."""
    colours = np.broadcast_to(np.array(colour, np.float32), corners.shape).copy()
    return Triangles(corners.astype(np.float32), colours, np.ones(corners.shape[:2], dtype=np.float32))


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
    return export_glb(scene, include_normals=False, tree_postprocessor=_unlit)


def ply_bytes(mesh: trimesh.Trimesh, frame: Frame = SAME) -> bytes:
    """Return binary PLY of a mesh with vertex colours; frame: of its coordinates; where it is not the user's
    own, x y z are doubles, since floats may not resolve them."""
    data = export_ply(mesh, vertex_normal=False)
    return data if frame == SAME else with_doubles(data, frame.outward(mesh.vertices))


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


def _unlit(tree: dict) -> None:
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
