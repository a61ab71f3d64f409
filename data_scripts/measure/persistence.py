"""Alpha persistence beside other libraries on the same clouds; docs/persistence.md has the table.

    python data_scripts/measure/persistence.py [--sizes 2048 8192] [--turns 5]

One row per cloud, M and library: CPU milliseconds of the process, the ratio to ours, and the largest
difference of the ten longest bars of dimension 1. gudhi makes its pairs as lists, which is part of its time.
oineus gives squared radii by inexact predicates; it is measured where it is installed (`pip install oineus
eagerpy diode`). Run it on an idle machine.
"""

from collections.abc import Callable
from functools import partial

from common import count, in_turn, options, write

import numpy as np
import pandas as pd
import torch
from cost import CLOUDS, points_of
from peers import PEERS, bar_difference, why_missing

from paper_artifact.alpha import alpha_persistence
from paper_artifact.alpha.persistence import gudhi_persistence
from paper_artifact.record.environment import cpu_model


def libraries(points: np.ndarray) -> dict[str, Callable]:
    """Return what is timed on `points` (M,3): each call returns the bars (k,2) of dimension 1, radii."""
    calls: dict[str, Callable] = {"ours": lambda: alpha_persistence(points)[1].diagram}
    for precision in ("safe", "fast", "exact"):
        run = partial(gudhi_persistence, points, precision=precision)
        calls[f"gudhi {precision}"] = lambda run=run: run()[1].diagram
    oineus = PEERS[0]
    if why_missing(oineus) is None:
        calls[oineus.name] = lambda: oineus.diagrams(torch.from_numpy(points))[1].numpy()
    return calls


if __name__ == "__main__":
    given = options(
        __doc__,
        sizes={"type": count, "nargs": "+", "default": [2048, 8192]},
        turns={"type": count, "default": 5},
    )
    rows = []
    for name in CLOUDS:
        for size in given.sizes:
            calls = libraries(points_of(CLOUDS, name, size))
            bars = {library: call() for library, call in calls.items()}
            for library, clock in in_turn(calls, given.turns).items():
                row = {"cloud": name, "M": size, "library": library, "ms": 1e3 * clock["cpu"].median()}
                rows.append(row | {"difference": bar_difference(bars["ours"], bars[library])})
    table = pd.DataFrame(rows).assign(cpu=cpu_model())
    ours = table["ms"].where(table["library"] == "ours").groupby([table["cloud"], table["M"]])
    table["ratio"] = table["ms"] / ours.transform("max")
    print(table.pivot(index=["cloud", "M"], columns="library", values="ratio").round(1).to_string())
    write(table, given.out / "persistence.csv")
