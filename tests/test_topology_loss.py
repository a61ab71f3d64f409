"""The plan and the loss on raw points: the paper's equation by hand, Lemma 1, the Gabriel gate."""

import numpy as np
import pytest
import torch

from paper_artifact.alpha.diagrams import circumradius
from paper_artifact.alpha.persistence import Pairs, alpha_persistence
from paper_artifact.alpha.radii import passes_gate
from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.topology.bundle import build_bundle
from paper_artifact.topology.floor import measurement_floor, significant
from paper_artifact.topology.loss import TopologyLoss
from paper_artifact.topology.plan import (
    CLIP,
    DIAGONAL,
    MATCHED,
    RECRUITED,
    Plan,
    Pulls,
    build_plan,
    join_pulls,
    pair_weights,
    surface_variation,
)
from tests.topology_cases import handmade_bundle, pull, sphere


@pytest.fixture(scope="module")
def void():
    """A sphere's bundle and a dented, noisy sphere of the same density."""
    bundle = build_bundle(sphere(0), 2 * 3**0.5, shape="sphere")
    live = sphere(1) * [1, 1, 0.8] + 0.01 * np.random.default_rng(2).standard_normal((400, 3))
    return bundle, live


def test_loss_equals_the_equation_on_gudhis_diagram(void):
    bundle, live = void
    loss = TopologyLoss(bundle)
    value = loss(torch.tensor(live)).item()
    bars = alpha_persistence(live / bundle.diagonal, method="gudhi")[2].diagram
    bars = bars[significant(bars, bundle.floor)]
    assert len(bars) == 1
    assert value == pytest.approx(((bars[0] - bundle.bars[2][0]) ** 2).sum(), rel=1e-9)
    report = loss.plan.report["dimensions"]["2"]
    assert (report["matched"], report["diagonal"], report["recruited"], report["unreached"]) == (1, 0, 0, 0)
    assert report["gabriel_failures"] == 0
    np.testing.assert_allclose(report["targets"][0]["live"], bars[0], rtol=1e-9)


def test_gradient_equals_finite_differences_of_the_whole_pipeline(void):
    """Frozen pairs are locally exact: a used point moved a little moves the diagram as the gradient says."""
    bundle, live = void
    points = torch.tensor(live, requires_grad=True)
    loss = TopologyLoss(bundle)
    loss(points).backward()
    used = loss.plan.used.numpy()
    assert (torch.linalg.vector_norm(points.grad, dim=1) > 0).sum() == len(used) == 7
    for index in used[:3]:
        for axis in range(3):
            values = []
            for shift in (1e-6, -1e-6):
                moved = live.copy()
                moved[index, axis] += shift
                values.append(TopologyLoss(bundle)(torch.tensor(moved)).item())
            slope = points.grad[index, axis].item()
            assert (values[0] - values[1]) / 2e-6 == pytest.approx(slope, rel=1e-4, abs=1e-8)


def every_kind_of_pull() -> list[Pulls]:
    return [
        pull(0, DIAGONAL, (0.0, 0.3), (0,), (0, 1), None),
        pull(1, MATCHED, (0.1, 0.4), (1, 2), (3, 4, 5), (0.1, 0.5)),
        pull(2, RECRUITED, (0.2, 0.3), (4, 5, 6), (5, 6, 7, 8), (0.2, 0.6), weight=2.0),
        pull(1, MATCHED, (0.1, 0.4), (1, 2), (3, 4, 5), (0.3, 0.9), sound=False),
    ]


def test_plan_value_gradcheck_with_every_kind_of_pull():
    positions = torch.tensor(np.random.default_rng(0).random((9, 3)), requires_grad=True)
    plan = Plan(join_pulls(every_kind_of_pull()), 9, {})
    assert torch.autograd.gradcheck(plan.value, (positions,), eps=1e-7, atol=1e-6)
    unsound = (0.1 - 0.3) ** 2 + (0.4 - 0.9) ** 2  # the last pull keeps its refresh value
    rest = Plan(join_pulls(every_kind_of_pull()[:3]), 9, {}).value(positions).item()
    assert plan.value(positions).item() == pytest.approx(rest + unsound, rel=1e-12)


def test_lemma_1():
    """Paper, Lemma 1: the gradient is independent of an unmatched target, unless bars are recruited."""
    generator = np.random.default_rng(0)
    # One blob of two clumps: its longest finite H0 bar is below the floor, so the target stays unmatched.
    cloud = np.vstack([generator.random((40, 3)), generator.random((40, 3)) + [1.3, 0, 0]])
    gradients = {}
    for recruitment in (False, True):
        for death in (0.8, 1.1):
            bundle = handmade_bundle([[0.0, death]], 0, 80, floor=0.7)
            points = torch.tensor(cloud, requires_grad=True)
            loss = TopologyLoss(bundle, recruitment=recruitment)
            loss(points).backward()
            report = loss.plan.report["dimensions"]["0"]
            assert report["significant"] == 0
            assert (report["recruited"], report["unreached"]) == ((1, 0) if recruitment else (0, 1))
            gradients[recruitment, death] = points.grad
    assert torch.equal(gradients[False, 0.8], gradients[False, 1.1]) and not gradients[False, 0.8].any()
    assert gradients[True, 0.8].any()
    assert (gradients[True, 0.8] - gradients[True, 1.1]).abs().max() > 0.1
    # A matched bar beside the unmatched target: its pull does not see that target either.
    far = np.vstack([cloud, generator.random((40, 3)) + [6, 0, 0]])
    pulls = []
    for second in (0.8, 1.1):
        points = torch.tensor(far, requires_grad=True)
        bundle = handmade_bundle([[0.0, 2.0], [0.0, second]], 0, 120, floor=0.7)
        TopologyLoss(bundle, recruitment=False)(points).backward()
        pulls.append(points.grad)
    assert pulls[0].any() and torch.equal(pulls[0], pulls[1])


def test_recruited_bars_leave_the_diagonal_term():
    generator = np.random.default_rng(1)
    cloud = np.vstack([generator.random((20, 3)) * 0.2 + [x, 0, 0] for x in (0.0, 1.0, 2.2)])
    # So persistent that leaving both at the diagonal is not cheaper.
    bundle = handmade_bundle([[0.0, 3.0]], 0, 60, floor=0.3)
    with_term = build_plan(cloud, bundle, LossConfig(recruitment=True)).report["dimensions"]["0"]
    without = build_plan(cloud, bundle, LossConfig(recruitment=False)).report["dimensions"]["0"]
    assert without["significant"] == with_term["significant"] == 2
    assert without["matched"] + without["diagonal"] == 2
    assert with_term["matched"] + with_term["recruited"] == 1 and with_term["diagonal"] == 1
    assert with_term["unreached"] == 0


def test_frozen_plan_follows_live_points_until_the_next_refresh(void):
    bundle, live = void
    loss = TopologyLoss(bundle, refresh_every=3)
    points = torch.tensor(live)
    plans = []
    for _ in range(7):
        loss(points)
        plans.append(loss.plan)
    assert plans[0] is plans[2] and plans[2] is not plans[3] and plans[3] is plans[5]
    assert plans[6] is not plans[5]
    scaled = loss(points * 1.1).item()
    bar = 1.1 * np.array(plans[6].report["dimensions"]["2"]["targets"][0]["live"])
    assert scaled == pytest.approx(((bar - bundle.bars[2][0]) ** 2).sum(), rel=1e-9)


def test_noise_reaches_the_plan_but_not_the_values(void):
    bundle, live = void
    loss = TopologyLoss(bundle, noise=0.01, seed=3, refresh_every=0)
    plan = loss.refresh(live)
    value = loss(torch.tensor(live)).item()
    assert plan.report["live_floor"] > measurement_floor(live, bundle.diagonal)
    births, deaths = plan.radii(live[plan.used.numpy()] / bundle.diagonal)[0].reshape(2, -1)
    expected = ((births - bundle.bars[2][0, 0]) ** 2 + (deaths - bundle.bars[2][0, 1]) ** 2).sum()
    assert value == pytest.approx(expected, rel=1e-12)
    assert abs(deaths[0] - plan.pulls.values[0, 1]) > 1e-6  # the plan's own value is the noisy one
    assert TopologyLoss(bundle, noise=0.01, seed=3).refresh(live).report == plan.report
    assert TopologyLoss(bundle, noise=0.01, seed=4).refresh(live).report != plan.report


def test_float32_points_keep_their_dtype_and_the_live_floor_is_an_option(void):
    bundle, live = void
    points = torch.tensor(live, dtype=torch.float32, requires_grad=True)
    value = TopologyLoss(bundle)(points)
    value.backward()
    assert value.dtype == points.grad.dtype == torch.float32
    assert value.item() == pytest.approx(TopologyLoss(bundle)(torch.tensor(live)).item(), rel=1e-3)
    for cloud in (live / bundle.diagonal, (live / bundle.diagonal).tolist(), points / bundle.diagonal):
        assert build_plan(cloud, bundle).report["floor"] == bundle.floor
    report = build_plan(live / bundle.diagonal, bundle, LossConfig(floor_source="live")).report
    assert report["floor"] == report["live_floor"] == measurement_floor(live, bundle.diagonal)


@pytest.fixture
def non_gabriel(monkeypatch):
    """Edge 0-1 has point 2 inside its smallest sphere: it enters with 0-1-2; a far one kills the loop."""
    cloud = np.array([[0.0, 0, 0], [2, 0, 0], [1, 0.5, 0], [9, 0, 0], [9, 6, 0], [13, 3, 1]])
    birth = 1.25  # circumradius of 0-1-2: sides 2, sqrt(1.25), sqrt(1.25), area .5
    edges = cloud[4:] - cloud[3]
    death = float(np.linalg.norm(np.linalg.lstsq(edges, (edges**2).sum(axis=1) / 2, rcond=None)[0]))
    pairs = Pairs(np.array([birth]), np.array([death]), np.array([[0, 1]]), np.array([[3, 4, 5]]))

    def found(*_, as_given):
        return None, pairs, None

    monkeypatch.setattr("paper_artifact.topology.plan.alpha_persistence", found)
    return cloud, handmade_bundle([[1.0, 4.0]], 1, 6, floor=0.5), birth, death


def test_gate_detaches_and_counts(non_gabriel):
    cloud, bundle, birth, death = non_gabriel
    assert not passes_gate(cloud, np.array([[0, 1]]), np.array([birth]))[0]
    plan = build_plan(cloud, bundle)
    assert plan.report["dimensions"]["1"]["gabriel_failures"] == 1
    points = torch.tensor(cloud[plan.used.numpy()], requires_grad=True)
    value = plan.value(points)
    value.backward()
    assert value.item() == pytest.approx((birth - 1) ** 2 + (death - 4) ** 2, rel=1e-12)
    assert not points.grad.any()


def test_fallback_drop_takes_the_bar_out_before_the_matching(non_gabriel):
    cloud, bundle, _, _ = non_gabriel
    plan = build_plan(cloud, bundle, LossConfig(fallback="drop"))
    report = plan.report["dimensions"]["1"]
    assert len(plan) == 0 and report["gabriel_failures"] == 1 and report["unreached"] == 1
    assert plan.value(torch.zeros((0, 3), dtype=torch.float64)).item() == 0.0


def test_flat_cases_and_wrong_density_are_refused(void):
    bundle, live = void
    loss = TopologyLoss(bundle)
    for bad, words in (
        (live[:3], "at least 4 points"),
        (live[:200], "built at M = 400"),
        (live * [1, 1, 0], "in one plane"),
        (np.where(np.arange(400)[:, None] == 7, np.nan, live), "coordinates that are finite"),
        (np.zeros((400, 3), int), "floating-point"),
    ):
        with pytest.raises(InputError, match=words):
            loss(torch.tensor(bad))
    for setting in ("kind", "samples", "dimensions", "rho", "betti", "guard", "pull", "colour"):
        with pytest.raises(InputError, match=f"TopologyLoss does not follow the setting {setting}; choose"):
            TopologyLoss(bundle, **{setting: 1})
    for other in (None, {"a": 1}, bundle.to_json()):
        with pytest.raises(InputError, match="is no Bundle; make one by `build_bundle`"):
            TopologyLoss(other)
    for setting in ("fallback", "floor_source"):
        with pytest.raises(InputError, match=f"unknown {setting}"):
            TopologyLoss(bundle, **{setting: "none"})
    with pytest.raises(InputError, match="no plan yet"):
        TopologyLoss(bundle, refresh_every=0)(torch.tensor(live))


def test_curvature_weights_grow_where_the_surface_bends():
    cube = np.random.default_rng(0).random((3000, 3))
    axis = np.arange(3000) % 3
    cube[np.arange(3000), axis] = 0.0  # three faces of a cube meeting at the origin
    edge = int(np.argmin(np.abs(cube[:, 0]) + np.abs(cube[:, 1]) + np.abs(cube[:, 2] - 0.5)))
    flat = int(np.argmin(np.linalg.norm(cube - [0, 0.5, 0.5], axis=1)))
    weights = pair_weights(cube, np.array([[edge, -1], [flat, -1]]))
    assert weights[0] > 2 and weights[1] == 0.25
    variation = surface_variation(cube)
    expected = np.clip(variation[[edge, flat]].mean() / variation.mean(), *CLIP)
    assert pair_weights(cube, np.array([[edge, flat]])) == pytest.approx(expected)
    np.testing.assert_array_equal(pair_weights(cube * [1, 1, 0], np.array([[0, 1], [2, -1]])), [1, 1])


@pytest.mark.parametrize("settings", [{}, {"curvature_weighted": True}])
def test_a_plan_of_many_pulls_is_the_sum_over_its_bars(settings):
    """Value and gradient against one bar after the other, by torch's own autograd; nothing is lost or
    doubled."""
    target, live = np.random.default_rng(0).random((2, 700, 3))
    bundle = build_bundle(target, 3**0.5, k=0.05)
    loss = TopologyLoss(bundle, **settings)
    points = torch.tensor(live, requires_grad=True)
    value = loss(points)
    value.backward()
    pulls = loss.plan.pulls
    assert len(pulls) > 1400 and set(pulls.dimension) == {0, 1, 2} and {MATCHED, DIAGONAL} <= set(pulls.kind)
    again = torch.tensor(live, requires_grad=True)
    cloud, terms = again / bundle.diagonal, []
    for i in range(len(pulls)):
        corners = [torch.tensor(each[each >= 0]) for each in pulls.simplices[i]]
        birth, death = (circumradius(cloud[each][None])[0] for each in corners)
        aim = pulls.target[i]
        term = ((death - birth) / 2) ** 2
        if pulls.kind[i] != DIAGONAL:
            term = (birth - aim[0]) ** 2 + (death - aim[1]) ** 2
        terms.append(term * pulls.weight[i])
        assert pulls.sound[i]
        assert [birth.item(), death.item()] == pytest.approx(pulls.values[i], rel=1e-6, abs=1e-12)
    torch.stack(terms).sum().backward()
    assert value.item() == pytest.approx(torch.stack(terms).sum().item(), rel=1e-12)
    torch.testing.assert_close(points.grad, again.grad, rtol=1e-9, atol=1e-14)


def test_gradients_are_summed_in_the_order_of_the_pulls():
    """The same bits as numpy's unbuffered addition, pull after pull: recorded runs rest on it."""
    generator = np.random.default_rng(3)
    target, live = generator.random((2, 500, 3))
    plan = build_plan(live, build_bundle(target, 1.0, k=0.05))
    positions = live[plan.used.numpy()] + 1e-3 * generator.random((len(plan.used), 3))
    radii, gradients = plan.radii(positions)
    births, deaths = radii.reshape(2, -1)
    away = (deaths - births) / 2 * np.array([[-1.0], [1.0]])
    pulls = plan.pulls
    slope = np.where(pulls.kind == DIAGONAL, away, 2 * (radii.reshape(2, -1) - pulls.target.T)).ravel()
    expected = np.zeros_like(positions)
    for (rows, corners), gradient in zip(plan.groups, gradients, strict=True):
        np.add.at(expected, corners, slope[rows, None, None] * gradient)
    np.testing.assert_array_equal(plan.value_and_gradient(positions)[1], expected)
