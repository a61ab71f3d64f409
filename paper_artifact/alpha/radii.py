"""Circumradii of edges, triangles and tetrahedra with a closed-form gradient, and the Gabriel gate.

Paper §3.2, equation of the radii: a Gabriel simplex enters the alpha filtration at its squared circumradius,
so a paired bar's coordinates are functions of 1 to 4 sample positions. Everything here is a RADIUS, in the
unit of the positions.

Gradient. With circumcentre c = Σ β_i p_i, Σ β_i = 1, and R² = |p_i - c|² for every i, weighting the
differentials by β cancels dc, because Σ β_i (p_i - c) = 0, and leaves dR/dp_i = β_i (p_i - c) / R. One
formula for every dimension; for a critical simplex (circumcentre inside, β ≥ 0) no corner's gradient is
longer than 1.

Where this breaks: a flat tetrahedron or a collinear triangle has no circumcentre; its radius is inf and its
gradient 0, so the Gabriel gate refuses it and no NaN reaches the vertices.

The gate asks whether a paired simplex's filtration value is its own circumradius, to a relative 1e-6 (paper
§3.2). In general position a simplex of a bar of positive length is critical, hence Gabriel, so failures mean
rounding or degenerate input. `LossConfig.fallback` says what then happens: the pair keeps its value and gets
no gradient ("detach", the paper's default), or its bar is taken out before the matching ("drop").
"""

from __future__ import annotations

import numpy as np

TOLERANCE = 1e-6  # relative (paper §3.2)


def radius_and_gradient(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the circumradii (n,) and their gradients (n,k,3) by `corners` (n,k,3) float64, k = 1 to 4."""
    # Rows last: one corner's coordinate of all simplices lies together, so thousands of them cost little.
    rows_last = np.ascontiguousarray(np.moveaxis(corners, 0, -1))
    with np.errstate(all="ignore"):  # a flat simplex overflows on purpose and is masked in `_finish`
        # Each simplex is scaled by a power of two, which is exact: no product over- or underflows.
        relative = rows_last - rows_last[0]
        exponents = np.frexp(np.abs(relative).max(axis=(0, 1)))[1]
        radius, gradient = _KERNELS[corners.shape[1]](np.ldexp(relative, -exponents))
    return np.ldexp(radius, exponents), np.moveaxis(gradient, -1, 0)


def passes_gate(cloud: np.ndarray, simplices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the mask (n,) of simplices (n,k) int64 whose circumradius is relatively their filtration value.

    values: radii (n,), like the cloud (M,3) in one unit.
    """
    radii = radius_and_gradient(cloud[simplices])[0] if len(simplices) else np.zeros(0)
    return np.abs(radii - values) <= TOLERANCE * np.abs(values)


# Below: corners and gradients (k,3,n), vectors (3,n), numbers (n,). The first corner is the origin.


def _point(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(corners.shape[-1]), np.zeros_like(corners)


def _edge(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    difference = corners[1] - corners[0]
    length = np.sqrt(_dot(difference, difference))
    direction = difference / np.where(length > 0, length, 1.0) / 2
    return length / 2, np.stack([-direction, direction])


def _triangle(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, u, v = corners
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    normal = _cross(u, v)
    square = _dot(normal, normal)
    weight_1, weight_2 = vv * (uu - uv) / (2 * square), uu * (vv - uv) / (2 * square)
    # |u||v||u-v| / (2|u×v|), the paper's form, loses no digits to a cancellation in c - p0.
    radius = np.sqrt(uu * vv * _dot(u - v, u - v) / square) / 2
    centre = weight_1 * u + weight_2 * v
    weights = np.stack([1 - weight_1 - weight_2, weight_1, weight_2])
    return _finish(corners, centre, weights, radius)


def _tetrahedron(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, u, v, w = corners
    vw, wu, uv = _cross(v, w), _cross(w, u), _cross(u, v)
    volume = _dot(u, vw)
    # Cramer's rule on A y = ½ diag(A Aᵀ), rows of A = u, v, w: y is the circumcentre relative to p0.
    centre = (_dot(u, u) * vw + _dot(v, v) * wu + _dot(w, w) * uv) / (2 * volume)
    inner = np.stack([_dot(centre, vw), _dot(centre, wu), _dot(centre, uv)]) / volume
    weights = np.concatenate([1 - inner.sum(axis=0, keepdims=True), inner])
    return _finish(corners, centre, weights, np.sqrt(_dot(centre, centre)))


def _finish(
    corners: np.ndarray, centre: np.ndarray, weights: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (radius, β_i (p_i - c) / R), inf and 0 where the simplex is flat or a number overflowed."""
    gradient = weights[:, None] * (corners - centre) / radius
    bad = ~(np.isfinite(radius) & np.isfinite(gradient).all(axis=(0, 1)))
    if bad.any():
        radius, gradient = np.where(bad, np.inf, radius), np.where(bad, 0.0, gradient)
    return radius, gradient


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # By components: np.cross costs ten times as much on a handful of rows.
    x, y, z = a
    p, q, r = b
    return np.stack([y * r - z * q, z * p - x * r, x * q - y * p])


_KERNELS = {1: _point, 2: _edge, 3: _triangle, 4: _tetrahedron}
