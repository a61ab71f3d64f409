"""Every void bar of one sphere seed over its training under C0, C1 and C2 (Fig. S1).

Records keep only the longest bars of an evaluation; here the three runs are trained once more and all bars
longer than SHORTEST are kept, from the samples that the evaluation of that step has. One row per bar:
condition, step (0: before training), floor, birth, death; radii over the bounding box's diagonal. Notebook 06
reads it. Two minutes of CPU.
"""

from common import options, write

import numpy as np
import pandas as pd

from paper_artifact.catalogue import study_config
from paper_artifact.evaluate.diagram import diagram_of
from paper_artifact.evaluate.scores import make_target, soup_samples
from paper_artifact.files import RESULTS
from paper_artifact.pipeline import make_run_bundle, make_run_term, prepare_scene
from paper_artifact.randomness import stream
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.train.loop import train

SHAPE, SEED, CONDITIONS = "sphere", 0, ("C0", "C1", "C2")  # "one sphere seed"; the paper does not say which
STEPS = (0, 200, 700, 1300, 2500)
SHORTEST = 0.001  # about a twentieth of the floor


def run_bars(condition: str) -> pd.DataFrame:
    """Return the bars of one run at STEPS; the run has the bits of `pipeline.run`."""
    config, mesh, tables = study_config(SHAPE, condition, SEED), find_mesh(SHAPE), []
    target = make_target(mesh)
    scene = prepare_scene(config, mesh, RESULTS / "scenes")
    term = make_run_term(config, make_run_bundle(config, mesh))

    def keep(soup, step):
        if step in STEPS:
            generator = stream(config.seed, "evaluation samples", step)
            corners, opacity = soup.vertices.detach().numpy(), soup.corner_opacity()
            points = soup_samples(corners, opacity, len(target.samples), generator)
            bars = diagram_of(points, target.diagonal)[target.dimension]
            bars = bars[bars[:, 1] - bars[:, 0] > SHORTEST]
            order = np.lexsort((bars[:, 0], bars[:, 0] - bars[:, 1]))
            own = pd.DataFrame(bars[order], columns=["birth", "death"])
            floor = measurement_floor(points, target.diagonal)
            tables.append(own.assign(condition=condition, step=step, floor=floor))
        return {"step": step}

    keep(initial_soup(scene.points, max(2, round(config.initial_ratio * config.budget)), config.seed), 0)
    train(scene, config, term=term, evaluate=keep)
    return pd.concat(tables, ignore_index=True)[["condition", "step", "floor", "birth", "death"]]


if __name__ == "__main__":
    folder = options(__doc__).out
    write(pd.concat([run_bars(condition) for condition in CONDITIONS]), folder / "diagrams.csv")
