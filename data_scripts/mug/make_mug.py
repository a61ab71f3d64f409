"""Write mug.ply: a mug with a thin wall and a handle, one closed surface of genus 1, centimetres, +z up.

    python data_scripts/mug/make_mug.py [--out FILE]          # in this project's environment
    python -m paper_artifact certify data_scripts/mug/mug.ply

The mug is the zero set of a signed-distance-like function (rounded cylinder, ring of elliptic section, cavity
cut out, smooth joints), made triangles by marching cubes of scikit-image.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import trimesh
from skimage.measure import marching_cubes

HERE = Path(__file__).parent
RADIUS, HEIGHT, WALL, BOTTOM = 4.0, 9.0, 0.55, 0.8  # of the cup, centimetres
HANDLE = (3.9, 4.6, 2.7, 2.8)  # of the ring that is the handle: middle x and z, radii along x and z
GRIP = (0.55, 0.8)  # half width of the ring's section, in the ring's plane and across
CELL = 0.25  # of the grid of marching cubes


def rounded_cylinder(radius, z, outer, low, high, rounding):
    """Return the signed distance to a cylinder about the z axis between two heights, its edges rounded."""
    across = radius - outer + rounding
    along = np.abs(z - (low + high) / 2) - (high - low) / 2 + rounding
    outside = np.hypot(np.maximum(across, 0), np.maximum(along, 0))
    return outside + np.minimum(np.maximum(across, along), 0) - rounding


def smooth_min(a, b, width):
    """Return min(a, b), rounded where the two differ by less than `width`."""
    share = np.clip(0.5 + (b - a) / (2 * width), 0, 1)
    return b + (a - b) * share - width * share * (1 - share)


def mug(x, y, z):
    """Return the mug's function: negative inside, zero on the surface, about a distance; arrays of one
    shape."""
    radius = np.hypot(x, y)
    cup = rounded_cylinder(radius, z, RADIUS, 0.0, HEIGHT, 0.5)
    middle_x, middle_z, across, along = HANDLE
    angle = np.arctan2((z - middle_z) / along, (x - middle_x) / across)
    ring = np.hypot(x - middle_x - across * np.cos(angle), z - middle_z - along * np.sin(angle))
    handle = (np.hypot(ring / GRIP[0], y / GRIP[1]) - 1) * GRIP[0]
    cavity = rounded_cylinder(radius, z, RADIUS - WALL, BOTTOM, 2 * HEIGHT, 0.9)
    return -smooth_min(-smooth_min(cup, handle, 0.5), cavity, 0.2)


def mug_mesh(cell: float = CELL) -> trimesh.Trimesh:
    """Return the mug as a closed mesh, centimetres."""
    low, high = np.array([-5.03, -5.07, -1.09]), np.array([8.0, 5.0, 10.0])  # no vertex falls on a grid point
    axes = [np.arange(a, b + cell, cell) for a, b in zip(low, high, strict=True)]
    values = mug(*np.meshgrid(*axes, indexing="ij"))
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(cell,) * 3)
    mesh = trimesh.Trimesh((vertices + low).astype(np.float32), faces, process=True)
    mesh.fix_normals()
    return mesh


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE / "mug.ply")
    out = parser.parse_args().out
    mesh = mug_mesh()
    out.write_bytes(mesh.export(file_type="ply", vertex_normal=False))
    print(f"{out}: {len(mesh.vertices)} vertices, {len(mesh.faces)} triangles, closed {mesh.is_watertight}")
