"""Notebook 17: point clouds that are given Betti numbers in words, as PNG strips: no scene, no target.

A demonstration is a cloud and the words that it is to have; Adam moves the points under `BettiLoss` alone.
The words hold when every wanted bar is longer than the cloud's floor and no other one is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from scipy.cluster.hierarchy import fcluster, linkage

from paper_artifact.alpha import alpha_diagrams
from paper_artifact.bench.words_task import punctured_sphere, slab
from paper_artifact.errors import InputError
from paper_artifact.plot import PAGE, new_figure
from paper_artifact.randomness import stream
from paper_artifact.report.kit.figures import draw_cloud
from paper_artifact.topology import BettiLoss
from paper_artifact.topology.floor import measurement_floor

T2 = {"guard": 0.0, "suppress": "all"}
PICTURES = 5  # of a strip


@dataclass(frozen=True)
class Demo:
    """A cloud, and what it is to become."""

    title: str  # of the strip
    betti: tuple[int, int, int]  # the words
    cloud: Callable[[], np.ndarray]  # (n,3) float64
    settings: Mapping[str, Any] = field(default_factory=dict)  # of `BettiLoss`
    steps: int = 150  # of Adam, at most
    rate: float = 4e-3  # of Adam, in the cloud's unit
    axes: tuple[int, int] = (0, 1)  # that its pictures show


def dumbbell(count: int = 1600, beads: int = 5) -> np.ndarray:
    """Return two balls of radius .5 with a string of beads between them, (count + beads,3).

    The string is looser than the balls are anywhere: the widest gap, which the words are about, lies in it.
    """
    draws = stream(0, "demo dumbbell")
    ball = draws.standard_normal((count, 3))
    ball *= 0.5 * draws.random((count, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1, keepdims=True)
    ball[: count // 2, 0] -= 0.9
    ball[count // 2 :, 0] += 0.9
    places = np.linspace(-0.4, 0.4, beads + 2)[1:-1]
    return np.concatenate([ball, np.column_stack([places, 0.01 * draws.standard_normal((beads, 2))])])


def linked_rings(count: int = 1600, centre: float = 1.6) -> np.ndarray:
    """Return two linked solid tori (radii 1 and .08) that come close, (count,3); centre: x of the second
    one's."""
    draws = stream(0, "demo rings")
    u, v = 2 * np.pi * draws.random((2, count))
    tube = 0.08 * np.sqrt(draws.random(count))
    across = 1 + tube * np.cos(v)
    ring = np.column_stack([across * np.cos(u), across * np.sin(u), tube * np.sin(v)])
    half = count // 2
    return np.concatenate([ring[:half], ring[half:][:, [0, 2, 1]] + [centre, 0, 0]])


DEMOS = {
    "grow a hole": Demo(
        "a sheet is said to have one loop", (1, 1, 0), slab, {**T2, "dimensions": (1,)}, rate=3e-3
    ),
    "close a puncture": Demo(
        "a sphere with two punctures is said to have no loop",
        (1, 0, 1),
        punctured_sphere,
        {**T2, "dimensions": (1,)},
        rate=6e-3,
    ),
    "cut a bridge": Demo(
        "a dumbbell is said to be two",
        (2, 0, 0),
        dumbbell,
        {"guard": 0.0, "suppress": "none", "dimensions": (0,)},
        rate=6e-3,
    ),
    "two tori linked": Demo(
        "two linked rings that come close are said to be two",
        (2, 2, 0),
        linked_rings,
        {"guard": 0.0, "dimensions": (0, 1)},
        rate=1e-2,
        axes=(0, 2),
    ),
}


@dataclass(frozen=True, eq=False)
class Course:
    """What a demonstration did."""

    frames: tuple[np.ndarray, ...]  # PICTURES clouds (n,3), the first before any step
    steps: tuple[int, ...]  # of these
    margins: tuple[tuple[float, float], ...]  # of these: weakest wanted, longest other bar, in floors
    reached: int | None  # first step at which the words hold, None: never


@cache
def course(name: str) -> Course:
    """Return the course of a demonstration of DEMOS. Raises InputError for another name."""
    if name not in DEMOS:
        raise InputError(f"no demonstration is called {name!r}; choose one of {', '.join(DEMOS)}")
    demo = DEMOS[name]
    points = torch.tensor(demo.cloud(), requires_grad=True)
    loss = BettiLoss(demo.betti, refresh_every=1, **demo.settings)
    optimiser, clouds, reached = torch.optim.Adam([points], lr=demo.rate), [], None
    for step in range(demo.steps + 1):
        clouds.append(points.detach().numpy().copy())
        if reached is None and step % 5 == 0 and holds(clouds[-1], demo):
            reached = step
        optimiser.zero_grad()
        loss(points).backward()
        optimiser.step()
    shown = np.linspace(0, demo.steps, PICTURES).round().astype(int).tolist()
    frames = tuple(clouds[step] for step in shown)
    return Course(frames, tuple(shown), tuple(margins(each, demo) for each in frames), reached)


def margins(points: np.ndarray, demo: Demo) -> tuple[float, float]:
    """Return (lifetime of the weakest wanted bar, of the longest other one) of points (n,3), in floors, over
    the dimensions that the demonstration acts in."""
    floor = measurement_floor(points, 1.0)
    wanted, others = [], [0.0]
    for dimension, diagram in enumerate(alpha_diagrams(torch.tensor(points))):
        if dimension not in demo.settings.get("dimensions", (0, 1, 2)):
            continue
        lifetimes = np.sort(np.ptp(diagram.bars.detach().numpy(), axis=1))[::-1] / floor
        k = demo.betti[dimension] - (dimension == 0)
        wanted += np.pad(lifetimes[:k], (0, max(0, k - len(lifetimes)))).tolist()
        others += lifetimes[k : k + 1].tolist()
    return min(wanted, default=np.inf), max(others)


def holds(points: np.ndarray, demo: Demo) -> bool:
    """Return whether points (n,3) have the words: wanted bars above the floor, all others below."""
    weakest, longest = margins(points, demo)
    return weakest > 1 >= longest


def parts(points: np.ndarray) -> str:
    """Return how many points (n,3) lie on either side of the widest gap, "800 + 800"."""
    labels = fcluster(linkage(points, "single"), 2, "maxclust")
    return " + ".join(map(str, sorted(np.bincount(labels)[1:].tolist())))


def strip_figure(name: str) -> Figure:
    """Return the strip of a demonstration: its cloud at PICTURES steps, one scale."""
    own, demo = course(name), DEMOS[name]
    figure, axes = new_figure(1, PICTURES, PAGE / PICTURES, 1.7)
    every = np.concatenate(own.frames)[:, list(demo.axes)]
    limits = tuple((low, high) for low, high in zip(every.min(axis=0), every.max(axis=0), strict=True))
    for axis, points, step in zip(axes[0], own.frames, own.steps, strict=True):
        draw_cloud(axis, points, f"step {step}", demo.axes, limits)
        axis.set(xticks=[], yticks=[], xlabel="", ylabel="")  # one scale, world units
    figure.suptitle(f"{name}: {demo.title}")
    return figure


def demo_table(names: Iterable[str] = tuple(DEMOS)) -> pd.DataFrame:
    """Return per demonstration and pictured step: weakest wanted bar and longest other one, in floors; and
    the first step (of every fifth) at which the words hold, and how many points lie on either side of the
    cloud's widest gap."""
    rows = {}
    for name in names:
        own = course(name)
        for step, (weakest, longest) in zip(own.steps, own.margins, strict=True):
            rows[name, step] = {
                "wanted": f"{weakest:.2f}" if np.isfinite(weakest) else "none wanted",
                "longest other": f"{longest:.2f}",
                "sides of the widest gap": parts(own.frames[own.steps.index(step)]),
                "words hold from step": ""
                if step
                else ("not reached" if own.reached is None else own.reached),
            }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.index = pd.MultiIndex.from_tuples(table.index, names=["demonstration", "step"])
    return table
