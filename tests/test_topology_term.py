"""The training-side term: schedule, calibration, refreshes, log, conditions, the repulsion control."""

import json
from itertools import combinations, product

import numpy as np
import pytest
import torch

from paper_artifact.catalogue import get_condition
from paper_artifact.config import LossConfig, with_changes
from paper_artifact.errors import InputError
from paper_artifact.topology.bundle import Bundle, build_bundle
from paper_artifact.topology.plan import Plan, Pulls
from paper_artifact.topology.term import (
    TopologyTerm,
    draw_samples,
    neighbour_pairs,
    peak_weight,
    ramp_factor,
    repulsion,
    samples_stream,
)

M = 600


def octahedron_soup(refinements: int = 2) -> np.ndarray:
    """The unit sphere as a soup (T,3,3): an octahedron refined and pushed out."""
    soup = np.stack([np.diag(signs) for signs in product((1.0, -1.0), repeat=3)])
    for _ in range(refinements):
        (a, b, c), (ab, bc, ca) = (each.swapaxes(0, 1) for each in (soup, (soup + np.roll(soup, -1, 1)) / 2))
        children = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        soup = np.concatenate([np.stack(child, axis=1) for child in children])
        soup /= np.linalg.norm(soup, axis=2, keepdims=True)
    return soup


@pytest.fixture(scope="module")
def bundle():
    soup = torch.tensor(octahedron_soup())
    points = draw_samples(soup, None, M, samples_stream(9, 0)).positions(soup)
    return build_bundle(points.numpy(), 2 * 3**0.5, shape="sphere")


def term_of(condition: str, bundle: Bundle, steps: int = 100, **settings) -> TopologyTerm:
    loss = with_changes(get_condition(condition).loss, {"samples": bundle.samples} | settings)
    return TopologyTerm(loss, bundle, steps, 0)


def live_soup() -> torch.Tensor:
    return torch.tensor(octahedron_soup() * [0.8, 1, 1], dtype=torch.float32, requires_grad=True)


def test_samples_follow_the_vertices_and_carry_gradients():
    soup = torch.tensor(octahedron_soup(1), requires_grad=True)
    samples = draw_samples(soup, None, 500, samples_stream(0, 3))
    positions = samples.positions(soup)
    torch.testing.assert_close(samples.positions(soup * 2), positions * 2)
    picked = torch.tensor([4, 77, 499])
    torch.testing.assert_close(samples.positions(soup, picked), positions[picked])
    positions.sum().backward()
    assert soup.grad.sum().item() == pytest.approx(3 * 500)  # barycentrics sum to 1
    again = draw_samples(soup, None, 500, samples_stream(0, 3))
    assert torch.equal(again.faces, samples.faces) and torch.equal(again.barycentrics, samples.barycentrics)
    assert not torch.equal(draw_samples(soup, None, 500, samples_stream(0, 4)).faces, samples.faces)


def test_samples_of_another_soup_are_refused():
    soup = torch.tensor(octahedron_soup(0))
    with pytest.raises(InputError, match="refresh after every resampling"):
        draw_samples(soup, None, 10, samples_stream(0, 0)).positions(soup[:5])
    with pytest.raises(InputError, match="not finite or opacities outside"):
        draw_samples(soup * torch.nan, None, 10, samples_stream(0, 0))


def test_ramp_and_calibration():
    factors = [ramp_factor(step, 2500, (0.2, 0.5)) for step in (0, 500, 875, 1250, 2499)]
    assert factors == pytest.approx([0, 0, 0.5, 1, 1])
    assert ramp_factor(0, 2500, None) == 1
    assert peak_weight(0.1, 3.0, 0.5) == pytest.approx(0.6)
    for photo, topo in ((0.0, 1.0), (1.0, 0.0), (np.nan, 1.0), (1.0, np.inf), (1e308, 1e-300)):
        assert peak_weight(0.1, photo, topo) is None


def run(condition: str, bundle: Bundle, steps: int = 100, upto: int = 60, photo: float = 2.0, **options):
    """Step a soup by the term alone; return (term, {step: λ(t)·L})."""
    term = term_of(condition, bundle, steps, **options)
    soup, values, asked = live_soup(), {}, []
    for step in range(1, upto + 1):
        opacity = torch.full((len(soup), 3), 0.9)
        if term.due(step, (step - 1) % 25 == 0):
            term.refresh(step, soup, opacity)
        value = term.value(step, soup, lambda batches: asked.append(batches) or photo)
        if value is not None:
            soup.grad = None
            value.backward()
            values[step] = value.item()
            with torch.no_grad():
                soup -= 0.01 * soup.grad / torch.linalg.vector_norm(soup.grad)
    return term, values, asked


def test_refreshes_every_ten_steps_and_after_resampling_and_logs(bundle):
    term, values, asked = run("C1", bundle)
    assert min(values) == 22 and asked == [1]
    assert run("C1", bundle, upto=22, calibration_batches=20)[2] == [20]
    assert [entry["step"] for entry in term.log if entry["event"] == "refresh"] == [22, 26, 36, 46, 51]
    (weight,) = [entry for entry in term.log if entry["event"] == "lambda"]
    assert weight["step"] == 22 and term.lambda_peak == weight["lambda_peak"]
    assert weight["lambda_peak"] == pytest.approx(0.1 * 2.0 / weight["topo_norm"])
    report = term.log[0]["dimensions"]["2"]
    counts = ["significant", "matched", "diagonal", "recruited", "unreached", "gabriel_failures"]
    assert [report[name] for name in counts] == [1, 1, 0, 0, 0, 0]
    (first,) = report["targets"]
    assert first["target"] == bundle.bars[2][0].tolist() and first["kind"] == "matched"
    json.dumps(term.log, allow_nan=False)
    live = [
        entry["dimensions"]["2"]["targets"][0]["live"] for entry in term.log if entry["event"] == "refresh"
    ]
    errors = abs(np.array(live)[:, 1] - bundle.bars[2][0, 1])
    assert errors[-1] < errors[0]  # the pull works through the soup's vertices


def test_weighted_gradient_norm_is_rho_times_photo_at_full_ramp(bundle):
    for name in ("C3", "C2"):
        term, soup = term_of(name, bundle), live_soup()
        step = 1 if term.config.ramp is None else 51
        assert term.due(step)
        term.refresh(step, soup, None)
        term.value(step, soup, 3.0).backward()
        assert torch.linalg.vector_norm(soup.grad).item() == pytest.approx(0.3, rel=1e-5)


def test_zero_gradient_calibration_is_a_stated_no_op_and_tries_again(bundle):
    term = term_of("C1", bundle)
    soup = live_soup()
    term.refresh(31, soup, None)
    assert term.value(31, soup, 0.0) is None and term.lambda_peak is None
    assert term.log[-1]["event"] == "no-op" and "photometric" in term.log[-1]["reason"]
    nothing = {name: each[:0] for name, each in vars(term._objective.plan.pulls).items()}
    term._objective.plan = Plan(Pulls(**nothing), M, {})
    assert term.value(32, soup, 1.0) is None and "topology" in term.log[-1]["reason"]
    if term.due(33, True):
        term.refresh(33, soup, None)
    assert term.value(33, soup, 1.0) is not None and term.lambda_peak > 0


def test_misuse_is_refused(bundle):
    with pytest.raises(InputError, match=f"built at M = {M} but the loss samples 2048"):
        TopologyTerm(LossConfig(samples=2048), bundle, 100, 0)
    for setting in ("steps", "refresh_every"):
        with pytest.raises(InputError, match="at least 1"):
            term_of("C1", bundle, **{setting: 0})
    with pytest.raises(InputError, match="call refresh where due"):
        term_of("C1", bundle).value(51, live_soup(), 1.0)


def test_state_resumes_exactly_where_a_refresh_is_due(bundle):
    def finish(term, soup, start):
        for step in range(start, 61):
            if term.due(step, step == 41):
                term.refresh(step, soup, None)
            soup.grad = None
            value = term.value(step, soup, 1.0)
            if value is not None:
                value.backward()
                with torch.no_grad():
                    soup -= 0.1 * soup.grad
            if step == 40:
                saved = json.loads(json.dumps(term.state())), soup.detach().clone()
        return soup.detach(), saved if start == 1 else None

    straight, (state, soup) = finish(term_of("C1", bundle), live_soup(), 1)
    resumed = term_of("C1", bundle)
    resumed.load_state(state)
    again, _ = finish(resumed, soup.requires_grad_(True), 41)
    assert torch.equal(straight, again) and [e["step"] for e in resumed.log][-2:] == [41, 51]


def test_curvature_weighted_condition_weights_the_terms(bundle):
    weights = {}
    for name in ("C1", "C4"):
        term = term_of(name, bundle)
        term.refresh(31, live_soup(), None)
        weights[name] = term._objective.plan.pulls.weight.tolist()
    assert weights["C1"] == [1.0] and weights["C4"] != [1.0] and 0.25 <= weights["C4"][0] <= 4


def test_repulsion_gradient_and_cutoff():
    points = np.random.default_rng(0).random((40, 3))
    points[1] = points[0]  # no direction: no force
    pairs = neighbour_pairs(points, 0.3)
    apart = {pair: np.linalg.norm(np.diff(points[list(pair)], axis=0)) for pair in combinations(range(40), 2)}
    assert [tuple(pair) for pair in pairs] == [pair for pair, away in apart.items() if away < 1.25 * 0.3]
    energy = sum(max(0.0, 1 - away / 0.3) ** 2 for away in apart.values()) / 40
    assert repulsion(torch.tensor(points), pairs, 0.3).item() == pytest.approx(energy, rel=1e-12)
    live = torch.tensor(points, requires_grad=True)
    repulsion(live, pairs, 0.3).backward()
    assert torch.isfinite(live.grad).all()
    smooth = torch.tensor(np.delete(points, 1, axis=0)[:15], requires_grad=True)
    pairs = neighbour_pairs(smooth.detach().numpy(), 0.5)
    assert torch.autograd.gradcheck(lambda x: repulsion(x, pairs, 0.5), (smooth,), eps=1e-7, atol=1e-6)
