"""The similarity between two frames is found exactly, mirrored and flat sets too, and refused where open."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from paper_artifact.errors import InputError
from paper_artifact.evaluate.geometry import similarity
from paper_artifact.randomness import stream


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("flat", [False, True])
def test_a_known_similarity_is_found(seed, flat):
    draws = stream(seed, "align")
    points = draws.normal(size=(9, 3)) * (1, 1, 0 if flat else 1)
    turn = Rotation.random(rng=draws).as_matrix()
    moved = 2.5 * points @ turn.T + (3, -1, 100)
    found = similarity(points, moved)
    assert np.allclose(found.rotation, turn) and np.isclose(found.scale, 2.5)
    assert np.allclose(found.apply(points), moved)


def test_a_mirror_image_gives_a_rotation_and_noise_the_least_squares():
    points = stream(0, "align").normal(size=(30, 3))
    assert np.linalg.det(similarity(points, points * (1, 1, -1)).rotation) == pytest.approx(1)
    noisy = 2 * points + 0.1 * stream(1, "align").normal(size=points.shape)
    best = similarity(points, noisy)
    least = ((best.apply(points) - noisy) ** 2).sum()
    for change in ({"scale": best.scale * 1.01}, {"shift": best.shift + 0.01}):
        assert ((best._replace(**change).apply(points) - noisy) ** 2).sum() > least


def test_too_few_points_and_points_on_a_line_are_refused():
    line = np.arange(5)[:, None] * np.ones(3)
    for points in (np.eye(3)[:2], line):
        with pytest.raises(InputError):
            similarity(points, points)
