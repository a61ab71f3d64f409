"""What every export format starts from: coloured triangles with an opacity per corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from paper_artifact.errors import InputError
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

    def visible(self, threshold: float = THRESHOLD) -> Triangles:
        """Return the triangles whose mean opacity is at least `threshold`; InputError when none is left."""
        kept = self.opacity.mean(axis=1) >= threshold
        if not kept.any():
            raise InputError(
                f"no triangle has an opacity of at least {threshold}: the soup looks empty; train it further"
            )
        return Triangles(self.vertices[kept], self.colours[kept], self.opacity[kept])


def soup_triangles(soup: Soup) -> Triangles:
    """Return the soup's triangles with the colour of each corner baked in: viewers know no shading MLP.

    A corner's colour is the trained shading (base and MLP blended, DiffSoup) averaged over 14 directions to
    the camera, weighted with |cos| to the triangle's normal, so that the directions a triangle is seen from
    count most, from either side.
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
    return Triangles(vertices.numpy(), colours.clamp(0, 1).numpy(), soup.corner_opacity())


def mesh_triangles(mesh: Mesh, colour: tuple[float, float, float] = STONE) -> Triangles:
    """Return a mesh's faces as opaque triangles of one colour (RGB in [0,1])."""
    vertices = np.asarray(mesh.vertices, dtype=np.float32)[mesh.faces]
    colours = np.broadcast_to(np.float32(colour), vertices.shape).copy()
    return Triangles(vertices, colours, np.ones(vertices.shape[:2], dtype=np.float32))
