"""Writes results/measured/staircase.csv: the longest lifetimes and the floor of every analytic shape, M = 512
to 20,000, five sampling seeds. A minute of CPU; notebook 03 reads it.

    python data_scripts/measure/staircase.py
"""

from common import options, write

from paper_artifact.scene.shapes import SHAPES
from paper_artifact.staircase import DENSITIES, SEEDS, staircases

if __name__ == "__main__":
    folder = options(__doc__).out
    table = staircases(tuple(SHAPES), (512, 1024, *DENSITIES), SEEDS, progress=print)
    write(table, folder / "staircase.csv")
