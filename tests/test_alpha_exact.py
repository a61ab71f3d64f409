"""Predicates, values, radii and small diagrams against rational arithmetic and the paper's formulas."""

from fractions import Fraction
from itertools import combinations

import gudhi
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from paper_artifact.alpha import alpha_persistence, circumradius, filtration, predicates
from paper_artifact.alpha.expansions import WORKSPACE, evaluate, exact
from paper_artifact.errors import InputError
from tests.test_alpha_pairs import draw, sphere

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
    lattice, plane = rng.integers(0, 3, (5, 3)) / 3.0, rng.random((5, 2)) @ rng.random((2, 3))
    bases = lattice, plane, sphere(5000)[5 * k % 4000 :][:5]
    return bases[k % 3] + rng.integers(-2, 3, (5, 3)) * 2.0 ** -int(rng.integers(20, 54)) * (k % 2)


def dot(p: list[Fraction], q: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(p, q, strict=True)), Fraction(0))


def solve(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction] | None:
    """Return the solution of linear equations by Cramer's rule, None where they have no single one."""
    det = determinant(matrix) if matrix else Fraction(1)
    if det == 0:
        return None
    places = range(len(matrix))
    replaced = ([[*row[:k], x, *row[k + 1 :]] for row, x in zip(matrix, right, strict=True)] for k in places)
    return [determinant(each) / det for each in replaced]


def both_ways(quick, exact_value, points: np.ndarray, rows: tuple[int, ...], truth: Fraction) -> None:
    """The filter decides nothing wrongly, and what it leaves open the exact part decides rightly."""
    value, bound = quick(points, *rows)
    assert bound >= 0
    if abs(value) > bound:
        assert np.sign(value) == np.sign(truth)
    assert np.sign(exact_value(points, *rows, WS)) == np.sign(truth)


@pytest.mark.parametrize("part", range(3))
def test_predicates_have_the_sign_of_rational_arithmetic(part):
    for k in range(part, 600, 3):
        points = near_degenerate(k)
        orient = determinant(fractions(points[:4], 3))
        both_ways(predicates.orient3d_filter, predicates.orient3d_exact, points, (0, 1, 2, 3), orient)
        assert np.sign(predicates.orient3d(points, 0, 1, 2, 3, WS)) == np.sign(orient)
        vectors = fractions(points, 4)
        sphere_sign = determinant([[*v, sum(x * x for x in v)] for v in vectors])
        rows = (0, 1, 2, 3, 4)
        both_ways(predicates.insphere_filter, predicates.insphere_exact, points, rows, sphere_sign)
        # The determinant of rows (x, y, z, lift) is positive when e is inside a positively oriented
        # tetrahedron (Shewchuk).
        assert np.sign(predicates.insphere(points, 0, 1, 2, 3, 4, WS)) == np.sign(sphere_sign)
        a, b = fractions(points[:3], 2)
        both_ways(predicates.edge_filter, predicates.edge_exact, points, (0, 1, 2), dot(a, b))
        u, v, w = fractions(points[:4], 3)
        gram = [[dot(v, v), dot(v, w)], [dot(v, w), dot(w, w)]]
        weights = solve(gram, [dot(v, v) / 2, dot(w, w) / 2])
        if weights is not None:  # centre of the circle through 0, v, w, then the power of u
            centre = [weights[0] * x + weights[1] * y for x, y in zip(v, w, strict=True)]
            power = dot(u, u) - 2 * dot(centre, u)
            both_ways(predicates.triangle_filter, predicates.triangle_exact, points, (3, 1, 2, 0), power)


def test_double_doubles_and_expansions_agree_with_rational_arithmetic():
    values = np.empty((12 + len(predicates.INSPHERE), 2))
    for k in range(90):
        points, rows = near_degenerate(k), np.arange(5)
        truth = determinant([[*v, sum(x * x for x in v)] for v in fractions(points, 4)])
        assert abs(evaluate(points, rows, predicates.INSPHERE, values) - truth) <= 1e-29 * 30
        found = exact(points, rows, predicates.INSPHERE, WS, values)
        assert found == pytest.approx(float(truth), rel=1e-15, abs=0)


def tetrahedron(points: np.ndarray) -> float:
    """Return the squared circumradius of four points as `filtration.values` has it."""
    value = filtration.tetrahedron_filter(points, 0, 1, 2, 3)
    return value if value > 0 else filtration.flat_tetrahedron_value(points, 0, 1, 2, 3, -value, WS)


def triangle(points: np.ndarray) -> float:
    """Return the squared circumradius of three points as `filtration.values` has it."""
    unit, area, third = filtration.triangle_sides(points, 0, 1, 2)
    if area <= filtration.FLAT**2 * unit:
        area = filtration.flat_triangle_area(points, 0, 1, 2, unit, WS)
    return unit / area * third / 4.0


def test_circumradii_of_flat_simplices_agree_with_rational_arithmetic():
    for k in range(1, 400, 2):
        points = near_degenerate(k)
        for value, corners in ((tetrahedron, 4), (triangle, 3)):
            edges = fractions(points[:corners], 0)
            gram = [[dot(p, q) for q in edges] for p in edges]
            weights = solve(gram, [row[i] / 2 for i, row in enumerate(gram)])
            if weights is not None:
                square = dot(weights, [row[i] / 2 for i, row in enumerate(gram)])
                assert value(points) == pytest.approx(float(square), rel=1e-10)


def cech_radius(points: list) -> Fraction:
    """Return the squared radius of the smallest ball around up to four integer points, exactly."""
    best = None
    for size in range(1, len(points) + 1):
        for base, *rest in combinations(points, size):
            edges = [[Fraction(x - y) for x, y in zip(p, base, strict=True)] for p in rest]
            gram = [[dot(u, v) for v in edges] for u in edges]
            weights = solve(gram, [row[i] / 2 for i, row in enumerate(gram)])
            if weights is None:
                continue
            centre = [base[k] + sum(w * e[k] for w, e in zip(weights, edges, strict=True)) for k in range(3)]
            apart = [[c - x for c, x in zip(centre, p, strict=True)] for p in [base, *points]]
            radius = dot(apart[0], apart[0])
            if all(dot(each, each) <= radius for each in apart) and (best is None or radius < best):
                best = radius
    return best


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=1, max_size=7, unique=True))
def test_small_integer_clouds_have_the_diagrams_of_the_exact_cech_complex(rows):
    """Alpha and Čech filtrations have one diagram (nerve theorem); the Čech complex needs no Delaunay."""
    tree = gudhi.SimplexTree()
    for size in range(1, 5):
        for simplex in combinations(range(len(rows)), size):
            tree.insert(simplex, float(cech_radius([rows[i] for i in simplex])))
    tree.compute_persistence(2, 0, True)
    for dimension, pairs in enumerate(alpha_persistence(np.array(rows), infinite=True, squared=True)):
        theirs = tree.persistence_intervals_in_dimension(dimension).reshape(-1, 2)
        theirs = theirs[theirs[:, 1] > theirs[:, 0]]
        np.testing.assert_allclose(np.sort(pairs.diagram, 0), np.sort(theirs, 0), rtol=1e-12)


# circumradii with gradients


def readable(corners: torch.Tensor) -> torch.Tensor:
    """The slow twin: solve for the circumcentre in the simplex's own plane by autograd's least squares."""
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.mT
    weights = torch.linalg.solve(gram, torch.diagonal(gram, dim1=1, dim2=2)[:, :, None] / 2)
    return torch.linalg.vector_norm((weights * edges).sum(dim=1), dim=1)


@pytest.mark.parametrize("corners", [1, 2, 3, 4])
def test_radii_and_gradients_equal_the_readable_twin_and_finite_differences(corners):
    draws = np.random.default_rng(corners)
    few = torch.tensor(draws.random((5, corners, 3)), requires_grad=True)
    assert torch.autograd.gradcheck(circumradius, (few,), eps=1e-7, atol=1e-5, rtol=1e-4)
    if corners == 1:
        return
    points = torch.tensor(draws.standard_normal((200, corners, 3)), requires_grad=True)
    fast, slow = circumradius(points), readable(points)
    torch.testing.assert_close(fast, slow, rtol=1e-8, atol=0)
    weights = torch.linspace(0.5, 2, 200, dtype=torch.float64) / slow.detach()
    (a,), (b,) = (torch.autograd.grad((weights * each).sum(), points) for each in (fast, slow))
    torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-7)
    far = circumradius(points + torch.tensor([1000.0, -1000.0, 500.0]))
    torch.testing.assert_close(far, fast, rtol=1e-6, atol=0)


def test_known_radii_and_those_of_flat_simplices():
    for rows, radius in (
        ([[0, 0, 0], [3, 4, 0]], 2.5),
        ([[0, 0, 0], [3, 0, 0], [0, 4, 0]], 2.5),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], 3**0.5 / 2),
        ([[0, 0, 0], [0, 0, 0]], 0.0),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.inf),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 4, 0]], np.inf),
    ):
        corners = torch.tensor([rows], dtype=torch.float64, requires_grad=True)
        found = circumradius(corners)
        found.sum().backward()
        assert found.item() == pytest.approx(radius, rel=1e-15)
        assert bool(corners.grad.any()) == (0 < radius < np.inf)


@pytest.mark.parametrize("shape", [(3, 3), (1, 5, 3), (1, 3, 2), (1, 3, 3)])
def test_bad_corners_are_refused(shape):
    with pytest.raises(InputError, match="corners must be"):
        circumradius(torch.zeros(shape, dtype=torch.int64 if shape == (1, 3, 3) else torch.float64))
