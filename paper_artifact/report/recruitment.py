"""Notebook 16: a construction in which C1's recruitment claims the wrong bar (the paper leaves it open).

A disc has a hole that is to be wider: the target is the same disc with the wide hole. The narrow hole's bar
is born early and dies early. Three stray points beside the disc, as floaters of a soup make them, have a loop
that is born late and dies late: shorter than the hole's bar, but nearer to the target in the plane of births
and deaths. Recruitment takes the nearest bar, ranking takes the longest.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.export.figures import new_figure
from paper_artifact.randomness import stream
from paper_artifact.report.kit.figures import draw_cloud
from paper_artifact.topology import BettiLoss, TopologyLoss, build_bundle
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.topology.loss import PlannedLoss
from paper_artifact.topology.pulls import DIAGONAL, KINDS

POINTS, OUTER, NARROW, WIDE, THICKNESS = 1500, 0.5, 0.08, 0.3, 0.01
STRAYS, AWAY = 0.25, 1.2  # circumradius of the three strays, and the distance of their centre
STEPS, RATE = 120, 2e-3  # of Adam; the points' unit is the disc's
CASES = ("the disc alone", "three strays beside it")
LOSSES = ("C1", "T1", "T2")


def disc(hole: float, strays: bool = False, seed: int = 0) -> np.ndarray:
    """Return POINTS points (n,3) of a thin disc with a hole of radius `hole`; the last three are strays if
    asked for."""
    draws = stream(seed, "recruitment")
    radius = np.sqrt(hole**2 + (OUTER**2 - hole**2) * draws.random(POINTS))
    angle = 2 * np.pi * draws.random(POINTS)
    height = THICKNESS * draws.standard_normal(POINTS)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    if strays:
        corners = np.arange(3) * 2 * np.pi / 3
        points[-3:] = np.column_stack(
            [AWAY + STRAYS * np.cos(corners), STRAYS * np.sin(corners), np.zeros(3)]
        )
    return points


def loss_of(name: str) -> PlannedLoss:
    """Return C1 with the wide hole's bundle, or T1 or T2 with the words (1, 1, 0), acting on loops; the unit
    is that of the points."""
    if name == "C1":
        return TopologyLoss(build_bundle(disc(WIDE), 1.0, dimensions=(1,)))
    settings = {"guard": 0.0, "suppress": "all"} if name == "T2" else {}
    return BettiLoss((1, 1, 0), diagonal=1.0, dimensions=(1,), **settings)


@cache
def descended(name: str, strays: bool) -> tuple[np.ndarray, np.ndarray, dict]:
    """Return (points before, points after, first claim) of one loss's descent by Adam.

    claim: bar (birth, death), kind, and whether the strays are what it belongs to.
    """
    loss, points = loss_of(name), torch.tensor(disc(NARROW, strays), requires_grad=True)
    optimiser = torch.optim.Adam([points], lr=RATE)
    claim: dict = {}
    for _ in range(STEPS):
        optimiser.zero_grad()
        loss(points).backward()
        if not claim:
            assert loss.plan is not None
            pulls = loss.plan.pulls
            claim = {"kind": "none"}
            for row in np.flatnonzero(pulls.kind != DIAGONAL):
                of_strays = bool((pulls.simplices[row, 1] >= POINTS - 3).any()) and strays
                claim = {"bar": pulls.values[row], "kind": KINDS[pulls.kind[row]], "strays": of_strays}
        optimiser.step()
    return disc(NARROW, strays), points.detach().numpy(), claim


def claim_table() -> pd.DataFrame:
    """Return per case and loss: the target bar, the hole's and the strays' bar with their distances to it,
    which was claimed and how, and the hole's death (its radius) after the descent."""
    target = build_bundle(disc(WIDE), 1.0, dimensions=(1,)).bars[1][0]
    rows = {}
    for strays, case in enumerate(CASES):
        for name in LOSSES:
            before, after, claim = descended(name, bool(strays))
            bars = {"hole": hole_bar(before)} | ({"strays": strays_bar(before)} if strays else {})
            rows[case, name] = {
                "target": _text(target),
                **{f"bar of the {each}": _text(bar) for each, bar in bars.items()},
                **{f"{each} to target": f"{np.linalg.norm(bar - target):.3f}" for each, bar in bars.items()},
                "claims": "nothing"
                if "bar" not in claim
                else f"the {'strays' if claim['strays'] else 'hole'}' bar, {claim['kind']}".replace(
                    "hole'", "hole's"
                ),
                "hole's radius": f"{bars['hole'][1]:.3f} → {hole_bar(after)[1]:.3f}",
            }
    table = pd.DataFrame.from_dict(rows, orient="index").fillna("")
    table.index = pd.MultiIndex.from_tuples(table.index, names=["case", "loss"])
    return table


def claim_figure() -> Figure:
    """Return the points before and after each descent with strays, seen from above."""
    figure, axes = new_figure(1, 1 + len(LOSSES), 2.6, 2.0)
    limits = ((-0.6, 1.6), (-0.6, 0.6))
    draw_cloud(axes[0][0], descended(LOSSES[0], True)[0], "before", (0, 1), limits)
    for axis, name in zip(axes[0][1:], LOSSES, strict=True):
        draw_cloud(axis, descended(name, True)[1], f"after {STEPS} steps of {name}", (0, 1), limits)
    return figure


def hole_bar(points: np.ndarray) -> np.ndarray:
    """Return (birth, death) of the longest loop of the disc, the strays left out; unit of the points."""
    near = points[np.linalg.norm(points[:, :2], axis=1) < 2 * OUTER]
    near = near[near[:, 0] < AWAY - 2 * STRAYS]
    return _longest(near)


def strays_bar(points: np.ndarray) -> np.ndarray:
    """Return (birth, death) of the loop of the three strays: half the longest side, and the circumradius."""
    far = points[-3:]
    sides = np.linalg.norm(far - np.roll(far, 1, axis=0), axis=1)
    area = np.linalg.norm(np.cross(far[1] - far[0], far[2] - far[0])) / 2
    return np.array([sides.max() / 2, sides.prod() / (4 * area)])


def floors() -> dict[str, float]:
    """Return the live floor and the target's, in the unit of the points."""
    return {"live": measurement_floor(disc(NARROW, True), 1.0), "target": measurement_floor(disc(WIDE), 1.0)}


def _longest(points: np.ndarray) -> np.ndarray:
    loops = alpha_persistence(points)[1].diagram
    return loops[np.argmax(loops[:, 1] - loops[:, 0])]


def _text(bar: np.ndarray) -> str:
    return f"({bar[0]:.3f}, {bar[1]:.3f})"
