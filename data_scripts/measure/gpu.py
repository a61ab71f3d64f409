"""Prints GPU memory of C0 and C1 on the torus by the paper's protocol (App. H): memory in use on the GPU,
asked every 400 ms, beside the paper's. Needs an NVIDIA GPU; each run is a process by itself.
"""

import subprocess
import threading
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from pathlib import Path

from common import in_own_process

import pandas as pd

from paper_artifact.catalogue import study_config
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.files import partial_folder
from paper_artifact.pipeline import make_run_bundle, make_run_term, prepare_scene
from paper_artifact.results import published
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.train.loop import train

INTERVAL = 0.4  # seconds between two readings
ASK = ("nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits", "--id=0")


def used_mib() -> int:
    """Return the memory in use on the first GPU, MiB."""
    return int(subprocess.run(ASK, capture_output=True, text=True, check=True, timeout=10).stdout)


def peak_during(work: Callable[[], float], read: Callable[[], int] = used_mib) -> dict[str, float]:
    """Return what `work` returns as "allocated", with "before" and "peak": read() before it, and the largest
    of that and the readings every INTERVAL seconds while it runs."""
    readings, ended = [read()], threading.Event()

    def watch() -> None:
        while not ended.wait(INTERVAL):
            readings.append(read())

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        allocated = work()
    finally:
        ended.set()
        thread.join()
    return {"before": readings[0], "peak": max(readings), "allocated": allocated}


def allocated_mib(condition: str, folder: str, steps: int = STEPS_OF_THE_STUDY) -> float:
    """Train the torus on the GPU; return the memory that torch allocated, at most, MiB."""
    import torch

    mesh, config = find_mesh("torus"), study_config("torus", condition, steps=steps)
    scene = prepare_scene(config, mesh, Path(folder))
    term = make_run_term(config, make_run_bundle(config, mesh))
    train(scene, config, term=term, device="cuda")
    return torch.cuda.max_memory_allocated() / 2**20


def main() -> None:
    """Print a row per condition."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=STEPS_OF_THE_STUDY)
    given = parser.parse_args()
    try:
        used_mib()
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise SystemExit(f"nvidia-smi gives no memory ({error}); this needs an NVIDIA GPU") from error
    printed = published("cost").query("quantity == 'gpu_memory_mib'").set_index("condition")["value"]
    rows = {}
    with partial_folder() as folder:
        for condition in ("C0", "C1"):
            rows[condition] = peak_during(
                lambda condition=condition: in_own_process(allocated_mib, condition, folder, given.steps)
            )
    print(pd.DataFrame(rows).T.assign(paper=printed).round(0).rename_axis("MiB").to_string())


if __name__ == "__main__":
    main()
