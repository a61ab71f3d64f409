"""A training step against triangles and pixels, and whole runs of C0 and C1 in turn, on one core.

Rows "step": triangles N, image side `size`, views, CPU and wall milliseconds, medians. The soup is the
sphere's after 300 steps, its triangles halved until there are enough: soups trained with that many triangles
cost the same to 12 %. Rows "run": per condition, milliseconds per step of the training loop, medians of RUNS
runs. Notebook 07 reads it. Four minutes on an idle core; a busy machine gives other numbers. With --threads
it prints whole runs of C0 on one thread and on two instead.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from common import in_turn, options, write

import numpy as np
import pandas as pd
import torch
from PIL import Image

from paper_artifact.catalogue import study_config
from paper_artifact.files import partial_folder
from paper_artifact.pipeline import make_run_bundle, make_run_term, prepare_scene
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.threads import one_torch_thread, set_thread_count
from paper_artifact.record.environment import cpu_model, packages
from paper_artifact.scene.load import Scene
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.adam import SoupOptimiser
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import CpuBackend
from paper_artifact.train.loop import train
from paper_artifact.train.state import learning_rates

TRIANGLES = (1_000, 3_000, 10_000, 15_000, 30_000)
SIZES = (100, 200, 400, 800, 1600)  # side of the images, pixels
TURNS, RUNS, BATCH = 7, 3, 4


def resized_soup(soup: Soup, count: int) -> Soup:
    """Return a soup of `count` >= 1 triangles that shows the same picture: the largest are halved at their
    longest edge, again and again, or the smallest left out."""
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
        corners, *values = (_halves(array, split, turn) for array in (corners, *values))
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


def stepper(scene: Scene, soup: Soup, triangles: int, size: int) -> Callable[[], None]:
    """Return a step of training as the loop takes it, optimisers included, on BATCH views of a resized scene;
    the learning rates are those of a run's end, so that the soup stays what it is."""
    views = scene.train[np.arange(BATCH) * len(scene.train) // BATCH]
    backend, own = CpuBackend(resized_scene(scene, views, size), views), resized_soup(soup, triangles)
    config, optimiser, taken = study_config("sphere", steps=1), SoupOptimiser(own), 0
    rates = learning_rates(config, float(scene.radius), config.steps)

    @one_torch_thread()  # as the trainer does: torch's threads would spin beside the kernels
    def step() -> None:
        nonlocal taken
        taken += 1
        backend.photometric_step(own, views, [view_key(0, taken, int(view)) for view in views])
        optimiser.step(rates)

    return step


def step_rows(
    scene: Scene,
    soup: Soup,
    triangles: Sequence[int] = TRIANGLES,
    sizes: Sequence[int] = SIZES,
    turns: int = TURNS,
) -> Iterator[dict]:
    """Yield a row per number of triangles N and image side."""
    for size in sizes:
        for count in triangles:
            clock = 1e3 * in_turn({"": stepper(scene, soup, count, size)}, turns)[""].median()
            row = {"what": "step", "repetitions": turns, "N": count, "size": size, "views": BATCH}
            yield row | {"ms": clock["cpu"], "wall_ms": clock["wall"]}


def whole_run(folder: Path, condition: str, threads: int = 1, **changes: int) -> None:
    """Train the sphere, on the CPU; its scene is built in `folder` the first time."""
    set_thread_count(threads)
    config, mesh = study_config("sphere", condition, **changes), find_mesh("sphere")
    term = make_run_term(config, make_run_bundle(config, mesh))
    train(prepare_scene(config, mesh, folder), config, term=term, device="cpu")


def measured(folder: Path) -> pd.DataFrame:
    """Return the table; scenes are built in `folder`."""
    config = study_config("sphere")
    scene = prepare_scene(config, find_mesh("sphere"), folder)
    rows = list(step_rows(scene, train(scene, study_config("sphere", steps=300), device="cpu").soup))
    runs = {condition: partial(whole_run, folder, condition) for condition in ("C0", "C1")}
    for condition, clock in in_turn(runs, RUNS).items():
        row = {"what": "run", "N": config.budget, "size": config.size, "views": config.batch}
        row |= {"condition": condition, "steps": config.steps, "repetitions": RUNS}
        milliseconds = 1e3 * clock.median() / config.steps
        rows.append(row | {"ms": milliseconds["cpu"], "wall_ms": milliseconds["wall"]})
    machine = {"cpu": cpu_model(), "load": round(os.getloadavg()[0]), "numba": packages()["numba"]}
    return pd.DataFrame(rows).assign(**machine)


def threads_table(folder: Path) -> pd.DataFrame:
    """Return seconds of C0 on one thread and two, and how many times as fast as one."""
    runs = {str(count): partial(whole_run, folder, "C0", count) for count in (1, 2)}
    table = pd.DataFrame({count: clock.median() for count, clock in in_turn(runs, RUNS).items()}).T
    return table.assign(speedup=table["wall"].iloc[0] / table["wall"]).rename_axis("threads")


if __name__ == "__main__":
    given = options(__doc__, threads={"action": "store_true", "help": "one thread beside two, printed"})
    with partial_folder() as name:
        if given.threads:
            print(threads_table(name).round(2).to_string())
        else:
            write(measured(name), given.out / "speed.csv")
