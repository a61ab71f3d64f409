"""Prune and split: the budget against an independent visible-pixel count, the split's geometry, schedule."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from paper_artifact.config import AllocationConfig, RunConfig
from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.raster import twin
from paper_artifact.soup.resample import Resampler, visible_pixels
from paper_artifact.soup.split import least_pieces, split_long_edges
from paper_artifact.soup.state import Soup, initial_mlp
from tests.raster_cases import cameras, look_at
from tests.raster_cases import soup as random_soup

HEIGHT = 40


def resampler(budget: int, **settings) -> Resampler:
    """The resampler of a run of 100 steps."""
    return Resampler(RunConfig("x", budget=budget, dump_steps=(), **{"steps": 100, **settings}))


def case(seed: int = 0, count: int = 60, size: float = 0.3) -> Soup:
    """Return a random soup whose features and opacity logits tell of which triangle and corner they are."""
    parts = random_soup(seed, count, size)
    features = torch.arange(count * 21, dtype=torch.float32).reshape(count, 3, 7) / (count * 21)
    return Soup(
        parts["vertices"].float(), features, torch.logit(parts["opacity"]).float(), initial_mlp(seed)
    ).trainable()


def views(count: int = 5) -> np.ndarray:
    return cameras(3, count).numpy().astype(np.float32)


def independent_counts(soup: Soup, world_to_clip: np.ndarray, height: int, width: int) -> np.ndarray:
    """Visible pixels per triangle, summed over the views, from the float64 twin."""
    vertices, opacity = soup.vertices.detach().double(), torch.sigmoid(soup.opacity.detach().double())
    matrices = torch.from_numpy(world_to_clip).double()
    raster = twin.rasterize(vertices, opacity, matrices, height, width, None)
    return np.bincount(raster.triangle.numpy().ravel(), minlength=len(soup) + 1)[1:]


def areas(corners: np.ndarray) -> np.ndarray:
    corners = np.asarray(corners, np.float64)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def screen(corners: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """NDC x and y (T,3,2) and whether the corner is in the clip cube (T,3)."""
    homogeneous = np.concatenate([np.asarray(corners, np.float64), np.ones((*corners.shape[:2], 1))], -1)
    clip = homogeneous @ np.asarray(matrix, np.float64).T
    ndc = clip[..., :3] / clip[..., 3:]
    return ndc[..., :2], (clip[..., 3] > 0) & (np.abs(ndc) <= 1).all(-1)


def edge_lengths(corners: np.ndarray, matrix: np.ndarray, aspect: float) -> np.ndarray:
    """Screen lengths (T,3) in NDC, x scaled by `aspect`; 0 where an end is outside the clip cube."""
    position, inside = screen(corners, matrix)
    difference = (position - np.roll(position, -1, axis=1)) * (aspect, 1.0)
    return np.where(inside & np.roll(inside, -1, axis=1), np.linalg.norm(difference, axis=-1), 0.0)


def split(corners: np.ndarray, wanted, matrix: np.ndarray, aspect: float = 1.0, limit: float = 0.4):
    corners, matrix = np.ascontiguousarray(corners), np.asarray(matrix, np.float64)
    return split_long_edges(corners, np.arange(len(corners)), wanted, matrix, aspect, limit)


def test_pruning_keeps_the_most_visible_in_their_order():
    soup, world_to_clip = case(), views()
    budget = 25
    kept, report = resampler(budget).resample(soup, world_to_clip, HEIGHT, HEIGHT, 99)  # of 100: no split
    assert (report["before"], report["pruned"], report["after"]) == (60, budget, budget)
    assert len(kept) == budget

    counts = independent_counts(soup, world_to_clip, HEIGHT // 2, HEIGHT // 2)
    order = sorted(range(len(soup)), key=lambda t: (counts[t], t))  # the least visible first, ties by index
    wanted = sorted(order[len(soup) - budget :])
    assert counts[wanted].min() >= max(counts[t] for t in range(len(soup)) if t not in wanted)
    for before, after in zip(soup.tensors()[:3], kept.tensors()[:3], strict=True):
        assert torch.equal(after, before[wanted])
        assert after.is_leaf and after.requires_grad
    assert kept.mlp is soup.mlp


def test_visible_pixels_are_those_of_the_twin_up_to_rounding_at_edges():
    soup, world_to_clip = case(1), views()
    mine = visible_pixels(soup, world_to_clip, 32, 32)
    assert mine.shape == (5, 60)
    theirs = independent_counts(soup, world_to_clip, 32, 32)
    assert np.abs(mine.sum(0) - theirs).sum() <= 2 and theirs.sum() > 300


def test_within_the_budget_nothing_is_pruned_and_the_schedule_is_the_papers():
    soup = case()
    kept, report = resampler(60).resample(soup, views(), HEIGHT, HEIGHT, 99)
    assert kept is soup and report["pruned"] == 60
    whole, short = Resampler(RunConfig("x")), resampler(9, steps=60, resample_every=10)
    assert [step for step in range(1, 2501) if whole.due(step)] == list(range(100, 2301, 100))
    assert [step for step in range(1, 61) if short.due(step)] == [10, 20, 30, 40, 50]


def test_the_last_resamplings_prune_but_do_not_split():
    soup = case(2, size=1.0)
    small = resampler(40, split_height=0.1)
    split_soup, report = small.resample(soup, views(), HEIGHT, HEIGHT, 94)
    assert report["pruned"] == 40 and report["after"] == len(split_soup) > 40
    assert len(small.resample(soup, views(), HEIGHT, HEIGHT, 95)[0]) == 40


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 2.0), st.floats(0.15, 0.8), st.floats(0.5, 2.0))
def test_split_invariants(seed, size, limit, aspect):
    corners = random_soup(seed, 12, size)["vertices"].numpy()
    matrix = look_at(stream(seed, "split camera").normal(size=3) * 2 + (0, 0, 4))
    wanted = stream(seed, "wanted").random(12) < 0.7
    children, origins = split(corners, wanted, matrix, aspect, limit)
    # No edge of a wanted triangle stays longer than the limit; the others are as they were.
    assert (edge_lengths(children, matrix, aspect)[wanted[origins]] <= limit * (1 + 1e-9)).all()
    for t in np.flatnonzero(~wanted):
        assert (origins == t).sum() == 1 and np.array_equal(children[t], corners[t])
    # Every parent's area is its children's.
    assert np.array_equal(np.unique(origins), np.arange(12))
    np.testing.assert_allclose(np.bincount(origins, areas(children)), areas(corners), rtol=1e-9)
    # The union too: each child lies in its parent, facing the same way; with equal areas they tile it.
    for child, origin in zip(children, origins, strict=True):
        a, b, c = corners[origin]
        weights = np.linalg.lstsq(np.stack([b - a, c - a], 1), (child - a).T, rcond=None)[0].T
        np.testing.assert_allclose(a + weights @ np.stack([b - a, c - a]), child, atol=1e-9)
        assert weights.min() > -1e-6 and weights.sum(1).max() < 1 + 1e-6
        assert np.cross(child[1] - child[0], child[2] - child[0]) @ np.cross(b - a, c - a) > 0


def test_the_split_point_is_the_midpoint_in_the_image_not_in_space():
    matrix = look_at((0.0, 0.0, -4.0))
    corners = np.array([[[-0.6, 0.0, -1.5], [0.7, 0.1, 1.5], [0.0, 0.2, 0.0]]])
    lengths = edge_lengths(corners, matrix, 1.0)[0]
    children, origins = split(corners, np.array([True]), matrix, limit=0.99 * lengths.max())
    assert len(children) == 2 and lengths.argmax() == 0 and origins.tolist() == [0, 0]
    (a, middle, c), (again, b, c2) = children
    assert np.array_equal(a, corners[0, 0]) and np.array_equal(b, corners[0, 1])
    assert np.array_equal(c, corners[0, 2]) and np.array_equal(c2, c) and np.array_equal(again, middle)
    position = screen(corners, matrix)[0][0]
    np.testing.assert_allclose(screen(middle[None, None], matrix)[0][0, 0], position[:2].mean(0), atol=1e-12)
    assert np.linalg.norm(middle - corners[0, :2].mean(0)) > 0.1
    # On the edge itself: its cross product with the edge vanishes.
    np.testing.assert_allclose(np.cross(middle - a, b - a), 0, atol=1e-12)


def test_an_edge_with_an_end_outside_the_clip_cube_is_left_alone():
    matrix = look_at((0.0, 0.0, -4.0))
    beside, along = [[-9, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 0, -9], [0.2, 0, 9], [0, 0.2, -9]]
    outside = np.array([beside, along], float)
    children, origins = split(outside, np.ones(2, bool), matrix)
    assert np.array_equal(children, outside) and origins.tolist() == [0, 1]


def test_many_splits_outgrow_the_first_buffer():
    corners = np.array([[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]], np.float32)
    children, origins = split(corners, np.array([True]), look_at((0.0, 0.0, -4.0)), limit=0.05)
    assert len(children) > 500 and not origins.any() and children.dtype == np.float32
    assert areas(children).sum() == pytest.approx(2.0, rel=1e-5)


def test_children_inherit_features_and_opacity():
    soup, world_to_clip = case(4, size=0.4), views()
    drawing = resampler(60, seed=7, split_views=3, split_height=0.25)
    after, report = drawing.resample(soup, world_to_clip, HEIGHT, 2 * HEIGHT, 10)
    assert report["after"] == len(after) > report["pruned"] == 60
    # Features name their triangle: their first entry, times what `case` divided by.
    origins = np.rint(after.features[:, 0, 0].detach().numpy() * 60 * 21 / 21).astype(int)
    assert torch.equal(after.features, soup.features[origins])
    assert torch.equal(after.opacity, soup.opacity[origins])
    # Split are exactly the triangles that show an edge above the limit, 2·.25 in NDC, in a drawn view that
    # sees them.
    drawn = world_to_clip[stream(7, "split-views", 10).permutation(5)[:3]]
    seen = visible_pixels(soup, drawn, HEIGHT // 2, HEIGHT) > 0
    corners, children = soup.vertices.detach().numpy(), after.vertices.detach().numpy()
    np.testing.assert_allclose(np.bincount(origins, areas(children)), areas(corners), rtol=1e-3, atol=1e-6)
    longest = np.stack([edge_lengths(corners, matrix, 2.0).max(1) for matrix in drawn])
    long = longest > 0.5
    assert np.array_equal(np.bincount(origins) > 1, (long & seen).any(0)) and (long & ~seen).any()
    assert (~long & seen).any()
    reach = np.where(seen, longest, 0.0).max(0)
    assert ((reach > 0.26) & (reach < 0.5)).any()  # so that half the limit would split more
    # The last view has the last word on those it sees.
    assert (edge_lengths(children, drawn[-1], 2.0)[seen[-1][origins]] <= 0.5 * (1 + 1e-5)).all()
    assert (long & seen)[-1].any()


def test_no_split_views_beyond_those_there_are_and_the_same_seed_gives_the_same_bits():
    soup = case(5, size=1.0)
    first, second, other = (
        resampler(60, seed=1, split_views=count).resample(soup, views(), HEIGHT, HEIGHT, 10)[0]
        for count in (50, 50, 1)
    )
    assert torch.equal(first.vertices, second.vertices) and len(other) < len(first)


def test_importance_decides_the_order_of_pruning():
    soup, prior = case(), AllocationConfig(protection=1e6, subdivided=0.0)
    config = RunConfig("x", steps=100, dump_steps=(), budget=10, allocation=prior)
    made = Resampler(config, importance=lambda points: 1 - np.arange(len(points)) / 60)
    kept, _ = made.resample(soup, views(), HEIGHT, HEIGHT, 99)
    assert torch.equal(kept.vertices, soup.vertices[:10])


def test_a_split_beyond_the_memory_is_refused_with_the_amount_before_it_is_tried(monkeypatch):
    soup, world_to_clip, limit = case(4, size=1.0), views()[:1].astype(np.float64), 0.05
    where = (np.ones(60, bool), world_to_clip[0], 1.0, limit)
    corners, _ = split_long_edges(soup.vertices.detach().numpy(), np.arange(60), *where)
    least = least_pieces(soup.vertices.detach().numpy(), *where)
    assert 60 < least <= len(corners) < 20 * least
    monkeypatch.setattr("paper_artifact.soup.resample.split_long_edges", None)  # calling it would fail
    with pytest.raises(InputError, match=r"longer than 0.0001 .* at least .* GiB of memory, .* available"):
        resampler(60, split_height=1e-4).resample(soup, views(), HEIGHT, HEIGHT, 10)
