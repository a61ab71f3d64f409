"""Write ../THING/photographs/*.jpg and cameras.json: a mug on wood, a basket on cloth or a chain on stone,
photographed with a plain lens and sensor.

    python -m venv ../mitsuba && ../mitsuba/bin/pip install mitsuba trimesh scipy pillow
    ../mitsuba/bin/python data_scripts/mug/photograph.py [mug|basket|chain] [--samples 8] [--out DIR]

Mitsuba 3 renders (a path tracer: glaze, shadows, light between surfaces); the lens bends by one radial term,
the sensor adds shot and read noise, JPEG does the rest. Mitsuba is no dependency of the project: the
photographs are committed. cameras.json keeps the true camera centres, which only the comparison with the
truth reads.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

try:
    import mitsuba as mi
except ImportError as error:
    raise SystemExit(
        f"photograph.py needs mitsuba ({error}); its first lines say how to install it"
    ) from None

HERE = Path(__file__).parent
WIDTH, HEIGHT = 600, 450  # of a photograph, pixels
FOCAL = 760.0  # of the lens, pixels
BENT = -0.09  # radial distortion: r_bent = r (1 + BENT r²), r in focal lengths
MARGIN = 1.06  # how much more the pinhole picture shows than the photograph
TABLE = 11.0  # half side of the table, centimetres
TARGETS = {"mug": (0.6, 0.0, 3.6), "basket": (0.0, 0.0, 2.2), "chain": (0.0, 0.0, 1.8)}  # looked at, cm
VIEWS = {"mug": 42, "basket": 30, "chain": 30}
RINGS = ((16.0, 15), (34.0, 15), (54.0, 14))  # elevation in degrees and the share of the views


def decorated(points: np.ndarray, draws: np.random.Generator, banded: bool) -> np.ndarray:
    """Return colours (V,3) in [0,1] of vertices (V,3): painted spots, speckles; on the mug bands."""
    low, high = ([-5, -5, 0], [8, 5, 9.2]) if banded else (points.min(0), points.max(0))
    colour = np.tile([0.88, 0.84, 0.74], (len(points), 1))
    cells = draws.uniform(low, high, (900, 3))
    paints = np.array([[0.12, 0.22, 0.5], [0.65, 0.2, 0.12], [0.2, 0.45, 0.3], [0.85, 0.6, 0.15]])
    distance, nearest = cKDTree(cells).query(points)
    spot = distance < draws.uniform(0.2, 0.62, len(cells))[nearest]
    colour[spot] = paints[draws.integers(0, 4, len(cells))[nearest[spot]]]
    if banded:
        radius, z, angle = np.hypot(*points.T[:2]), points[:, 2], np.arctan2(points[:, 1], points[:, 0])
        for middle, waves, width in ((7.6, 7, 0.22), (1.5, 11, 0.16)):
            band = (radius > 3.8) & (np.abs(z - middle - 0.35 * np.sin(waves * angle)) < width)
            colour[band] = [0.1, 0.16, 0.38]
    grains = draws.uniform(low, high, (6000, 3))
    near, grain = cKDTree(grains).query(points)
    colour[near < 0.075] *= draws.uniform(0.35, 0.8, len(grains))[grain[near < 0.075], None]
    return np.clip(colour, 0, 1)


def cloth_picture(draws: np.random.Generator, size: int = 1024) -> np.ndarray:
    """Return a cloth's picture (size,size,3) float32 in [0,1]: checks of three colours, threads, creases."""
    across = np.repeat(draws.integers(0, 3, size // 32), 32)
    colours = np.array([[0.75, 0.71, 0.6], [0.5, 0.13, 0.12], [0.16, 0.22, 0.38]])
    picture = (colours[across][None] + colours[np.roll(across, 7)][:, None]) / 2
    threads = 1 + 0.12 * np.sin(np.arange(size) * np.pi / 2)
    creases = gaussian_filter(draws.standard_normal((size, size)), 18) * 9
    spots = gaussian_filter(draws.standard_normal((size, size)), 1.5) * 1.2
    return np.clip(picture * (threads[:, None] * threads + creases + spots)[..., None], 0.02, 1)


def stone_picture(draws: np.random.Generator, size: int = 1024) -> np.ndarray:
    """Return a stone's picture (size,size,3) float32 in [0,1]: grains of every size, dark veins."""
    noise = [gaussian_filter(draws.standard_normal((size, size)), scale) * scale for scale in (1, 3, 9, 40)]
    veins = np.abs(gaussian_filter(draws.standard_normal((size, size)), 25)) * 60 < 0.06
    grey = 0.42 + 0.1 * np.tanh(np.sum(noise, axis=0)) - 0.2 * veins
    return np.clip(grey[..., None] * [1.05, 1.0, 0.92], 0.02, 1)


def table_picture(draws: np.random.Generator, size: int = 1024) -> np.ndarray:
    """Return the table's picture (size,size,3) float32 in [0,1]: boards with grain, knots, and scattered
    print."""
    picture = np.empty((size, size, 3), np.float32)
    boards = 6
    for board in range(boards):
        rows = slice(board * size // boards, (board + 1) * size // boards)
        noise = draws.standard_normal((rows.stop - rows.start, size))
        grain = gaussian_filter(noise, (1.2, 40)) * 9 + gaussian_filter(noise, (8, 90)) * 30
        base = np.array([0.5, 0.33, 0.19]) * draws.uniform(0.75, 1.2)
        picture[rows] = base * (1 + 0.35 * np.tanh(grain))[..., None]
        picture[rows.start : rows.start + 3] *= 0.3
    for _ in range(900):
        row, column = draws.integers(0, size, 2)
        high, wide = draws.integers(3, 9), draws.integers(4, 26)
        ink = draws.choice([0.08, 0.85]) * draws.uniform(0.7, 1, 3)
        picture[row : row + high, column : column + wide] = ink
    return np.clip(picture, 0.02, 1)


GROUNDS = {"mug": table_picture, "basket": cloth_picture, "chain": stone_picture}


def camera_centres(views: int, target: tuple, draws: np.random.Generator) -> np.ndarray:
    """Return the centres (views,3), centimetres, of cameras that look at `target`, by ring."""
    shares = np.array([share for _, share in RINGS], float)
    counts = np.floor(views * shares / shares.sum()).astype(int)
    counts[0] += views - counts.sum()
    centres = []
    for (elevation, _), count in zip(RINGS, counts, strict=True):
        turn = 2 * np.pi * (np.arange(count) + draws.uniform(-0.15, 0.15, count) + draws.uniform()) / count
        rise = np.radians(elevation + draws.uniform(-4, 4, count))
        reach = draws.uniform(26, 29, count)
        away = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], 1)
        centres.append(away * reach[:, None])
    return np.concatenate(centres) + target


def scene_of(name: str, mesh: trimesh.Trimesh, draws: np.random.Generator) -> mi.Scene:
    """Return the Mitsuba scene: thing, ground, a large lamp, a grey room."""
    fine = mesh.subdivide().subdivide()
    colours = decorated(np.asarray(fine.vertices), draws, name == "mug")
    thing = mi.Mesh("thing", len(fine.vertices), len(fine.faces), has_vertex_normals=False, props=_glaze())
    thing.add_attribute("vertex_color", 3, colours.astype(np.float32).ravel())
    values = mi.traverse(thing)
    values["vertex_positions"] = np.asarray(fine.vertices, np.float32).ravel()
    values["faces"] = np.asarray(fine.faces, np.uint32).ravel()
    values.update()
    to_world = mi.ScalarTransform4f().translate([0, 0, 0]).scale([TABLE, TABLE, 1])
    lamp = mi.ScalarTransform4f().look_at(origin=[14, -18, 30], target=[0, 0, 3], up=[0, 0, 1]).scale(5)
    board = mi.Bitmap(GROUNDS[name](draws).astype(np.float32))
    ground = {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": board, "raw": True}}
    light = {"type": "area", "radiance": {"type": "rgb", "value": [19.0, 18.0, 16.0]}}
    parts = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "thing": thing,
        "table": {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "twosided", "inside": ground}},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": light},
        "room": {"type": "constant", "radiance": {"type": "rgb", "value": [0.42, 0.45, 0.5]}},
    }
    return mi.load_dict(parts)


def _glaze() -> mi.Properties:
    """Return the properties of a mesh that is painted by its vertices and glazed."""
    properties, paint = mi.Properties(), {"type": "mesh_attribute", "name": "vertex_color"}
    glaze = {"roughness": 0.45, "clearcoat": 0.6, "clearcoat_gloss": 0.9}
    properties["bsdf"] = mi.load_dict({"type": "principled", "base_color": paint, **glaze})
    return properties


def photographed(
    scene: mi.Scene, centre: np.ndarray, target: tuple, samples: int, draws: np.random.Generator
) -> Image.Image:
    """Return one photograph: pinhole picture, bent by the lens, noise, sRGB."""
    wide, high = round(WIDTH * MARGIN), round(HEIGHT * MARGIN)
    place = mi.ScalarTransform4f().look_at(origin=list(centre), target=list(target), up=[0, 0, 1])
    camera = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(wide / 2 / FOCAL))),
        "fov_axis": "x",
        "to_world": place,
        "film": {"type": "hdrfilm", "width": wide, "height": high, "rfilter": {"type": "gaussian"}},
        "sampler": {"type": "independent", "sample_count": samples},
    }
    sensor = mi.load_dict(camera)
    seed = int(draws.integers(2**31))
    plain = np.array(mi.render(scene, sensor=sensor, spp=samples, seed=seed))[..., :3]
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    bent_x, bent_y = (x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL
    bent = np.hypot(bent_x, bent_y)
    straight = bent.copy()
    for _ in range(20):  # of r_bent = r (1 + BENT r²), solved for r
        straight = bent / (1 + BENT * straight**2)
    ratio = straight / np.maximum(bent, 1e-12)
    where = [bent_y * ratio * FOCAL + high / 2 - 0.5, bent_x * ratio * FOCAL + wide / 2 - 0.5]
    light = np.stack([map_coordinates(plain[..., c], where, order=1, mode="nearest") for c in range(3)], -1)
    light = np.clip(light, 0, 1)
    light += draws.standard_normal(light.shape) * np.sqrt(light / 9000 + 0.0018**2)  # shot noise, read noise
    light = np.clip(light, 0, 1)
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return Image.fromarray(np.rint(255 * shown).astype(np.uint8))


def main() -> None:
    """Photograph a thing from all sides."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("thing", choices=TARGETS, nargs="?", default="mug")
    parser.add_argument("--samples", type=int, default=8, help="paths per pixel")
    parser.add_argument("--out", type=Path, default=None, help="photographs that are there stay")
    given = parser.parse_args()
    mi.set_variant("scalar_rgb")
    home, target = HERE.parent / given.thing, TARGETS[given.thing]
    scene = scene_of(given.thing, trimesh.load(home / f"{given.thing}.ply"), np.random.default_rng(1))
    centres = camera_centres(VIEWS[given.thing], target, np.random.default_rng(2))
    out = given.out or home
    folder = out / "photographs"
    folder.mkdir(parents=True, exist_ok=True)
    true = {}
    for index, centre in enumerate(centres):
        name = f"{given.thing}_{index:02d}.jpg"
        true[name] = [round(float(value), 5) for value in centre]
        if not (folder / name).is_file():
            picture = photographed(scene, centre, target, given.samples, np.random.default_rng([3, index]))
            picture.save(folder / name, quality=80)
            print(name, flush=True)
    facts = {"unit": "centimetre", "focal": FOCAL, "distortion": BENT, "centres": true}
    (out / "cameras.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
