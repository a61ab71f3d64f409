"""The repair gate (paper §5, App. C, Fig. S5): the loss alone, Adam on raw points, must repair four clouds.

  T1 punctured void: sphere without a cap of opening .5; the matched term must close the void (paper 8.8x)
  T2 spurious handle: sphere with a handle; the diagonal term must kill the extra loop
  T3 mis-spaced components: two spheres at gap .9, target gap 1.4 (paper 1229x)
  T4 bridged merge: two spheres joined by a chain of 6 points: no significant live H0 bar against one target;
     only recruitment has a gradient (paper 450x). The chain's links are longer than any spacing of the
     spheres
  T4d dense bridge: the same with a chain of 24 points, denser than the spheres. Recruitment then tugs at a
     sphere's longest edge and tears one point off: the diagram is repaired, the bridge is not

The paper gives no parameters; these starts were inferred from its figures. All spheres have radius 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gudhi
import numpy as np
import torch

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.bundle import Bundle, build_bundle
from paper_artifact.topology.floor import significant
from paper_artifact.topology.loss import TopologyLoss

# World units; the spheres' radius is 1.
CAP_OPENING = 0.5  # T1: radius of the cap's rim
HANDLE_MAJOR, HANDLE_TUBE, HANDLE_HEIGHT = 0.8, 0.1, 1.1  # T2: the handle's radii, and height of its centre
TARGET_GAP, LIVE_GAP = 1.4, 0.9  # T3: between the two spheres, wanted and at the start
CHAIN, DENSE_CHAIN = 6, 24  # T4, T4d: points of the bridge
ROUNDING = 1e-12  # a bottleneck below this is zero
FINAL_RATE = 0.01  # the learning rate decays to this fraction
REFRESH_EVERY = 10  # steps
_Parts = tuple[np.ndarray, np.ndarray, int, float, int]  # start, target, dimension, first rate, steps


@dataclass(frozen=True, eq=False)
class RepairProbe:
    """A defective cloud, its target, and Adam's settings."""

    name: str  # "T1" … "T4d"
    start: np.ndarray  # (M,3) world units
    target: np.ndarray  # (M,3) world units, at the same M
    bundle: Bundle  # of the target
    dimension: int  # to repair
    learning_rate: float  # Adam's first
    steps: int  # Adam's


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What a repair did, at k recorded steps."""

    name: str  # of the probe
    steps: np.ndarray  # (k,)
    bottleneck: np.ndarray  # (k,) distance of the significant bars to the target's, L∞, radius / diagonal
    significant: np.ndarray  # (k,) number of significant bars in the probe's dimension
    loss: np.ndarray  # (k,)
    recruited: np.ndarray  # (k,) bars recruited by the plan of that step
    start: np.ndarray  # (M,3) world units
    final: np.ndarray  # (M,3) world units

    @property
    def factor(self) -> float:
        """Return the first bottleneck divided by the last; inf when the last is ROUNDING."""
        first, last = self.bottleneck[0], self.bottleneck[-1]
        return float(first / last) if last > ROUNDING else float("inf")


def make_probe(name: str, seed: int = 0) -> RepairProbe:
    """Return probe "T1", "T2", "T3", "T4" or "T4d"; its clouds are a function of `seed`.

    Raises InputError for another name.
    """
    if name not in _PROBES:
        raise InputError(f"unknown repair probe {name!r}; choose one of {', '.join(_PROBES)}")
    start, target, dimension, learning_rate, steps = _PROBES[name](stream(seed, f"repair-{name}"))
    diagonal = float(np.linalg.norm(np.ptp(target, axis=0)))
    # T2's target has no loop on purpose: every significant live one goes to the diagonal.
    choice = {"suppress": (1,), "dimensions": ()} if name == "T2" else {"dimensions": (dimension,)}
    bundle = build_bundle(target, diagonal, shape=name, seed=seed, **choice)
    return RepairProbe(name, start, target, bundle, dimension, learning_rate, steps)


def repair(
    probe: RepairProbe,
    *,
    steps: int | None = None,
    recruitment: bool = True,
    record_every: int = 10,
    seed: int = 0,
    final_rate: float = FINAL_RATE,
) -> Trajectory:
    """Return the trajectory of the loss alone, with Adam on the probe's points.

    steps: fewer or more than the probe's; recruitment False shows Lemma 1 on T4: nothing moves; record_every:
    a multiple of REFRESH_EVERY; final_rate: the fraction that the learning rate decays to, 1 for none.
    """
    bundle, dimension = probe.bundle, probe.dimension
    loss = TopologyLoss(bundle, refresh_every=REFRESH_EVERY, recruitment=recruitment, seed=seed)
    points = torch.tensor(probe.start, requires_grad=True)
    adam = torch.optim.Adam([points], lr=probe.learning_rate)
    total = probe.steps if steps is None else steps
    # The trainer's own decay: Adam's momentum keeps a tugged point moving, so a constant rate cannot settle
    # below about one step.
    decay = torch.optim.lr_scheduler.ExponentialLR(adam, gamma=final_rate ** (1 / max(total, 1)))
    rows = []
    for step in range(total + 1):
        if step % record_every == 0 or step == total:
            cloud = points.detach().numpy()
            bars = alpha_persistence(cloud / bundle.diagonal, as_given=True)[dimension].diagram
            kept = bars[significant(bars, bundle.floor)]
            distance = float(gudhi.bottleneck_distance(kept, bundle.bars[dimension]))
            rows.append([step, distance, len(kept), 0.0, 0])
        value = loss(points)
        if rows[-1][0] == step and loss.plan is not None:
            recruited = loss.plan.report["dimensions"][str(dimension)]["recruited"]
            rows[-1][3:] = [float(value.detach()), recruited]
        if step == total:
            break
        adam.zero_grad()
        value.backward()
        adam.step()
        decay.step()
    taken, bottleneck, significant_bars, value, recruited = np.array(rows).T
    return Trajectory(
        probe.name,
        taken.astype(int),
        bottleneck,
        significant_bars.astype(int),
        value,
        recruited.astype(int),
        probe.start,
        points.detach().numpy().copy(),
    )


def _sphere(generator: np.random.Generator, count: int) -> np.ndarray:
    directions = generator.standard_normal((count, 3))
    # Exactly cospherical points are the slow case of exact predicates; 1e-6 is far below every spacing here.
    radii = 1 + 1e-6 * generator.standard_normal((count, 1))
    return radii * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _punctured(generator: np.random.Generator) -> _Parts:
    """Return 1024 points on the sphere outside the cap, and on the whole sphere as the target."""
    candidates = _sphere(generator, 2048)
    outside = candidates[candidates[:, 2] <= np.sqrt(1 - CAP_OPENING**2)]
    return outside[:1024], _sphere(generator, 1024), 2, 0.01, 600


def _handle(generator: np.random.Generator) -> _Parts:
    """Return 1400 points on sphere and handle, by area, and on the sphere as the target."""
    handle_area = 4 * np.pi**2 * HANDLE_MAJOR * HANDLE_TUBE
    fraction = handle_area / (handle_area + 4 * np.pi)
    u, v = generator.random((2, 4000)) * 2 * np.pi
    # A torus around the y axis above the north pole (at height 1 its loop clears the floor by 5 % only, less
    # than the seeds' spread); rejection makes the tube's angle uniform by area.
    kept = generator.random(4000) < (HANDLE_MAJOR + HANDLE_TUBE * np.cos(v)) / (HANDLE_MAJOR + HANDLE_TUBE)
    ring = HANDLE_MAJOR + HANDLE_TUBE * np.cos(v[kept])
    torus = np.column_stack(
        [ring * np.cos(u[kept]), HANDLE_TUBE * np.sin(v[kept]), HANDLE_HEIGHT + ring * np.sin(u[kept])]
    )
    torus = torus[np.linalg.norm(torus, axis=1) > 1]  # the part inside the sphere is no surface of the union
    count = round(1400 * fraction * len(torus) / kept.sum())
    start = np.vstack([_sphere(generator, 1400 - count), torus[:count]])
    return start, _sphere(generator, 1400), 1, 0.01, 600


def _two_spheres(generator: np.random.Generator, gap: float, each: int) -> np.ndarray:
    shift = np.array([1 + gap / 2, 0.0, 0.0])
    return np.vstack([_sphere(generator, each) - shift, _sphere(generator, each) + shift])


def _spacing(generator: np.random.Generator) -> _Parts:
    return _two_spheres(generator, LIVE_GAP, 512), _two_spheres(generator, TARGET_GAP, 512), 0, 0.03, 1000


def _bridge(generator: np.random.Generator, links: int = CHAIN) -> _Parts:
    each = 500
    joined = _two_spheres(generator, TARGET_GAP, each)
    along = (np.arange(links) + 0.5) / links - 0.5
    chain = np.column_stack([along * TARGET_GAP, np.zeros(links), np.zeros(links)])
    return np.vstack([joined, chain]), _two_spheres(generator, TARGET_GAP, each + links // 2), 0, 0.01, 1000


_PROBES: dict[str, Callable[[np.random.Generator], _Parts]] = {
    "T1": _punctured,
    "T2": _handle,
    "T3": _spacing,
    "T4": _bridge,
    "T4d": lambda generator: _bridge(generator, DENSE_CHAIN),
}
