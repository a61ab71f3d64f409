"""The repair gate (paper §5 and App. C, Fig. S5): the loss alone, Adam on raw points, must repair four defective clouds.

  T1 punctured void: sphere without a cap of opening .5; the matched term must close the void (paper 8.8x)
  T2 spurious handle: sphere with a handle; the diagonal term must kill the extra loop
  T3 mis-spaced components: two spheres at gap .9, target gap 1.4 (paper 1229x)
  T4 bridged merge: two spheres joined by a chain of 6 points: no significant live H0 bar against one target; only recruitment
     has a gradient (paper 450x). The chain's links are longer than any spacing of the spheres
  T4d dense bridge: the same with a chain of 24 points, denser than the spheres. Recruitment then tugs at a sphere's longest
     edge and tears one point off: the diagram is repaired, the bridge is not

The paper gives no parameters; these starts were inferred from its figures. Radii of all spheres are 1 world unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.bundle import Bundle, build_bundle
from paper_artifact.topology.floor import significant
from paper_artifact.topology.loss import TopologyLoss

CAP_OPENING = 0.5
HANDLE_MAJOR, HANDLE_TUBE, HANDLE_HEIGHT = 0.8, 0.1, 1.1
TARGET_GAP, LIVE_GAP, CHAIN, DENSE_CHAIN = 1.4, 0.9, 6, 24


@dataclass(frozen=True, eq=False)
class Probe:
    """A start cloud (M,3) world units, its target at the same M, the dimension to repair, and Adam's settings."""

    name: str
    start: np.ndarray
    target: np.ndarray
    bundle: Bundle
    dimension: int
    learning_rate: float
    steps: int


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What a repair did. steps (k,); bottleneck (k,): distance of the significant bars in the probe's dimension to the target's
    (L-infinity, radius / diagonal); significant (k,): their number; loss (k,); start, final (M,3) world units; recruited (k,):
    bars recruited by the plan at that step."""

    name: str
    steps: np.ndarray
    bottleneck: np.ndarray
    significant: np.ndarray
    loss: np.ndarray
    recruited: np.ndarray
    start: np.ndarray
    final: np.ndarray

    @property
    def factor(self) -> float:
        """First bottleneck divided by the last; inf when the last is rounding (below 1e-12)."""
        return (
            float(self.bottleneck[0] / self.bottleneck[-1]) if self.bottleneck[-1] > 1e-12 else float("inf")
        )


def make_probe(name: str, seed: int = 0, method: str = "fast") -> Probe:
    """Return probe "T1", "T2", "T3", "T4" or "T4d"; its clouds are a function of `seed`. Raises InputError for another name."""
    if name not in _PROBES:
        raise InputError(f"unknown repair probe {name!r}; choose one of {', '.join(_PROBES)}")
    start, target, dimension, learning_rate, steps = _PROBES[name](stream(seed, f"repair-{name}"))
    diagonal = float(np.linalg.norm(np.ptp(target, axis=0)))
    # T2's target has no loop on purpose: every significant live one goes to the diagonal.
    choice = {"suppress": (1,), "dimensions": ()} if name == "T2" else {"dimensions": (dimension,)}
    bundle = build_bundle(target, diagonal, shape=name, seed=seed, method=method, **choice)
    return Probe(name, start, target, bundle, dimension, learning_rate, steps)


def repair(
    probe: Probe,
    *,
    steps: int | None = None,
    recruitment: bool = True,
    record_every: int = 10,
    seed: int = 0,
    method: str = "fast",
    progress: Callable[[int], None] | None = None,
) -> Trajectory:
    """Run the loss alone on the probe's points with Adam and return the trajectory; the plan is refreshed every 10 steps.

    steps: fewer or more than the probe's; recruitment False shows Lemma 1 on T4: nothing moves; record_every: a multiple of 10.
    """
    from paper_artifact.alpha.persistence import alpha_persistence  # compiled kernels: only when needed

    bundle, dimension = probe.bundle, probe.dimension
    loss = TopologyLoss(bundle, refresh_every=10, recruitment=recruitment, seed=seed, method=method)
    points = torch.tensor(probe.start, requires_grad=True)
    adam = torch.optim.Adam([points], lr=probe.learning_rate)
    total = probe.steps if steps is None else steps
    # The trainer's own decay: Adam's momentum keeps a tugged point moving, so a constant rate cannot settle below about one step.
    decay = torch.optim.lr_scheduler.ExponentialLR(adam, gamma=0.01 ** (1 / max(total, 1)))
    rows = []
    for step in range(total + 1):
        if step % record_every == 0 or step == total:
            cloud = points.detach().numpy()
            bars = alpha_persistence(cloud / bundle.diagonal, method=method)[dimension].diagram
            kept = bars[significant(bars, bundle.floor)]
            rows.append([step, _bottleneck(kept, bundle.bars[dimension]), len(kept), 0.0, 0])
        value = loss(points)
        if rows[-1][0] == step:
            rows[-1][3:] = [
                float(value.detach()),
                loss.plan.report["dimensions"][str(dimension)]["recruited"],
            ]
        if step == total:
            break
        adam.zero_grad()
        value.backward()
        adam.step()
        decay.step()
        if progress is not None:
            progress(step)
    table = np.array(rows)
    return Trajectory(
        probe.name,
        table[:, 0].astype(int),
        table[:, 1],
        table[:, 2].astype(int),
        table[:, 3],
        table[:, 4].astype(int),
        probe.start,
        points.detach().numpy().copy(),
    )


def _bottleneck(a: np.ndarray, b: np.ndarray) -> float:
    import gudhi

    return float(gudhi.bottleneck_distance(a, b))


def _sphere(generator: np.random.Generator, count: int) -> np.ndarray:
    directions = generator.standard_normal((count, 3))
    # Exactly cospherical points are the slow case of exact predicates; 1e-6 is far below every spacing here.
    radii = 1 + 1e-6 * generator.standard_normal((count, 1))
    return radii * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _punctured(generator):
    """1024 points on the sphere outside a cap whose rim radius is CAP_OPENING; target: the whole sphere at the same M."""
    candidates = _sphere(generator, 2048)
    outside = candidates[candidates[:, 2] <= np.sqrt(1 - CAP_OPENING**2)]
    return outside[:1024], _sphere(generator, 1024), 2, 0.01, 600


def _handle(generator):
    """1400 points on sphere and handle, by area; target: the sphere at the same M."""
    handle_area = 4 * np.pi**2 * HANDLE_MAJOR * HANDLE_TUBE
    fraction = handle_area / (handle_area + 4 * np.pi)
    u, v = generator.random((2, 4000)) * 2 * np.pi
    # A torus around the y axis above the north pole (at height 1 its loop clears the floor by 5 % only, less than the seeds'
    # spread); rejection makes the tube's angle uniform by area.
    kept = generator.random(4000) < (HANDLE_MAJOR + HANDLE_TUBE * np.cos(v)) / (HANDLE_MAJOR + HANDLE_TUBE)
    ring = HANDLE_MAJOR + HANDLE_TUBE * np.cos(v[kept])
    torus = np.column_stack(
        [ring * np.cos(u[kept]), HANDLE_TUBE * np.sin(v[kept]), HANDLE_HEIGHT + ring * np.sin(u[kept])]
    )
    torus = torus[np.linalg.norm(torus, axis=1) > 1]  # the part inside the sphere is no surface of the union
    count = int(round(1400 * fraction * len(torus) / kept.sum()))
    return (
        np.vstack([_sphere(generator, 1400 - count), torus[:count]]),
        _sphere(generator, 1400),
        1,
        0.01,
        600,
    )


def _two_spheres(generator, gap: float, each: int) -> np.ndarray:
    shift = np.array([1 + gap / 2, 0.0, 0.0])
    return np.vstack([_sphere(generator, each) - shift, _sphere(generator, each) + shift])


def _spacing(generator):
    return _two_spheres(generator, LIVE_GAP, 512), _two_spheres(generator, TARGET_GAP, 512), 0, 0.03, 1000


def _bridge(generator, links: int = CHAIN):
    each = 500
    joined = _two_spheres(generator, TARGET_GAP, each)
    along = (np.arange(links) + 0.5) / links - 0.5
    chain = np.column_stack([along * TARGET_GAP, np.zeros(links), np.zeros(links)])
    return np.vstack([joined, chain]), _two_spheres(generator, TARGET_GAP, each + links // 2), 0, 0.01, 1000


def _dense_bridge(generator):
    return _bridge(generator, DENSE_CHAIN)


_PROBES = {"T1": _punctured, "T2": _handle, "T3": _spacing, "T4": _bridge, "T4d": _dense_bridge}
