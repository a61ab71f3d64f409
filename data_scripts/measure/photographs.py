"""Mug, basket and chain (data_scripts/THING) from their photographs: registered anew, trained, held against
the true surface.

    python data_scripts/measure/photographs.py [--things basket chain] [--seeds 0]   # rows of others stay

One row per thing, condition and seed: distances over the thing's diagonal, significant bars and bottleneck of
20,000 samples of what the soup has inside the thing's box and above the ground; psnr with one ray a pixel,
psnr_rays with RAYS × RAYS; genus and components of the subject's solid at every offset, the smallest offset
that gives the wanted topology and that solid's Chamfer. Notebook 18 reads it. Also writes
results/pictures/mug.png, of the first soup that has a solid. Needs pycolmap; ten minutes of CPU a thing.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

from common import kept, options, write

import numpy as np
import pandas as pd
import torch
from PIL import Image

from paper_artifact.catalogue import study_config
from paper_artifact.config import GivenConfig
from paper_artifact.evaluate.geometry import Similarity, similarity
from paper_artifact.evaluate.image import view_scores
from paper_artifact.evaluate.scores import Target, evaluate_samples, make_target, soup_samples
from paper_artifact.export.flat import render_flat
from paper_artifact.export.solid import SoupSolid, distances_to, solidify_soup
from paper_artifact.files import REPOSITORY, RESULTS, partial_folder, write_bytes
from paper_artifact.mesh import Mesh, load_mesh
from paper_artifact.photos.scene import PhotosConfig, photographs_scene
from paper_artifact.pipeline import run
from paper_artifact.randomness import stream
from paper_artifact.record.store import config_of, record_path
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.subject import Subject, subject_of_scene
from paper_artifact.soup.state import Soup, load_soup, render_views

SCRIPTS = REPOSITORY / "data_scripts"
SIZE = 400  # longest side of the scene's images, pixels
# The stated numbers. Samples of the mug show its handle as a loop from M = 8192 on, the second loop and the
# void of the thin wall at no density up to 20,000: one sheet with one loop; the basket likewise. The solid
# around such a sheet has as many handles.
BETTI = {"mug": (1, 1, 0), "basket": (1, 2, 0), "chain": (3, 6, 3)}
SAMPLES = 8192
ARMS = ("C0", "T1", "T3")
SETTINGS: dict[str, Any] = {"budget": 3000, "batch": 1, "steps": 2500, "dump_steps": (2500,)}
HOLDOUT = "8"  # every 8th photograph
RAYS = 2  # per side of a pixel, where a photograph's averaging over it is imitated
OFFSETS = {"chain": (0.0075, 0.01, 0.015, 0.02)}  # ε / diagonal of the subject's triangles; links are close
OFFSETS |= dict.fromkeys(("mug", "basket"), (0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06))
SHOWN = 3  # of the views held out, in the picture
MARGIN = 0.3  # centimetres around a thing that still count as it; below z = MARGIN is the ground


def measured(thing: str, seeds: list[int]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a thing; write the picture of the mug."""
    shown = thing != "mug"
    truth = load_mesh(SCRIPTS / thing / f"{thing}.ply")  # centimetres
    with partial_folder() as folder:
        place = folder / thing
        photographs_scene(SCRIPTS / thing / "photographs", place, PhotosConfig(size=SIZE))
        scene, subject = load_scene(place, holdout=HOLDOUT), subject_of_scene(place)
        target, to_truth = make_target(truth), similarity(*centres(place, thing))
        for seed, condition in product(seeds, ARMS):
            soup, record = trained(place, condition, seed, Path(folder) / "results", BETTI[thing])
            held = np.flatnonzero(subject.holds(soup.vertices.numpy().mean(1)))
            of_it = soup.select(torch.from_numpy(held))
            solid = solidify_soup(of_it, BETTI[thing], OFFSETS[thing])
            row = {"thing": thing, "condition": condition, "seed": seed}
            row |= against_the_truth(soup, truth, target, to_truth)
            row |= {"psnr": record["images"]["psnr"], "ssim": record["images"]["ssim"]}
            row |= {"psnr_rays": view_scores(soup, scene, scene.holdout, RAYS)["psnr"]}
            row |= {"triangles": len(soup), "cpu": record["cpu_seconds"]}
            yield row | of_the_solid(solid, truth, to_truth)
            if solid.mesh is not None and not shown:
                shown = True
                write_bytes(RESULTS / "pictures" / "mug.png", strip(soup, scene, solid, subject))


def trained(scene: Path, condition: str, seed: int, results: Path, betti: tuple) -> tuple[Soup, dict]:
    """Return the final soup and the record of one run."""
    loss = {} if condition == "C0" else {"betti": betti, "samples": SAMPLES}
    config = study_config(str(scene), condition, seed, loss=loss, **SETTINGS)
    record = run(replace(config, given=GivenConfig(holdout=HOLDOUT)), results=results, device="cpu")
    stem = record_path(config_of(record), results / "runs", record["defaults"]).stem
    return load_soup(results / "soups" / f"{stem}.npz"), record


def against_the_truth(soup: Soup, truth: Mesh, target: Target, to_truth: Similarity) -> dict[str, float]:
    """Return Chamfer, Hausdorff95, counts and bottlenecks of what the soup has in the thing's box."""
    corners = to_truth.apply(soup.vertices.detach().numpy())
    low, high = truth.vertices.min(0) - MARGIN, truth.vertices.max(0) + MARGIN
    low[2] = MARGIN
    kept = ((corners.mean(1) > low) & (corners.mean(1) < high)).all(1)
    opacity, generator = soup.corner_opacity()[kept], stream(0, "mug samples")
    samples = soup_samples(corners[kept], opacity, len(target.samples), generator)
    found = evaluate_samples(samples, target)
    return {
        "on_it": int(kept.sum()),
        "chamfer": found["chamfer"],
        "hausdorff95": found["hausdorff95"],
        **{f"count_{k}": found["counts"][k] for k in range(3)},
        **{f"target_{k}": target.counts[k] for k in range(3)},
        **{f"bottleneck_{k}": found["bottleneck"][k] for k in range(3)},
    }


def of_the_solid(solid: SoupSolid, truth: Mesh, to_truth: Similarity) -> dict[str, Any]:
    """Return genus and components at every offset, the smallest offset that gives the wanted topology (NaN:
    none) and that solid's Chamfer to the truth."""
    row: dict[str, Any] = {
        "offsets": "/".join(f"{rung.offset:g}" for rung in solid.rungs),
        "genus": "/".join(str(rung.genus) for rung in solid.rungs),
        "components": "/".join(str(rung.betti[0]) for rung in solid.rungs),
        "solid_offset": np.nan,
        "solid_chamfer": np.nan,
    }
    if solid.rung is not None and solid.mesh is not None:
        aligned = replace(solid.mesh, vertices=to_truth.apply(solid.mesh.vertices))
        row |= {"solid_offset": solid.rung.offset, "solid_chamfer": distances_to(aligned, truth)["chamfer"]}
    return row


def strip(soup: Soup, scene: Scene, solid: SoupSolid, subject: Subject) -> bytes:
    """Return a PNG: a photograph that was held out, the soup's render of it, and its solid."""
    view, points, faces = scene.holdout[SHOWN : SHOWN + 1], solid.mesh.vertices, solid.mesh.faces
    photograph, render = scene.colours(view)[0], render_views(soup, scene, view, RAYS)[0]
    x, y, z = scene.camera_centres[view[0]] - points.mean(0)
    up, colours = tuple(subject.up), np.minimum(1, 1.4 * solid.colours[faces].mean(1))
    made = render_flat(points, faces, len(photograph), direction=(x, y, z), up=up, material=colours)
    pixels, png = np.concatenate([photograph, render, made], axis=1).clip(0, 1), BytesIO()
    Image.fromarray(np.rint(255 * pixels).astype(np.uint8)).save(png, "PNG", optimize=True)
    return png.getvalue()


def centres(scene: Path, thing: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera centres (n,3) of the model in a folder, in its frame, and the true ones in cm."""
    model = read_model(scene / "sparse" / "0")
    true = json.loads((SCRIPTS / thing / "cameras.json").read_text(encoding="utf-8"))["centres"]
    ours = np.stack([model.camera(index).position for index in model.images])
    return ours, np.array([true[pose.name] for pose in model.images.values()])


if __name__ == "__main__":
    given = options(
        __doc__,
        things={"nargs": "+", "choices": BETTI, "default": list(BETTI)},
        seeds={"nargs": "+", "type": int, "default": [0, 1, 2]},
    )
    file, key = given.out / "photographs.csv", ["thing", "condition", "seed"]
    table = kept(file, key)
    for name in given.things:
        for row in measured(name, given.seeds):
            table = pd.concat([table, pd.DataFrame([row])]).drop_duplicates(key, keep="last")
            write(table, file)
