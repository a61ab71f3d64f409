"""Clouds, bundles and pulls made by hand, for the tests of the loss."""

import numpy as np

from paper_artifact.topology.bundle import Bundle
from paper_artifact.topology.plan import Pulls, padded


def sphere(seed: int, count: int = 400) -> np.ndarray:
    directions = np.random.default_rng(seed).standard_normal((count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def handmade_bundle(
    target: list, dimension: int, samples: int, floor: float = 0.05, diagonal: float = 1.0
) -> Bundle:
    bars = [np.zeros((0, 2))] * 3
    bars[dimension] = np.array(target, dtype=np.float64).reshape(-1, 2)
    return Bundle(
        tuple(bars), (dimension,), ("", "", ""), samples, 0, floor, 6.0, diagonal, "handmade", "sha256:"
    )


def pull(dimension: int, kind: int, values, birth_simplex, death_simplex, target, sound=True, weight=1.0):
    """One bar and its pull."""
    simplices = [padded(np.array([each])) for each in (birth_simplex, death_simplex)]
    return Pulls(
        dimension=np.array([dimension]),
        kind=np.array([kind]),
        values=np.array([values], dtype=np.float64),
        simplices=np.stack(simplices, axis=1),
        target=np.array([target or (0.0, 0.0)]),
        sound=np.array([sound]),
        weight=np.array([weight]),
    )
