"""Notebook 18: photographs of a mug, registered by structure from motion, trained, and held against the
truth.

The photographs are our own (data_scripts/mug/), and so is the mug: its mesh and the true camera centres are
known, in centimetres. The model that structure from motion made of the photographs is committed; the frame it
has is turned, moved and scaled onto the truth by the camera centres alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from PIL import Image

from paper_artifact.catalogue import study_config
from paper_artifact.config import GivenConfig
from paper_artifact.evaluate.align import Similarity, similarity
from paper_artifact.evaluate.image import view_scores
from paper_artifact.evaluate.scores import Target, evaluate_samples, make_target, soup_samples
from paper_artifact.export.flat import render_flat
from paper_artifact.export.solid import SoupSolid, distances_to, solidify_soup
from paper_artifact.files import REPOSITORY, RESULTS, write_bytes
from paper_artifact.ingest.distance import nearest_on
from paper_artifact.mesh import Mesh, load_mesh
from paper_artifact.pipeline import run
from paper_artifact.randomness import stream
from paper_artifact.record.store import config_of, record_path
from paper_artifact.report.kit.figures import image_rows
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.subject import Subject, subject_of_scene
from paper_artifact.soup.render import render_views
from paper_artifact.soup.state import Soup, load_soup

FOLDER = REPOSITORY / "data_scripts" / "mug"
SIZE = 400  # longest side of the scene's images, pixels
# Settings of the condition's loss. Samples of the mug show its handle as a loop from M = 8192 on, the second
# loop and the void of the thin wall at no density up to 20,000.
ARMS: dict[str, dict[str, Any]] = {"C0": {}, "T1": {"betti": (1, 1, 0), "samples": 8192}}
SETTINGS: dict[str, Any] = {"budget": 3000, "batch": 1, "steps": 2500, "dump_steps": (2500,)}
SEEDS = (0, 1, 2)
HOLDOUT = "8"  # every 8th photograph
RAYS = 2  # per side of a pixel, where a photograph's averaging over it is imitated
BETTI = (1, 1, 0)  # of the mug as one sheet: its handle; the solid around it has genus 1
OFFSETS = (0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06)  # ε / diagonal of the subject's triangles
SHOWN = 3  # of the views held out, in the picture
PICTURE = RESULTS / "pictures" / "mug.png"
MARGIN = 0.3  # centimetres around the mug that still count as the mug; below z = MARGIN is the table


@cache
def mug() -> Mesh:
    """Return the ground truth, centimetres."""
    return load_mesh(FOLDER / "mug.ply")


@cache
def alignment() -> tuple[Similarity, np.ndarray]:
    """Return the similarity from the committed model's frame to centimetres, and the distances (n,) that the
    cameras are then from where they truly were."""
    ours, theirs = _centres(FOLDER)
    found = similarity(ours, theirs)
    return found, np.linalg.norm(found.apply(ours) - theirs, axis=1)


def registration_table() -> pd.DataFrame:
    """Return what structure from motion made of the photographs, and how far it is from the truth."""
    model = read_model(FOLDER / "sparse" / "0")
    found, missed = alignment()
    cloud = found.apply(model.positions)
    near = cloud[_inside(cloud)]
    photographs = list((FOLDER / "photographs").glob("*.jpg"))
    rows = {
        "photographs": len(photographs),
        "MB in all": round(sum(file.stat().st_size for file in photographs) / 1e6, 2),
        "registered": len(model.images),
        "points of the cloud": len(cloud),
        "of them on the mug": len(near),
        "cameras off by, median, millimetres": round(10 * float(np.median(missed)), 3),
        "cameras off by, at most, millimetres": round(10 * float(missed.max()), 3),
        "points off the mug, median, millimetres": round(10 * _off(near), 3),
    }
    return pd.DataFrame({"value": [f"{value:g}" for value in rows.values()]}, index=list(rows))


def photographs_figure(names: tuple[str, ...] = ("00", "08", "17", "24", "33", "40")) -> Figure:
    """Return some of the photographs, by number."""
    pictures = [np.asarray(Image.open(FOLDER / "photographs" / f"mug_{name}.jpg")) / 255 for name in names]
    return image_rows([("", pictures[:3]), ("", pictures[3:])], size=2.4)


def measure_photographs(
    progress: Callable[[str], None] | None = None, seeds: Sequence[int] = SEEDS, picture: Path = PICTURE
) -> pd.DataFrame:
    """Return one row per arm and seed: the photographs registered anew (pycolmap), trained, held against the
    mug, and made solid; writes README's picture, of the first that has a solid.

    Distances are divided by the mug's diagonal, the counts are of 20,000 samples of what the soup has inside
    the mug's box and above the table. psnr: one ray a pixel, as in records; psnr_rays: RAYS × RAYS.
    """
    from paper_artifact.photos.scene import PhotosConfig, photographs_scene

    tell = progress or (lambda text: None)
    rows, shown = [], False
    with TemporaryDirectory() as folder:
        folder_of_scene, results = Path(folder) / "mug", Path(folder) / "results"
        tell("photographs: structure from motion")
        photographs_scene(FOLDER / "photographs", folder_of_scene, PhotosConfig(size=SIZE))
        scene, subject = load_scene(folder_of_scene, holdout=HOLDOUT), subject_of_scene(folder_of_scene)
        target, to_truth = make_target(mug(), cache=None), similarity(*_centres(folder_of_scene))
        for seed in seeds:
            for condition, loss in ARMS.items():
                config = study_config(str(folder_of_scene), condition, seed, loss=loss, **SETTINGS)
                config = replace(config, given=GivenConfig(holdout=HOLDOUT))
                record = run(
                    config,
                    results=results,
                    device="cpu",
                    progress=lambda step, text: tell(f"step {step}, {text}"),
                )
                stem = record_path(config_of(record), results / "runs", record["defaults"]).stem
                soup = load_soup(results / "soups" / f"{stem}.npz")
                of_it = subject.holds(soup.vertices.numpy().mean(1))
                solid = solidify_soup(soup.select(torch.from_numpy(np.flatnonzero(of_it))), BETTI, OFFSETS)
                row = {"condition": condition, "seed": seed} | _against_the_mug(soup, target, to_truth)
                rows.append(row | _scores(soup, scene, record) | _of_the_solid(solid, to_truth))
                if solid.mesh is not None and not shown:
                    shown = True
                    write_bytes(picture, _strip(soup, scene, solid, subject))
    return pd.DataFrame(rows)


def _scores(soup: Soup, scene: Scene, record: dict) -> dict[str, float]:
    return {
        "psnr": record["images"]["psnr"],
        "ssim": record["images"]["ssim"],
        "psnr_rays": view_scores(soup, scene, scene.holdout, RAYS)["psnr"],
        "triangles": len(soup),
        "cpu": record["cpu_seconds"],
    }


def _against_the_mug(soup: Soup, target: Target, to_truth: Similarity) -> dict[str, float]:
    """Return Chamfer, Hausdorff95, counts and bottlenecks of what the soup has in the mug's box."""
    corners = to_truth.apply(soup.vertices.detach().numpy())
    kept = _inside(corners.mean(1))
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


def _of_the_solid(solid: SoupSolid, to_truth: Similarity) -> dict[str, Any]:
    """Return the smallest offset that gives the mug's topology (empty: none), the genus and components at
    every offset, and the solid's distance to the mug."""
    row: dict[str, Any] = {
        "offsets": "/".join(f"{rung.offset:g}" for rung in solid.rungs),
        "genus": "/".join(str(rung.genus) for rung in solid.rungs),
        "components": "/".join(str(rung.betti[0]) for rung in solid.rungs),
        "solid_offset": np.nan,
        "solid_chamfer": np.nan,
    }
    if solid.rung is not None and solid.mesh is not None:
        aligned = replace(solid.mesh, vertices=to_truth.apply(solid.mesh.vertices))
        row |= {"solid_offset": solid.rung.offset, "solid_chamfer": distances_to(aligned, mug())["chamfer"]}
    return row


def _strip(soup: Soup, scene: Scene, solid: SoupSolid, subject: Subject) -> bytes:
    """Return a PNG: a photograph that was held out, the soup's render of it, and its solid."""
    assert solid.mesh is not None and solid.colours is not None
    view, points, faces = scene.holdout[SHOWN : SHOWN + 1], solid.mesh.vertices, solid.mesh.faces
    photograph, render = scene.colours(view)[0], render_views(soup, scene, view, RAYS)[0]
    x, y, z = scene.camera_centres[view[0]] - points.mean(0)
    up, colours = tuple(subject.up), np.minimum(1, 1.4 * solid.colours[faces].mean(1))
    made = render_flat(points, faces, len(photograph), direction=(x, y, z), up=up, material=colours)
    strip, png = np.concatenate([photograph, render, made], axis=1).clip(0, 1), BytesIO()
    Image.fromarray(np.rint(255 * strip).astype(np.uint8)).save(png, "PNG", optimize=True)
    return png.getvalue()


def result_table(measured: pd.DataFrame) -> pd.DataFrame:
    """Return the measurement as the notebook shows it, a row per condition (means, the range of the seeds,
    bars seed by seed); of an empty one, the command."""
    if measured.empty:
        return pd.DataFrame({"not measured yet": ["python -m paper_artifact measure photographs"]})
    rows = {}
    for condition, own in measured.groupby("condition", sort=False):
        rows[condition] = {
            "seeds": len(own),
            "held-out PSNR, dB": _spread(own["psnr"], ".2f"),
            f"with {RAYS**2} rays a pixel": _spread(own["psnr_rays"], ".2f"),
            "SSIM": _spread(own["ssim"], ".3f"),
            "triangles on the mug": _spread(own["on_the_mug"], ".0f"),
            "Chamfer, % of D": _spread(100 * own["chamfer"], ".3f"),
            "Chamfer, mm": f"{10 * mug().diagonal * own['chamfer'].mean():.2f}",
            "significant bars": " ".join(_triples(own, "count", "d")),
            "of the mug": _triples(own, "target", "d")[0],
            "bottleneck H1": _spread(own["bottleneck_1"], ".4f"),
            "CPU seconds": f"{own['cpu'].mean():.0f}",
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("condition")


def result_text(measured: pd.DataFrame) -> str:
    """Return whether the words pay on these photographs: T1 against C0 in the mean, and how often either
    soup's solid has the mug's topology."""
    arms = dict(iter(measured.groupby("condition"))) if len(measured) else {}
    if not {"C0", "T1"} <= set(arms):
        return "C0 and T1: not measured yet"
    base, own = arms["C0"], arms["T1"]
    ratios = ", ".join(
        f"{name} {own[column].mean() / base[column].mean():.2f} times"
        for name, column in (("Chamfer", "chamfer"), ("bottleneck of the handle's loop", "bottleneck_1"))
    )
    loop = "neither better nor worse"
    if own["bottleneck_1"].max() < base["bottleneck_1"].min():
        loop = "better"
    elif own["bottleneck_1"].min() > base["bottleneck_1"].max():
        loop = "worse"
    solids = ", ".join(
        f"{condition} {each['solid_offset'].notna().sum()} of {len(each)} (smallest ε "
        + "/".join("none" if np.isnan(offset) else f"{offset:g}" for offset in each["solid_offset"])
        + ")"
        for condition, each in arms.items()
    )
    return (
        f"T1 against C0: PSNR {own['psnr'].mean() - base['psnr'].mean():+.2f} dB, {ratios}; in every seed "
        f"the loop is {loop}: its radius is off by {_millimetres(own)} mm, C0's by {_millimetres(base)} mm\n"
        f"solids of genus 1: {solids}"
    )


def _millimetres(measured: pd.DataFrame) -> str:
    """Return the mean bottleneck distance of the loops, a radius, in millimetres."""
    return f"{10 * mug().diagonal * measured['bottleneck_1'].mean():.1f}"


def solid_table(measured: pd.DataFrame) -> pd.DataFrame:
    """Return per condition and seed the genus of the subject's solid at every offset ("genus in k": of k
    components), the smallest offset with the mug's topology, and that solid's distance to the mug."""
    rows = {}
    for row in measured.itertuples():
        found = zip(*(str(each).split("/") for each in (row.offsets, row.genus, row.components)), strict=True)
        cells = {
            f"ε = {offset}": genus if count == "1" else f"{genus} in {count}"
            for offset, genus, count in found
        }
        none = np.isnan(row.solid_offset)
        cells["taken"] = "none" if none else f"{row.solid_offset:g}"
        cells["Chamfer, % of D"] = "" if none else f"{100 * row.solid_chamfer:.2f}"
        rows[row.condition, row.seed] = cells
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["condition", "seed"])


def _spread(values: pd.Series, form: str) -> str:
    """Return mean and range."""
    low, high = format(values.min(), form), format(values.max(), form)
    return format(values.mean(), form) + (f" ({low} … {high})" if low != high else "")


def _triples(measured: pd.DataFrame, name: str, form: str) -> list[str]:
    columns = measured[[f"{name}_{k}" for k in range(3)]].to_numpy()
    return ["(" + ", ".join(format(value, form) for value in row) + ")" for row in columns]


def _centres(scene: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera centres (n,3) of the model in a folder, in its frame, and the true ones,
    centimetres."""
    model = read_model(scene / "sparse" / "0")
    true = json.loads((FOLDER / "cameras.json").read_text(encoding="utf-8"))["centres"]
    ours = np.stack([model.camera(index).position for index in model.images])
    return ours, np.array([true[pose.name] for pose in model.images.values()])


def _inside(points: np.ndarray) -> np.ndarray:
    """Return which points (n,3), centimetres, are in the mug's box and above the table, (n,) bool."""
    low, high = mug().vertices.min(0) - MARGIN, mug().vertices.max(0) + MARGIN
    low[2] = MARGIN
    return ((points > low) & (points < high)).all(1)


def _off(points: np.ndarray) -> float:
    """Return the median distance of points (n,3) from the mug's surface, centimetres."""
    found = nearest_on(mug().vertices[mug().faces], points, mug().diagonal)
    return float(np.median(np.linalg.norm(found.points - points, axis=1)))
