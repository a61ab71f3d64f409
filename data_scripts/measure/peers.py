"""Differentiable alpha diagrams beside oineus.diff and torch-topological: time, bars, gradient.

Everyone gets the same float64 points (M,3), makes the diagrams of dimensions 0 to 2 as torch tensors that
know the points, and the same loss: the sum of squared lifetimes (death - birth)² in dimension 1, in RADII, in
the unit of the points. oineus.diff gives squared radii; torch-topological pairwise distances, which are
halved.

One row per cloud, M and library: CPU milliseconds (forward, backward, both), medians of `turns`; ratios to
ours; bars of dimension 1; how far its ten longest and the gradient are from ours; the machine, versions, and
what was not measured. Notebook 07 reads it. Needs the peers, in a side environment (docs/study.md): a stored
table must not lose one unnoticed. Five minutes of CPU.
"""

import gc
import importlib
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import metadata

from common import Clock, options, write

import numpy as np
import pandas as pd
import torch
from cost import CLOUDS, points_of
from torch import Tensor

import paper_artifact
from paper_artifact.alpha.diagrams import alpha_diagrams
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.record.environment import cpu_model, packages

OURS = "paper_artifact"
LONGEST = 10  # bars that are compared
SIZES, TURNS = (2048, 8192), (7, 3)  # points M of a cloud, and turns at each
SLOW = 30.0  # CPU seconds: a peer that takes longer is timed once, and not at all at a larger size

Diagrams = Callable[[Tensor], Sequence[Tensor]]  # points (M,3) -> bars (k,2) of dimensions 0, 1, 2: RADII


@dataclass(frozen=True)
class Peer:
    """A library and how it is called."""

    name: str
    modules: tuple[str, ...]  # what must import
    distributions: tuple[str, ...]  # whose versions are reported
    diagrams: Diagrams
    install: str  # how to get it
    note: str  # what it measures


def our_diagrams(points: Tensor) -> list[Tensor]:
    """Return the bars (k,2) of `alpha_diagrams`, dimensions 0, 1, 2."""
    return [diagram.bars for diagram in alpha_diagrams(points)]


def _oineus_diagrams(points: Tensor) -> list[Tensor]:
    from oineus import diff

    diagrams = diff.persistence_diagram(diff.alpha_filtration(points), n_threads=1)
    # A vertex enters at 0, where the square root has no derivative: dimension 0 keeps its births.
    radii = [torch.stack([diagrams[0][:, 0], diagrams[0][:, 1].sqrt()], dim=1)]
    return radii + [diagrams[dimension].sqrt() for dimension in (1, 2)]


def _torch_topological_diagrams(points: Tensor) -> list[Tensor]:
    from torch_topological.nn import AlphaComplex

    empty = points.new_zeros((0, 2))
    return [each.diagram / 2 if len(each.diagram) else empty for each in AlphaComplex()(points)]


PEERS = (
    Peer(
        name="oineus.diff",
        modules=("oineus.diff", "diode"),
        distributions=("oineus", "diode"),
        diagrams=_oineus_diagrams,
        install="pip install oineus eagerpy diode (diode is compiled: g++, cmake, libcgal-dev)",
        note="alpha filtration, squared radii",
    ),
    Peer(
        name="torch-topological",
        modules=("torch_topological.nn",),
        distributions=("torch-topological",),
        diagrams=_torch_topological_diagrams,
        install="pip install torch-topological",
        note="pairs of gudhi's alpha filtration (precision `fast`); "
        "values are half the longest edge, not circumradii",
    ),
)


def why_missing(peer: Peer) -> str | None:
    """Import the peer; return None, or one line: what went wrong and how to install it."""
    try:
        for module in peer.modules:
            importlib.import_module(module)
    except Exception as error:  # a broken build of another's extension may raise anything
        return f"{peer.name}: does not import ({reason(error)}); install it with: {peer.install}"
    return None


def reason(error: Exception) -> str:
    """Return an error's kind and text in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def version_of(peer: Peer) -> str:
    """Return "0.9.39", or "0.9.39, diode 1.2.2" where more than one distribution matters."""
    first, *others = peer.distributions
    return ", ".join([metadata.version(first), *(f"{name} {metadata.version(name)}" for name in others)])


def loss_and_gradient(diagrams: Diagrams, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return (diagram of dimension 1 (k,2), gradient (M,3), forward, backward) at `points` (M,3).

    forward, backward: CPU seconds; forward makes the points' tensor, the diagrams and the loss.
    """
    gc.collect()  # so that no library is charged for another's garbage
    with Clock() as forward:
        cloud = torch.tensor(points, dtype=torch.float64, requires_grad=True)
        loops = diagrams(cloud)[1]
        loss = (loops[:, 1] - loops[:, 0]).square().sum()
    with Clock() as backward:
        loss.backward()
    return loops.detach().numpy().copy(), cloud.grad.numpy().copy(), forward.cpu, backward.cpu


def rows_of(cloud: str, size: int, turns: int, peers: Sequence[Peer], notes: list[str]) -> list[dict]:
    """Return a row for us and for each peer that does not fail on this cloud; a line for each that does is
    appended to `notes`."""
    points, rows = points_of(CLOUDS, cloud, size), []
    run, first = {OURS: our_diagrams} | {peer.name: peer.diagrams for peer in peers}, {}
    for name in list(run):
        try:
            first[name] = loss_and_gradient(run[name], points)
        except Exception as error:  # a peer's own failure is a finding, not ours
            if name == OURS:
                raise
            notes.append(f"{name}: failed on {cloud}, M = {size} ({reason(error)})")
    slow = {name for name, found in first.items() if name != OURS and sum(found[2:]) > SLOW}
    times = {name: [found[2:]] if name in slow else [] for name, found in first.items()}
    for _ in range(turns):
        for name in (each for each in first if each not in slow):
            times[name].append(loss_and_gradient(run[name], points)[2:])
    named = {peer.name: (version_of(peer), peer.note) for peer in peers if peer.name in first}
    named[OURS] = (paper_artifact.__version__, "circumradii, closed-form gradient")
    for name, each in times.items():
        forward, backward = 1e3 * np.median(each, axis=0)
        row = {"cloud": cloud, "M": size, "library": name, "version": named[name][0]}
        row |= {"forward_ms": forward, "backward_ms": backward}
        row |= {"ms": 1e3 * float(np.median(np.sum(each, axis=1))), "turns": len(each)}
        ours = rows[0] if rows else row
        row |= {"forward_ratio": forward / ours["forward_ms"], "ratio": row["ms"] / ours["ms"]}
        row |= {"bars": len(first[name][0]), "bar_difference": bar_difference(first[OURS][0], first[name][0])}
        row["gradient_difference"] = gradient_difference(first[OURS][1], first[name][1])
        rows.append(row | {"note": named[name][1]})
    return rows


def peer_rows(
    notes: list[str], sizes: Sequence[int] = SIZES, clouds: Sequence[str] = ("torus", "soup")
) -> Iterable[dict]:
    """Yield the rows of all clouds, small ones first; what is not measured is appended to `notes`."""
    for cloud in clouds:
        able = list(PEERS)
        for size, turns in zip(sizes, TURNS, strict=False):
            with one_torch_thread():
                rows = rows_of(cloud, size, turns, able, notes)
            yield from rows
            slow = {row["library"]: row["ms"] / 1e3 for row in rows[1:] if row["ms"] > 1e3 * SLOW}
            if size < max(sizes):
                what = f"not measured on {cloud} beyond M = {size}, where it took"
                notes += [f"{name}: {what} {seconds:.0f} s" for name, seconds in slow.items()]
            able = [peer for peer in able if peer.name not in slow]


def bar_difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the largest |difference| of births and deaths of the LONGEST bars of two diagrams (k,2).

    inf if their numbers differ, 0 if both are empty.
    """
    longest = [_longest(diagram) for diagram in (ours, theirs)]
    if len(longest[0]) != len(longest[1]):
        return float("inf")
    return float(np.abs(longest[0] - longest[1]).max(initial=0.0))


def _longest(diagram: np.ndarray) -> np.ndarray:
    chosen = diagram[np.argsort(diagram[:, 0] - diagram[:, 1], kind="stable")[:LONGEST]]
    # By birth: rounding must not swap bars of nearly one length.
    return chosen[np.lexsort((chosen[:, 1], chosen[:, 0]))]


def gradient_difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return max |theirs - ours| / max |ours| of two gradients (M,3); nan where theirs is not finite."""
    off = np.abs(theirs - ours).max() / np.abs(ours).max()
    return float(off) if np.isfinite(theirs).all() else float("nan")


def collected(peers: Sequence[Peer], rows: Callable[[list[str]], Iterable[dict]]) -> pd.DataFrame:
    """Return the rows with the machine's load, names and versions. Exits where a peer does not import.

    rows: is given the list to which notes on what was not measured are appended.
    """
    if missing := [line for line in map(why_missing, peers) if line]:
        raise SystemExit("; ".join(missing))
    notes: list[str] = []
    found = [row | {"load": round(os.getloadavg()[0], 1)} for row in rows(notes)]
    versions = {"python": platform.python_version(), "torch": torch.__version__, "gudhi": packages()["gudhi"]}
    return pd.DataFrame(found).assign(cpu=cpu_model(), **versions, not_measured="; ".join(notes))


if __name__ == "__main__":
    folder = options(__doc__).out
    write(collected(PEERS, peer_rows), folder / "peers.csv")
