"""Betti numbers in words with other libraries' diagrams: CPU seconds until a cloud has what it was told.

Everyone moves the same points by Adam under the loss of T2 (`paper_artifact.topology.loss`) in one
dimension: wanted deaths beyond their own by two median spacings, all other bars to the diagonal. With a
library's diagrams the loss is made of tensors and every step computes them anew, ours too in the row
"paper_artifact, diagrams"; `BettiLoss` makes a plan at every step too, and in the row "K = 10" at each
tenth, as in training. Whether the words hold is asked of our diagrams, outside of the clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.bench.peers import OURS, PEERS, Diagrams, Peer, our_diagrams, version_text, why_missing
from paper_artifact.randomness import stream
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.topology.floor import MULTIPLIER, measurement_floor, median_spacing
from paper_artifact.topology.loss import BettiLoss

PULL, EVERY = 2.0, 5  # median spacings; steps between two questions whether the words hold
PATIENCE = 60.0  # CPU seconds after which a library is stopped

Loss = Callable[[Tensor], Tensor]


def _topology_layer_diagrams(points: Tensor) -> list[Tensor]:
    from topologylayer.nn import AlphaLayer

    found = [each / 2 for each in AlphaLayer(maxdim=2)(points.float())[0]]  # it reads float32 alone
    return [each[torch.isfinite(each).all(dim=1)] for each in found]


TOPOLOGY_LAYER = Peer(
    name="TopologyLayer",
    modules=("topologylayer.nn",),
    distributions=("topologylayer",),
    diagrams=_topology_layer_diagrams,
    install="pip install git+https://github.com/bruel-gabrielsson/TopologyLayer (compiled: g++)",
    note="weak alpha filtration: half the longest edge, not circumradii",
)
TASK_PEERS = (*PEERS, TOPOLOGY_LAYER)


@dataclass(frozen=True)
class Task:
    """A cloud and what it is to become."""

    name: str
    cloud: Callable[[], np.ndarray]  # (n,3)
    betti: tuple[int, int, int]  # the words
    dimension: int  # that they are said of
    rate: float  # of Adam
    steps: int = 200  # at most


def slab(count: int = 600) -> np.ndarray:
    """Return a square sheet without a hole, (count,3), side 1, a fiftieth thick."""
    return stream(0, "demo slab").random((count, 3)) * [1, 1, 0.02]


def punctured_sphere(count: int = 1500, openings: tuple[float, float] = (0.4, 0.6)) -> np.ndarray:
    """Return a unit sphere, (about count,3), without caps of these radii at both ends of the x axis.

    Of one puncture no loop would tell, since the rest of the sphere fills it; of two one does.
    """
    points = stream(0, "demo sphere").standard_normal((count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    away = np.linalg.norm(points[:, 1:], axis=1)
    return points[away > np.where(points[:, 0] > 0, *openings)]


TASKS = (
    Task("grow a hole", slab, (1, 1, 0), 1, 3e-3),
    Task("close a puncture", punctured_sphere, (1, 0, 1), 1, 6e-3),
)


def words_loss(diagrams: Diagrams, task: Task, points: Tensor) -> Tensor:
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
    """Return (step at which the words hold or None, CPU seconds of the steps, steps taken), after an
    uncounted pass over a third of the points."""
    some = torch.tensor(task.cloud()[::3], requires_grad=True)
    make()(some).backward()
    loss = make()
    points = torch.tensor(task.cloud(), requires_grad=True)
    optimiser, spent, step = torch.optim.Adam([points], lr=task.rate), 0.0, 0
    for step in range(task.steps + 1):
        if step % EVERY == 0 and holds(points.detach().numpy(), task):
            return step, spent, step
        if step == task.steps or spent > PATIENCE:
            break
        begin = time.process_time()
        optimiser.zero_grad()
        loss(points).backward()
        optimiser.step()
        spent += time.process_time() - begin
    return None, spent, step


def task_rows(
    tasks: Sequence[Task] = TASKS, peers: Sequence[Peer] = TASK_PEERS, missing: list[str] | None = None
) -> Iterator[dict]:
    """Yield, for each task, a row for `BettiLoss`, for our diagrams and for each peer that runs.

    Keys: task, library, version (of a peer), step (None: the words never held), taken (steps), seconds (CPU,
    of the steps), ms (per step), ratio (seconds over BettiLoss's; None where either did not reach them). A
    line for each peer that does not run is appended to `missing`.
    """
    missing = [] if missing is None else missing
    lines = {peer.name: why_missing(peer) for peer in peers}
    missing += [line for line in lines.values() if line]
    versions = {peer.name: version_text(peer.distributions) for peer in peers}
    for task in tasks:
        settings = {"guard": 0.0, "suppress": "all", "dimensions": (task.dimension,), "pull": PULL}
        betti_loss = partial(BettiLoss, task.betti, diagonal=1.0, **settings)
        losses: dict[str, Callable[[], Loss]] = {
            f"{OURS}, BettiLoss": partial(betti_loss, refresh_every=1),
            f"{OURS}, BettiLoss, K = 10": betti_loss,
        }
        for name, diagrams in [(f"{OURS}, diagrams", our_diagrams)] + [
            (peer.name, peer.diagrams) for peer in peers if lines[peer.name] is None
        ]:
            losses[name] = partial(partial, words_loss, diagrams, task)
        ours: float | None = None
        for place, (name, make) in enumerate(losses.items()):
            try:
                with one_torch_thread():
                    step, seconds, taken = descend(make, task)
            except Exception as error:  # a peer's own failure is a finding, not ours
                if name.startswith(OURS):
                    raise
                reason = " ".join(str(error).split())
                missing.append(f"{name}: failed at {task.name} ({type(error).__name__}: {reason})")
                continue
            if place == 0 and step is not None:
                ours = seconds
            yield {
                "task": task.name,
                "library": name,
                "version": versions.get(name),
                "step": step,
                "taken": taken,
                "seconds": seconds,
                "ms": 1e3 * seconds / max(1, taken),
                "ratio": None if step is None or not ours else seconds / ours,
            }
