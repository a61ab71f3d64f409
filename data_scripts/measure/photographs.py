"""The mug of data_scripts/mug from its photographs: registered anew, trained, held against its true surface.

One row per condition and seed: distances over the mug's diagonal, significant bars and bottleneck of 20,000
samples of what the soup has inside the mug's box and above the table; psnr with one ray a pixel, psnr_rays
with RAYS × RAYS; genus and components of the subject's solid at every offset, the smallest offset that gives
the mug's topology and that solid's Chamfer. Notebook 18 reads it. Also writes results/pictures/mug.png, of
the first soup that has a solid. Needs pycolmap; ten minutes of CPU.
"""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import torch
from common import options, write
from PIL import Image

from paper_artifact.catalogue import study_config
from paper_artifact.config import GivenConfig
from paper_artifact.evaluate.geometry import Similarity, similarity
from paper_artifact.evaluate.image import view_scores
from paper_artifact.evaluate.scores import Target, evaluate_samples, make_target, soup_samples
from paper_artifact.export.flat import render_flat
from paper_artifact.export.solid import SoupSolid, distances_to, solidify_soup
from paper_artifact.files import REPOSITORY, RESULTS, write_bytes
from paper_artifact.mesh import load_mesh
from paper_artifact.photos.scene import PhotosConfig, photographs_scene
from paper_artifact.pipeline import run
from paper_artifact.randomness import stream
from paper_artifact.record.store import config_of, record_path
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.subject import Subject, subject_of_scene
from paper_artifact.soup.state import Soup, load_soup, render_views

FOLDER = REPOSITORY / "data_scripts" / "mug"
MUG = load_mesh(FOLDER / "mug.ply")  # centimetres
SIZE = 400  # longest side of the scene's images, pixels
# Settings of the condition's loss. Samples of the mug show its handle as a loop from M = 8192 on, the second
# loop and the void of the thin wall at no density up to 20,000.
WORDS: dict[str, Any] = {"betti": (1, 1, 0), "samples": 8192}
ARMS: dict[str, dict[str, Any]] = {"C0": {}, "T1": WORDS, "T3": WORDS}
SETTINGS: dict[str, Any] = {"budget": 3000, "batch": 1, "steps": 2500, "dump_steps": (2500,)}
SEEDS = (0, 1, 2)
HOLDOUT = "8"  # every 8th photograph
RAYS = 2  # per side of a pixel, where a photograph's averaging over it is imitated
BETTI = (1, 1, 0)  # of the mug as one sheet: its handle; the solid around it has genus 1
OFFSETS = (0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06)  # ε / diagonal of the subject's triangles
SHOWN = 3  # of the views held out, in the picture
MARGIN = 0.3  # centimetres around the mug that still count as the mug; below z = MARGIN is the table


def measured() -> pd.DataFrame:
    """Return the table; write the picture."""
    rows, shown = [], False
    with TemporaryDirectory() as folder:
        place = Path(folder) / "mug"
        photographs_scene(FOLDER / "photographs", place, PhotosConfig(size=SIZE))
        scene, subject = load_scene(place, holdout=HOLDOUT), subject_of_scene(place)
        target, to_truth = make_target(MUG, cache=None), similarity(*centres(place))
        for seed in SEEDS:
            for condition in ARMS:
                soup, record = trained(place, condition, seed, Path(folder) / "results")
                of_it = subject.holds(soup.vertices.numpy().mean(1))
                solid = solidify_soup(soup.select(torch.from_numpy(np.flatnonzero(of_it))), BETTI, OFFSETS)
                row = {"condition": condition, "seed": seed} | against_the_mug(soup, target, to_truth)
                row |= {"psnr": record["images"]["psnr"], "ssim": record["images"]["ssim"]}
                row |= {"psnr_rays": view_scores(soup, scene, scene.holdout, RAYS)["psnr"]}
                row |= {"triangles": len(soup), "cpu": record["cpu_seconds"]}
                rows.append(row | of_the_solid(solid, to_truth))
                if solid.mesh is not None and not shown:
                    shown = True
                    write_bytes(RESULTS / "pictures" / "mug.png", strip(soup, scene, solid, subject))
    return pd.DataFrame(rows)


def trained(scene: Path, condition: str, seed: int, results: Path) -> tuple[Soup, dict]:
    """Return the final soup and the record of one run."""
    config = study_config(str(scene), condition, seed, loss=ARMS[condition], **SETTINGS)
    record = run(replace(config, given=GivenConfig(holdout=HOLDOUT)), results=results, device="cpu")
    stem = record_path(config_of(record), results / "runs", record["defaults"]).stem
    return load_soup(results / "soups" / f"{stem}.npz"), record


def against_the_mug(soup: Soup, target: Target, to_truth: Similarity) -> dict[str, float]:
    """Return Chamfer, Hausdorff95, counts and bottlenecks of what the soup has in the mug's box."""
    corners = to_truth.apply(soup.vertices.detach().numpy())
    low, high = MUG.vertices.min(0) - MARGIN, MUG.vertices.max(0) + MARGIN
    low[2] = MARGIN
    kept = ((corners.mean(1) > low) & (corners.mean(1) < high)).all(1)
    samples = soup_samples(
        corners[kept], soup.corner_opacity()[kept], len(target.samples), stream(0, "mug samples")
    )
    found = evaluate_samples(samples, target)
    return {
        "on_the_mug": int(kept.sum()),
        "chamfer": found["chamfer"],
        "hausdorff95": found["hausdorff95"],
        **{f"count_{k}": found["counts"][k] for k in range(3)},
        **{f"target_{k}": target.counts[k] for k in range(3)},
        **{f"bottleneck_{k}": found["bottleneck"][k] for k in range(3)},
    }


def of_the_solid(solid: SoupSolid, to_truth: Similarity) -> dict[str, Any]:
    """Return genus and components at every offset, the smallest offset that gives the mug's topology (NaN:
    none) and that solid's Chamfer to the mug."""
    row: dict[str, Any] = {
        "offsets": "/".join(f"{rung.offset:g}" for rung in solid.rungs),
        "genus": "/".join(str(rung.genus) for rung in solid.rungs),
        "components": "/".join(str(rung.betti[0]) for rung in solid.rungs),
        "solid_offset": np.nan,
        "solid_chamfer": np.nan,
    }
    if solid.rung is not None and solid.mesh is not None:
        aligned = replace(solid.mesh, vertices=to_truth.apply(solid.mesh.vertices))
        row |= {"solid_offset": solid.rung.offset, "solid_chamfer": distances_to(aligned, MUG)["chamfer"]}
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


def centres(scene: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera centres (n,3) of the model in a folder, in its frame, and the true ones in cm."""
    model = read_model(scene / "sparse" / "0")
    true = json.loads((FOLDER / "cameras.json").read_text(encoding="utf-8"))["centres"]
    ours = np.stack([model.camera(index).position for index in model.images])
    return ours, np.array([true[pose.name] for pose in model.images.values()])


if __name__ == "__main__":
    write(measured(), options(__doc__).out / "photographs.csv")
