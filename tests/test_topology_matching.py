"""Matching against brute force and gudhi's Wasserstein distance; recruitment against the paper's equation."""

from __future__ import annotations

import itertools

import gudhi.hera
import numpy as np
import pytest

from paper_artifact.topology.matching import PAPER_DIAGONAL, match_bars, pair_costs, recruit


def random_bars(generator, count):
    births = generator.random(count) * 0.2
    return np.column_stack([births, births + 0.01 + generator.random(count) * 0.3])


def brute_force(live, target, factor):
    """The cheapest partial matching, over all injections of subsets."""

    def alone(bars):
        return factor * (bars[:, 1] - bars[:, 0]) ** 2

    best = np.inf
    costs = pair_costs(live, target)
    for size in range(min(len(live), len(target)) + 1):
        for rows in itertools.combinations(range(len(live)), size):
            for columns in itertools.permutations(range(len(target)), size):
                total = costs[list(rows), list(columns)].sum()
                total += np.delete(alone(live), rows).sum() + np.delete(alone(target), columns).sum()
                best = min(best, total)
    return best


@pytest.mark.parametrize("live_count, target_count", [(0, 0), (0, 2), (3, 0), (1, 1), (3, 4), (5, 3)])
def test_cost_equals_brute_force_on_the_papers_equation(live_count, target_count):
    for seed in range(4):
        generator = np.random.default_rng(seed)
        live, target = random_bars(generator, live_count), random_bars(generator, target_count)
        found = match_bars(live, target)
        assert found.cost == pytest.approx(brute_force(live, target, PAPER_DIAGONAL), rel=1e-10, abs=1e-15)
        recomputed = pair_costs(live, target)[found.matched[:, 0], found.matched[:, 1]].sum()
        for bars, left in ((live, found.unmatched_live), (target, found.unmatched_target)):
            recomputed += (((bars[left, 1] - bars[left, 0]) / 2) ** 2).sum()
        assert found.cost == pytest.approx(recomputed, rel=1e-12, abs=1e-15)
        assert sorted([*found.matched[:, 0], *found.unmatched_live]) == list(range(live_count))
        assert sorted([*found.matched[:, 1], *found.unmatched_target]) == list(range(target_count))


def test_equals_gudhi_wasserstein_with_its_diagonal_and_is_within_two_of_it_with_the_papers():
    """The Euclidean ground metric puts the diagonal (d - b)²/2 away: that is W2; half is the paper's."""
    for seed in range(5):
        generator = np.random.default_rng(seed)
        live, target = random_bars(generator, 12), random_bars(generator, 7)
        w2 = gudhi.hera.wasserstein_distance(live, target, order=2, internal_p=2, delta=1e-9) ** 2
        assert match_bars(live, target, diagonal_factor=0.5).cost == pytest.approx(w2, rel=1e-7)
        assert w2 / 2 <= match_bars(live, target).cost <= w2 * (1 + 1e-12)


def test_bars_far_from_every_target_go_to_the_diagonal():
    found = match_bars(np.array([[0.0, 0.01]]), np.array([[0.1, 0.9]]))
    assert len(found.matched) == 0
    assert list(found.unmatched_live) == [0] and list(found.unmatched_target) == [0]


def test_recruitment_is_greedy_by_decreasing_persistence_without_replacement():
    pool = np.array([[0.0, 0.30], [0.0, 0.10]])
    missing = np.array(
        [[0.0, 0.25], [0.0, 0.50]]
    )  # the second, more persistent, chooses first and takes the bar at .30
    assert recruit(pool, missing) == [(0, 1), (1, 0)]
    # Greedy, not optimal: .50 takes .48 and leaves .60 for .45 (.0229 in all); the other way costs .0109.
    pool, missing = np.array([[0.0, 0.60], [0.0, 0.48]]), np.array([[0.0, 0.45], [0.0, 0.50]])
    assert recruit(pool, missing) == [(1, 1), (0, 0)]
    assert recruit(pool[:1], missing) == [(0, 1)]
    assert recruit(np.zeros((0, 2)), missing) == []
