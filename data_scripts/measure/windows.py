"""Writes results/measured/windows.csv: the margin over the floor of every feature of Table S13's shapes, 40
sampling seeds, of the torus 200. Five minutes of CPU; notebook 04 reads it.

    python data_scripts/measure/windows.py
"""

from common import options, write

import pandas as pd

from paper_artifact.catalogue import shape_row
from paper_artifact.results import published
from paper_artifact.staircase import bundle_margins

if __name__ == "__main__":
    folder = options(__doc__).out
    shapes = [shape for shape in published("S13")["shape"].unique() if shape_row(shape) is not None]
    tables = [bundle_margins([shape], range(200 if shape == "torus" else 40)) for shape in shapes]
    write(pd.concat(tables), folder / "windows.csv")
