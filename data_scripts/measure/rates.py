"""Does one learning rate fit all scenes? PSNR and SSIM of held-out views against the vertices' rate.

One row per scene, factor on the default vertex_lr, seed, steps and picture size. First run `python -m
paper_artifact fetch castle lego fox monstree`; they are registered once into --folder, never shipped. A row
that is in the CSV already is not measured again: a killed sweep goes on. The default is 2,500 steps on whole
pictures, minutes of CPU a row; --steps 600 --downscale 2 takes half a minute. Needs pycolmap.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

from common import Clock, count, kept, options, write

import pandas as pd

from paper_artifact.catalogue import study_config
from paper_artifact.config import RunConfig
from paper_artifact.evaluate.image import view_scores
from paper_artifact.files import REPOSITORY, RESULTS
from paper_artifact.photos.scene import PhotosConfig, photographs_scene
from paper_artifact.pipeline import prepare_scene
from paper_artifact.scene.fetch import DOWNLOADS
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.scene.transforms import TransformsConfig, transforms_scene
from paper_artifact.train.loop import train

FACTORS = (1.0, 0.5, 2.0, 0.25, 4.0)  # of the default rate; the default first
STUDY = ("sphere", "torus")
BUDGET = 3000  # of photographs
FOX = DOWNLOADS / "NVlabs+instant-ngp" / "data" / "nerf" / "fox"


def registered(photographs: Path, size: int) -> Callable[[Path], object]:
    """Return what makes a scene of photographs in a folder."""
    return lambda folder: photographs_scene(photographs, folder, PhotosConfig(size=size))


def posed(file: Path, size: int, cloud: str) -> Callable[[Path], object]:
    """Return what makes a scene of a transforms.json in a folder."""
    return lambda folder: transforms_scene(file, folder, TransformsConfig(size=size, cloud=cloud))


LEGO = DOWNLOADS / "shouxieai+nerf" / "data" / "nerf_synthetic" / "lego" / "transforms_train.json"
SCENES: dict[str, Callable[[Path], object]] = {
    "lego": posed(LEGO, 200, "hull"),
    "castle": registered(DOWNLOADS / "openMVG+ImageDataset_SceauxCastle" / "images", 800),
    "mug": registered(REPOSITORY / "data_scripts" / "mug" / "photographs", 400),
    "fox": registered(FOX / "images", 400),  # a room
    "fox, random cloud": posed(FOX / "transforms.json", 400, "random"),
    "monstree": registered(DOWNLOADS / "alicevision+dataset_monstree" / "full", 400),  # outdoors
}


def scene_and_config(name: str, scenes: Path, steps: int, downscale: float) -> tuple[Scene, RunConfig]:
    """Return the scene of a row and the run's configuration at the default rate."""
    if name in STUDY:
        config = study_config(name, steps=steps, dump_steps=(), size=round(200 / downscale))
        return prepare_scene(config, find_mesh(name), scenes), config
    folder = scenes / name.replace(", ", "_").replace(" ", "_")
    if not folder.is_dir():
        SCENES[name](folder)
    return load_scene(folder, downscale=downscale), RunConfig(name, steps=steps, budget=BUDGET, dump_steps=())


def key_of(name: str, factor: float, scene: Scene, config: RunConfig) -> dict[str, object]:
    """Return what tells a row from the others."""
    height, width = scene.images.shape[2:]
    key = {"scene": name, "factor": factor, "seed": config.seed, "steps": config.steps}
    return key | {"width": width, "height": height}


def row_of(name: str, factor: float, scene: Scene, config: RunConfig) -> dict[str, object]:
    """Return one row: train at `factor` times the default rate, score the views held out."""
    with Clock() as clock:
        state = train(scene, replace(config, vertex_lr=factor * config.vertex_lr), device="cpu")
    scores = view_scores(state.soup, scene, scene.holdout)
    found = {"triangles": len(state.soup), "psnr": scores["psnr"], "ssim": scores["ssim"]}
    return key_of(name, factor, scene, config) | found | {"cpu": clock.cpu}


def main() -> None:
    """Measure what is asked for and not in the CSV yet; write it after every row."""
    given = options(
        __doc__,
        folder={"type": Path, "default": RESULTS / "scenes" / "rates", "help": "of the scenes"},
        steps={"type": count, "default": 2500},
        downscale={"type": float, "default": 1.0, "help": "of the pictures"},
        scenes={"nargs": "+", "default": [*STUDY, *SCENES], "choices": [*STUDY, *SCENES]},
        factors={"nargs": "+", "type": float, "default": FACTORS},
        seeds={"nargs": "+", "type": int, "default": (0, 1, 2)},
    )
    if not 1 <= given.downscale < float("inf"):
        raise SystemExit(f"--downscale is {given.downscale}; give a number of at least 1")
    path = given.out / "rates.csv"
    rows = kept(path, ["scene", "factor", "seed", "steps"]).to_dict("records")
    for name in given.scenes:
        scene, config = scene_and_config(name, given.folder, given.steps, given.downscale)
        for seed, factor in product(given.seeds, given.factors):
            seeded = replace(config, seed=seed)
            key = key_of(name, factor, scene, seeded)
            if not any(key.items() <= row.items() for row in rows):
                rows.append(row_of(name, factor, scene, seeded))
                write(pd.DataFrame(rows).sort_values([*key]), path)


if __name__ == "__main__":
    main()
