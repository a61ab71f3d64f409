"""Notebook 07: our differentiable alpha diagrams beside the libraries that offer them.

Measured by `bench.peers` in a side environment (README, "Beside other libraries"); the table reads the file
and needs no peer.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence

import pandas as pd
import torch

from paper_artifact.bench.peers import OURS, PEERS, SIZES, Peer, peer_rows, why_missing
from paper_artifact.errors import InputError
from paper_artifact.record.environment import host, packages

ROUNDING = 1e-12  # a difference up to it is none


def measure_peers(
    sizes: Sequence[int] = SIZES, repetitions: int = 7, progress: Callable[[str], None] | None = None
) -> pd.DataFrame:
    """Return the rows of `bench.peers.peer_rows` with the machine, its load (1-minute average when the row
    was done; 0 where the system has none) and the versions; five minutes of CPU.

    Raises InputError, with the line that installs it, when a peer is missing: a stored table must not lose
    one unnoticed.
    """
    require(PEERS)
    rows, notes = [], []
    for row in peer_rows(sizes, repetitions=repetitions, missing=notes):
        rows.append(row | {"load": load_now()})
        if progress is not None:
            progress(f"{row['cloud']}, M = {row['M']}: {row['library']}")
    return with_machine(rows, notes)


def require(peers: Sequence[Peer]) -> None:
    """Raise InputError, with the lines that install them, where peers do not import."""
    missing = [line for line in map(why_missing, peers) if line]
    if missing:
        raise InputError("; ".join(missing))


def load_now() -> float:
    """Return the machine's 1-minute load average, 0 where the system has none."""
    return round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else 0.0


def with_machine(rows: Sequence[dict], notes: Sequence[str]) -> pd.DataFrame:
    """Return the rows as a table with the machine, the versions and `notes` on what was not measured."""
    return pd.DataFrame(rows).assign(
        cpu=host()["cpu"],
        python=platform.python_version(),
        torch=torch.__version__,
        gudhi=packages()["gudhi"],
        not_measured="; ".join(notes),
    )


def peers_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return per cloud, M and library: CPU ms of forward (points, diagrams, loss) and backward, how many
    times ours, for the forward alone and for both, and whether the ten longest bars and the gradient are ours
    (largest difference; "same" up to 1e-12)."""
    names = stored["library"]
    return pd.DataFrame(
        {
            "cloud": stored["cloud"],
            "M": stored["M"],
            "library": names.where(names == OURS, names + " " + stored["version"]),
            "forward ms": stored["forward_ms"].round(0),
            "backward ms": stored["backward_ms"].round(0),
            "forward / ours": stored["forward_ratio"].round(1),
            "both / ours": stored["ratio"].round(1),
            "longest bars": stored["bar_difference"].map(_same),
            "gradient": stored["gradient_difference"].map(_same),
        }
    ).set_index(["cloud", "M", "library"])


def peers_machine(stored: pd.DataFrame) -> str:
    """Return the line that says where the stored times come from and what was left out."""
    turns = f"medians of {stored['turns'].max()} turns, a peer that took longer than half a minute once"
    return machine_text(stored, f", gudhi {stored['gudhi'].iloc[0]}; {turns}")


def machine_text(stored: pd.DataFrame, how: str) -> str:
    """Return the machine of a table made by `with_machine`, how it was measured and what was left out."""
    row, load = stored.iloc[0], stored["load"]
    left = f"; {row['not_measured']}" if isinstance(row["not_measured"], str) and row["not_measured"] else ""
    return (
        f"{row['cpu']}, load {load.min()} to {load.max()}, one thread, Python {row['python']}, "
        f"torch {row['torch']}{how}{left}"
    )


def _same(difference: float) -> str:
    if pd.isna(difference):
        return "not finite"
    return "same" if difference <= ROUNDING else f"differ by {difference:.2g}"
