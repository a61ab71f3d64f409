"""A whole run: CPU seconds, wall time, peak memory, where the time goes. Each is a process of its own."""

from __future__ import annotations

from pathlib import Path

from paper_artifact.bench.child import run_child

_PROGRAM = """
import json, sys, time
from pathlib import Path
import torch
from paper_artifact.raster.threads import set_thread_count
from paper_artifact.catalogue import study_config
from paper_artifact.record.environment import peak_memory_mib
from paper_artifact.train.loop import train
from paper_artifact.pipeline import make_run_term, prepare_scene
from paper_artifact.scene.shapes import find_mesh
shape, condition, steps, threads, results, changes = json.loads(sys.argv[1])
torch.set_num_threads(1)
set_thread_count(threads)
mesh = find_mesh(shape)
config = study_config(shape, condition, steps=steps, **changes)
scene = prepare_scene(config, mesh, Path(results) / "scenes")
train(scene, study_config(shape, steps=2, **changes), device="cpu")  # the kernels are compiled or loaded here
term, _ = make_run_term(config, mesh)
cpu, wall = time.process_time(), time.perf_counter()
outcome = train(scene, config, term=term, device="cpu")
print(json.dumps({"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall,
                  "peak_mb": peak_memory_mib(), "seconds": outcome.seconds, "loss": outcome.losses[-1]}))
"""


def run_row(shape: str, condition: str, steps: int, threads: int, results: Path, **changes) -> dict:
    """Return {cpu, wall, seconds by stage, peak_mb, loss} of one run's training loop, compilation and scene
    left out.

    results: folder for the scene; changes: other values than `study_config`'s (numbers). Raises RuntimeError
    with the child's last line when it fails.
    """
    return run_child(_PROGRAM, [shape, condition, steps, threads, str(results), changes])[0]
