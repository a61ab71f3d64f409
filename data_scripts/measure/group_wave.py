"""Writes results/measured/group_wave.csv: staircases of the external meshes, 40 sampling seeds at M = 2048,
five at each other density. Two minutes of CPU; notebook 10 reads it.

    python data_scripts/measure/group_wave.py
"""

from common import options, write

import pandas as pd

from paper_artifact.catalogue import shapes_of
from paper_artifact.results import published
from paper_artifact.scene.fetch import sources
from paper_artifact.staircase import DENSITIES, SEEDS, staircases

if __name__ == "__main__":
    folder = options(__doc__).out
    candidates = published("S12", quantity="certificate").query("printed == 'pass'")["shape"]
    groups = [shape for shape in shapes_of("loop group", "void group") if shape in sources()]
    tables = []
    for shape in dict.fromkeys([*candidates, *groups]):  # at M = 2048 counts can depend on the seed
        tables += [staircases([shape], DENSITIES[:1], range(40)), staircases([shape], DENSITIES[1:], SEEDS)]
    table = pd.concat(tables)
    write(table, folder / "group_wave.csv")
