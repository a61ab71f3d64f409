"""Betti numbers in words: the loss, its plan, its audit, and the density that is chosen for it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import make_shape
from paper_artifact.topology import BettiLoss, cleaned
from paper_artifact.topology.bundle import build_bundle
from paper_artifact.topology.floor import measurement_floor
from paper_artifact.topology.loss import build_betti_plan
from paper_artifact.topology.plan import DIAGONAL, NONE
from paper_artifact.topology.statement import (
    Statement,
    choose_density,
    contradictions,
    finished,
    frame_diagonal,
    measured_on,
    projected,
    suggest,
    trimmed,
    unmeasured,
    unseen,
)
from paper_artifact.topology.term import LEAST_RATIO, TopologyTerm, peak_weight

T2 = {"guard": 0.0, "suppress": "all"}


def cloud_of(shape: str, count: int, seed: int = 0) -> np.ndarray:
    mesh = make_shape(shape)
    return sample_surface(mesh.vertices, mesh.faces, count, stream(seed, "test"))[0]


def soup_of(shape: str) -> torch.Tensor:
    mesh = make_shape(shape)
    return torch.tensor(mesh.vertices[mesh.faces], dtype=torch.float32, requires_grad=True)


def lifetimes(cloud: np.ndarray) -> list[np.ndarray]:
    return [np.sort(pairs.deaths - pairs.births)[::-1] for pairs in alpha_persistence(cloud)]


@pytest.mark.filterwarnings("ignore:the loss does not act")
@pytest.mark.parametrize("settings", [{}, T2, {"guard": 3.0}, {"dimensions": (1,)}, {"pull": 0.5}])
def test_the_value_at_a_refresh_is_the_notes_formula(settings):
    points = cloud_of("torus", 600)
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    cloud, loss = points / diagonal, BettiLoss((2, 2, 0), "soup", **settings)
    floor, config = measurement_floor(cloud, 1.0), loss.config
    expected, wanted_bars, other_bars = 0.0, 0, 0
    for dimension, (bars, wanted) in enumerate(zip(lifetimes(cloud), (1, 2, 0), strict=True)):
        if config.dimensions is not None and dimension not in config.dimensions:
            continue
        first, others = bars[:wanted], bars[wanted:]
        if dimension == 0 or config.suppress == "floor":
            others = others[others > floor]
        first = first[first > config.guard * floor]
        expected += len(first) * (config.pull * floor / 6) ** 2 + ((others / 2) ** 2).sum()
        wanted_bars, other_bars = wanted_bars + len(first), other_bars + len(others)
    value = loss(torch.tensor(points)).item()
    assert value == pytest.approx(expected, rel=1e-9) and len(loss.plan) == wanted_bars + other_bars
    report = loss.plan.report["dimensions"].values()
    assert wanted_bars == sum(each["matched"] for each in report)
    assert other_bars == sum(each["diagonal"] for each in report)
    assert (other_bars > 500) == (settings == T2)


@pytest.mark.parametrize("count, betti, settings", [(600, (1, 0, 1), {}), (80, (1, 1, 0), T2)])
def test_the_gradient_is_that_of_finite_differences(count, betti, settings):
    """Words that leave a bar out, so that bars are pushed down beside those that are pulled up."""
    points = torch.tensor(cloud_of("torus", count), requires_grad=True)
    loss = BettiLoss(betti, "soup", refresh_every=0, **(settings | {"guard": 0.1}))
    plan = loss.refresh(points)
    assert {*plan.pulls.kind.tolist()} == {0, DIAGONAL} and plan.pulls.sound.all()
    assert torch.autograd.gradcheck(loss, (points,), eps=1e-6, atol=1e-7, rtol=1e-5)


def test_wanted_bars_are_pulled_by_their_deaths_alone():
    points = torch.tensor(cloud_of("torus", 500), requires_grad=True)
    loss = BettiLoss((1, 1, 0), "soup", guard=0.0, dimensions=(1,))
    loss.refresh(points)
    pulls = loss.plan.pulls
    wanted = pulls.kind != DIAGONAL
    assert wanted.sum() == 1 and (pulls.simplices[wanted, 0] == NONE).all()
    assert (pulls.simplices[~wanted, 0, :2] != NONE).all()
    before = pulls.values[wanted][0]
    assert pulls.target[wanted][0].tolist() == [before[0], before[1] + 2 * loss.plan.report["floor"] / 6]
    loss(points).backward()
    with torch.no_grad():
        longer = BettiLoss((1, 1, 0), "soup", diagonal=1.0, guard=0.0, dimensions=(1,), refresh_every=0)
        one = longer.refresh(points - 0.01 * points.grad / points.grad.norm())
    assert one.pulls.values[0, 1] > longer.refresh(points).pulls.values[0, 1]


def test_classes_are_pulled_up_to_the_clouds_deaths_and_no_further():
    cloud = cloud_of("torus", 2000)
    statement = measured_on(cloud, Statement((1, 3, 1), frame_diagonal(cloud)), 2000)
    deaths = [np.sort(pairs.deaths)[::-1] for pairs in alpha_persistence(cloud / statement.diagonal)]
    assert np.allclose(statement.shown[1], deaths[1][:2]) and statement.shown[0] == statement.shown[2] == ()
    sentences = unmeasured(statement, 2000, 2000)  # the void lies below a floor, the third loop is none
    assert len(sentences) == 2 and "you said 3 loops; at M = 2000 the SfM cloud shows 2" in sentences[0]
    config = LossConfig("betti", betti=(1, 3, 1), aim="cloud", samples=2000)
    for scale, pulled in ((0.9, True), (1.1, False)):  # a soup with narrower loops, and one with wider ones
        plan = build_betti_plan(scale * cloud / statement.diagonal, statement, config)
        of_loops = plan.report["dimensions"]["1"]
        aims = np.array([each["target"][1] for each in of_loops["targets"]])
        lives = np.array([each["live"][1] for each in of_loops["targets"]])
        assert of_loops["wanted"] == 3 and of_loops["matched"] == 2
        assert np.allclose(aims, statement.shown[1] if pulled else lives, rtol=1e-9)
        loss = plan.value(torch.from_numpy(scale * cloud / statement.diagonal)[plan.used])
        assert float(loss) == pytest.approx(((aims - lives) ** 2).sum(), rel=1e-6, abs=1e-12)
    fewer = measured_on(cloud, Statement((1, 1, 1), statement.diagonal), 2000)  # as a cloud with gaps
    assert fewer.shown[1] is None and "shows more" in unmeasured(fewer, 2000, 2000)[0]
    sparse = measured_on(cloud, statement, 2500)  # 2,000 points do not speak for 2,500
    assert sparse.shown == (None,) * 3 and "2000 points" in unmeasured(sparse, 2500, 2000)[0]
    plan = build_betti_plan(cloud / statement.diagonal, sparse, replace(config, samples=2500))
    assert len(plan.used) == 0
    plan = build_betti_plan(cloud / statement.diagonal, fewer, replace(config, betti=(1, 1, 1)))
    assert len(plan.used) == 0 and plan.report["dimensions"]["1"]["surplus"] == 1
    with pytest.raises(InputError, match="condition T3"):
        BettiLoss((1, 1, 0), aim="cloud")


def test_a_hole_grows():
    """A slab of points that is said to have one loop gets a hole, by the line of the docs."""
    slab = torch.tensor(stream(0, "slab").random((200, 3)) * [1, 1, 0.1], requires_grad=True)
    loss, optimiser = BettiLoss((1, 1, 0)), torch.optim.Adam([slab], lr=0.005)
    margins = []
    for _ in range(40):
        optimiser.zero_grad()
        loss(slab).backward()
        margins.append(loss.plan.report["dimensions"]["1"]["margins"])
        optimiser.step()
    assert margins[0][0] < 0.3 and margins[-1][0] > 2 * margins[0][0] and margins[-1][1] < 0.3


@pytest.mark.parametrize("betti", [(1, 2), (1, 2.0, 1), (1, True, 1), "two loops", None])
def test_what_are_no_betti_numbers_is_refused(betti):
    """Numbers out of range, from the command line: test_train_in_words."""
    with pytest.raises(InputError, match=r"three whole numbers b0,b1,b2 \(components, loops, voids\), got"):
        BettiLoss(betti)


FLAT, BALL = stream(0, "flat").random((50, 3)) * [1, 1, 0], cloud_of("sphere", 60)
UNKNOWN = ("kind", "samples", "rho", "ramp", "recruitment", "floor_source", "bundle_seed", "colour")


@pytest.mark.parametrize(
    "points, settings, words",
    [
        (FLAT, {}, "all live points lie in one plane"),
        (FLAT[:1].repeat(9, axis=0), {}, "all live points lie in one plane"),
        (FLAT[:3], {}, r"at least 4 points of shape \(n, 3\), got \(3, 3\)"),
        (FLAT[:, :2], {}, r"shape \(M, 3\), got torch.float64 \(50, 2\)"),
        (np.full((9, 3), np.nan), {}, "coordinates that are finite"),
        (1e308 * abs(BALL), {}, "below 1e307; remove others, scale all"),
        (BALL, {"betti": (1, 9999, 0)}, r"9999 finite bars of dimension 1 \(loops\).*have \d+ in all"),
        *((BALL, {"preset": wrong}, "preset must be one of points, soup, got") for wrong in ("bare", [])),
        *((BALL, {"diagonal": wrong}, "positive length") for wrong in (-1.0, 0, np.nan, np.inf, "1")),
        *((BALL, {"diagonal": wrong}, "give the diagonal in their unit") for wrong in (1e300, 1e-320)),
        *((BALL, {"seed": wrong}, "seed is .*; give a whole number") for wrong in (-1, 0.5, "a")),
        *((BALL, {name: 1}, f"does not follow the setting {name}; choose among") for name in UNKNOWN),
    ],
)
def test_what_no_loss_can_be_had_of_is_refused(points, settings, words):
    with pytest.raises(InputError, match=words):
        BettiLoss(**{"betti": (1, 1, 0)} | settings)(torch.tensor(points))


def test_no_plan_is_made_of_points_without_coordinates():
    with pytest.raises(InputError, match=r"at least 4 points of shape \(n, 3\), got \(9, 0\)"):
        BettiLoss((1, 1, 0)).refresh(FLAT[:9, :0])


def test_a_loss_needs_a_tensor():
    with pytest.raises(InputError, match="needs a torch tensor, got ndarray"):
        BettiLoss((1, 1, 0))(BALL)


@pytest.mark.parametrize("scale", [1e-300, 1e-150, 1.0, 1e150, 1e300])
def test_the_loss_is_the_same_at_any_scale(scale):
    points = torch.tensor(scale * (cloud_of("torus", 200) + 5.0), requires_grad=True)
    assert cleaned(points).shape == cleaned(points / scale).shape
    loss = BettiLoss(np.array([1, np.int64(2), 0]), dimensions=torch.tensor([1]), refresh_every=np.int64(5))
    (gradient,) = torch.autograd.grad(loss(points), points)
    one = (points.detach() / scale).requires_grad_()
    right = BettiLoss((1, 2, 0), dimensions=(1,))
    (expected,) = torch.autograd.grad(right(one), one)
    assert loss(points).item() == pytest.approx(right(one).item(), rel=1e-6)
    assert torch.allclose(gradient * scale, expected, rtol=1e-6, atol=1e-12) and bool(expected.any())
    if scale < 1e-39:
        with pytest.raises(InputError, match="one place|in one plane|scale them up"):
            loss(torch.tensor(1e-44 + 1e-40 * cloud_of("torus", 200), dtype=torch.float32))


def test_a_wanted_class_that_the_guard_hides_is_warned_of_once():
    points, loss = torch.tensor(cloud_of("sphere", 200)), BettiLoss((1, 2, 0), "soup")
    with pytest.warns(UserWarning, match="does not act on 2 of the wanted classes"):
        loss.refresh(points)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loss.refresh(points)
        BettiLoss((1, 2, 0)).refresh(points)


# --- the statement against what the images show


def said(shape: str, betti: tuple[int, ...], samples: int = 2048, **settings) -> tuple[list[str], list[str]]:
    """Return (what contradicts the words, what does not show yet)."""
    points = cloud_of(shape, samples)
    loss = BettiLoss(betti, "soup", **settings)
    report = loss.refresh(points).report
    statement = Statement(betti, 1.0)
    return contradictions(statement, report), unseen(statement, report, loss.config)


@pytest.mark.filterwarnings("ignore:the loss does not act")
@pytest.mark.parametrize("settings", [{}, T2])
def test_the_audit_says_what_contradicts_the_words(settings):
    assert said("sphere", (1, 0, 1), **settings) == ([], [])
    assert said("torus", (1, 2, 1), **settings) == ([], [])
    (void,), _ = said("sphere", (1, 0, 0), **settings)
    assert void.startswith("you said no void; the images show 1 void (the longest has ")
    _, (loops,) = said("sphere", (1, 2, 1), **settings)
    assert loops.startswith("you said 2 loops; none so far: the next candidate has 0.")
    _, (loop,) = said("torus", (1, 3, 1), **settings)
    assert loop.startswith("you said 3 loops; 2 so far: the next candidate has 0.") and "below 0.5" in loop
    (surplus,), _ = said("torus", (1, 0, 1), **settings)
    assert surplus.startswith("you said no loop; the images show ")
    _, (second,) = said("sphere", (2, 0, 1), **settings)
    assert second.startswith("you said 2 components; 1 so far: the next candidate has 0.")
    (component,), _ = said("two_spheres", (1, 0, 2), **settings)
    assert component.startswith("you said 1 component; the images show 1 component more")


def words_of(betti: tuple[int, ...], steps: int = 100, **options) -> TopologyTerm:
    loss = LossConfig("betti", betti=betti, samples=2048)
    return TopologyTerm(loss, Statement(betti, 3.0, 2048), steps, 0, **options)


def test_a_term_audits_its_words_once_before_any_gradient():
    told: list[str] = []
    soup, term = soup_of("sphere"), words_of((1, 0, 0), tell=told.append)
    for step in (20, 22, 32):
        if term.due(step):
            term.refresh(step, soup, None)
    assert [event["event"] for event in term.log] == ["refresh", "audit", "refresh"]
    (warning,) = term.log[1]["warnings"]
    assert told == [f"step 22: {warning}"] and "no void" in warning and term.lambda_peak is None
    resumed = words_of((1, 0, 0), tell=told.append)
    resumed.load_state(term.state())
    resumed.refresh(42, soup, None)
    assert len(told) == 1 and resumed.log[-1]["event"] == "refresh"
    with pytest.raises(InputError, match="at step 22 the images contradict the words: you said no"):
        words_of((1, 0, 0), strict=True).refresh(22, soup, None)
    words_of((1, 0, 1), strict=True).refresh(22, soup, None)
    words_of((1, 1, 1), strict=True, tell=told.append).refresh(22, soup, None)
    assert told[-1].startswith("step 22: you said 1 loop; none so far")


def test_the_images_are_asked_again_at_every_tenth_refresh():
    """A true statement of a sphere, whose second component comes up later."""
    told: list[str] = []
    one, two, term = soup_of("sphere"), soup_of("two_spheres"), words_of((1, 0, 1), tell=told.append)
    for refresh in range(12):
        term.refresh(22 + refresh, one if refresh < 9 else two, None)
    assert [event["step"] for event in term.log if event["event"] == "audit"] == [22, 32]
    assert told[0].startswith("step 32: you said 1 component; the images show 1 component more")


def test_a_finished_soup_is_held_to_the_statement():
    statement = Statement((1, 2, 1), 1.0)
    assert finished(statement, (0, 2, 1)) == finished(statement, (0, 1, 0)) == []
    assert finished(statement, (1, 4, 1)) == [
        "you said 1 component; the finished soup has 2 components",
        "you said 2 loops; the finished soup has 4 loops",
    ]


def test_a_target_of_another_kind_is_refused():
    bundle = build_bundle(cloud_of("sphere", 512), 3.4)
    with pytest.raises(InputError, match="'betti' does not act towards a Bundle"):
        TopologyTerm(LossConfig("betti", betti=(1, 0, 1), samples=512), bundle, 10, 0)
    with pytest.raises(InputError, match="'topology' does not act towards a Statement"):
        TopologyTerm(LossConfig(samples=512), Statement((1, 0, 1), 1.0, 512), 10, 0)
    with pytest.raises(InputError, match="made for M = 512, but the loss samples 100"):
        Statement((1, 0, 1), 1.0, 512).require_density(100)


@pytest.mark.parametrize("kind", ["betti", "topology"])
def test_a_gradient_of_rounding_alone_sets_no_weight(kind):
    assert peak_weight(0.1, 1.0, 2 * LEAST_RATIO) == pytest.approx(0.1 / (2 * LEAST_RATIO))
    assert peak_weight(0.1, 1.0, LEAST_RATIO / 2) is None
    soup, term = soup_of("sphere"), words_of((1, 0, 1))
    if kind == "topology":
        term = TopologyTerm(LossConfig(samples=512), build_bundle(cloud_of("sphere", 512), 3.4), 100, 0)
    term.refresh(30, soup, None)
    assert term.value(30, soup, 1e9) is None and term.lambda_peak is None
    assert term.log[-1]["event"] == "no-op"
    assert "of the photometric one, below 1e-05" in term.log[-1]["reason"]
    assert term.value(31, soup, 1.0).item() > 0 and term.log[-1]["event"] == "lambda"


# --- the density


def chosen(shape: str, betti: tuple[int, ...], count: int = 9000, **settings):
    cloud = cloud_of(shape, count)
    return choose_density(cloud, Statement(betti, frame_diagonal(cloud)), LossConfig("betti", **settings))


def test_the_density_is_the_smallest_that_shows_the_classes():
    found = chosen("sphere", (1, 0, 1))
    assert (found.samples, found.complete) == (2048, True) and "1 of 1 wanted classes" in found.reasons[0]
    torus = chosen("torus", (1, 2, 1), guard=1.0)
    assert torus.complete and torus.samples == 2048 * 2 ** (len(torus.reasons) - 1) > 2048
    assert chosen("torus", (1, 2, 1), guard=0.0) == chosen("torus", (1, 2, 1), guard=0.5)
    assert chosen("sphere", (1, 0, 0)).reasons == ("The statement names no class to be seen: M = 2048.",)


def test_where_no_density_shows_the_classes_it_says_so():
    found = chosen("sphere", (1, 3, 1))
    assert (found.samples, found.complete) == (2048, False) and len(found.reasons) == 4
    assert found.reasons[-1] == (
        "No density shows all of them; M = 2048 shows most (M = 16384 not asked: the cloud has 9000 points)."
    )
    assert chosen("sphere", (1, 0, 1), count=1000).reasons == (
        "The cloud has 1000 points, too few to choose M by: M = 2048.",
    )


def test_a_class_is_reached_where_the_loss_acts_on_it():
    """T3 acts on what the cloud shows above one floor, T1 on what exceeds half of it."""
    seen, reached = (chosen("torus", (1, 2, 1), aim=aim) for aim in ("deaths", "cloud"))
    assert seen.samples < reached.samples and "exceed 1 of the floor" in reached.reasons[-1]
    cloud = cloud_of("torus", 9000)
    statement = measured_on(cloud, Statement((1, 2, 1), frame_diagonal(cloud)), reached.samples)
    assert [len(each) for each in statement.shown] == [0, 2, 1]


@pytest.mark.parametrize("shape", ["sphere", "torus", "two_spheres"])
def test_samples_suggest_their_betti_numbers(shape):
    noise = stream(1, "noise").normal(size=(20_000, 3))
    cloud = cloud_of(shape, 20_000) + 0.002 * np.linalg.norm(np.ptp(cloud_of(shape, 100), axis=0)) * noise
    found = suggest(lambda count: cloud[:count], (1024, 2048, 4096))
    assert found.betti == make_shape(shape).betti and found.samples in (1024, 2048, 4096)
    assert len(found.sentences) == 3 and "M = 2048: " in found.sentences[1]


def test_what_hides_is_proposed_and_said():
    cloud = cloud_of("torus", 1024)
    found = suggest(lambda count: cloud[:count], (900,))  # the tube's loop lies below a floor
    first, second, third = lifetimes(cloud[:900])[1][:3] / measurement_floor(cloud[:900], 1.0)
    assert 0.75 < second < 1 < first and third < 0.4 and found.betti[1] == 2
    assert f"2 loops ({first:.1f}, {second:.1f}, next {third:.1f}; 1 hide)" in found.sentences[0]
    with pytest.raises(InputError, match="2048 are needed"):
        suggest(lambda count: cloud, ())


def test_the_frame_is_the_clouds_and_ignores_outliers():
    cloud = cloud_of("sphere", 4000)
    box = np.linalg.norm(np.ptp(cloud, axis=0))
    assert 0.95 * box < frame_diagonal(cloud) < box
    far = np.concatenate([cloud, 100.0 + np.random.default_rng(0).random((20, 3))])
    assert frame_diagonal(far) == pytest.approx(frame_diagonal(cloud), rel=0.05)
    for points, words in ((cloud[:1].repeat(9, axis=0), "one place"), (cloud[:2], "at least 4")):
        with pytest.raises(InputError, match=words):
            frame_diagonal(points)


def test_a_dirty_sphere_is_cleaned():
    draws = np.random.default_rng(0)
    points = draws.standard_normal((3000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    noisy = points * (1 + 0.02 * draws.standard_normal((3000, 1)))
    far = np.concatenate([noisy, draws.uniform(-3, 3, (100, 3))])
    found = cleaned(far)
    before, after = (np.abs(np.linalg.norm(each, axis=1) - 1) for each in (noisy, found))
    assert 2950 <= len(found) <= 3020 and after.mean() < 0.7 * before.mean() and after.max() < 0.3
    assert len(trimmed(points)) == 3000 and np.allclose(projected(points), points, atol=0.02)
    with pytest.raises(InputError, match="cleaning needs coordinates that are finite"):
        cleaned(np.full((9, 3), np.nan))
