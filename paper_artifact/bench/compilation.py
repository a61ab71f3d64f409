"""Compilation: everything in an empty cache, then from that cache, then without any folder to keep it in."""

from __future__ import annotations

import gc
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.bench.child import Told, run_child
from paper_artifact.catalogue import study_config
from paper_artifact.kernel_cache import PACKAGE
from paper_artifact.pipeline import prepare_scene
from paper_artifact.randomness import stream
from paper_artifact.scene.shapes import find_mesh

COLD, KEPT, CLOSED = "empty cache", "second process", "no writable cache"
_PROGRAM = """
import json, sys, time
from pathlib import Path
from paper_artifact.bench.compilation import use_every_kernel
print(json.dumps(use_every_kernel(lambda line: print(line, flush=True))))
"""


def _persistence(folder: Path) -> None:
    alpha_persistence(stream(0, "compilation benchmark").random((64, 3)))


def _scene_and_training(folder: Path) -> None:
    from paper_artifact.train.loop import train

    small = {"views": 4, "size": 32, "budget": 30, "initial_ratio": 3.0, "resample_every": 3, "samples": 64}
    config = study_config("sphere", steps=4, dump_steps=(4,), **small)
    train(prepare_scene(config, find_mesh("sphere"), folder), config, device="cpu")


def _certificate(folder: Path) -> None:
    from paper_artifact.certify.certificate import certify_mesh

    certify_mesh(find_mesh("torus"))


def _ingest(folder: Path) -> None:
    from paper_artifact.ingest.crossings import crossing_faces
    from paper_artifact.ingest.distance import distance_grid, nearest_on

    mesh = find_mesh("sphere")
    distance_grid(mesh.vertices, mesh.faces, mesh.diagonal / 8, mesh.diagonal / 4)
    nearest_on(mesh.vertices[mesh.faces], mesh.vertices, mesh.diagonal / 4)
    crossing_faces(mesh.vertices, mesh.faces)


WORKS: dict[str, Callable[[Path], None]] = {
    "persistence": _persistence,
    "scene and training": _scene_and_training,
    "certificate": _certificate,
    "ingest": _ingest,
}


def package_kernels() -> list[Dispatcher]:
    """Return the compiled functions of this package that the process has loaded, inlined ones included."""
    found = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    return [each for each in found if each.py_func.__module__.startswith("paper_artifact.")]


def use_every_kernel(told: Told) -> dict:
    """Use every kernel once on something small; return {cpu: seconds of this process so far, kernels,
    compiled, loaded, modules, unused}.

    kernels: those that are kept, of how many modules; compiled: how often a function was compiled, inlined
    ones included; loaded: how often one came from the cache, both by numba's own statistics; unused: names of
    kernels that were neither (some are within another one that was loaded). told(line) is called before each
    part.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name, work in WORKS.items():
            told(name)
            work(Path(folder))
    kernels = package_kernels()
    kept = [each for each in kernels if each.stats.cache_path is not None]
    return {
        "cpu": time.process_time(),
        "kernels": len(kept),
        "modules": sorted({each.py_func.__module__ for each in kept}),
        "unused": sorted(each.py_func.__name__ for each in kept if not each.signatures),
        "compiled": sum(sum(each.stats.cache_misses.values()) for each in kernels),
        "loaded": sum(sum(each.stats.cache_hits.values()) for each in kernels),
    }


def compilation_rows(told: Told | None = None) -> list[dict]:
    """Return what `use_every_kernel` says in three processes, with `what` (COLD, KEPT, CLOSED), `wall`
    seconds and `notices`: how often the process said that it cannot keep its kernels.

    The first two share a cache folder that is empty at first. The third runs a copy of the package with no
    folder for kernels, by a user without one. told(line) is called before each part.
    """
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        kept = {"NUMBA_CACHE_DIR": str(base / "kernels")}
        rows = []
        for what, environment in ((COLD, kept), (KEPT, kept), (CLOSED, _closed_copy(base))):

            def told_of(line: str, what: str = what) -> None:
                if told is not None:
                    told(f"{what}: {line}")

            begin = time.perf_counter()
            place = base if what == CLOSED else None  # Python looks for the package in its folder first
            row, complaints = run_child(_PROGRAM, None, told_of, environment, place)
            notices = sum("kernels cannot be kept" in line for line in complaints)
            rows.append({"what": what, **row, "wall": time.perf_counter() - begin, "notices": notices})
        return rows


def _closed_copy(base: Path) -> dict[str, str]:
    """Copy the package to a folder where no cache can be made, not even by root: files stand in the way.

    Return the environment of a process that runs it.
    """
    copy = base / "copy" / "paper_artifact"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for module in copy.rglob("*.py"):
        (module.parent / "__pycache__").touch()
    (base / "nobody").touch()
    nowhere = str(base / "nobody" / "cache")
    return {
        "PYTHONPATH": str(copy.parent),
        "NUMBA_CACHE_DIR": "",
        "HOME": nowhere,
        "XDG_CACHE_HOME": nowhere,
        "MPLCONFIGDIR": str(base),
    }
