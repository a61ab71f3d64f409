"""The verdict rule and the claims on hand-made rows and on the paper's own per-seed values."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from paper_artifact.claims import Claims, mean_text, order_claims, side, size_claims
from paper_artifact.errors import InputError
from paper_artifact.results import published
from paper_artifact.verdict import arms, below, chance_below, ratio_interval, verdicts, welch

# Of Tables S7 and S10, the paper's verdicts: Table 2, the text of §5.1 (cube; two spheres tied).
OUTCOMES = dict.fromkeys(("spot", "bob", "fandisk", "pot", "eight", "armadillo", "horse", "cube"), "pass")
OUTCOMES |= {"bowl_narrow": "pass", "bowl_wide": "pass"}
OUTCOMES |= {"rocker-arm": "no effect", "two_spheres": "tied by control"}


def rows(shape: str, chamfer: dict | None = None, **tails: tuple) -> pd.DataFrame:
    return pd.DataFrame(
        {"shape": shape, "condition": condition, "seed": seed, "tail": tail}
        | ({"chamfer": chamfer[condition]} if chamfer else {})
        for condition, values in tails.items()
        for seed, tail in enumerate(values)
    )


@pytest.fixture(scope="module")
def per_seed():
    return (
        published("S7", "S10", quantity="tail_bottleneck")
        .dropna(subset="seed")
        .rename(columns={"value": "tail"})
    )


def test_published_per_seed_values_give_the_papers_verdicts(per_seed):
    judged = verdicts(per_seed)
    assert judged["outcome"].to_dict() == OUTCOMES
    for shape, ratio in (("fandisk", 10.4), ("armadillo", 4.1), ("rocker-arm", 0.96), ("cube", 7.9)):
        assert judged.loc[shape, "ratio"] == pytest.approx(ratio, abs=0.06)


def test_means_are_the_papers(per_seed):
    table = arms(per_seed)
    bob = table.loc[("bob", "C1")]
    assert mean_text(bob["mean"], bob["sd"]) == ".0208±.0008"
    assert bob["ratio"] == pytest.approx(2.05, abs=0.01)
    assert (bob["seeds"], bob["low"], bob["high"]) == (3, 0.0200, 0.0216)
    assert table["ratio"].xs("C0", level="condition").isna().all()


def test_welch_only_with_five_seeds_and_equal_to_scipys():
    a, b = np.random.default_rng(0).random((2, 5))
    assert welch(a, b) == pytest.approx(stats.ttest_ind(a, b, equal_var=False).statistic, rel=1e-12)
    assert math.isnan(welch(a[:4], b)) and math.isnan(welch([1.0] * 5, [2.0] * 5))
    # The paper's sphere: .0623±.0063 against .0156±.0013, five seeds each, is 16.2 sigma.
    unit = np.array([-1, -0.5, 0, 0.5, 1]) / np.std([-1, -0.5, 0, 0.5, 1], ddof=1)
    tails = {"C0": tuple(0.0623 + 0.0063 * unit), "C1": tuple(0.0156 + 0.0013 * unit), "C2": (0.1372,) * 5}
    judged = verdicts(rows("sphere", **tails)).loc["sphere"]
    assert judged["welch"] == pytest.approx(16.2, abs=0.05) and judged["outcome"] == "pass"


def test_chance_is_scipys_exact_test_and_the_same_for_three_and_five_seeds():
    draws = np.random.default_rng(1)
    for n, m in ((3, 3), (5, 5), (3, 5), (4, 6)):
        for _ in range(20):
            a, b = draws.random(n), draws.random(m) + 0.3
            exact = stats.mannwhitneyu(a, b, alternative="less", method="exact").pvalue
            assert chance_below(a, b) == pytest.approx(exact, rel=1e-12)
    assert below((1, 2, 3), (4, 5, 6)) and not below((1, 2, 4), (3, 5, 6))  # the paper's rule
    assert below((1, 2, 3, 4, 6), (5, 7, 8, 9, 10)) and not below((1, 1, 1), (1, 1, 1))
    # How often two equal arms pass, by all arrangements: one in 20 for three seeds, for five at most.
    for seeds, most in ((3, 1 / 20), (5, 1 / 20)):
        equal = [below(*draws.random((2, seeds))) for _ in range(4000)]
        assert 0.6 * most < np.mean(equal) < 1.3 * most


def test_interval_of_the_ratio_covers_it_and_is_one_value_for_pinned_arms():
    draws, covered = np.random.default_rng(2), 0
    for k in range(200):
        low, high = ratio_interval(draws.normal(0.06, 0.006, 5), draws.normal(0.02, 0.002, 5), f"{k}")
        covered += low <= 3.0 <= high
    assert 160 <= covered <= 195  # percentile intervals of five seeds are somewhat narrow
    assert ratio_interval(np.full(3, 0.06), np.full(3, 0.02)) == pytest.approx((3.0, 3.0))


GOOD = {"C0": (0.06, 0.07, 0.05), "C1": (0.01, 0.02, 0.015), "C2": (0.1, 0.1, 0.1)}


@pytest.mark.parametrize(
    ("outcome", "changes"),
    [
        ("pass", {}),
        ("no effect", {"C1": (0.01, 0.02, 0.055)}),
        ("worse", {"C1": (0.08, 0.09, 0.085)}),
        ("tied by control", {"C2": (0.02, 0.03, 0.04)}),
        ("tied by control", {"C2g": (0.012, 0.02, 0.03)}),  # every control that was run must be beaten
        ("beaten by control", {"C2": (0.001, 0.002, 0.003)}),
        ("saturated", {"C0": (0.03,) * 3, "C1": (0.03,) * 3, "C2": (0.03,) * 3}),
        ("negligible", {"C0": (0.0201, 0.0202, 0.0203), "C1": (0.019, 0.0195, 0.02)}),
        ("tied by control", {"C2": (0.0201, 0.0202, 0.0203), "C1": (0.019, 0.0195, 0.02)}),
        ("incomplete", {"C1": (0.01, 0.02)}),  # by chance one in ten
    ],
)
def test_every_outcome(outcome, changes):
    assert verdicts(rows("x", **GOOD | changes)).loc["x", "outcome"] == outcome


@pytest.mark.parametrize("missing", ["C0", "C1", "C2"])
def test_a_missing_arm_is_named(missing):
    tails = {name: values for name, values in GOOD.items() if name != missing}
    judged = verdicts(rows("x", **tails)).loc["x"]
    assert judged["outcome"] == "incomplete" and missing in judged["reason"]


def test_chamfer_parity_is_115_percent_of_the_baselines_mean():
    for chamfer, outcome in ((0.01149, "pass"), (0.01151, "parity failed")):
        judged = verdicts(rows("x", {"C0": 0.01, "C1": chamfer, "C2": 0.02}, **GOOD)).loc["x"]
        assert judged["outcome"] == outcome and judged["chamfer_ratio"] == pytest.approx(chamfer / 0.01)
    unknown = verdicts(rows("x", **GOOD)).loc["x"]
    assert math.isnan(unknown["chamfer_ratio"]) and "unknown" in unknown["reason"]
    for lost in ("C0", "C1"):  # measured, and not finite: no parity, so no pass
        chamfer = {"C0": 0.01, "C1": 0.01, "C2": 0.02} | {lost: None}
        judged = verdicts(rows("x", chamfer, **GOOD)).loc["x"]
        assert judged["outcome"] == "incomplete" and "Chamfer that is not finite" in judged["reason"]
        worse = GOOD | {"C1": (0.08, 0.09, 0.085)}
        assert verdicts(rows("x", chamfer, **worse)).loc["x", "outcome"] == "worse", "whatever the Chamfer"


def test_another_loss_is_judged_and_a_seed_twice_is_refused():
    assert verdicts(rows("x", **GOOD, C8=(0.001, 0.002, 0.003)), loss="C8").loc["x", "outcome"] == "pass"
    with pytest.raises(InputError, match="x C0 has seed 0 twice"):
        verdicts(pd.concat([rows("x", **GOOD)] * 2))
    assert verdicts(rows("x", **GOOD).iloc[:0]).empty
    assert verdicts(pd.DataFrame()).empty and arms(pd.DataFrame()).empty
    for table in (arms, verdicts):
        with pytest.raises(InputError, match="no column tail; give rows"):
            table(rows("x", **GOOD).drop(columns="tail"))


def test_sides_of_two_arms():
    assert side(0.02, 0.001, 0.03, 0.002) == -1
    assert side(0.03, 0.01, 0.02, 0.001) == side(0.5, math.nan, 0.4, 0.1) == 0
    assert side(0.0249, 0.0, 0.0248, 0.0) == 0, "the last printed digit"
    made = rows("cube", C0=(0.06, 0.0601, 0.0602), C1=(0.01, 0.0101, 0.0102), C2=(0.05, 0.0501, 0.0502))
    paper = published("1", quantity="tail_bottleneck")
    first, second = order_claims(arms(made), paper, [("C1", "C0"), ("C2", "C0")])
    assert (first[3], second[3]) == (True, False), "the paper's control is above the baseline"
    assert ".0101±.0001 below .0601±.0001" in first[1] and ".1346 above .0582" in second[2]
    sizes = {what: holds for what, _, _, holds in size_claims(arms(made), paper)}
    assert sizes["cube: size of C0"] and not sizes["cube: size of C1"]
    (lost,) = order_claims(arms(made.query("condition != 'C2'")), paper, [("C2", "C0")])
    assert lost[1] == "not recorded" and lost[3] is None


def test_claims_are_written_once_and_their_items_exist(tmp_path):
    claims = Claims("06_c_matrix")
    claims.path = tmp_path / "claims.csv"
    assert claims.add("Table 1", "a", 1, 2, False) is False
    assert claims.add("Fig. S3", "b", "x", "x", None) is None
    assert claims.table()["holds"].tolist() == ["no", "not recorded"]
    before = claims.path.stat().st_mtime_ns
    claims.table()
    assert claims.path.stat().st_mtime_ns == before, "the same text is not written again"
    with pytest.raises(InputError, match="no item 'Table 9'"):
        claims.add("Table 9", "a", 1, 1, True)


def test_many_seeds_are_decided_and_a_tail_that_is_not_finite_is_not():
    low, high = np.arange(20.0), np.arange(20.0) + 20.5
    assert chance_below(low, high) == 1 / math.comb(40, 20)
    lost = verdicts(rows("x", **GOOD | {"C0": (math.nan, 0.07, 0.05)})).loc["x"]
    assert lost["outcome"] == "incomplete" and lost["reason"] == "C0 has a tail that is not finite"
