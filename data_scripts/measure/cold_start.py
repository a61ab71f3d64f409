"""Prints what compilation costs: every kernel used once with an empty cache, then with that cache.

Each line is a process by itself, imports included; compiled and loaded are numba's own counts. Two minutes.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
from common import Clock, options
from numba.core.dispatcher import Dispatcher

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.catalogue import study_config
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.ingest.crossings import crossing_faces
from paper_artifact.ingest.distance import distance_grid, nearest_on
from paper_artifact.pipeline import prepare_scene
from paper_artifact.randomness import stream
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.train.loop import train


def use_every_kernel() -> dict:
    """Use every kernel on something small; return CPU seconds of this process so far, how many kernels are
    kept, and how often one was compiled and loaded."""
    alpha_persistence(stream(0, "compilation benchmark").random((64, 3)))
    mesh = find_mesh("sphere")
    small = {"views": 4, "size": 32, "budget": 30, "initial_ratio": 3.0, "resample_every": 3, "samples": 64}
    config = study_config("sphere", steps=4, dump_steps=(4,), **small)
    with TemporaryDirectory() as folder:
        train(prepare_scene(config, mesh, Path(folder)), config, device="cpu")
    certify_mesh(mesh)
    distance_grid(mesh.vertices, mesh.faces, mesh.diagonal / 8, mesh.diagonal / 4)
    nearest_on(mesh.vertices[mesh.faces], mesh.vertices, mesh.diagonal / 4)
    crossing_faces(mesh.vertices, mesh.faces)
    found = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    kernels = [each for each in found if each.py_func.__module__.startswith("paper_artifact.")]
    return {
        "CPU s": time.process_time(),
        "kernels": sum(each.stats.cache_path is not None for each in kernels),
        "compiled": sum(sum(each.stats.cache_misses.values()) for each in kernels),
        "loaded": sum(sum(each.stats.cache_hits.values()) for each in kernels),
    }


def main() -> None:
    """Print a row per process."""
    given = options(__doc__, once={"action": "store_true", "help": "only this process, as JSON"})
    if given.once:
        print(json.dumps(use_every_kernel()))
        return
    rows = {}
    with TemporaryDirectory() as cache:
        for name in ("empty cache", "second process"):
            with Clock() as clock:
                made = subprocess.run(
                    [sys.executable, __file__, "--once"],
                    env=os.environ | {"NUMBA_CACHE_DIR": cache},
                    stdout=subprocess.PIPE,
                    check=True,
                )
            rows[name] = json.loads(made.stdout.splitlines()[-1]) | {"wall s": clock.wall}
    print(pd.DataFrame(rows).T.round(1).to_string())


if __name__ == "__main__":
    main()
