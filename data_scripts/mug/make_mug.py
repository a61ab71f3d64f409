"""Write ../THING/THING.ply, centimetres, +z up: closed surfaces to be photographed.

    python data_scripts/mug/make_mug.py [mug|basket|chain] [--out FILE]     # in this project's environment
    python -m paper_artifact certify data_scripts/basket/basket.ply

mug: a thin wall and a handle, genus 1. basket: wide and low, open, a thin wall and two handles, genus 2.
chain: three links through one another, each of genus 1, turned a quarter against the next. Each is the zero
set of a signed-distance-like function (rounded cylinder, rings, cavity cut out, smooth joints), made
triangles by marching cubes of scikit-image.
"""

import argparse
from pathlib import Path

from paper_artifact.cli import as_script

as_script()  # before what takes long to import

import numpy as np
import trimesh
from skimage.measure import marching_cubes

from paper_artifact.errors import InputError
from paper_artifact.files import write_bytes

HERE = Path(__file__).parent
WALL, BOTTOM = 0.55, 0.8  # of a cup, centimetres
MUG = (4.0, 9.0, (3.9, 4.6, 2.7, 2.8), (1,))  # radius, height, handle, the sides (±x) that have one
BASKET = (5.0, 5.0, (4.9, 2.7, 2.6, 1.7), (1, -1))  # handle: a ring's middle x and z, radii along x and z
GRIP = (0.55, 0.8)  # half width of the ring's section, in the ring's plane and across
LINK = (2.3, 0.55, 3.1)  # of the chain: radius, half thickness, distance to the next
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


def cup(x, y, z, radius, height, handle, sides):
    """Return a cup's function: negative inside, zero on the surface, about a distance."""
    around = np.hypot(x, y)
    body = rounded_cylinder(around, z, radius, 0.0, height, 0.5)
    middle_x, middle_z, across, along = handle
    for side in sides:
        angle = np.arctan2((z - middle_z) / along, (side * x - middle_x) / across)
        ring = np.hypot(side * x - middle_x - across * np.cos(angle), z - middle_z - along * np.sin(angle))
        body = smooth_min(body, (np.hypot(ring / GRIP[0], y / GRIP[1]) - 1) * GRIP[0], 0.5)
    cavity = rounded_cylinder(around, z, radius - WALL, BOTTOM, 2 * height, 0.9)
    return -smooth_min(-body, cavity, 0.2)


def chain(x, y, z):
    """Return the function of three links along x, leaning to the left, right, left by 45 degrees."""
    radius, thick, apart = LINK
    z = z - (radius / np.sqrt(2) + thick)
    links = []
    for place, lean in ((-apart, 1), (0.0, -1), (apart, 1)):
        flat, off = (y + lean * z) / np.sqrt(2), (z - lean * y) / np.sqrt(2)  # in the link's plane, out of it
        links.append(np.hypot(np.hypot(x - place, flat) - radius, off) - thick)
    return np.minimum.reduce(links)


THINGS = {
    "mug": (lambda x, y, z: cup(x, y, z, *MUG), (-5.03, -5.07, -1.09), (8.0, 5.0, 10.0)),
    "basket": (lambda x, y, z: cup(x, y, z, *BASKET), (-8.53, -5.57, -1.09), (8.5, 5.5, 6.0)),
    "chain": (chain, (-6.53, -3.07, -1.09), (6.5, 3.0, 6.0)),
}  # function, and the corners of a box whose grid no vertex falls on


def mesh_of(thing: str, cell: float = CELL) -> trimesh.Trimesh:
    """Return a thing as a closed mesh, centimetres."""
    function, low, high = THINGS[thing]
    axes = [np.arange(a, b + cell, cell) for a, b in zip(low, high, strict=True)]
    values = function(*np.meshgrid(*axes, indexing="ij"))
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(cell,) * 3)
    mesh = trimesh.Trimesh((vertices + np.array(low)).astype(np.float32), faces, process=True)
    mesh.fix_normals()
    return mesh


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("thing", choices=THINGS, nargs="?", default="mug")
    parser.add_argument("--out", type=Path, default=None)
    given = parser.parse_args()
    if given.out is not None and given.out.suffix.lower() != ".ply":
        parser.error(f"--out is a PLY file, name.ply, got {given.out}")
    out = given.out or HERE.parent / given.thing / f"{given.thing}.ply"
    mesh = mesh_of(given.thing)
    try:
        write_bytes(out, mesh.export(file_type="ply", vertex_normal=False))
    except InputError as error:
        parser.error(str(error))
    print(f"{out}: {len(mesh.vertices)} vertices, {len(mesh.faces)} triangles, closed {mesh.is_watertight}")
