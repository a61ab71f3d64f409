"""The study's fixed decisions per shape, as data: budget class, loss dimensions, density (paper §4; fixed before any
training)."""

from __future__ import annotations

from dataclasses import dataclass

REFRESH_EVERY = 10  # K


@dataclass(frozen=True)
class Protocol:
    """samples: M of bundle and loss; dimensions: where the loss acts, None for every dimension with a significant bar; seed: of
    the bundle."""

    samples: int = 2048
    dimensions: tuple[int, ...] | None = None
    seed: int = 0


# The torus restricts the loss to H1 (its void is below the floor at M = 2048), rocker-arm and the double torus likewise; eight
# and the pot are bundled where the pre-registered staircase first shows their class, M = 8192. bob's void is marginal (paper:
# 1.13 times the floor; ours over 30 sampling seeds .98 to 1.25, median 1.11): the paper's bundle holds it, seed 0 of our sampler
# misses it, so seed 1 is taken.
PROTOCOLS = {
    "sphere": Protocol(dimensions=(2,)),
    "cube": Protocol(dimensions=(2,)),
    "cylinder": Protocol(dimensions=(2,)),
    "torus": Protocol(dimensions=(1,)),
    "double_torus": Protocol(dimensions=(1,)),
    "bob": Protocol(seed=1),
    "rocker-arm": Protocol(dimensions=(1,)),
    "eight": Protocol(samples=8192),
    "pot": Protocol(samples=8192, dimensions=(2,)),
    "bowl_narrow": Protocol(dimensions=(2,)),
    "bowl_wide": Protocol(dimensions=(2,)),
    "spot": Protocol(dimensions=(2,)),
    "fandisk": Protocol(dimensions=(2,)),
    "armadillo": Protocol(dimensions=(2,)),
    "horse": Protocol(dimensions=(2,)),
}


def protocol_of(shape: str) -> Protocol:
    """Return the shape's protocol; shapes the study does not name get M = 2048 and every dimension with a significant bar."""
    return PROTOCOLS.get(shape, Protocol())
