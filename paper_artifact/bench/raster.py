"""Photometric step: the numba kernels beside the plain-torch twin, on the C0 sphere (N = 1200, 200 px, batch 4)."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median

import numpy as np
import torch

from paper_artifact.catalogue import study_config
from paper_artifact.pipeline import prepare_scene
from paper_artifact.raster import functions, twin
from paper_artifact.raster.draws import view_key
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import CpuBackend
from paper_artifact.train.loop import train

FUSED = "numba, fused (the trainer's)"


def sphere_case(results: Path, steps: int = 300) -> tuple[Scene, Soup]:
    """Return the sphere's scene and a soup trained for `steps` steps (pruned to N = 1200), built under `results`."""
    config = study_config("sphere", steps=steps)
    scene = prepare_scene(config, find_mesh("sphere"), results / "scenes")
    return scene, train(scene, config, device="cpu").soup


def _numba_step(
    soup: Soup, scene: Scene, target: torch.Tensor, statistics, buffers, views, keys, seconds: dict
) -> None:
    def lap(stage: str) -> None:
        nonlocal begin
        now = time.perf_counter()
        seconds.setdefault(stage, []).append(now - begin)
        begin = now

    begin = time.perf_counter()
    opacity = torch.sigmoid(soup.opacity)
    raster = functions.rasterize(
        soup.vertices, opacity, scene.world_to_clip[views], *target.shape[2:], keys, buffers
    )
    lap("raster")
    colour = functions.shade(torch.sigmoid(soup.features), soup.mlp, raster, scene.background)
    lap("shading")
    auxiliary = functions.opacity_gradient(opacity, colour, target, raster)
    lap("opacity gradient")
    colour = functions.edge_gradient(colour, soup.vertices, raster)
    loss = functions.photometric_loss(colour, target, statistics)
    lap("L1 + SSIM with gradient")
    (loss + auxiliary).backward()
    lap("backward (shading, edges)")


def _twin_step(
    soup: Soup, matrices: torch.Tensor, background: torch.Tensor, target: torch.Tensor, keys
) -> None:
    opacity = torch.sigmoid(soup.opacity)
    raster = twin.rasterize(soup.vertices, opacity, matrices, *target.shape[2:], keys)
    colour = twin.shade(torch.sigmoid(soup.features), soup.mlp, raster, matrices, background)
    auxiliary = twin.opacity_gradient(opacity, colour.detach(), target, raster)
    colour = twin.edge_gradient(colour, soup.vertices, raster, matrices)
    (twin.photometric_loss(colour, target) + auxiliary).backward()


def _as(soup: Soup, dtype: torch.dtype) -> Soup:
    tensors = [
        tensor.detach().to(dtype) for tensor in (soup.vertices, soup.features, soup.opacity, *soup.mlp)
    ]
    return Soup(*tensors[:3], tuple(tensors[3:])).trainable()


def raster_rows(results: Path, repetitions: int = 15) -> list[dict]:
    """Return rows {what, ms, ratio to the trainer's step}: medians of interleaved forward + backward passes, CPU time of one
    thread."""
    scene, soup = sphere_case(results)
    views = scene.train[np.arange(4) * len(scene.train) // 4]
    target = torch.from_numpy(np.ascontiguousarray(scene.images[views].transpose(0, 3, 1, 2)))
    statistics, buffers = functions.target_statistics(target), functions.RasterBuffers()
    times: dict[str, list[float]] = {
        name: [] for name in (FUSED, "numba, torch functions", "twin float32", "twin float64")
    }
    stages: dict[str, list[float]] = {}
    copies = {"twin float32": _as(soup, torch.float32), "twin float64": _as(soup, torch.float64)}
    trainer = CpuBackend(scene, views)
    for repetition in range(repetitions + 1):
        keys = [view_key(0, repetition, int(view)) for view in views]
        for name in times:
            begin = time.process_time()
            if name == FUSED:
                trainer.photometric_step(soup, views, keys)
            elif name in copies:
                dtype = copies[name].vertices.dtype
                _twin_step(
                    copies[name],
                    torch.from_numpy(scene.world_to_clip[views]).to(dtype),
                    torch.as_tensor(scene.background).to(dtype),
                    target.to(dtype),
                    keys,
                )
            else:
                _numba_step(soup, scene, target, statistics, buffers, views, keys, stages)
            times[name].append(time.process_time() - begin)
    rows = [
        {
            "what": f"forward + backward, {name}",
            "ms": 1e3 * median(values[1:]),
            "ratio": median(values[1:]) / median(times[FUSED][1:]),
        }
        for name, values in times.items()
    ]
    return rows + [
        {"what": f"  numba: {name} (wall)", "ms": 1e3 * median(values[1:]), "ratio": None}
        for name, values in stages.items()
    ]
