"""Differentiable alpha diagrams beside the libraries that offer them: forward and backward, in one process.

Everyone gets the same float64 points (M,3), makes the diagrams of dimensions 0 to 2 as torch tensors that
know the points, and the same loss: the sum of squared lifetimes (death - birth)² in dimension 1, in RADII, in
the unit of the points. A peer's diagram is brought to radii: oineus.diff gives squared radii;
torch-topological gives pairwise distances (see its note), which are halved.

The peers are no dependency. They live in a side environment that borrows this one's packages (README, "Beside
other libraries"): `Peer.install` is the line that a missing one gets.
"""

from __future__ import annotations

import gc
import importlib
import importlib.util
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata

import numpy as np
import torch
from torch import Tensor

import paper_artifact
from paper_artifact.alpha.diagrams import alpha_diagrams
from paper_artifact.bench.persistence import CLOUDS
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.raster.threads import one_torch_thread

OURS = "paper_artifact"
LONGEST = 10  # bars that are compared
SIZES = (2048, 8192)  # points M of a cloud
SLOW = 30.0  # CPU seconds: a peer that takes longer is timed once, and not at all at a larger size

Diagrams = Callable[[Tensor], Sequence[Tensor]]


@dataclass(frozen=True)
class Peer:
    """A library and how it is called."""

    name: str
    modules: tuple[str, ...]  # what must import
    distributions: tuple[str, ...]  # whose versions are reported
    diagrams: Diagrams  # points (M,3) -> diagrams (k,2) of dimensions 0, 1, 2: RADII that know the points
    install: str  # how to get it
    note: str  # what it measures


def our_diagrams(points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the bars (k,2) of `alpha.diagrams.alpha_diagrams`, dimensions 0, 1, 2."""
    return tuple(diagram.bars for diagram in alpha_diagrams(points))


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
        note=(
            "pairs of gudhi's alpha filtration (precision `fast`); "
            "values are half the longest edge, not circumradii"
        ),
    ),
)


def installed(peer: Peer) -> bool:
    """Return whether the peer's packages can be found; import nothing."""
    return all(importlib.util.find_spec(module.split(".")[0]) is not None for module in peer.modules)


def why_missing(peer: Peer) -> str | None:
    """Import the peer; return None, or one line: what went wrong and how to install it."""
    try:
        for module in peer.modules:
            importlib.import_module(module)
    except Exception as error:  # a broken build of another's extension may raise anything
        reason = " ".join(str(error).split())
        what = f"{type(error).__name__}: {reason}"
        return f"{peer.name}: does not import ({what}); install it with: {peer.install}"
    return None


def loss_and_gradient(diagrams: Diagrams, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return (diagram of dimension 1 (k,2), gradient (M,3), forward, backward) at `points` (M,3).

    forward, backward: CPU seconds; forward makes the points' tensor, the diagrams and the loss.
    """
    cloud = torch.tensor(points, dtype=torch.float64, requires_grad=True)
    gc.collect()  # nobody pays for another's garbage
    begin = time.process_time()
    loops = diagrams(cloud)[1]
    loss = (loops[:, 1] - loops[:, 0]).square().sum()
    middle = time.process_time()
    loss.backward()
    end = time.process_time()
    return loops.detach().numpy().copy(), cloud.grad.numpy().copy(), middle - begin, end - middle


def peer_rows(
    sizes: Sequence[int] = SIZES,
    clouds: Sequence[str] = ("torus", "soup"),
    repetitions: int = 7,
    peers: Sequence[Peer] = PEERS,
    missing: list[str] | None = None,
) -> Iterator[dict]:
    """Yield, for each cloud and size M, one row for us and one for each peer that runs.

    A line for each peer that does not run is appended to `missing`. Keys: cloud, M, library, version;
    forward_ms, backward_ms, ms (both together): CPU milliseconds of the process, medians of `turns` turns
    (`repetitions`, at most 3 beyond 4096 points) after one uncounted pass, which is the only one of a peer
    beyond SLOW (turns 1); forward_ratio and ratio (forward_ms and ms over ours); bars (of dimension 1);
    bar_difference (`bar_difference`, radii in the unit of the points); gradient_difference
    (`gradient_difference`); note.

    Raises InputError for an unknown cloud, a size below 100, or fewer than one repetition.
    """
    missing = [] if missing is None else missing
    unknown = sorted(set(clouds) - set(CLOUDS))
    if unknown:
        raise InputError(f"unknown cloud {unknown[0]!r}; choose one of {', '.join(CLOUDS)}")
    if min(sizes, default=0) < 100 or repetitions < 1:
        raise InputError("the benchmark needs sizes of at least 100 points and at least one repetition")
    lines = {peer.name: why_missing(peer) for peer in peers}
    missing += [line for line in lines.values() if line]
    for cloud in clouds:
        able = [peer for peer in peers if lines[peer.name] is None]
        for size in sorted(sizes):
            with one_torch_thread():
                rows = _measure(
                    cloud, size, repetitions if size <= 4096 else min(repetitions, 3), able, missing
                )
            yield from rows
            slow = {row["library"]: row["ms"] for row in rows[1:] if row["ms"] > 1e3 * SLOW}
            if size < max(sizes):
                missing += [
                    f"{name}: not measured on {cloud} beyond M = {size}, where it took {ms / 1e3:.0f} s"
                    for name, ms in slow.items()
                ]
            able = [peer for peer in able if peer.name not in slow]


def _measure(
    cloud: str, size: int, repetitions: int, peers: Sequence[Peer], missing: list[str]
) -> list[dict]:
    points = CLOUDS[cloud](size, stream(0, f"persistence benchmark {cloud}", size))
    first, run = {OURS: loss_and_gradient(our_diagrams, points)}, {OURS: our_diagrams}
    for peer in peers:
        try:
            first[peer.name], run[peer.name] = loss_and_gradient(peer.diagrams, points), peer.diagrams
        except Exception as error:  # a peer's own failure is a finding, not ours
            reason = " ".join(str(error).split())
            missing.append(f"{peer.name}: failed on {cloud}, M = {size} ({type(error).__name__}: {reason})")
    slow = {name for name, result in first.items() if name != OURS and sum(result[2:]) > SLOW}
    times = {name: [first[name][2:]] if name in slow else [] for name in run}
    for _ in range(repetitions):
        for name in (each for each in run if each not in slow):
            times[name].append(loss_and_gradient(run[name], points)[2:])
    named = {peer.name: peer for peer in peers}
    rows: list[dict] = []
    for name, each in times.items():
        forward, backward = (1e3 * np.median(each, axis=0)).tolist()
        row = {
            "cloud": cloud,
            "M": size,
            "library": name,
            "version": version_text(named[name].distributions)
            if name in named
            else paper_artifact.__version__,
            "forward_ms": forward,
            "backward_ms": backward,
            "ms": 1e3 * float(np.median(np.sum(each, axis=1))),
            "turns": len(each),
        }
        ours = rows[0] if rows else row
        rows.append(
            row
            | {
                "forward_ratio": forward / ours["forward_ms"],
                "ratio": row["ms"] / ours["ms"],
                "bars": len(first[name][0]),
                "bar_difference": bar_difference(first[OURS][0], first[name][0]),
                "gradient_difference": gradient_difference(first[OURS][1], first[name][1]),
                "note": named[name].note if name in named else "circumradii, closed-form gradient",
            }
        )
    return rows


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
    return (
        float(np.abs(theirs - ours).max() / np.abs(ours).max()) if np.isfinite(theirs).all() else float("nan")
    )


def version_text(distributions: Sequence[str]) -> str:
    """Return "0.9.39", or "0.9.39, diode 1.2.2" where more than one matters."""
    found = []
    for name in distributions:
        try:
            found.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            found.append((name, "unknown"))
    return ", ".join([found[0][1], *(f"{name} {version}" for name, version in found[1:])])
