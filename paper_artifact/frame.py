"""Units of a run: an offset and a power of two that bring coordinates to where float32 resolves them.

Scenes near the origin and of a size near 1, so all of the study, are left as they are, to the bit. The others
are trained as if they lay there, and what is written goes back to the user's coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from paper_artifact.arithmetic import norm

FARTHEST = 16.0  # radii from the origin to a scene's centre, beyond which it is moved there
LARGEST = 2.0**10  # radius, and its inverse the smallest, beyond which a scene is scaled to .5 … 1


@dataclass(frozen=True)
class Frame:
    """The map user's coordinates = offset + 2^exponent · run's coordinates."""

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # user's units
    exponent: int = 0  # of two

    def inward(self, points: np.ndarray) -> np.ndarray:
        """Return user's points (…,3) in the run's coordinates; the same array where both are equal."""
        return (
            points if self == SAME else np.ldexp(np.asarray(points, np.float64) - self.offset, -self.exponent)
        )

    def outward(self, points: np.ndarray) -> np.ndarray:
        """Return run's points (…,3) in the user's coordinates; the same array where both are equal."""
        return (
            points if self == SAME else np.ldexp(np.asarray(points, np.float64), self.exponent) + self.offset
        )

    def length(self, length: float) -> float:
        """Return a user's length in the run's unit."""
        return math.ldexp(length, -self.exponent)

    def to_json(self) -> dict:
        """Return a JSON-able dict, for the record."""
        return {"offset": list(self.offset), "exponent": self.exponent}


SAME = Frame()


def frame_for(centre: np.ndarray, radius: float) -> Frame:
    """Return the frame for a scene around `centre` (3,) of a `radius` > 0, user's units."""
    far = float(norm(centre)) > FARTHEST * radius
    x, y, z = (float(value) for value in centre) if far else (0.0, 0.0, 0.0)
    exponent = 0 if 1 / LARGEST <= radius <= LARGEST else math.frexp(radius)[1]
    return Frame((x, y, z), exponent)
