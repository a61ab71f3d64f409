"""The step of training against the number of triangles and pixels, on one core and two; a law of its cost."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
import torch
from PIL import Image

from paper_artifact.bench.raster import BATCH, sphere_case
from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.threads import one_torch_thread, set_thread_count, thread_count
from paper_artifact.scene.load import Scene
from paper_artifact.soup.adam import soup_optimiser
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import CpuBackend
from paper_artifact.train.state import learning_rates

TRIANGLES = (1_000, 3_000, 10_000, 15_000, 30_000)
SIZES = (100, 200, 400, 800, 1600)  # side of the images, pixels
TERMS = ("a", "b", "c", "d")  # of the law, see `fit_law`


def resized_soup(soup: Soup, count: int) -> Soup:
    """Return a soup of `count` triangles that shows the same picture: the largest are halved at their longest
    edge, again and again, or the smallest left out. Raises InputError for fewer than one."""
    if count < 1:
        raise InputError(f"a soup of {count} triangles cannot be drawn; ask for at least one")
    corners, *values = (tensor.detach().numpy() for tensor in soup.tensors()[:3])
    while True:
        a, b, c = corners.transpose(1, 0, 2)
        order = np.argsort(-np.linalg.norm(np.cross(b - a, c - a), axis=1), kind="stable")
        if count <= len(order):
            order = np.sort(order[:count])
            corners, *values = (array[order] for array in (corners, *values))
            break
        split = order[: count - len(order)]
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)[split]
        # Turned so that the longest edge is the one from corner 0 to corner 1.
        turn = (edges.argmax(1)[:, None] + np.arange(3)) % 3
        halved = [_halves(array, split, turn) for array in (corners, *values)]
        corners, *values = halved
    tensors = [torch.from_numpy(np.ascontiguousarray(array)) for array in (corners, *values)]
    return Soup(*tensors, tuple(tensor.detach().clone() for tensor in soup.mlp)).trainable()


def _halves(array: np.ndarray, split: np.ndarray, turn: np.ndarray) -> np.ndarray:
    # array (T,3,…) of corners: both halves of the triangles `split`, one in place and one at the end.
    first, second, third = array[split[:, None], turn].swapaxes(0, 1)
    middle = (first + second) / 2
    out = np.concatenate([array, np.stack([middle, second, third], axis=1)])
    out[split] = np.stack([first, middle, third], axis=1)
    return out


def resized_scene(scene: Scene, views: np.ndarray, size: int) -> Scene:
    """Return the scene with these views' images alone, all others black, scaled to size × size pixels."""
    images = np.zeros((len(scene.images), 3, size, size), np.uint8)
    for view in views:
        picture = Image.fromarray(np.moveaxis(scene.images[view], 0, -1))
        images[view] = np.moveaxis(np.asarray(picture.resize((size, size), Image.Resampling.BICUBIC)), -1, 0)
    return replace(scene, images=images)


class Stepper:
    """A step of training as the loop takes it, optimisers included, on BATCH views of a resized scene."""

    def __init__(self, scene: Scene, soup: Soup, triangles: int, size: int) -> None:
        """Make the step for a soup resized to `triangles` and images of size × size pixels."""
        self._views = scene.train[np.arange(BATCH) * len(scene.train) // BATCH]
        self._backend = CpuBackend(resized_scene(scene, self._views, size), self._views)
        self._soup = resized_soup(soup, triangles)
        self._optimiser, self._taken = soup_optimiser(self._soup), 0
        config = study_config("sphere", steps=1)  # the rates of a run's end: the soup stays what it is
        self._rates = learning_rates(config, float(scene.radius), config.steps)

    @one_torch_thread()  # as the trainer does: torch's threads would spin beside the kernels
    def __call__(self) -> tuple[float, float]:
        """Take a step; return its (CPU, wall) milliseconds."""
        self._taken += 1
        cpu, wall = time.process_time(), time.perf_counter()
        keys = [view_key(0, self._taken, int(view)) for view in self._views]
        self._backend.photometric_step(self._soup, self._views, keys)
        self._optimiser.step(self._rates)
        return 1e3 * (time.process_time() - cpu), 1e3 * (time.perf_counter() - wall)


def step_rows(
    results: Path,
    triangles: Sequence[int] = TRIANGLES,
    sizes: Sequence[int] = SIZES,
    repetitions: int = 7,
    case: tuple[Scene, Soup] | None = None,
) -> Iterator[dict]:
    """Yield a row {N, size, views, ms, wall_ms} per number of triangles N and image side, one thread.

    Medians over `repetitions` after one uncounted step. case: scene and soup, by default the sphere's after
    300 steps, built under `results`. Raises InputError for fewer than one repetition.
    """
    if repetitions < 1:
        raise InputError("the benchmark needs at least one repetition")
    scene, soup = case or sphere_case(results)
    for size in sizes:
        for count in triangles:
            step = Stepper(scene, soup, count, size)
            step()
            cpu, wall = zip(*(step() for _ in range(repetitions)), strict=True)
            yield {"N": count, "size": size, "views": BATCH, "ms": median(cpu), "wall_ms": median(wall)}


def thread_rows(
    results: Path,
    sizes: Sequence[int] = (200, 800),
    repetitions: int = 15,
    case: tuple[Scene, Soup] | None = None,
) -> list[dict]:
    """Return a row {size, threads, wall_ms, cpu_ms, speedup} per image side and 1 and 2 threads, which take
    turns; speedup: wall time of one thread over this. Other arguments and errors as `step_rows`."""
    if repetitions < 1:
        raise InputError("the benchmark needs at least one repetition")
    scene, soup = case or sphere_case(results)
    before, rows = thread_count(), []
    try:
        for size in sizes:
            step = Stepper(scene, soup, len(soup), size)
            times: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
            for _ in range(repetitions + 1):
                for threads, taken in times.items():
                    set_thread_count(threads)
                    taken.append(step())
            one = median(wall for _, wall in times[1][1:])
            for threads, taken in times.items():
                cpu, wall = (median(values) for values in zip(*taken[1:], strict=True))
                rows.append(
                    {"size": size, "threads": threads, "wall_ms": wall, "cpu_ms": cpu, "speedup": one / wall}
                )
    finally:
        set_thread_count(before)
    return rows


def fit_law(rows: Sequence[dict]) -> tuple[dict[str, float], np.ndarray]:
    """Return (the law's constants, predicted ÷ measured - 1 of each row).

    ms = a + b·P/1000 + c·N/1000 + d·√(N·P)/1000, P = views · size² the pixels of a step: pixels are shaded
    and compared, triangles set up and moved, and edges have lengths. Constants >= 0 of least relative
    squares. Raises InputError for fewer rows than constants.
    """
    from scipy.optimize import nnls

    if len(rows) < len(TERMS):
        raise InputError(f"a law of {len(TERMS)} constants needs as many measurements, got {len(rows)}")
    measured = np.array([row["ms"] for row in rows], np.float64)
    columns = law_columns(
        np.array([row["N"] for row in rows]), np.array([row["views"] * row["size"] ** 2 for row in rows])
    )
    constants, _ = nnls(columns / measured[:, None], np.ones(len(rows)))
    return dict(zip(TERMS, constants.tolist(), strict=True)), columns @ constants / measured - 1


def law_text(constants: dict[str, float], residuals: np.ndarray) -> str:
    """Return the law of `fit_law` in one line, with the spread of predicted ÷ measured."""
    a, b, c, d = (f"{constants[name]:.3g}" for name in TERMS)
    return (
        f"ms = {a} + {b}·P/1000 + {c}·N/1000 + {d}·√(N·P)/1000, P pixels of all views; "
        f"off by {100 * np.sqrt(np.mean(residuals**2)):.0f} % (root mean square), "
        f"{100 * np.abs(residuals).max():.0f} % at most"
    )


def law_columns(triangles: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return what the law's constants multiply, (k,4), for numbers of triangles (k,) and of pixels (k,)."""
    pixels = pixels.astype(np.float64)
    return np.stack(
        [np.ones(len(pixels)), pixels / 1e3, triangles / 1e3, np.sqrt(triangles * pixels) / 1e3], 1
    )


def machine_line() -> str:
    """Return the cores this process may use, whether they are real ones, and the load."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    siblings = Path("/sys/devices/system/cpu/cpu0/topology/thread_siblings_list")
    kind = ""
    if siblings.is_file():
        alone = siblings.read_text().strip() == "0"
        kind = ", one thread each" if alone else ", which share their units in pairs"
    return f"{cores} cores{kind}, load {os.getloadavg()[0]:.1f}"
