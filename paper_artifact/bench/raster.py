"""Photometric step: the kernels beside the plain-torch twin, C0 sphere (N = 1200, 200 px, batch 4)."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import torch

from paper_artifact.catalogue import study_config
from paper_artifact.pipeline import prepare_scene
from paper_artifact.raster.arrays import SoupArrays
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.photometric import make_target
from paper_artifact.raster.view import ViewCamera, ViewRaster, make_camera, to_clip
from paper_artifact.scene.load import Scene
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import CpuBackend, TwinBackend
from paper_artifact.train.loop import train

TRAINER = "numba (the trainer's)"
BATCH = 4


def sphere_case(results: Path, steps: int = 300) -> tuple[Scene, Soup]:
    """Return the sphere's scene and a soup of `steps` steps (pruned to N = 1200), built under `results`."""
    config = study_config("sphere", steps=steps)
    scene = prepare_scene(config, find_mesh("sphere"), results / "scenes")
    return scene, train(scene, config, device="cpu").soup


def _stages(
    view: ViewRaster,
    drawn: SoupArrays,
    camera: ViewCamera,
    target: np.ndarray,
    background: np.ndarray,
    key: int,
) -> dict[str, Callable[[], object]]:
    # One view's part of the trainer's step, in its order.
    out = SoupArrays.of(np.zeros_like(array) for array in drawn.flat())
    return {
        "raster": lambda: view.draw(to_clip(drawn.vertices, camera.matrix), drawn.opacity, key),
        "shading": lambda: view.shade(drawn.features, drawn.mlp, camera.rays, background),
        "L1 + SSIM with gradient": lambda: view.compare(target, BATCH),
        "opacity gradient": lambda: view.add_opacity_gradient(BATCH, out.opacity),
        "edge gradient": lambda: view.add_edge_gradient(camera.matrix, out.vertices),
        "shading gradient": lambda: view.add_shading_gradient(drawn, camera.rays, out.features, out.mlp),
    }


def _stage_seconds(scene: Scene, soup: Soup, views: np.ndarray, repetitions: int) -> dict[str, list[float]]:
    height, width = scene.images.shape[2:]
    raster, drawn = ViewRaster(height, width), soup.drawn()
    cameras = [make_camera(scene.world_to_clip[view]) for view in views]
    targets = [make_target(scene.images[view]) for view in views]
    seconds: dict[str, list[float]] = {}
    for repetition in range(repetitions):
        for view, camera, target in zip(views, cameras, targets, strict=True):
            key = view_key(0, repetition, int(view))
            for name, call in _stages(raster, drawn, camera, target, scene.background, key).items():
                begin = time.perf_counter()
                call()
                seconds.setdefault(name, [0.0] * repetitions)[repetition] += time.perf_counter() - begin
    return seconds


def raster_rows(results: Path, repetitions: int = 15) -> list[dict]:
    """Return rows {what, ms, ratio to the trainer's step}: medians over `repetitions` interleaved passes.

    Forward + backward in CPU time of one thread; the trainer's stages in wall time (ratio None).
    """
    scene, soup = sphere_case(results)
    views = scene.train[np.arange(BATCH) * len(scene.train) // BATCH]
    backends = {
        TRAINER: CpuBackend(scene, views),
        "twin float32": TwinBackend(scene, views, "cpu", torch.float32),
        "twin float64": TwinBackend(scene, views, "cpu", torch.float64),
    }
    soups = {name: backend.to_device(soup) for name, backend in backends.items()}
    times: dict[str, list[float]] = {name: [] for name in backends}
    for repetition in range(repetitions + 1):
        keys = [view_key(0, repetition, int(view)) for view in views]
        for name, backend in backends.items():
            begin = time.process_time()
            backend.photometric_step(soups[name], views, keys)
            times[name].append(time.process_time() - begin)
    middle = {name: median(values[1:]) for name, values in times.items()}
    rows = [
        {"what": f"forward + backward, {name}", "ms": 1e3 * seconds, "ratio": seconds / middle[TRAINER]}
        for name, seconds in middle.items()
    ]
    return rows + [
        {"what": f"  numba: {name} (wall)", "ms": 1e3 * median(values), "ratio": None}
        for name, values in _stage_seconds(scene, soup, views, repetitions).items()
    ]
