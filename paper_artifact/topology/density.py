"""Which density M shows the classes that a statement names: asked of the SfM cloud, not of a ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.topology.statement import NAMES, Statement, noise_level

DENSITIES = (2048, 4096, 8192, 16384)
ENOUGH = 0.9  # share of M points that a cloud must have to speak for M


@dataclass(frozen=True)
class Density:
    """What the rule says of a cloud."""

    samples: int  # M
    complete: bool  # whether all wanted classes clear the guard there
    reasons: tuple[str, ...]  # the rule's steps as sentences

    def to_json(self) -> dict:
        """Return a JSON-able dict, for the log of a run."""
        return {"samples": self.samples, "complete": self.complete, "reasons": list(self.reasons)}


def choose_density(
    points: np.ndarray, statement: Statement, config: LossConfig, densities: Sequence[int] = DENSITIES
) -> Density:
    """Return the smallest of `densities` at which the cloud `points` (n,3), world units, shows all wanted
    classes.

    Shows: the k-th longest bar exceeds guard · floor (guard 0: noise_level). Where no density shows all, the
    one that shows most is taken, the smallest of those. The draw of M points is a function of M alone, so all
    seeds of a shape get one M; a cloud of fewer than M but ENOUGH · M points is taken whole, one of fewer not
    asked about M. Raises InputError for a cloud too small for the smallest density, or bad points.
    """
    points, level = np.asarray(points, dtype=np.float64), noise_level(config)
    able = [samples for samples in sorted(densities) if len(points) >= ENOUGH * samples]
    if not able:
        raise InputError(
            f"samples=auto needs an SfM cloud of at least {round(ENOUGH * min(densities))} points, got "
            f"{len(points)}; give the number, for example --loss samples={min(densities)}"
        )
    dimensions = [d for d in config.dimensions or (0, 1, 2) if statement.wanted[d]]
    if not dimensions:
        return Density(able[0], True, (f"The statement names no class to be seen: M = {able[0]}.",))
    reasons, shown = [], {}
    for samples in able:
        chosen = stream(0, "density", samples).permutation(len(points))[:samples]
        margins = _margins(points[chosen], statement, dimensions)
        shown[samples] = sum(int((each > level).sum()) for each in margins.values())
        weakest = "; ".join(f"{NAMES[d][1]} {each[-1]:.2f}" for d, each in margins.items())
        wanted = sum(len(each) for each in margins.values())
        reasons.append(
            f"M = {samples}: {shown[samples]} of {wanted} wanted classes exceed {level:g} of the floor "
            f"(the weakest of each dimension: {weakest})."
        )
        if shown[samples] == wanted:
            return Density(samples, True, tuple(reasons))
    best = max(able, key=lambda samples: (shown[samples], -samples))
    asked = f"No density shows all of them; M = {best} shows most"
    if too_dense := [samples for samples in sorted(densities) if samples not in able]:
        asked += f" (M = {', '.join(map(str, too_dense))} not asked: the cloud has {len(points)} points)"
    return Density(best, False, (*reasons, f"{asked}."))


def _margins(points: np.ndarray, statement: Statement, dimensions: Sequence[int]) -> dict[int, np.ndarray]:
    """Return, per dimension, the wanted bars' lifetimes over the floor, longest first (0: no such bar)."""
    floor = measurement_floor(points, 1.0)
    pairs = alpha_persistence(points, as_given=True)
    found = {}
    for dimension in dimensions:
        lifetimes = np.sort(pairs[dimension].deaths - pairs[dimension].births)[::-1]
        wanted = statement.wanted[dimension]
        found[dimension] = np.pad(lifetimes[:wanted], (0, max(0, wanted - len(lifetimes)))) / floor
    return found
