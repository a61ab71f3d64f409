"""Matching against brute force and gudhi's Wasserstein distance; recruitment against the paper's equation."""

from __future__ import annotations

import itertools

import gudhi.hera
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

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


@pytest.mark.parametrize("components", [False, True])
@pytest.mark.parametrize("live_count, target_count", [(0, 0), (0, 2), (3, 0), (1, 1), (3, 4), (5, 3)])
def test_cost_equals_brute_force_on_the_papers_equation(live_count, target_count, components):
    for seed in range(3):
        generator = np.random.default_rng(seed)
        live, target = random_bars(generator, live_count), random_bars(generator, target_count)
        if components:  # births of 0, as in dimension 0
            live, target = live - live[:, :1], target - target[:, :1]
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
    assert recruit(pool, missing).tolist() == [[0, 1], [1, 0]]
    # Greedy, not optimal: .50 takes .48 and leaves .60 for .45 (.0229 in all); the other way costs .0109.
    pool, missing = np.array([[0.0, 0.60], [0.0, 0.48]]), np.array([[0.0, 0.45], [0.0, 0.50]])
    assert recruit(pool, missing).tolist() == [[1, 1], [0, 0]]
    assert recruit(pool[:1], missing).tolist() == [[0, 1]]
    assert recruit(np.zeros((0, 2)), missing).tolist() == []
    assert pool.tolist() == [[0.0, 0.60], [0.0, 0.48]]  # not changed


@pytest.mark.parametrize("components", [False, True])
def test_a_large_matching_costs_what_the_augmented_problem_does(components):
    """Hundreds of bars, against the (n+m) × (m+n) assignment that has every bar's copy on the diagonal."""
    generator = np.random.default_rng(0)
    live, target = random_bars(generator, 220), random_bars(generator, 220)
    if components:  # births of 0, as in dimension 0
        live, target = live - live[:, :1], 1.5 * (target - target[:, :1])
    n, m = len(live), len(target)
    alone = [PAPER_DIAGONAL * (bars[:, 1] - bars[:, 0]) ** 2 for bars in (live, target)]
    cost = np.full((n + m, m + n), 1e3)
    cost[:n, :m], cost[n:, m:] = pair_costs(live, target), 0.0
    cost[np.arange(n), m + np.arange(n)] = alone[0]
    cost[n + np.arange(m), np.arange(m)] = alone[1]
    rows, columns = linear_sum_assignment(cost)
    found = match_bars(live, target)
    assert found.cost == pytest.approx(cost[rows, columns].sum(), rel=1e-12)
    pairs = {(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if i < n and j < m}
    assert {tuple(pair) for pair in found.matched.tolist()} == pairs and 100 < len(pairs) < 220
