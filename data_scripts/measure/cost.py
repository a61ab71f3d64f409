"""Time of alpha persistence against the number of samples: ours beside gudhi's `safe` path, in turns.

One row per cloud and M: CPU milliseconds of every stage and of all, medians, ratios, and the number of
Delaunay tetrahedra. Notebook 07 reads it. Three minutes of CPU on an idle machine.
"""

import pandas as pd
from common import cpu_name, options, write

from paper_artifact.bench.persistence import STUDY_CLOUDS, persistence_rows
from paper_artifact.record.environment import packages

SIZES, TURNS = (2048, 4096, 8192, 20_000), 5

if __name__ == "__main__":
    folder, versions = options(__doc__).out, packages()
    rows = [
        row
        for cloud, (_, draw) in STUDY_CLOUDS.items()
        for row in persistence_rows(SIZES, TURNS, cloud, draw)
    ]
    machine = {"cpu": cpu_name(), "gudhi": versions["gudhi"], "numba": versions["numba"]}
    write(pd.DataFrame(rows).assign(repetitions=TURNS, **machine), folder / "cost.csv")
