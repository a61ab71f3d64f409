"""Arithmetic with the same bits everywhere, held to mpmath, LAPACK and scipy."""

import mpmath
import numpy as np
import pytest

from paper_artifact import arithmetic
from paper_artifact.randomness import stream
from paper_artifact.raster.arrays import sigmoid


def ulps(ours: np.ndarray, exact: list) -> float:
    """Return the largest distance of float numbers to mpmath's, in units of the last place."""
    rows = zip(ours.tolist(), exact, np.spacing(np.abs(ours)).tolist(), strict=True)
    return max(float(abs(mpmath.mpf(one) - other) / spacing) for one, other, spacing in rows)


DRAWS = np.random.default_rng(0)
NEAR_ZEROS = np.pi / 2 * np.arange(1, 800)  # where a sine's or cosine's reduction shows


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("exp", np.concatenate([DRAWS.uniform(-700, 700, 800), DRAWS.uniform(-1, 1, 800)])),
        ("log", np.concatenate([10 ** DRAWS.uniform(-307, 307, 800), DRAWS.uniform(0.5, 2, 800), [5e-324]])),
        ("sin", np.concatenate([DRAWS.uniform(-1e6, 1e6, 800), DRAWS.uniform(-4, 4, 800), NEAR_ZEROS])),
        ("cos", np.concatenate([DRAWS.uniform(-1e6, 1e6, 800), DRAWS.uniform(-4, 4, 800), NEAR_ZEROS])),
    ],
)
def test_functions_are_within_one_ulp(name, values):
    with mpmath.workprec(200):
        exact = [getattr(mpmath, name)(mpmath.mpf(float(value))) for value in values]
        assert ulps(getattr(arithmetic, name)(values), exact) < 1
        ours = np.array(getattr(arithmetic, name)(values[0]))
        assert ours == getattr(arithmetic, name)(values)[0] and ours.shape == ()


def test_sigmoid_is_the_nearest_float32_or_its_neighbour():
    values = np.concatenate([DRAWS.normal(size=2000) * 6, [0, -80, 17, 90]]).astype(np.float32)
    with mpmath.workprec(100):
        exact = [1 / (1 + mpmath.exp(-mpmath.mpf(float(value)))) for value in values]
        assert ulps(sigmoid(values), exact) < 0.51


def test_ends_and_what_is_no_number():
    infinite = np.array([np.inf, -np.inf, np.nan], np.float32)
    np.testing.assert_array_equal(sigmoid(infinite), np.array([1, 0, np.nan], np.float32))
    logarithms = arithmetic.log([0, -1, 1, np.inf, np.nan])
    np.testing.assert_array_equal(logarithms, [-np.inf, np.nan, 0, np.inf, np.nan])
    assert np.isnan(arithmetic.exp(np.nan)) and np.isnan(arithmetic.sin([np.nan, np.inf, 1e7])).all()
    assert arithmetic.power(0.01, 0.0) == 1.0
    assert arithmetic.power(0.999, 2500) == pytest.approx(0.999**2500, rel=1e-14)


def test_the_same_bits_one_number_at_a_time():
    """Whole arrays go through vector instructions, the ends of arrays and single numbers do not."""
    values = DRAWS.uniform(-30, 30, 67)
    for function in (arithmetic.exp, arithmetic.log, arithmetic.sin, arithmetic.cos):
        inputs = np.abs(values)
        np.testing.assert_array_equal(function(inputs), [function(float(value)) for value in inputs])
    x = values.astype(np.float32)
    np.testing.assert_array_equal(sigmoid(x), [sigmoid(x[i : i + 1])[0] for i in range(len(x))])


def test_small_matrices_are_those_of_lapack():
    parts = DRAWS.normal(size=(300, 5, 3)) * 10 ** DRAWS.uniform(-4, 4, (300, 1, 3))
    parts[0], parts[1, :, 2] = 0.0, 0.0
    matrices = arithmetic.spreads(parts)
    np.testing.assert_allclose(matrices, np.einsum("nki,nkj->nij", parts, parts), rtol=1e-12)
    values, vectors = arithmetic.symmetric_eigen(matrices)
    size = np.abs(matrices).max(axis=(1, 2))[:, None]
    assert (np.abs(values - np.linalg.eigvalsh(matrices)) <= 1e-14 * size).all()
    assert np.abs(vectors @ np.swapaxes(vectors, 1, 2) - np.eye(3)).max() < 1e-14
    rebuilt = np.einsum("nki,nk,nkj->nij", vectors, values, vectors)
    assert (np.abs(rebuilt - matrices) <= 1e-14 * size[..., None]).all()
    for matrix in DRAWS.normal(size=(20, 3, 3)):
        adjugate, determinant = arithmetic.adjugate(matrix)
        np.testing.assert_allclose(adjugate / determinant, np.linalg.inv(matrix), rtol=1e-9, atol=1e-12)
        product = arithmetic.product(parts[2], matrix)
        np.testing.assert_allclose(product, parts[2] @ matrix, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(arithmetic.product(matrix, matrix[0]), matrix @ matrix[0], atol=1e-14)


def test_quaternions_are_those_of_scipy():
    from scipy.spatial.transform import Rotation

    turns = np.concatenate([DRAWS.normal(size=(200, 4)), np.eye(4), [[0, 1, 1, 0], [1e-9, 0, 0, 1]]])
    matrices = arithmetic.quaternion_matrix(turns)
    np.testing.assert_allclose(matrices, Rotation.from_quat(turns, scalar_first=True).as_matrix(), atol=1e-15)
    for matrix in matrices:
        back = np.array(arithmetic.matrix_quaternion(matrix))
        assert back[np.abs(back).argmax()] > 0
        np.testing.assert_allclose(arithmetic.quaternion_matrix(back), matrix, atol=1e-15)


def test_normals_are_normal():
    from scipy.stats import kstest

    numbers = arithmetic.normals(stream(3, "normals"), 101, 101)
    assert numbers.shape == (101, 101) and kstest(numbers.ravel(), "norm").pvalue > 0.01
    assert abs(np.corrcoef(numbers[:, :50].ravel(), numbers[:, 50:100].ravel())[0, 1]) < 0.04
