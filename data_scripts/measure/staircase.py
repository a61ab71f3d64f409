"""Writes results/measured/staircase.csv: the longest lifetimes and the floor of every analytic shape, M = 512
to 20,000, five sampling seeds. A minute of CPU; notebook 03 reads it.

    python data_scripts/measure/staircase.py
"""

from paper_artifact.results import MEASURED
from paper_artifact.scene.shapes import SHAPES
from paper_artifact.staircase import DENSITIES, SEEDS, staircases

if __name__ == "__main__":
    table = staircases(tuple(SHAPES), (512, 1024, *DENSITIES), SEEDS, progress=print)
    table.to_csv(MEASURED / "staircase.csv", index=False, float_format="%.6g", lineterminator="\n")
