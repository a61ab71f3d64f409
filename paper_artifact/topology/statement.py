"""A statement in words: Betti numbers in the place of a target diagram, and the audit that holds it to the
images.

The numbers are those that dense samples show (a cup with a narrow rim counts as one void). Nothing here knows
a ground truth: the frame is that of the SfM cloud, the floor that of the live soup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.topology.floor import check_diagonal

NAMES = (("component", "components"), ("loop", "loops"), ("void", "voids"))
# Lifetimes of noise-born bars reach .35 to .49 of the floor on clean samples: what a loss without a guard
# takes for seen must exceed this fraction of the floor to be called seen.
NOISE_LEVEL = 0.5
# Floors: a bar beyond the stated ones that is longer contradicts the statement, and is what T1 pushes to the
# diagonal. When the ramp begins (step 502 of 2,500, seed 0, the study's M) the longest that true words met on
# the 16 shapes was .66 (eight, a void), elsewhere at most .40.
SURPLUS = 1.0
# Percentiles of a cloud's coordinates between which the frame lies: SfM clouds have outliers.
BOX = (1.0, 99.0)


@dataclass(frozen=True)
class Statement:
    """What the user says of a shape, and the unit that its loss is measured in."""

    betti: tuple[int, ...]  # b0, b1, b2
    diagonal: float  # the unit of births, deaths and floor, world units
    samples: int | None = None  # M of the live cloud; None: any number

    def __post_init__(self) -> None:
        check_diagonal(self.diagonal)

    @property
    def wanted(self) -> tuple[int, int, int]:
        """The numbers of finite bars per dimension: one component never dies."""
        components, loops, voids = self.betti
        return components - 1, loops, voids

    def require_density(self, samples: int) -> None:
        """Raise InputError unless the loss samples M points."""
        if self.samples is not None and samples != self.samples:
            raise InputError(f"the statement was made for M = {self.samples}, but the loss samples {samples}")

    def to_json(self) -> dict:
        """Return the statement as a JSON-able dict, for a run record."""
        return {"betti": list(self.betti), "diagonal": self.diagonal, "samples": self.samples}


def frame_diagonal(points: np.ndarray) -> float:
    """Return the diagonal, world units, of the box of the 1st to 99th percentile of `points` (n,3).

    Raises InputError for a cloud without extent or a coordinate that is not finite.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
        raise InputError(f"a frame needs at least 4 finite points of shape (n, 3), got {points.shape}")
    low, high = np.percentile(points, BOX, axis=0)
    diagonal = float(np.linalg.norm(high - low))
    if not diagonal > 0:
        raise InputError("all points lie in one place, which has no extent to measure by; check the cloud")
    return diagonal


def noise_level(config: LossConfig) -> float:
    """Return the fraction of the floor that a wanted bar must exceed to be called seen."""
    return config.guard or NOISE_LEVEL


def unseen(statement: Statement, report: Mapping[str, Any], config: LossConfig) -> list[str]:
    """Return one sentence for each dimension whose wanted classes do not all show yet.

    report: of a plan of `betti.build_betti_plan`. No contradiction: before the ramp true words are often not
    seen either, and what is wanted is pulled out of the noise.
    """
    level, found = noise_level(config), []
    for dimension, each in ((int(key), value) for key, value in report["dimensions"].items()):
        margins = each["margins"]
        seen = sum(margin > level for margin in margins[: each["wanted"]])
        if seen < each["wanted"]:
            said, shown = _counted(statement.betti[dimension], dimension), seen + (dimension == 0) or "none"
            found.append(
                f"you said {said}; {shown} so far: the next candidate has {margins[seen]:.2f} of the floor, "
                f"and below {level:g} it may be noise"
            )
    return found


def ended(statement: Statement, log: Sequence[Mapping[str, Any]], config: LossConfig) -> list[str]:
    """Return what is to be known of a finished run's loss, a sentence each: wanted classes that its last plan
    does not show, and that it never acted, where no weight could be set. log: of the run's `TopologyTerm`."""
    plans = [event for event in log if event["event"] == "refresh"]
    found = unseen(statement, plans[-1], config) if plans else []
    if plans and not any(event["event"] == "lambda" for event in log):
        found.append("the loss never acted: none of its plans had a bar to act on")
    return found


def contradictions(statement: Statement, report: Mapping[str, Any]) -> list[str]:
    """Return one sentence for each dimension in which a refresh's report contradicts the statement.

    report: of a plan of `betti.build_betti_plan`. A contradiction is a bar beyond the stated ones that is
    longer than SURPLUS floors.
    """
    found = []
    for dimension, each in ((int(key), value) for key, value in report["dimensions"].items()):
        margins, count = each["margins"], statement.betti[dimension]
        if each["surplus"]:
            said, shown = _counted(count, dimension), _counted(each["surplus"], dimension)
            found.append(
                f"you said {said}; the images show {shown}{' more' if count else ''} "
                f"(the longest has {margins[each['wanted']]:.1f} floors), which will be filled in or cut"
            )
    return found


def _counted(count: int, dimension: int) -> str:
    one, more = NAMES[dimension]
    return f"{count or 'no'} {one if count < 2 else more}"
