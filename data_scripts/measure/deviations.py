"""What two deviations of method change: the repair gate with a constant learning rate beside the decaying
one, and a soup's samples with the opacity of a triangle's mean logit beside the mean of its corners'.

One row per subject, case and quantity (value). Notebook 15 reads it. Two minutes of CPU; needs the committed
soups.
"""

from collections.abc import Iterator

from common import needed, options, write

import numpy as np
import pandas as pd

from paper_artifact import results
from paper_artifact.catalogue import shapes_of
from paper_artifact.evaluate.diagram import bottlenecks, diagram_of
from paper_artifact.evaluate.scores import SAMPLES, make_target
from paper_artifact.randomness import stream
from paper_artifact.sampling import face_areas, sample_surface
from paper_artifact.scene.shapes import surface
from paper_artifact.soup.state import Soup, load_soup
from paper_artifact.study.repair import FINAL_RATE, make_probe, repair


def gate_rows(name: str) -> Iterator[tuple]:
    """Yield what a probe reaches: the step of the paper's factor, and the factor at the end."""
    gate = results.published("gate")
    wanted = gate[gate["shape"].str.startswith(name)]["value"].iloc[0]
    for rate in (FINAL_RATE, 1.0):
        run = repair(make_probe(name), record_every=20, final_rate=rate)
        reached = np.flatnonzero(run.bottleneck <= run.bottleneck[0] / wanted)
        step = int(run.steps[reached[0]]) if len(reached) else None
        yield "gate", name, f"step of the paper's factor, rate to {rate:g}", step
        yield "gate", name, f"factor at the end, rate to {rate:g}", run.factor


def opacity_rows(shape: str, soup: Soup) -> Iterator[tuple]:
    """Yield the sampling probability that moves (total variation) and the bottleneck distance either way."""
    corners, faces = soup.vertices.detach().numpy().astype(float), np.arange(3 * len(soup)).reshape(-1, 3)
    logits, flat = soup.opacity.detach().numpy().astype(float), corners.reshape(-1, 3)
    weights = {
        "mean of opacities": soup.corner_opacity().astype(float).mean(axis=1),
        "opacity of the mean": 1 / (1 + np.exp(-logits.mean(axis=1))),
    }
    shares = [each * face_areas(flat, faces) for each in weights.values()]
    shares = [each / each.sum() for each in shares]
    yield "opacity", shape, "total variation", float(np.abs(shares[0] - shares[1]).sum() / 2)
    target = make_target(surface(shape))
    for name, weight in weights.items():
        generator = stream(0, "evaluation samples", 2500)
        points = sample_surface(flat, faces, SAMPLES, generator, weights=weight)[0]
        found = bottlenecks(diagram_of(points, target.diagonal), target.diagram)
        yield "opacity", shape, f"bottleneck, {name}", found[target.dimension]


if __name__ == "__main__":
    folder = options(__doc__).out
    rows = [row for name in ("T1", "T3", "T4") for row in gate_rows(name)]
    tables = results.load()
    runs = tables.of("table2").query("condition == 'C1' and seed == 0").set_index("shape")["run"]
    shapes = shapes_of("loop group", "void group")
    for shape, run in needed(runs, shapes, "table2")[[*shapes]].items():
        rows += opacity_rows(str(shape), load_soup(tables.soup_path(run)))
    write(pd.DataFrame(rows, columns=["subject", "case", "quantity", "value"]), folder / "deviations.csv")
