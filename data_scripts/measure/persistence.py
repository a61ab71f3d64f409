"""Writes results/measured/persistence.csv: alpha persistence beside other libraries on the same clouds.

    python data_scripts/measure/persistence.py [--sizes 2048 8192] [--turns 5]

Every row is one cloud, size and library: CPU milliseconds of the process (median of turns in which all take
turns), the ratio to ours, and the largest difference of the ten longest bars of dimension 1. gudhi makes its
pairs as lists, which is part of its time. oineus gives squared radii by inexact predicates; it is measured
where it is installed (`pip install oineus eagerpy diode`). Run it on an idle machine.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
from common import cpu_name, in_turn, options, write

from paper_artifact.alpha import alpha_persistence
from paper_artifact.alpha.persistence import gudhi_persistence
from paper_artifact.bench.peers import PEERS, bar_difference, why_missing
from paper_artifact.bench.persistence import CLOUDS
from paper_artifact.randomness import stream


def libraries(points: np.ndarray) -> dict[str, Callable]:
    """Return what is timed on `points` (M,3): each call returns the bars (k,2) of dimension 1, radii."""
    calls = {"ours": lambda: alpha_persistence(points)[1].diagram}
    for precision in ("safe", "fast", "exact"):
        calls[f"gudhi {precision}"] = partial(
            lambda precision: gudhi_persistence(points, precision=precision)[1].diagram, precision
        )
    oineus = PEERS[0]
    if why_missing(oineus) is None:
        import torch

        calls[oineus.name] = lambda: oineus.diagrams(torch.from_numpy(points))[1].numpy()
    return calls


if __name__ == "__main__":
    given = options(
        __doc__, sizes={"type": int, "nargs": "+", "default": [2048, 8192]}, turns={"type": int, "default": 5}
    )
    rows = []
    for name, draw in CLOUDS.items():
        for size in given.sizes:
            points = draw(size, stream(0, f"persistence benchmark {name}", size))
            calls = libraries(points)
            bars = {library: call() for library, call in calls.items()}
            taken = in_turn(calls, given.turns)
            ms = {
                library: 1e3 * float(np.median([c.cpu for c in clocks])) for library, clocks in taken.items()
            }
            for library in calls:
                row = {"cloud": name, "M": size, "library": library, "ms": ms[library]}
                row["ratio"] = ms[library] / ms["ours"]
                rows.append(
                    row | {"difference": bar_difference(bars["ours"], bars[library]), "cpu": cpu_name()}
                )
    table = pd.DataFrame(rows)
    print(table.pivot(index=["cloud", "M"], columns="library", values="ratio").round(1).to_string())
    write(table, given.out / "persistence.csv")
