"""Notebook 17: Betti numbers in words with other libraries' diagrams, and how long each takes.

Measured by `bench.words_task` in a side environment (README, "Beside other libraries"); the table reads the
file and needs no peer.
"""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from paper_artifact.bench.words_task import TASK_PEERS, task_rows
from paper_artifact.report.peers import load_now, machine_text, require, with_machine


def measure_peers_task(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return the rows of `bench.words_task.task_rows` with the machine, its load and the versions; ten
    minutes of CPU. Raises InputError when a peer is missing."""
    require(TASK_PEERS)
    rows, notes = [], []
    for row in task_rows(missing=notes):
        rows.append(row | {"load": load_now()})
        if progress is not None:
            progress(f"{row['task']}: {row['library']}")
    return with_machine(rows, notes)


def task_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return per task and library: the step from which the words hold, the CPU seconds until then and how
    many times BettiLoss's; of a library that was stopped before, the steps taken; CPU ms per step."""
    reached = stored["step"].notna()
    seconds = stored["seconds"].map("{:.2f}".format)
    table = pd.DataFrame(
        {
            "task": stored["task"],
            "library": (stored["library"] + " " + stored["version"].fillna("")).str.strip(),
            "words hold from step": stored["step"]
            .map("{:.0f}".format)
            .where(reached, "not in " + stored["taken"].astype(str)),
            "CPU s": seconds.where(reached, "stopped at " + seconds),
            "times BettiLoss": stored["ratio"].map("{:.1f}".format).where(reached, ""),
            "ms a step": stored["ms"].round(1),
        }
    )
    return table.set_index(["task", "library"])


def task_machine(stored: pd.DataFrame) -> str:
    """Return the line that says where the stored times come from and what was left out."""
    return machine_text(stored, "; one descent each")
