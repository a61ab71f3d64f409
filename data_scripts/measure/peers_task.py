"""Stated Betti numbers with other libraries' diagrams: CPU seconds until a cloud has them.

Everyone moves the same points by Adam under the loss of T2 (`paper_artifact.topology.loss`) in one
dimension: wanted deaths beyond their present value by two median spacings, all other bars to the diagonal.
With a library's diagrams the loss is made of tensors and every step computes them anew, ours too in the row
"paper_artifact, diagrams"; `BettiLoss` makes a plan at every step too, and in the row "K = 10" at each tenth,
as in training. Our diagrams decide whether the cloud has the numbers, outside of the clock.

One row per task and library: step at which they hold (empty: never), steps taken, CPU seconds, milliseconds a
step, ratio to BettiLoss; load, machine and versions as in peers.py. Notebook 17 reads it. Needs oineus,
torch-topological and TopologyLayer in a side environment (docs/study.md). Ten minutes of CPU.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from common import Clock, options, write

import numpy as np
import torch
from peers import OURS, PEERS, Diagrams, Peer, collected, our_diagrams, reason, version_of
from torch import Tensor

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.randomness import stream
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.topology.floor import MULTIPLIER, measurement_floor, median_spacing
from paper_artifact.topology.loss import BettiLoss

PULL, EVERY = 2.0, 5  # median spacings; steps between two questions whether the numbers hold
PATIENCE = 60.0  # CPU seconds after which a library is stopped

Loss = Callable[[Tensor], Tensor]


def _topology_layer_diagrams(points: Tensor) -> list[Tensor]:
    from topologylayer.nn import AlphaLayer

    found = [each / 2 for each in AlphaLayer(maxdim=2)(points.float())[0]]  # it reads float32 alone
    return [each[torch.isfinite(each).all(dim=1)] for each in found]


TASK_PEERS = (
    *PEERS,
    Peer(
        name="TopologyLayer",
        modules=("topologylayer.nn",),
        distributions=("topologylayer",),
        diagrams=_topology_layer_diagrams,
        install="pip install git+https://github.com/bruel-gabrielsson/TopologyLayer (compiled: g++)",
        note="weak alpha filtration: half the longest edge, not circumradii",
    ),
)


@dataclass(frozen=True)
class Task:
    """A cloud and what it is to become."""

    name: str
    cloud: Callable[[], np.ndarray]  # (n,3)
    betti: tuple[int, int, int]  # the stated numbers
    dimension: int  # the one that the loss acts in
    rate: float  # of Adam
    steps: int = 200  # at most


def slab(count: int) -> np.ndarray:
    """Return a square sheet without a hole, (count,3), side 1, a fiftieth thick."""
    return stream(0, "demo slab").random((count, 3)) * [1, 1, 0.02]


def punctured_sphere() -> np.ndarray:
    """Return a unit sphere, (about 1,500,3), without caps of radii .4 and .6 at the ends of the x axis.

    One puncture would be no loop, since the rest of the sphere fills it; two are one.
    """
    points = stream(0, "demo sphere").standard_normal((1500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points[np.linalg.norm(points[:, 1:], axis=1) > np.where(points[:, 0] > 0, 0.4, 0.6)]


TASKS = (
    Task("grow a hole", partial(slab, 600), (1, 1, 0), 1, 3e-3),
    Task("close a puncture", punctured_sphere, (1, 0, 1), 1, 6e-3),
)


def stated_loss(diagrams: Diagrams, task: Task, points: Tensor) -> Tensor:
    """Return T2's loss (scalar) of `points` (n,3) in the task's dimension, made of a library's diagrams."""
    bars = diagrams(points)[task.dimension]
    wanted = task.betti[task.dimension] - (task.dimension == 0)
    order = torch.argsort(bars[:, 0] - bars[:, 1])
    first, others = bars[order[:wanted]], bars[order[wanted:]]
    target = first[:, 1].detach() + PULL * median_spacing(points.detach().numpy())
    return (first[:, 1] - target).square().sum() + ((others[:, 1] - others[:, 0]) / 2).square().sum()


def holds(points: np.ndarray, task: Task) -> bool:
    """Return whether the wanted bars of points (n,3) exceed their floor in the task's dimension, and no other
    bar does."""
    pairs = alpha_persistence(points)[task.dimension]
    significant = int((pairs.deaths - pairs.births > measurement_floor(points, 1.0, MULTIPLIER)).sum())
    return significant == task.betti[task.dimension] - (task.dimension == 0)


def descend(make: Callable[[], Loss], task: Task) -> tuple[int | None, float, int]:
    """Return (step at which the numbers hold or None, CPU seconds of the steps, steps taken), after an
    uncounted pass over a third of the points."""
    make()(torch.tensor(task.cloud()[::3], requires_grad=True)).backward()
    loss, points = make(), torch.tensor(task.cloud(), requires_grad=True)
    optimiser, spent, step = torch.optim.Adam([points], lr=task.rate), 0.0, 0
    for step in range(task.steps + 1):
        if step % EVERY == 0 and holds(points.detach().numpy(), task):
            return step, spent, step
        if step == task.steps or spent > PATIENCE:
            break
        with Clock() as clock:
            optimiser.zero_grad()
            loss(points).backward()
            optimiser.step()
        spent += clock.cpu
    return None, spent, step


def task_rows(
    notes: list[str], tasks: Sequence[Task] = TASKS, peers: Sequence[Peer] = TASK_PEERS
) -> Iterator[dict]:
    """Yield, for each task, a row for `BettiLoss`, for our diagrams and for each peer that does not fail."""
    versions = {peer.name: version_of(peer) for peer in peers}
    for task in tasks:
        settings = {"guard": 0.0, "suppress": "all", "dimensions": (task.dimension,), "pull": PULL}
        betti_loss = partial(BettiLoss, task.betti, diagonal=1.0, **settings)
        losses: dict[str, Callable[[], Loss]] = {
            f"{OURS}, BettiLoss": partial(betti_loss, refresh_every=1),
            f"{OURS}, BettiLoss, K = 10": betti_loss,
            f"{OURS}, diagrams": partial(partial, stated_loss, our_diagrams, task),
        }
        losses |= {peer.name: partial(partial, stated_loss, peer.diagrams, task) for peer in peers}
        ours: float | None = None
        for place, (name, make) in enumerate(losses.items()):
            try:
                with one_torch_thread():
                    step, seconds, taken = descend(make, task)
            except Exception as error:  # a peer's own failure is a finding, not ours
                if name.startswith(OURS):
                    raise
                notes.append(f"{name}: failed at {task.name} ({reason(error)})")
                continue
            if place == 0 and step is not None:
                ours = seconds
            row = {"task": task.name, "library": name, "version": versions.get(name), "step": step}
            row |= {"taken": taken, "seconds": seconds, "ms": 1e3 * seconds / max(1, taken)}
            yield row | {"ratio": None if step is None or not ours else seconds / ours}


if __name__ == "__main__":
    folder = options(__doc__).out
    write(collected(TASK_PEERS, task_rows), folder / "peers_task.csv")
