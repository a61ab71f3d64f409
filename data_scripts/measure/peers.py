"""Differentiable alpha diagrams beside oineus.diff and torch-topological: time, bars, gradient.

Columns as `paper_artifact.bench.peers.peer_rows`, the load when the row was done, the machine, versions and
what was not measured. Notebook 07 reads it. Needs the peers, in a side environment (README, "Beside other
libraries"): a stored table must not lose one unnoticed. Five minutes of CPU.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Sequence

import pandas as pd
import torch
from common import cpu_name, options, write

from paper_artifact.bench.peers import PEERS, Peer, peer_rows, why_missing
from paper_artifact.record.environment import packages


def collected(peers: Sequence[Peer], rows_of: Callable[[list[str]], Iterable[dict]]) -> pd.DataFrame:
    """Return the rows with the machine's load, names and versions. Exits where a peer does not import.

    rows_of: is given the list to which notes on what was not measured are appended.
    """
    if missing := [line for line in map(why_missing, peers) if line]:
        raise SystemExit("; ".join(missing))
    notes: list[str] = []
    rows = [row | {"load": round(os.getloadavg()[0], 1)} for row in rows_of(notes)]
    versions = {"python": platform.python_version(), "torch": torch.__version__, "gudhi": packages()["gudhi"]}
    return pd.DataFrame(rows).assign(cpu=cpu_name(), **versions, not_measured="; ".join(notes))


if __name__ == "__main__":
    folder = options(__doc__).out
    write(collected(PEERS, lambda notes: peer_rows(missing=notes)), folder / "peers.csv")
