"""Time until clouds have their stated Betti numbers: `BettiLoss` beside the same loss of other libraries.

Columns as `paper_artifact.bench.words_task.task_rows`, with load, machine and versions as in peers.py.
Notebook 17 reads it. Needs oineus, torch-topological and TopologyLayer. Ten minutes of CPU.
"""

from common import options, write
from peers import collected

from paper_artifact.bench.words_task import TASK_PEERS, task_rows

if __name__ == "__main__":
    folder = options(__doc__).out
    write(collected(TASK_PEERS, lambda notes: task_rows(missing=notes)), folder / "peers_task.csv")
