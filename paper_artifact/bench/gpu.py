"""GPU memory of a run, by the paper's protocol (App. H): memory in use on the GPU, asked every 400 ms."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

from paper_artifact.bench.child import run_child
from paper_artifact.errors import InputError

INTERVAL = 0.4  # seconds between two readings
ASK = ("nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits", "--id=0")

_PROGRAM = """
import json, sys
from pathlib import Path
import torch
from paper_artifact.catalogue import study_config
from paper_artifact.train.loop import train
from paper_artifact.pipeline import make_run_term, prepare_scene
from paper_artifact.scene.shapes import find_mesh
shape, condition, steps, results = json.loads(sys.argv[1])
mesh, config = find_mesh(shape), study_config(shape, condition, steps=steps)
train(prepare_scene(config, mesh, Path(results) / "scenes"), config, term=make_run_term(config, mesh)[0],
      device="cuda")
print(json.dumps({"allocated_mib": torch.cuda.max_memory_allocated() / 2**20}))
"""


def gpu_is_here() -> bool:
    """Return whether torch sees a GPU and nvidia-smi answers."""
    import torch

    try:
        used_mib()
    except InputError:
        return False
    return torch.cuda.is_available()


def used_mib() -> int:
    """Return the memory in use on the first GPU, MiB. Raises InputError where nvidia-smi gives no number."""
    try:
        return int(subprocess.run(ASK, capture_output=True, text=True, check=True, timeout=10).stdout)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise InputError(f"nvidia-smi gives no memory ({error}); this part needs an NVIDIA GPU") from error


def peak_during(work: Callable[[], dict], read: Callable[[], int] = used_mib) -> dict:
    """Return what `work` returns, with "before_mib" and "peak_mib": read() before it, and the largest of
    that and the readings every INTERVAL seconds while it runs."""
    readings, ended = [read()], threading.Event()

    def watch() -> None:
        while not ended.wait(INTERVAL):
            readings.append(read())

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        done = work()
    finally:
        ended.set()
        thread.join()
    return {**done, "before_mib": readings[0], "peak_mib": max(readings)}


def memory_row(condition: str, folder: Path, steps: int, shape: str = "torus") -> dict:
    """Return {before_mib, peak_mib: on the whole GPU; allocated_mib: by torch, at most} of a run, seed 0.

    folder: for the scene. Raises RuntimeError with the child's last line when it fails.
    """
    return peak_during(lambda: run_child(_PROGRAM, [shape, condition, steps, str(folder)])[0])
