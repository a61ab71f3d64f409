"""The public face of `paper_artifact.alpha`: input at the edges, options, gradients, the filtration."""

import subprocess
import sys
from functools import partial
from itertools import product

import gudhi
import numpy as np
import pytest
import torch
from sklearn.utils.estimator_checks import check_estimator

from paper_artifact import alpha
from paper_artifact.alpha import (
    AlphaPersistence,
    AlphaTransformer,
    alpha_diagrams,
    alpha_filtration,
    alpha_persistence,
    bottleneck,
)
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.topology.term import repulsion
from tests.test_alpha_pairs import CLOUDS

CORNER = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 3]])


def cloud(n: int = 60, d: int = 3, name: str = "face") -> np.ndarray:
    return stream(0, f"alpha {name}", n).normal(size=(n, d))


def same(ours, theirs) -> bool:
    return all(
        np.array_equal(getattr(a, each), getattr(b, each))
        for a, b in zip(ours, theirs, strict=True)
        for each in ("births", "deaths")
    )


# types, shapes, range, order


@pytest.mark.parametrize(
    "points",
    [
        CORNER.astype(np.int32), CORNER.astype(np.longdouble), CORNER.astype(object), CORNER.tolist(),
        [tuple(row) for row in CORNER], np.asfortranarray(CORNER),
        np.broadcast_to(CORNER, (4, 3)),  # not writeable
        torch.tensor(CORNER, dtype=torch.int64), torch.tensor(CORNER, dtype=torch.bfloat16),
        torch.tensor(CORNER, requires_grad=True),
    ],
    ids=str,
)  # fmt: skip
def test_kinds_of_numbers_that_mean_the_same(points):
    right = alpha_persistence(CORNER)
    assert same(alpha_persistence(points), right)
    for diagram, pairs in zip(alpha_diagrams(points), right, strict=True):
        np.testing.assert_allclose(diagram.bars.detach().double().numpy(), pairs.diagram, rtol=1e-2)
    assert len(alpha_diagrams(torch.zeros(0))[0]) == 0
    assert alpha_diagrams(torch.tensor(CORNER).long())[0].bars.dtype == torch.float64


@pytest.mark.parametrize(
    "points",
    [
        CORNER + 1j, torch.tensor(CORNER) + 1j, CORNER.astype(str), np.array([["a", "b", "c"]], dtype=object),
        CORNER > 0, np.ma.masked_array(CORNER, mask=CORNER > 2), torch.tensor(CORNER).to_sparse(),
        [[0, 0, None], [1, 0, 0]], [[0, 0, 0], [1, 0]], [[10**400, 0, 0], [0, 0, 0]], {"x": 1}, None, 3.0,
        CORNER.reshape(-1), cloud(20, 4), np.zeros((0, 4)), np.zeros((2, 3, 1)),
        np.full((4, 3), 1.7e308), np.vstack([np.eye(3), [[0, np.inf, 0]]]), torch.full((5, 3), float("nan")),
    ],
    ids=lambda points: type(points).__name__,
)  # fmt: skip
def test_what_is_no_cloud_is_one_sentence(points):
    calls = (alpha_persistence, alpha_diagrams, alpha_filtration, partial(alpha_persistence, method="gudhi"))
    for call in calls:
        with pytest.raises(InputError, match=r"point"):
            call(points)


@pytest.mark.parametrize("power", [-1000, -540, -200, 170, 500, 1015])
def test_bars_and_gradients_scale_exactly(power):
    points, scale = torch.tensor(cloud(), requires_grad=True), 2.0**power
    far = (points.detach() * scale).requires_grad_()
    for ours, theirs in zip(alpha_persistence(far), alpha_persistence(far, "gudhi"), strict=True):
        np.testing.assert_allclose(np.sort(ours.deaths) / scale, np.sort(theirs.deaths) / scale, rtol=1e-5)
    for one, other in zip(alpha_diagrams(points), alpha_diagrams(far), strict=True):
        assert torch.equal(other.bars, one.bars * scale) and bool(other.gabriel.all())
    gradients = [
        torch.autograd.grad(sum(d.bars[:, 1].sum() for d in alpha_diagrams(p)), p)[0] for p in (points, far)
    ]
    assert torch.equal(*gradients)


def by_exact_gudhi(points: np.ndarray, **options) -> list[np.ndarray]:
    """Return gudhi's diagrams, bars that never die and squared radii included, but bars of no length."""
    tree = gudhi.AlphaComplex(points=points, precision="exact").create_simplex_tree(**options)
    tree.compute_persistence(2, 0, True)
    bars = [tree.persistence_intervals_in_dimension(d).reshape(-1, 2) for d in range(points.shape[1])]
    return [each[each[:, 1] > each[:, 0] * (1 + 1e-12)] for each in bars]


ORDERED = ["uniform", "soup of 5", "integer lattice", "duplicates", "coplanar", "collinear"]


@pytest.mark.parametrize("name", ORDERED)
def test_every_order_of_the_points_gives_the_same_bits(name):
    points = np.asarray(CLOUDS[name](), dtype=float)
    points, rng = points[:300], stream(1, "permutations")
    first, leaf = alpha_persistence(points), torch.tensor(points, requires_grad=True)
    (gradient,) = torch.autograd.grad(sum(d.bars.square().sum() for d in alpha_diagrams(leaf)), leaf)
    for _ in range(5):
        order = rng.permutation(len(points))
        again, leaf = alpha_persistence(points[order]), torch.tensor(points[order], requires_grad=True)
        assert same(again, first)
        (moved,) = torch.autograd.grad(sum(d.bars.square().sum() for d in alpha_diagrams(leaf)), leaf)
        if name != "duplicates":  # which of two equal points a simplex names is free
            assert torch.equal(moved, gradient[torch.from_numpy(order)])
            for a, b in zip(again, first, strict=True):
                assert np.array_equal(np.sort(order[a.death_simplices]), b.death_simplices)


# gradients


def test_bars_are_those_of_alpha_persistence_and_gradients_those_of_finite_differences():
    points = torch.tensor(cloud(16), requires_grad=True)
    diagrams = alpha_diagrams(points)
    for diagram, pairs in zip(diagrams, alpha_persistence(cloud(16)), strict=True):
        np.testing.assert_allclose(diagram.bars.detach().numpy(), pairs.diagram, rtol=1e-9)
        assert len(diagram) == len(pairs) and bool(diagram.gabriel.all())
    assert torch.autograd.gradcheck(
        lambda p: tuple(each.bars for each in alpha_diagrams(p)), (points,), eps=1e-7, atol=1e-5
    )
    single = points.detach().float().requires_grad_()
    loops = alpha_diagrams(single)[1].bars
    loops.sum().backward()
    assert loops.dtype == single.grad.dtype == torch.float32 and bool((single.grad != 0).any())


def test_a_lattice_gives_finite_gradients():
    """Cospherical points: a value that is not the simplex's own radius is a constant, never NaN."""
    axis = torch.arange(4, dtype=torch.float64)
    points = torch.cartesian_prod(axis, axis, axis).requires_grad_()
    diagrams = alpha_diagrams(points)
    sum(each.bars.sum() for each in diagrams).backward()
    assert bool(points.grad.isfinite().all())
    reference = alpha_persistence(points.detach().numpy(), method="gudhi")
    for diagram, pairs in zip(diagrams, reference, strict=True):
        deaths = np.sort(diagram.bars.detach().numpy()[:, 1])
        np.testing.assert_allclose(deaths, np.sort(pairs.deaths), atol=1e-9)


def test_second_derivatives_are_refused_on_every_route():
    points = torch.tensor(cloud(12), requires_grad=True)
    pairs = np.array([[0, 1], [2, 3]])
    for loss in (
        lambda p: sum(d.bars.sum() for d in alpha_diagrams(p)),
        lambda p: alpha_diagrams(p, squared=True)[1].bars.square().sum(),
        lambda p: repulsion(p, pairs, 9.0),
    ):
        value = loss(points)
        (gradient,) = torch.autograd.grad(value, points, create_graph=True)
        with pytest.raises(InputError, match="first derivative only"):
            torch.autograd.grad(loss(points) + gradient.square().sum(), points)
        (first,) = torch.autograd.grad(loss(points), points)
        assert torch.equal(first, gradient)


# options


def test_infinite_bars_thresholds_and_squares_are_gudhis():
    points = cloud(150)
    ours = alpha_persistence(points, infinite=True, squared=True, max_radius=0.5)
    for pairs, theirs in zip(ours, by_exact_gudhi(points, max_alpha_square=0.25), strict=True):
        np.testing.assert_allclose(np.sort(pairs.diagram, 0), np.sort(theirs, 0), rtol=1e-9, atol=1e-12)
        assert ((pairs.death_simplices == -1).all(axis=1) == np.isinf(pairs.deaths)).all()
    finite = alpha_persistence(points, max_radius=0.5)
    assert [len(each) for each in finite] == [int(np.isfinite(each.deaths).sum()) for each in ours]
    assert len(alpha_persistence(points, max_dimension=0)) == 1
    tensors = alpha_diagrams(torch.tensor(points), infinite=True, squared=True, max_radius=0.5)
    for pairs, tensor in zip(ours, tensors, strict=True):
        np.testing.assert_allclose(tensor.bars.numpy(), pairs.diagram, rtol=1e-9)


FEW = [np.zeros((0, 3)), np.ones((1, 3)), np.ones((1, 2)), np.ones((4, 3)), np.repeat(CORNER, 2, 0)]


@pytest.mark.parametrize("points", FEW)
def test_one_component_never_dies(points):
    bars = alpha_persistence(points, infinite=True)[0]
    assert np.isinf(bars.deaths).sum() == min(1, len(points))
    named = bars.birth_simplices[:, 0]
    assert len(np.unique(points[named], axis=0)) == len(np.unique(points, axis=0)) == len(bars)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_dimension": 3}, "max_dimension"),
        ({"max_dimension": -1}, "max_dimension"),
        ({"max_dimension": 1.0}, "max_dimension is 1.0; give a whole number from 0 to 2"),
        ({"max_dimension": "1"}, "max_dimension"),
        ({"squared": "no"}, "squared is 'no'; give True or False"),
        ({"max_radius": "1"}, "max_radius is '1'; give a number of at least 0"),
        ({"max_radius": None}, "max_radius"),
        ({"max_radius": -1.0}, "max_radius"),
        ({"max_radius": np.nan}, "max_radius"),
        ({"method": "exact"}, "unknown persistence method 'exact'"),
        ({"method": CORNER}, "unknown persistence method array"),
        ({"squared": True}, "range of float64"),
    ],
)
def test_bad_options(options, words):
    for scale in (2.0**600, 2.0**-600):
        for call in (alpha_persistence, alpha_diagrams)[: 1 + ("method" not in options)]:
            with pytest.raises(InputError, match=words):
                call(CORNER * scale, **options)
        with pytest.raises(InputError, match="range of float64"):
            alpha_filtration(CORNER * scale).simplex_tree()
    for points in (torch.tensor(CORNER * 1e30).float(), torch.tensor(CORNER * 1e-30).float()):
        with pytest.raises(InputError, match="leave the range of torch.float32"):
            alpha_diagrams(points, squared=True)
    far = alpha_persistence(CORNER, squared=True, max_radius=1e200)
    assert same(far, alpha_persistence(CORNER, squared=True))
    assert len(alpha_persistence(CORNER, max_dimension=np.int64(1), max_radius=np.float32(9))) == 2


def planar(n: int) -> np.ndarray:
    angle = 2 * np.pi * stream(0, "circle", n).random(n)
    return np.column_stack([np.cos(angle), np.sin(angle)]) + 0.05 * cloud(n, 2)


PLANES = planar(400), np.argwhere(np.ones((7, 9))) * 1.0, np.outer(np.arange(9.0), [1, 2]), np.zeros((3, 2))


@pytest.mark.parametrize("points", PLANES)
def test_clouds_in_the_plane_are_gudhis_and_have_gradients(points):
    ours = alpha_persistence(points, squared=True, infinite=True)
    for pairs, theirs in zip(ours, by_exact_gudhi(points), strict=True):
        np.testing.assert_allclose(np.sort(pairs.diagram, 0), np.sort(theirs, 0), rtol=1e-9)
    leaf = torch.tensor(points, requires_grad=True)
    assert len(alpha_diagrams(leaf)) == 2
    if len(points) == 400:
        small = torch.tensor(points[:30], requires_grad=True)
        assert torch.autograd.gradcheck(lambda p: alpha_diagrams(p)[1].bars, small, eps=1e-7, atol=1e-5)


def test_batches_lists_and_modules_are_the_single_clouds():
    clouds = [cloud(50, 2), *(cloud(200, name=str(i)) for i in range(12))]  # on threads
    for many, points in zip(alpha_persistence(clouds), clouds, strict=True):
        assert same(many, alpha_persistence(points))
    batch = torch.tensor(np.stack([cloud(30), cloud(30, name="other")]), requires_grad=True)
    module = AlphaPersistence(max_dimension=1)
    assert "max_dimension=1" in repr(module)
    sum(d.bars.sum() for each in module(batch) for d in each).backward()
    single = batch.detach()[1].requires_grad_()
    sum(d.bars.sum() for d in module(single)).backward()
    assert torch.equal(batch.grad[1], single.grad)


# the filtration


def test_the_filtration_is_gudhis_and_so_are_its_pairs():
    for points in (cloud(80), planar(60)):
        ours, theirs = alpha_filtration(points), gudhi.AlphaComplex(points=points).create_simplex_tree()
        tree = ours.simplex_tree()
        assert tree.num_simplices() == theirs.num_simplices() == sum(map(len, ours.radii))
        values = {tuple(simplex): value for simplex, value in tree.get_filtration()}
        assert values == {tuple(s): pytest.approx(v, rel=1e-9) for s, v in theirs.get_filtration()}
    empty = alpha_filtration(np.zeros((0, 3)))
    assert [*map(len, empty.simplices)] == [0] * 4 and empty.simplex_tree().num_simplices() == 0


def test_a_loop_is_represented_by_a_shortest_cycle_at_its_birth():
    points = np.column_stack([planar(120), np.zeros(120)])
    loops = alpha_persistence(points)[1]
    place = int(np.argmax(loops.deaths - loops.births))
    filtration = alpha_filtration(points)
    cycle = filtration.shortest_loop(loops.birth_simplices[place])
    assert set(loops.birth_simplices[place]) <= set(cycle) and len(set(cycle)) == len(cycle) > 20
    angles = np.unwrap(np.arctan2(*points[np.append(cycle, cycle[0]), :2].T[::-1]))
    assert abs(angles[-1] - angles[0]) == pytest.approx(2 * np.pi)
    lengths = np.linalg.norm(points[cycle] - points[np.roll(cycle, 1)], axis=1) / 2
    assert lengths.max() <= loops.births[place] * (1 + 1e-9)
    for power in (-600, 600):
        far = alpha_filtration(points * 2.0**power)
        assert np.array_equal(far.shortest_loop(loops.birth_simplices[place]), cycle)
    for edge in ([0, 0], [0], None, "ab", [0, 1.5], filtration.simplices[1][np.argmin(filtration.radii[1])]):
        with pytest.raises(InputError, match=r"edge \(2,\)|edge of the complex|closes no loop"):
            filtration.shortest_loop(edge)


@pytest.mark.parametrize("make", [np.complex64, complex])
def test_complex_numbers_are_refused_and_lose_no_part(make):
    for values in (np.array([[0.0, 1.0, 0.0], [0.2, 0.5, 1.0], [1.0, 2.0, 3.0]]), [[0.0, 1.0], [0.2, 0.5]]):
        mixed = np.array([[make(each + 1j) for each in row] for row in values], dtype=object)
        for given in (mixed, mixed.astype(complex), torch.tensor(mixed.astype(complex))):
            for read in (alpha_persistence, alpha_filtration, lambda bars: bottleneck(bars, [[0.0, 1.0]])):
                with pytest.raises(InputError, match="are not numbers"):
                    read(given)


# the transformer, threads, the import


def test_the_transformer_is_scikit_learns():
    check_estimator(AlphaTransformer(), on_skip=None)
    clouds = [cloud(30), cloud(40)]
    rows = AlphaTransformer(longest=3).fit_transform(clouds)
    assert rows.shape == (2, 9)
    lives = [np.sort(each.deaths - each.births)[::-1][:3] for each in alpha_persistence(clouds[1])]
    np.testing.assert_array_equal(rows[1], np.concatenate(lives))
    for name, value in product(("longest", "delay"), (0, -1, 2.5, "1", 10**400)):
        for X in (cloud(4), clouds):
            with pytest.raises(InputError, match="is .*; give a whole number from 1"):
                AlphaTransformer(**{name: value}).fit(X)
    for X in ([cloud(30), cloud(30, 2)], np.zeros((0, 5, 3)), [cloud(30), cloud(30, 4)]):
        with pytest.raises(InputError, match="X has no clouds, or some|shape"):
            AlphaTransformer().fit(X)
    with pytest.raises(InputError, match="clouds in 2 dimensions, and not as in fit"):
        AlphaTransformer().fit(clouds).transform([cloud(30, 2)])


def test_the_import_is_numpy_alone_and_every_name_is_there():
    assert all(getattr(alpha, name).__name__ == name for name in alpha.__all__)
    heavy = "{'torch', 'numba', 'scipy', 'sklearn', 'matplotlib', 'gudhi'} & set(sys.modules)"
    code = f"import sys, paper_artifact.alpha; print({heavy})"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "set()"
