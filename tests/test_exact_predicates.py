"""Exact predicates and values of nearly flat simplices against rational arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from paper_artifact.alpha import filtration, predicates
from paper_artifact.alpha.expansions import WORKSPACE, evaluate, exact
from tests.test_persistence import draw, sphere

WS = np.empty(WORKSPACE)


def determinant(rows: list[list[Fraction]]) -> Fraction:
    if len(rows) == 1:
        return rows[0][0]
    minors = ([r[:k] + r[k + 1 :] for r in rows[1:]] for k in range(len(rows)))
    return sum(((-1) ** k * rows[0][k] * determinant(m) for k, m in enumerate(minors)), Fraction(0))


def fractions(points: np.ndarray, base: int) -> list[list[Fraction]]:
    exact = [[Fraction(float(x)) for x in p] for p in points]
    return [[x - y for x, y in zip(p, exact[base], strict=True)] for k, p in enumerate(exact) if k != base]


def near_degenerate(k: int) -> np.ndarray:
    """Five points of a lattice or a plane or a sphere, some of them off by little."""
    rng = draw(f"predicate {k}")
    bases = (
        rng.integers(0, 3, (5, 3)) / 3.0,
        rng.random((5, 2)) @ rng.random((2, 3)),
        sphere(5000)[5 * k % 4000 :][:5],
    )
    return bases[k % 3] + rng.integers(-2, 3, (5, 3)) * 2.0 ** -int(rng.integers(20, 54)) * (k % 2)


@pytest.mark.parametrize("part", range(3))
def test_predicates_have_the_sign_of_rational_arithmetic(part):
    for k in range(part, 600, 3):
        points = near_degenerate(k)
        orient = determinant(fractions(points[:4], 3))
        assert np.sign(predicates.orient3d(points, 0, 1, 2, 3, WS)) == np.sign(orient)
        vectors = fractions(points, 4)
        sphere_sign = determinant([[*v, sum(x * x for x in v)] for v in vectors])
        # The determinant of rows (x, y, z, lift) is positive when e is inside a positively oriented
        # tetrahedron (Shewchuk).
        assert np.sign(predicates.insphere(points, 0, 1, 2, 3, 4, WS)) == np.sign(sphere_sign)
        a, b = fractions(points[:3], 2)
        assert predicates.edge_excludes(points, 0, 1, 2, WS) == (
            sum(x * y for x, y in zip(a, b, strict=True)) >= 0
        )
        u, v, w = fractions(points[:4], 3)
        normal = [v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]]
        if any(normal):  # centre of the circle through 0, v, w, then the power of u
            vv, ww = sum(x * x for x in v), sum(x * x for x in w)
            side = [vv * q - ww * p for p, q in zip(v, w, strict=True)]
            towards = cross(side, normal)
            nn = sum(x * x for x in normal)
            # The circumcentre solves 2 c·v = |v|²: it fixes the sign of the cross product.
            for sign in (1, -1):
                centre = [sign * x / (2 * nn) for x in towards]
                if (
                    2 * sum(c * x for c, x in zip(centre, v, strict=True)) == vv
                    and 2 * sum(c * x for c, x in zip(centre, w, strict=True)) == ww
                ):
                    break
            power = sum(x * x for x in u) - 2 * sum(c * x for c, x in zip(centre, u, strict=True))
            assert predicates.triangle_excludes(points, 3, 1, 2, 0, WS) == (power >= 0)


def test_double_doubles_and_expansions_agree_with_rational_arithmetic():
    values = np.empty((12 + len(predicates.INSPHERE), 2))
    for k in range(90):
        points, rows = near_degenerate(k), np.arange(5)
        truth = determinant([[*v, sum(x * x for x in v)] for v in fractions(points, 4)])
        assert abs(evaluate(points, rows, predicates.INSPHERE, values) - truth) <= 1e-29 * 30
        assert exact(points, rows, predicates.INSPHERE, WS, values) == pytest.approx(
            float(truth), rel=1e-15, abs=0
        )


def cross(p: list[Fraction], q: list[Fraction]) -> list[Fraction]:
    return [p[(i + 1) % 3] * q[(i + 2) % 3] - p[(i + 2) % 3] * q[(i + 1) % 3] for i in range(3)]


def dot(p: list[Fraction], q: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(p, q, strict=True)), Fraction(0))


def test_circumradii_of_flat_simplices_agree_with_rational_arithmetic():
    for k in range(1, 400, 2):
        points = near_degenerate(k)
        u, v, w = fractions(points[:4], 0)
        det = determinant([u, v, w])
        if det != 0:
            terms = zip(cross(v, w), cross(w, u), cross(u, v), strict=True)
            centre = [(dot(u, u) * x + dot(v, v) * y + dot(w, w) * z) / (2 * det) for x, y, z in terms]
            assert filtration.tetrahedron_value(points, 0, 1, 2, 3, WS) == pytest.approx(
                float(dot(centre, centre)), rel=1e-10
            )
        area = dot(cross(u, v), cross(u, v))
        if area != 0:
            third = [x - y for x, y in zip(u, v, strict=True)]
            radius = dot(u, u) * dot(v, v) * dot(third, third) / (4 * area)
            assert filtration.triangle_value(points, 0, 1, 2, WS) == pytest.approx(float(radius), rel=1e-10)
