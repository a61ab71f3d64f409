"""Distances of diagrams against gudhi's hera; images, landscapes, plots."""

import gudhi.hera
import numpy as np
import pytest
import torch
from gudhi.representations import Landscape
from hypothesis import given, settings
from hypothesis import strategies as st

from paper_artifact.alpha import (
    alpha_diagrams,
    alpha_persistence,
    bottleneck,
    persistence_image,
    persistence_landscape,
    plot_diagram,
    wasserstein,
)
from paper_artifact.errors import InputError
from tests.test_alpha_face import cloud


def hera(a: np.ndarray, b: np.ndarray) -> float:
    return gudhi.hera.bottleneck_distance(a, b, delta=0.0)


def random_bars(generator: np.random.Generator, count: int, on_ray: bool) -> np.ndarray:
    births = np.zeros(count) if on_ray else generator.random(count)
    lives = generator.exponential(0.3, count) * generator.choice([0.05, 1.0], count) + 1e-6
    return np.column_stack([births, births + lives])


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 50), st.integers(0, 50), st.booleans(), st.booleans())
def test_bottleneck_equals_hera_on_random_diagrams(seed, size_a, size_b, on_ray, close):
    generator = np.random.default_rng(seed)
    a = random_bars(generator, size_a, on_ray)
    b = random_bars(generator, size_b, on_ray)
    if close:  # a perturbed copy: the optimal matching then pairs most bars
        b = a + np.array([0.0 if on_ray else 0.01, 0.01]) * generator.normal(size=a.shape)
        b[:, 1] = np.maximum(b[:, 1], b[:, 0] + 1e-6)
    assert bottleneck(a, b) == pytest.approx(hera(a, b), abs=1e-13)
    assert bottleneck(a, b) == pytest.approx(bottleneck(b, a), abs=1e-13)


def test_bottleneck_equals_hera_on_large_noisy_diagrams():
    generator = np.random.default_rng(5)
    for on_ray in (True, False):
        a = random_bars(generator, 2500, on_ray) * 0.01
        b = random_bars(generator, 2300, on_ray) * 0.011
        a = np.vstack([a, [[0.0, 0.3]]])
        assert bottleneck(a, b) == pytest.approx(hera(a, b), abs=1e-13)
        assert bottleneck(a, a) == 0


BARS = st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9)), max_size=6).map(
    lambda rows: np.array([(b, b + life) for b, life in rows], dtype=float).reshape(-1, 2)
)


# The same examples each time: on a few diagrams hera's auction does not end at this delta.
@settings(max_examples=100, deadline=None, derandomize=True, database=None)
@given(BARS, BARS, st.sampled_from([1.0, 2.0]), st.sampled_from([2.0, np.inf]))
def test_wasserstein_is_gudhis(a, b, order, internal):
    theirs = gudhi.hera.wasserstein_distance(a, b, order=order, internal_p=internal, delta=1e-9)
    assert wasserstein(a, b, order, internal) == pytest.approx(theirs, rel=1e-7, abs=1e-9)
    tensor = wasserstein(torch.tensor(a), torch.tensor(b), order, internal)
    assert float(tensor) == pytest.approx(theirs, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize(
    "bars",
    [
        [[2.7], [9.6]], [[0, 1, 2]], [0.0, 1.0], [[[0, 1]]], [["a", "b"]], [[1, 0]], [[0, np.nan]],
        [[np.inf, np.inf]], [[-1.7e308, 1.7e308]], [[0, 10**400]], np.ones((1, 2)) * 1j,
        np.ma.masked_array([[0.0, 1.0]], mask=[[False, True]]),
    ],
)  # fmt: skip
def test_what_are_no_bars(bars):
    for call in (bottleneck, wasserstein):
        with pytest.raises(InputError, match="bar"):
            call(bars, [[0.0, 3.0]])
    with pytest.raises(InputError, match="bar"):
        persistence_image(bars)


def test_distances_and_images_have_gradients():
    points, other = torch.tensor(cloud(14), requires_grad=True), alpha_persistence(cloud(14, name="aim"))
    span = ((0.0, 2.0), (0.0, 2.0))
    for loss in (
        lambda p: wasserstein(alpha_diagrams(p)[1].bars, torch.tensor(other[1].diagram)),
        lambda p: wasserstein(alpha_diagrams(p)[0].bars, torch.tensor(other[0].diagram), 2.0, 2.0),
        lambda p: persistence_image(alpha_diagrams(p)[1].bars, 4, 0.3, span),
        lambda p: persistence_landscape(alpha_diagrams(p)[1].bars, 3, 7, (0.0, 2.0)),
    ):
        assert torch.autograd.gradcheck(loss, points, eps=1e-7, atol=1e-5)
    bars = other[1].diagram
    image = persistence_image(bars, 60, 0.05, ((-0.5, 3.0), (-0.5, 3.0)))
    assert image.sum() * (3.5 / 60) ** 2 == pytest.approx((bars[:, 1] - bars[:, 0]).sum(), rel=1e-3)
    assert persistence_image([]).sum() == 0 and persistence_image([[0, np.inf]]).sum() == 0
    for power in (-300, -150, 150, 300):  # an image is in units of one over its bars'
        scale, unit = 10.0**power, ((0.0, 2.0), (0.0, 2.0))
        far = persistence_image(scale * bars, 5, 0.3 * scale, (scale * np.array(unit)).tolist())
        np.testing.assert_allclose(scale * far, persistence_image(bars, 5, 0.3, unit), rtol=1e-9)
        far = persistence_landscape(scale * bars, 3, 9, (0.0, 2.0 * scale))
        np.testing.assert_allclose(far, scale * persistence_landscape(bars, 3, 9, (0.0, 2.0)), rtol=1e-9)
        for order, internal in ((1, 2), (2, 2), (10, 10), (1, np.inf)):
            far = wasserstein(scale * bars, scale * other[0].diagram, order, internal)
            assert far == pytest.approx(scale * wasserstein(bars, other[0].diagram, order, internal))


CENTRED = {"resolution": 1, "span": ((-0.5, 0.5), (0.5, 1.5))}  # the pixel's centre is a bar


@pytest.mark.parametrize(
    ("call", "options", "words"),
    [
        (wasserstein, {"order": "2"}, "order and internal are"),
        (wasserstein, {"order": np.nan}, "order and internal are"),
        (wasserstein, {"order": 11}, "give 1 to 10"),
        (wasserstein, {"internal": 0.5}, "give 1 to 10, internal also inf"),
        (wasserstein, {"internal": 1000}, "give 1 to 10, internal also inf"),
        (persistence_image, {"resolution": 0}, "resolution is 0; give a whole number from 1"),
        (persistence_image, {"resolution": 10**400}, "resolution is 10+; give a whole number from 1"),
        (persistence_image, {"resolution": -1}, "resolution is -1"),
        (persistence_image, {"resolution": 2.5}, "resolution is 2.5"),
        (persistence_image, {"bandwidth": 0.0}, "bandwidth is 0.0; give a positive number"),
        (persistence_image, {"bandwidth": "1"}, "bandwidth is '1'; give a positive number"),
        (persistence_image, {"bandwidth": np.inf}, "bandwidth is inf"),
        (persistence_image, CENTRED | {"bandwidth": 1e-300}, "range of .*float64; give a larger bandwidth"),
        (persistence_image, {"span": ((0, np.inf), (0, 1))}, "the span .* is empty or none"),
        (persistence_image, {"span": ((0, np.nan), (0, 1))}, "the span .* is empty or none"),
        (persistence_image, {"span": (0, 1)}, "the span .* is empty or none"),
        (persistence_image, {"span": ((0, 1),)}, "the span .* is empty or none"),
        (persistence_image, {"span": ((1, 0), (0, 1))}, "the span .* is empty or none"),
        (persistence_landscape, {"span": (0, np.inf)}, "the span .* is empty or none"),
        (persistence_landscape, {"span": (-1.7e308, 1.7e308)}, "the span .* is empty or none"),
        (persistence_landscape, {"span": 3}, "the span .* is empty or none"),
        (persistence_landscape, {"layers": 0}, "layers is 0; give a whole number from 1"),
        (persistence_landscape, {"layers": 2.5}, "layers is 2.5"),
        (persistence_landscape, {"resolution": 1}, "resolution is 1; give a whole number from 2"),
    ],
)
def test_options_that_make_no_sense(call, options, words):
    bars = np.array([[0.0, 1.0], [0.5, 3.0]])
    for one in (bars, torch.tensor(bars)):
        with pytest.raises(InputError, match=words):
            call(one, **({"b": bars} if call is wasserstein else {}), **options)


def test_diagrams_of_every_kind_are_bars():
    points = torch.tensor(cloud(14), requires_grad=True)
    for call in (lambda bars: wasserstein(bars, [[0, 1]]), persistence_image, persistence_landscape):
        whole = alpha_diagrams(points)[1]
        assert torch.equal(call(whole), call(whole.bars)) and call(whole).requires_grad
        of_integers = call(torch.tensor([[0, 3], [1, 2]]))
        np.testing.assert_allclose(of_integers, call(np.array([[0.0, 3.0], [1.0, 2.0]])))
    assert torch.equal(wasserstein(torch.tensor([[0.0, np.inf]]), []), torch.tensor(np.inf))
    assert persistence_image([[1e17, 1e17 + 64]]).max() > 0 == persistence_landscape([[1e17, 1e17]]).max()


@settings(max_examples=50, deadline=None)
@given(BARS)
def test_landscapes_are_gudhis(bars):
    gudhis = Landscape(num_landscapes=3, resolution=20, sample_range=(0.0, 19.0), keep_endpoints=True)
    ours = persistence_landscape(np.vstack([bars, [[0.0, np.inf]]]), 3, 20, (0.0, 19.0))
    np.testing.assert_allclose(ours.ravel(), gudhis(bars) / 2**0.5 if len(bars) else np.zeros(60), atol=1e-12)
    assert persistence_landscape(torch.tensor(bars), 3, 20).shape == (3, 20)
    with pytest.raises(InputError, match="is empty or none"):
        persistence_landscape(bars, span=(1.0, 1.0))


def test_a_plot_shows_every_bar():
    import matplotlib.pyplot as plt

    diagrams = alpha_persistence(cloud(), infinite=True)
    axes = plot_diagram(diagrams, plt.figure().subplots())
    assert [len(each.get_offsets()) for each in axes.collections] == [len(each) for each in diagrams]
    assert plot_diagram([], plt.figure().subplots()).get_legend() is None
    for wrong in (diagrams[1], None, 3):
        with pytest.raises(InputError, match="give a list of diagrams"):
            plot_diagram(wrong)
    plt.close("all")


@pytest.mark.parametrize("order", (1, 2, 10))
def test_wasserstein_of_high_orders_nears_the_bottleneck_at_any_scale(order):
    draws = np.random.default_rng(0)
    a, b = (np.sort(draws.random((n, 2)), axis=1) for n in (50, 60))
    for scale in (1e-200, 1.0, 1e200):
        distance, least = wasserstein(scale * a, scale * b, order), bottleneck(scale * a, scale * b)
        assert least * (1 - 1e-9) <= distance <= least * 110 ** (1 / order) * (1 + 1e-9)
