"""A whole C0 run: CPU seconds, peak memory, where the time goes. Each measurement is a fresh process, so that its peak is its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

_CHILD = """
import json, resource, sys, time
from pathlib import Path
import torch
from paper_artifact.raster.threads import set_thread_count
from paper_artifact.train.config import default_config
from paper_artifact.train.loop import train
from paper_artifact.train.run import find_mesh, make_run_term, prepare_scene, with_condition
shape, condition, steps, threads, results = json.loads(sys.argv[1])
torch.set_num_threads(1)
set_thread_count(threads)
mesh = find_mesh(shape)
train(prepare_scene(default_config(shape, steps=2), mesh, Path(results) / "scenes"), default_config(shape, steps=2), device="cpu")
config = with_condition(default_config(shape, condition=condition, steps=steps), mesh)
scene = prepare_scene(config, mesh, Path(results) / "scenes")
term, _ = make_run_term(config, mesh)
cpu, wall = time.process_time(), time.perf_counter()
outcome = train(scene, config, term=term, device="cpu")
print(json.dumps({"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall, "seconds": outcome.seconds,
                  "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "loss": outcome.losses[-1]}))
"""


def run_row(shape: str, condition: str, steps: int, threads: int, results: Path) -> dict:
    """Return {cpu, wall (seconds of the training loop, compilation and scene left out), seconds by stage, peak_mb, loss} of one run.

    Raises RuntimeError with the child's last line when it fails.
    """
    child = subprocess.run([sys.executable, "-c", _CHILD, json.dumps([shape, condition, steps, threads, str(results)])],
                           capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    if child.returncode:
        raise RuntimeError(f"the benchmark run failed: {child.stderr.strip().splitlines()[-1:]}")
    return json.loads(child.stdout.strip().splitlines()[-1])
