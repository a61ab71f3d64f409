"""Arithmetic that gives the same bits on every processor: functions, sums of products, small matrices.

Addition, subtraction, multiplication, division and square root are rounded in one way everywhere (IEEE 754).
The rest is a library's choice: exp and sin of numpy, torch and the C library differ from processor to
processor in the last bit, and BLAS sums a product in an order that depends on the processor. Nothing between
a scene and its record may use those. It uses what is here: polynomials whose every operation is written down,
and sums from left to right. numpy ends each operation on an array before the next, so none are fused.

exp, log, sin and cos are within 1 ulp in float64 (sources: fdlibm's polynomials, W. J. Cody and W. Waite,
"Software Manual for the Elementary Functions", 1980, for the reduction of arguments).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

LOG2_E, LN2_HIGH, LN2_LOW = 1.4426950408889634, 6.93147180369123816490e-01, 1.90821492927058770002e-10
_EXP = tuple(1 / math.factorial(k) for k in range(2, 14))  # exact quotients, rounded once: e^r = 1 + r + r²·…
_LEAST, _LARGEST = -708.0, 709.0  # of exp's argument: its value is a normal number between them
_LOG_EVEN = (0.3999999999940941908, 0.2222219843214978396, 0.1531383769920937332)
_LOG_ODD = (0.6666666666666735130, 0.2857142874366239149, 0.1818357216161805012, 0.1479819860511658591)
_PI1, _PI2, _PI3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_MOST_RADIANS = 1e6  # up to which the reduction by these three parts of π/2 is exact enough
_SIN = (
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def _polynomial(coefficients: Sequence[float], x: np.ndarray) -> np.ndarray:
    """Return c0 + c1 x + c2 x² + … by Horner's scheme."""
    value = coefficients[-1] * x + coefficients[-2]
    for coefficient in coefficients[-3::-1]:
        value = value * x + coefficient
    return value


def exp(x: Any) -> Any:
    """Return e^x (float64, the shape of x); below e^-708 and above e^709 it is cut off there."""
    x = np.clip(np.asarray(x, np.float64), _LEAST, _LARGEST)
    n = np.rint(np.where(np.isnan(x), 0.0, x) * LOG2_E)
    r = (x - n * LN2_HIGH) - n * LN2_LOW
    return np.ldexp(1.0 + (r + r * r * _polynomial(_EXP, r)), n.astype(np.int32))


def log(x: Any) -> Any:
    """Return ln x (float64, the shape of x): -inf at 0, NaN below."""
    x = np.asarray(x, np.float64)
    usual = (x > 0) & (x < np.inf)
    mantissa, exponent = np.frexp(np.where(usual, x, 1.0))
    small = mantissa < math.sqrt(0.5)  # so that it lies between √½ and √2
    f = np.where(small, 2.0 * mantissa, mantissa) - 1.0
    n = exponent - small
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    half = 0.5 * f * f
    rest = half + (w * _polynomial(_LOG_EVEN, w) + z * _polynomial(_LOG_ODD, w))
    value = n * LN2_HIGH - ((half - (s * rest + n * LN2_LOW)) - f)
    return np.where(usual, value, np.where(x == 0, -np.inf, np.where(x == np.inf, np.inf, np.nan)))[()]


def sin(x: Any) -> Any:
    """Return the sine (float64, the shape of x); NaN beyond a million radians."""
    return _sine(x, 0)


def cos(x: Any) -> Any:
    """Return the cosine (float64, the shape of x); NaN beyond a million radians."""
    return _sine(x, 1)


def _sine(x: Any, quarters: int) -> Any:
    """Return sin(x + quarters · π/2): x less a multiple of π/2 as two numbers, then fdlibm's polynomials."""
    x = np.asarray(x, np.float64)
    x = np.where(np.abs(x) <= _MOST_RADIANS, x, np.nan)
    n = np.rint(np.where(np.isnan(x), 0.0, x) * (2 / np.pi))
    t = x - n * _PI1
    w = n * _PI2
    r = t - w
    w = n * _PI3 - ((t - r) - w)
    y = r - w
    tail = (r - y) - w
    z = y * y
    v = z * y
    sine = y - ((z * (0.5 * tail - v * _polynomial(_SIN, z)) - tail) + v * 1.66666666666666324348e-01)
    half = 0.5 * z
    head = 1.0 - half
    cosine = head + (((1.0 - head) - half) + (z * (z * _polynomial(_COS, z)) - y * tail))
    quarter = n.astype(np.int64) + quarters
    value = np.where(quarter & 1, cosine, sine)
    return np.where(quarter & 2, -value, value)[()]


def power(base: float, exponent: float) -> float:
    """Return base^exponent for base > 0, to about 1e-16 · |exponent ln base| of itself."""
    return float(exp(exponent * log(base)))


def normals(draws: np.random.Generator, *shape: int) -> np.ndarray:
    """Return independent standard normal numbers of a shape (Box and Muller 1958).

    numpy's own take a logarithm of the C library now and then.
    """
    count = int(np.prod(shape))
    u = draws.random((2, (count + 1) // 2))
    radius, angle = np.sqrt(-2.0 * log(1.0 - u[0])), 2.0 * np.pi * u[1]
    return np.concatenate([radius * cos(angle), radius * sin(angle)])[:count].reshape(shape)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return Σ a·b over the last axis, from left to right; for short ones (vectors of a few coordinates)."""
    a, b = np.asarray(a), np.asarray(b)
    total = a[..., 0] * b[..., 0]
    for k in range(1, a.shape[-1]):
        total = total + a[..., k] * b[..., k]
    return total


def norm(vectors: Any) -> Any:
    """Return the Euclidean lengths over the last axis, for short ones as in `dot`."""
    return np.sqrt(dot(vectors, vectors))


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b, a (…,k), b (k,) or (k,m), k small: sums from left to right, without BLAS."""
    a, b = np.asarray(a), np.asarray(b)
    columns = [a[..., k, None] if b.ndim > 1 else a[..., k] for k in range(len(b))]
    total = columns[0] * b[0]
    for column, row in zip(columns[1:], b[1:], strict=True):
        total = total + column * row
    return total


def spreads(vectors: np.ndarray) -> np.ndarray:
    """Return Σ v vᵀ (n,3,3) of vectors (n,k,3)."""
    return (vectors[:, :, :, None] * vectors[:, :, None, :]).sum(axis=1)


def length(values: np.ndarray) -> float:
    """Return the Euclidean length of all numbers of an array, summed in float64 in numpy's fixed order."""
    return float(np.sqrt(np.square(np.asarray(values, np.float64)).sum()))


def adjugate(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (adjugate (3,3), determinant) of a matrix (3,3): the inverse is their quotient."""
    rows = [np.cross(matrix[(k + 1) % 3], matrix[(k + 2) % 3]) for k in range(3)]
    return np.stack(rows, axis=1), float(dot(matrix[0], rows[0]))


def quaternion_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (…,3,3) of quaternions (…,4), w first, of any length but 0."""
    quaternion = np.asarray(quaternion, np.float64)
    w, x, y, z = np.moveaxis(quaternion / norm(quaternion)[..., None], -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def matrix_quaternion(matrix: np.ndarray) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z), its largest part positive, of a rotation matrix (3,3).

    Of four columns of q qᵀ, which differ by a factor, the one with the largest part of q on its diagonal is
    taken (Shepperd 1978).
    """
    m = np.asarray(matrix, np.float64)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([1 + trace, *(1 + 2 * m.diagonal() - trace)])  # 4 w², 4 x², 4 y², 4 z²
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2]
    columns = np.array([(0, wx, wy, wz), (wx, 0, xy, xz), (wy, xy, 0, yz), (wz, xz, yz, 0)])
    columns[np.arange(4), np.arange(4)] = squares
    column = columns[int(np.argmax(squares))]
    w, x, y, z = (column / norm(column)).tolist()
    return w, x, y, z


def symmetric_eigen(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues (n,3), increasing, and unit eigenvectors (n,3,3), one a row, of symmetric matrices
    (n,3,3): Jacobi's rotations, six sweeps of them."""
    a = np.moveaxis(np.array(matrices, np.float64), 0, -1).copy()
    v = np.zeros_like(a)
    v[0, 0], v[1, 1], v[2, 2] = 1.0, 1.0, 1.0
    for p, q in ((0, 1), (0, 2), (1, 2)) * 6:
        apart = a[q, q] - a[p, p]
        idle = np.abs(a[p, q]) <= 1e-100 * np.abs(apart)
        ratio = apart / np.where(idle, np.inf, 2.0 * a[p, q])
        tangent = np.where(ratio >= 0.0, 1.0, -1.0) / (np.abs(ratio) + np.sqrt(ratio * ratio + 1.0))
        tangent = np.where(idle, 0.0, tangent)
        c = 1.0 / np.sqrt(tangent * tangent + 1.0)
        s = tangent * c
        a[:, p], a[:, q] = c * a[:, p] - s * a[:, q], s * a[:, p] + c * a[:, q]
        a[p], a[q] = c * a[p] - s * a[q], s * a[p] + c * a[q]
        v[p], v[q] = c * v[p] - s * v[q], s * v[p] + c * v[q]
        a[p, q] = a[q, p] = 0.0
    values, vectors = np.stack([a[0, 0], a[1, 1], a[2, 2]], axis=1), np.moveaxis(v, -1, 0)
    order = np.argsort(values, axis=1, kind="stable")
    return np.take_along_axis(values, order, 1), np.take_along_axis(vectors, order[..., None], 1)
