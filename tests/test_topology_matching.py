"""Matching against the augmented assignment and gudhi's Wasserstein distance; recruitment against the paper's
equation."""

import gudhi.hera
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from paper_artifact.topology.matching import PAPER_DIAGONAL, match_bars, pair_costs, recruit


def random_bars(generator, count):
    births = generator.random(count) * 0.2
    return np.column_stack([births, births + 0.01 + generator.random(count) * 0.3])


def augmented(live, target):
    """The least cost and its pairs, by the (n+m) × (m+n) assignment with every bar's copy on the diagonal."""
    n, m = len(live), len(target)
    alone = [PAPER_DIAGONAL * (bars[:, 1] - bars[:, 0]) ** 2 for bars in (live, target)]
    cost = np.full((n + m, m + n), 1e3)
    cost[:n, :m], cost[n:, m:] = pair_costs(live, target), 0.0
    cost[np.arange(n), m + np.arange(n)] = alone[0]
    cost[n + np.arange(m), np.arange(m)] = alone[1]
    rows, columns = linear_sum_assignment(cost)
    pairs = {(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if i < n and j < m}
    return cost[rows, columns].sum(), pairs


@pytest.mark.parametrize("components", [False, True])
@pytest.mark.parametrize(
    "live_count, target_count", [(0, 0), (0, 2), (3, 0), (1, 1), (3, 4), (5, 3), (220, 220)]
)
def test_cost_and_pairs_are_those_of_the_augmented_problem(live_count, target_count, components):
    for seed in range(3):
        generator = np.random.default_rng(seed)
        live, target = random_bars(generator, live_count), random_bars(generator, target_count)
        if components:  # births of 0, as in dimension 0
            live, target = live - live[:, :1], 1.5 * (target - target[:, :1])
        found = match_bars(live, target)
        cost, pairs = augmented(live, target)
        assert found.cost == pytest.approx(cost, rel=1e-10, abs=1e-15)
        assert {tuple(pair) for pair in found.matched.tolist()} == pairs
        assert live_count < 220 or 100 < len(pairs) < 220
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
    missing = np.array([[0.0, 0.25], [0.0, 0.50]])
    # The second, more persistent, chooses first and takes the bar at .30.
    assert recruit(pool, missing).tolist() == [[0, 1], [1, 0]]
    # Greedy, not optimal: .50 takes .48 and leaves .60 for .45 (.0229 in all); the other way costs .0109.
    pool, missing = np.array([[0.0, 0.60], [0.0, 0.48]]), np.array([[0.0, 0.45], [0.0, 0.50]])
    assert recruit(pool, missing).tolist() == [[1, 1], [0, 0]]
    assert recruit(pool[:1], missing).tolist() == [[0, 1]]
    assert recruit(np.zeros((0, 2)), missing).tolist() == []
    assert pool.tolist() == [[0.0, 0.60], [0.0, 0.48]]  # not changed
