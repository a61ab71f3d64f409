"""Surface samples: on the surface, uniform by area × weight, reproducible."""

import numpy as np
import pytest
from scipy import stats

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_soup, sample_surface
from paper_artifact.scene.shapes import make_shape


def test_points_are_the_barycentric_combinations_of_their_faces():
    mesh = make_shape("cube")
    points, face, barycentrics = sample_surface(mesh.vertices, mesh.faces, 500, stream(1, "test"))
    assert points.shape == (500, 3) and face.dtype == np.int64
    assert barycentrics.min() >= 0
    np.testing.assert_allclose(barycentrics.sum(axis=1), 1, atol=1e-12)
    expected = np.einsum("nkd,nk->nd", mesh.vertices[mesh.faces[face]], barycentrics)
    np.testing.assert_allclose(expected, points, atol=1e-12)
    np.testing.assert_allclose(np.abs(points).max(axis=1), 0.5, atol=1e-12)
    again, other = (sample_surface(mesh.vertices, mesh.faces, 500, stream(k, "test"))[0] for k in (1, 2))
    assert np.array_equal(again, points) and not np.array_equal(other, points)


def test_faces_are_drawn_in_proportion_to_area_times_weight():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2], [2, 0, 2], [0, 2, 2]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 0, 1], [3, 4, 5]])
    count = 20000
    _, face, _ = sample_surface(vertices, faces, count, stream(0, "test"))
    observed = np.bincount(face, minlength=3)
    assert observed[1] == 0
    assert stats.chisquare(observed[[0, 2]], count * np.array([0.2, 0.8])).pvalue > 1e-3
    _, face, _ = sample_surface(vertices, faces, count, stream(0, "test"), weights=np.array([1.0, 1.0, 0.25]))
    assert stats.chisquare(np.bincount(face, minlength=3)[[0, 2]], count * np.array([0.5, 0.5])).pvalue > 1e-3
    _, face, _ = sample_surface(vertices, faces, 100, stream(0, "test"), weights=np.array([1.0, 1.0, 0.0]))
    assert set(face) == {0}


def test_points_are_uniform_on_a_triangle():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    points, _, _ = sample_surface(vertices, np.array([[0, 1, 2]]), 20000, stream(3, "test"))
    # The marginal of x of a uniform point of this triangle has the distribution 1 - (1 - x)².
    assert stats.kstest(points[:, 0], lambda x: 1 - (1 - x) ** 2).pvalue > 1e-3
    assert stats.kstest(points[:, 1], lambda y: 1 - (1 - y) ** 2).pvalue > 1e-3


def test_nothing_to_draw_from_is_an_error():
    mesh = make_shape("cube")
    for faces, weights in (
        (mesh.faces[:0], None),
        (mesh.faces, np.zeros(12)),
        (mesh.faces, np.full(12, np.nan)),
        (mesh.faces[:2], np.array([1.0, -0.5])),
    ):
        with pytest.raises(InputError, match="area × weight"):
            sample_surface(mesh.vertices, faces, 10, stream(0, "test"), weights=weights)
    for weights, words in ((np.ones(3), r"shape \(3,\); give 12, one a face"), ("abc", "are not numbers")):
        with pytest.raises(InputError, match=words):
            sample_surface(mesh.vertices, mesh.faces, 10, stream(0, "test"), weights=weights)
    for vertices in ("abc", None, mesh.vertices):
        with pytest.raises(InputError, match="soup"):
            sample_soup(vertices, None, 10, stream(0, "test"))
    with pytest.raises(InputError, match="number of samples is -1; give a whole number from 0 to 10"):
        sample_surface(mesh.vertices, mesh.faces, -1, stream(0, "test"))
    with pytest.raises(InputError, match="a stream's purpose is 5; give a text"):
        stream(0, 5)
    with pytest.raises(InputError, match="the generator is 42; give numpy's, as stream"):
        sample_surface(mesh.vertices, mesh.faces, 10, 42)
    assert len(sample_surface(mesh.vertices, mesh.faces, 0, stream(0, "test"))[0]) == 0
