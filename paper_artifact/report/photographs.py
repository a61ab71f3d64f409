"""Notebook 18: photographs of a mug, registered by structure from motion, trained, and held against the
truth.

The photographs are our own (data_scripts/mug/), and so is the mug: its mesh and the true camera centres are
known, in centimetres. The model that structure from motion made of the photographs is committed; the frame it
has is turned, moved and scaled onto the truth by the camera centres alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree

from paper_artifact.catalogue import study_config
from paper_artifact.config import GivenConfig
from paper_artifact.evaluate.align import Similarity, similarity
from paper_artifact.evaluate.scores import evaluate_samples, make_target, soup_samples
from paper_artifact.files import REPOSITORY
from paper_artifact.mesh import Mesh, load_mesh
from paper_artifact.pipeline import run
from paper_artifact.randomness import stream
from paper_artifact.record.store import config_of, record_path
from paper_artifact.report.kit.figures import image_rows
from paper_artifact.scene.colmap import read_model
from paper_artifact.soup.state import load_soup

FOLDER = REPOSITORY / "data_scripts" / "mug"
SIZE = 400  # longest side of the scene's images, pixels
ARMS: dict[str, dict[str, Any]] = {"C0": {}, "T1": {"betti": (1, 1, 0)}}  # settings of the condition's loss
SETTINGS = {"budget": 3000, "batch": 1}
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
    target = make_target(mug(), cache=None)
    photographs = list((FOLDER / "photographs").glob("*.jpg"))
    rows = {
        "photographs": len(photographs),
        "MB in all": round(sum(file.stat().st_size for file in photographs) / 1e6, 2),
        "registered": len(model.images),
        "points of the cloud": len(cloud),
        "of them on the mug": len(near),
        "cameras off by, median, millimetres": round(10 * float(np.median(missed)), 3),
        "cameras off by, at most, millimetres": round(10 * float(missed.max()), 3),
        "points of the mug off its surface, median, millimetres": round(10 * _off(near, target.samples), 3),
    }
    return pd.DataFrame({"value": [f"{value:g}" for value in rows.values()]}, index=list(rows))


def photographs_figure(names: tuple[str, ...] = ("00", "08", "17", "24", "33", "40")) -> Figure:
    """Return some of the photographs, by number."""
    pictures = [np.asarray(Image.open(FOLDER / "photographs" / f"mug_{name}.jpg")) / 255 for name in names]
    return image_rows([("", pictures[:3]), ("", pictures[3:])], size=2.4)


def measure_photographs(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return one row per arm: the photographs registered anew (pycolmap), trained, and held against the mug.

    Distances are divided by the mug's diagonal, the counts are of 20,000 samples of what the soup has inside
    the mug's box and above the table.
    """
    from paper_artifact.photos.scene import PhotosConfig, photographs_scene

    tell = progress or (lambda text: None)
    target = make_target(mug(), cache=None)
    rows = []
    with TemporaryDirectory() as folder:
        scene, results = Path(folder) / "mug", Path(folder) / "results"
        tell("photographs: structure from motion")
        photographs_scene(FOLDER / "photographs", scene, PhotosConfig(size=SIZE))
        for condition, loss in ARMS.items():
            config = study_config(str(scene), condition, loss=loss, **SETTINGS)
            config = replace(config, given=GivenConfig(holdout="8"))
            record = run(
                config,
                results=results,
                device="cpu",
                progress=lambda step, text: tell(f"step {step}, {text}"),
            )
            stem = record_path(config_of(record), results / "runs", record["defaults"]).stem
            soup = load_soup(results / "soups" / f"{stem}.npz")
            corners = aligned_to(scene).apply(soup.vertices.detach().numpy())
            kept = _inside(corners.mean(1))
            samples = soup_samples(
                corners[kept], soup.corner_opacity()[kept], len(target.samples), stream(0, "mug samples")
            )
            found = evaluate_samples(samples, target)
            rows.append(
                {
                    "condition": condition,
                    "psnr": record["images"]["psnr"],
                    "ssim": record["images"]["ssim"],
                    "triangles": len(soup),
                    "on_the_mug": int(kept.sum()),
                    "chamfer": found["chamfer"],
                    "hausdorff95": found["hausdorff95"],
                    **{f"count_{k}": found["counts"][k] for k in range(3)},
                    **{f"target_{k}": target.counts[k] for k in range(3)},
                    **{f"bottleneck_{k}": found["bottleneck"][k] for k in range(3)},
                    "cpu": record["cpu_seconds"],
                }
            )
    return pd.DataFrame(rows)


def aligned_to(scene: Path) -> Similarity:
    """Return the similarity from a scene of the mug's photographs to centimetres, by its camera centres."""
    return similarity(*_centres(scene))


def result_table(measured: pd.DataFrame) -> pd.DataFrame:
    """Return the measurement as the notebook shows it: one row per condition."""

    def triple(name: str, form: str) -> list[str]:
        columns = measured[[f"{name}_{k}" for k in range(3)]].to_numpy()
        return ["(" + ", ".join(format(value, form) for value in row) + ")" for row in columns]

    return pd.DataFrame(
        {
            "held-out PSNR, dB": measured["psnr"].round(2),
            "SSIM": measured["ssim"].round(3),
            "triangles": measured["triangles"],
            "of them on the mug": measured["on_the_mug"],
            "Chamfer, % of D": (100 * measured["chamfer"]).round(3),
            "Chamfer, mm": (10 * mug().diagonal * measured["chamfer"]).round(2),
            "significant bars": triple("count", "d"),
            "of the mug": triple("target", "d"),
            "bottleneck": triple("bottleneck", ".4f"),
            "CPU seconds": measured["cpu"].round(0),
        }
    ).set_index(measured["condition"])


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


def _off(points: np.ndarray, surface: np.ndarray) -> float:
    return float(np.median(cKDTree(surface).query(points)[0]))
