"""Peak memory: many large photographs, a million points. Each is a process of its own.

Photographs are synthetic: coloured noise as smooth as a picture, written as a COLMAP scene, then loaded and
trained on as anyone's scene is. What they show does not matter to memory.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from paper_artifact.bench.child import Told, run_child
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.cameras import fibonacci_cameras
from paper_artifact.scene.colmap import Intrinsics, Model, Pose, write_model
from paper_artifact.scene.shapes import make_shape

POINTS = 15_000  # of the SfM cloud, and the budget N: as many as DiffSoup starts with
PHOTOGRAPHS = ((48, 800, 600), (100, 1600, 3000))  # views, side in pixels, asked for at most in MiB
LARGE = 1_000_000  # points of the largest cloud
_TRAIN = """
import json, sys, time
from pathlib import Path
import torch
from paper_artifact.catalogue import study_config
from paper_artifact.record.environment import peak_memory_mib
from paper_artifact.scene.load import load_scene
from paper_artifact.train.loop import train
folder, budget, steps = json.loads(sys.argv[1])
torch.set_num_threads(1)
print("loading", flush=True)
scene = load_scene(Path(folder))
loaded = peak_memory_mib()
def progress(step, text):
    print(f"step {step} of {steps}", flush=True)
config = study_config("sphere", budget=budget, steps=steps, initial_ratio=1.0, dump_steps=())
cpu = time.process_time()
train(scene, config, device="cpu", progress=progress)
print(json.dumps({"loaded_mb": loaded, "peak_mb": peak_memory_mib(), "cpu": time.process_time() - cpu}))
"""
_PERSISTENCE = """
import json, sys, time
from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.bench.persistence import CLOUDS
from paper_artifact.randomness import stream
from paper_artifact.record.environment import peak_memory_mib
cloud, size = json.loads(sys.argv[1])
alpha_persistence(CLOUDS["uniform"](100, stream(0, "persistence benchmark warm-up")))
points = CLOUDS[cloud](size, stream(0, f"persistence benchmark {cloud}", size))
cpu, wall = time.process_time(), time.perf_counter()
bars = alpha_persistence(points, progress=lambda stage: print(stage, flush=True))
print(json.dumps({"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall,
                  "peak_mb": peak_memory_mib(), "bars": [len(each) for each in bars]}))
"""


def write_photographs(folder: Path, views: int, size: int) -> None:
    """Write a COLMAP scene of `views` synthetic images of size × size pixels around a sphere to `folder`."""
    mesh = make_shape("sphere")
    draws = stream(0, "synthetic photographs", size)
    cameras = fibonacci_cameras(mesh, views, size)
    (folder / "images").mkdir(parents=True)
    names = [f"view_{index:03d}.jpg" for index in range(views)]
    for name in names:
        coarse = Image.fromarray(draws.integers(0, 256, (size // 16 + 2, size // 16 + 2, 3), np.uint8))
        coarse.resize((size, size), Image.Resampling.BICUBIC).save(folder / "images" / name)
    positions, _, _ = sample_surface(mesh.vertices, mesh.faces, POINTS, draws)
    first = cameras[0]
    parameters = (first.focal_x, first.focal_y, first.centre_x, first.centre_y)
    poses = {
        index + 1: Pose(name, 1, camera.quaternion, camera.translation)
        for index, (name, camera) in enumerate(zip(names, cameras, strict=True))
    }
    model = Model(
        cameras={1: Intrinsics("PINHOLE", size, size, parameters)},
        images=poses,
        point_ids=np.arange(1, POINTS + 1),
        positions=positions,
        colours=np.full((POINTS, 3), 128, np.uint8),
        errors=np.zeros(POINTS),
    )
    write_model(model, folder / "sparse" / "0")


def photographs_row(
    results: Path, views: int, size: int, budget: int = POINTS, steps: int = 12, told: Told | None = None
) -> dict:
    """Return {views, size, N, loaded_mb, peak_mb, cpu}: MiB after loading and at most, CPU seconds of `steps`
    steps of training on `views` photographs of size × size pixels, written under `results`."""
    folder = results / f"photographs-{views}-{size}"
    write_photographs(folder, views, size)
    row, _ = run_child(_TRAIN, [str(folder), budget, steps], told)
    return {"views": views, "size": size, "N": budget, **row}


def large_row(size: int = LARGE, cloud: str = "soup", told: Told | None = None) -> dict:
    """Return {cloud, M, cpu, wall, peak_mb, bars} of our persistence of one large cloud: seconds, MiB, bars
    per dimension. told(line) is called as each stage begins."""
    row, _ = run_child(_PERSISTENCE, [cloud, size], told)
    return {"cloud": cloud, "M": size, **row}
