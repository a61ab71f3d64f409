"""Writes results/measured/starts.csv: the soup before training, judged like an evaluation, for every shape of
the catalogue and five seeds. It depends on shape and seed alone; `results` adds it to the frame dumps as step
0. Two minutes of CPU.

    python data_scripts/measure/starts.py
"""

from common import options, write

import pandas as pd

from paper_artifact.catalogue import SHAPES, study_config
from paper_artifact.evaluate.scores import evaluate_soup, make_target
from paper_artifact.files import RESULTS
from paper_artifact.pipeline import prepare_scene
from paper_artifact.scene.shapes import find_mesh, surface
from paper_artifact.train.backend import CpuBackend
from paper_artifact.train.loop import start_state

if __name__ == "__main__":
    folder, rows = options(__doc__).out, []
    for shape in (row.name for row in SHAPES):
        target = make_target(surface(shape))
        for seed in range(5):
            config = study_config(shape, seed=seed)
            scene = prepare_scene(config, find_mesh(shape), RESULTS / "scenes")
            soup = start_state(scene, config, CpuBackend(scene, scene.train)).soup
            found = evaluate_soup(soup.vertices.detach().numpy(), soup.corner_opacity(), target, seed)
            row = {"shape": shape, "seed": seed, "bottleneck": found["bottleneck"][target.dimension]}
            rows.append(row | {"count": found["counts"][target.dimension], "chamfer": found["chamfer"]})
        print(shape)
    write(pd.DataFrame(rows), folder / "starts.csv")
