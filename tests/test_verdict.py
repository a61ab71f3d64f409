"""The verdict rule on hand-made rows and on the paper's own per-seed values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from paper_artifact.errors import InputError
from paper_artifact.report.kit.frames import paper_verdicts
from paper_artifact.report.kit.text import arm_text
from paper_artifact.study.verdict import group_statistic, rows_of, verdict, welch_sigma
from tests.report_records import study_record

# Table S7 (supplement E), with the paper's verdicts: Table 2, the text of §5.1 (cube; two spheres tied).
PER_SEED = {
    "spot": ("pass", (0.0429, 0.0584, 0.0550), (0.0237,) * 3, (0.0652,) * 3),
    "bob": ("pass", (0.0429, 0.0413, 0.0437), (0.0200, 0.0207, 0.0216), (0.0437,) * 3),
    "fandisk": ("pass", (0.0540, 0.0515, 0.0559), (0.0058, 0.0055, 0.0042), (0.0571,) * 3),
    "pot": ("pass", (0.0218, 0.0223, 0.0223), (0.0059, 0.0056, 0.0056), (0.0223,) * 3),
    "rocker-arm": ("no effect", (0.0088, 0.0082, 0.0079), (0.0090, 0.0070, 0.0100), (0.0112, 0.0112, 0.0115)),
    "eight": ("pass", (0.0249,) * 3, (0.0169, 0.0175, 0.0142), (0.0249,) * 3),
    "armadillo": ("pass", (0.0511,) * 3, (0.0124, 0.0125, 0.0123), (0.0511,) * 3),
    "horse": ("pass", (0.0408,) * 3, (0.0124, 0.0083, 0.0118), (0.0408,) * 3),
    "cube": ("pass", (0.0560, 0.0551, 0.0636), (0.0071, 0.0064, 0.0086), (0.1346,) * 3),
    "two_spheres": (
        "tied by control",
        (0.0060, 0.0074, 0.0062),
        (0.0007, 0.0009, 0.0005),
        (0.0009, 0.0009, 0.0006),
    ),
    "bowl_narrow": ("pass", (0.0619, 0.0550, 0.0593), (0.0137, 0.0126, 0.0151), (0.1249,) * 3),
    "bowl_wide": ("pass", (0.0448, 0.0602, 0.0630), (0.0141, 0.0136, 0.0135), (0.0770,) * 3),
    "double_torus": ("saturated", (0.0264,) * 5, (0.0264,) * 5, (0.0264,) * 5),
}


def rows(shape: str, chamfer: dict | None = None, **arms: tuple) -> list[dict]:
    return [
        {"shape": shape, "condition": condition, "seed": seed, "tail": tail}
        | ({"chamfer": chamfer[condition]} if chamfer else {})
        for condition, tails in arms.items()
        for seed, tail in enumerate(tails)
    ]


def per_seed_rows() -> list[dict]:
    return [row for shape, (_, c0, c1, c2) in PER_SEED.items() for row in rows(shape, C0=c0, C1=c1, C2=c2)]


def test_published_per_seed_values_give_the_papers_verdicts():
    judged = verdict(per_seed_rows())
    assert {shape: each.outcome for shape, each in judged.items()} == {
        shape: values[0] for shape, values in PER_SEED.items()
    }
    assert (
        sum(judged[shape].passed for shape in list(PER_SEED)[:8]) == 7
    )  # seven of the eight external meshes
    assert not judged["rocker-arm"].below["C0"] and not judged["two_spheres"].disjoint["C2"]


def test_published_means_ratios_and_groups_are_reproduced():
    judged = verdict(per_seed_rows())
    assert (
        arm_text(judged["bob"].arms["C1"].mean, judged["bob"].arms["C1"].sd, judged["bob"].ratio)
        == ".0208±.0008 (2.05×)"
    )
    for shape, ratio in (
        ("fandisk", 10.4),
        ("armadillo", 4.1),
        ("rocker-arm", 0.96),
        ("cube", 7.9),
        ("bowl_wide", 4.1),
    ):
        assert judged[shape].ratio == pytest.approx(ratio, abs=0.06)
    loops = group_statistic(judged, ("bob", "rocker-arm", "eight"))
    voids = group_statistic(judged, ("spot", "fandisk", "pot", "armadillo", "horse"))
    assert loops == (pytest.approx(1.52, abs=0.01), pytest.approx(0.55, abs=0.01), 2)
    assert voids == (pytest.approx(4.87, abs=0.02), pytest.approx(3.17, abs=0.03), 5)
    with pytest.raises(InputError, match="missing: torus"):
        group_statistic(judged, ("bob", "torus"))


def test_welch_sigma_only_with_five_seeds_and_equal_to_scipys():
    a, b = np.random.default_rng(0).random((2, 5))
    assert welch_sigma(a, b) == pytest.approx(stats.ttest_ind(a, b, equal_var=False).statistic, rel=1e-12)
    assert welch_sigma(a[:4], b) is None and welch_sigma([1.0] * 5, [2.0] * 5) is None
    # The paper's sphere: .0623±.0063 against .0156±.0013, five seeds each, is 16.2 sigma.
    unit = np.array([-1, -0.5, 0, 0.5, 1]) / np.std([-1, -0.5, 0, 0.5, 1], ddof=1)
    judged = verdict(
        rows("sphere", C0=tuple(0.0623 + 0.0063 * unit), C1=tuple(0.0156 + 0.0013 * unit), C2=(0.1372,) * 5)
    )["sphere"]
    assert judged.welch["C0"] == pytest.approx(16.2, abs=0.05) and judged.passed
    assert verdict(rows("sphere", C0=(0.06,) * 3, C1=(0.01, 0.02, 0.03), C2=(0.1,) * 3))["sphere"].welch == {}


def test_every_outcome():
    good = {"C0": (0.06, 0.07, 0.05), "C1": (0.01, 0.02, 0.015), "C2": (0.1, 0.1, 0.1)}
    cases = {
        "pass": good,
        "no effect": {**good, "C1": (0.01, 0.02, 0.055)},
        "worse": {**good, "C1": (0.08, 0.09, 0.085)},
        "tied by control": {**good, "C2": (0.02, 0.03, 0.04)},
        "beaten by control": {**good, "C2": (0.001, 0.002, 0.003)},
        "saturated": {"C0": (0.03,) * 3, "C1": (0.03,) * 3, "C2": (0.03,) * 3},
    }
    for outcome, arms in cases.items():
        assert verdict(rows("x", **arms))["x"].outcome == outcome
    for missing in ("C0", "C1", "C2"):
        judged = verdict(rows("x", **{name: tails for name, tails in good.items() if name != missing}))["x"]
        assert judged.outcome == "incomplete" and missing in judged.reason
    gentle = verdict(rows("x", **good, C2g=(0.012, 0.02, 0.03)))["x"]
    assert (
        gentle.outcome == "tied by control" and "C2g" in gentle.reason
    )  # every control that was run must be beaten


def test_chamfer_parity_is_115_percent_of_the_baselines_mean():
    arms = {"C0": (0.06, 0.07), "C1": (0.01, 0.02), "C2": (0.1, 0.1)}
    for chamfer, parity, outcome in ((0.0115, True, "pass"), (0.01151, False, "parity failed")):
        judged = verdict(rows("x", {"C0": 0.01, "C1": chamfer, "C2": 0.02}, **arms))["x"]
        assert (judged.parity, judged.outcome) == (parity, outcome)
    unknown = verdict(rows("x", **arms))["x"]
    assert unknown.parity is None and unknown.passed and "unknown" in unknown.reason


def test_phantoms_and_missing_features_are_counted_per_seed_and_do_not_decide():
    made = rows("spot", C0=(0.06, 0.07, 0.05), C1=(0.01, 0.02, 0.015), C2=(0.1, 0.1, 0.1))
    counts = {"C0": (2, 1, 2), "C1": (1, 2, 1), "C2": (0, 0, 0)}
    for row in made:
        row |= {"count": counts[row["condition"]][row["seed"]], "expected": 1}
    judged = verdict(made)["spot"]
    assert judged.passed
    assert judged.phantoms == {"C0": (0, 2), "C1": (1,), "C2": ()} and judged.missing["C2"] == (0, 1, 2)
    del made[0]["count"]
    assert "C0" not in verdict(made)["spot"].phantoms


def test_bad_rows_are_refused():
    good = {"shape": "x", "condition": "C0", "seed": 0, "tail": 0.1}
    for change in ({"tail": math.nan}, {"tail": None}, {"tail": -1.0}, {"tail": math.inf}, {"shape": None}):
        with pytest.raises(InputError, match="finite tail"):
            verdict([good | change])
    with pytest.raises(InputError, match="seed 0 twice"):
        verdict([good, good])
    with pytest.raises(InputError, match="needs one"):
        verdict([good | {"dimension": 1}, good | {"seed": 1, "dimension": 2}])
    assert verdict([]) == {}


def test_rows_of_records():
    record = {
        "config": {"shape": "two_spheres", "condition": "C1", "seed": 2},
        "tails": {"bottleneck": [0.001, 0.2, 0.3], "counts": [1, 0, 2], "chamfer": 0.005},
        "mesh": {"dimension": 0, "betti": [2, 0, 2]},
        "bundle": {"bars": [[[0, 0.1]], [], []]},
    }
    assert rows_of([record, record | {"tails": {}}]) == [
        {
            "shape": "two_spheres",
            "condition": "C1",
            "seed": 2,
            "dimension": 0,
            "tail": 0.001,
            "chamfer": 0.005,
            "count": 1,
            "expected": 1,
        }
    ]
    assert rows_of([record | {"mesh": {"dimension": 0, "betti": None}}])[0]["expected"] == 1


def test_transcribed_tables_give_the_same_verdicts():
    """The committed transcription of the paper's per-seed tables, through the same rule."""
    judged = paper_verdicts("S7", "S10")
    expected = {shape: values[0] for shape, values in PER_SEED.items() if shape != "double_torus"}
    assert {shape: each.outcome for shape, each in judged.items()} == expected
    for shape, each in judged.items():
        assert each.arms["C1"].tails == PER_SEED[shape][2] and each.arms["C2"].tails == PER_SEED[shape][3]


def test_every_arm_of_a_shape_is_counted_against_the_same_number():
    """Betti where known, the bundle where it has more (or where Betti is unknown), also for C0, which has
    no bundle."""
    bob = [
        study_record("bob", condition, 0, 0.02) for condition in ("C0", "C1")
    ]  # no Betti numbers; two bars in its bundle
    assert [row["expected"] for row in rows_of(bob)] == [2, 2] and [
        row["expected"] for row in rows_of(bob[:1])
    ] == [None]
    disk = [record | {"mesh": record["mesh"] | {"betti": (1, 0, 0)}} for record in bob]
    assert [row["expected"] for row in rows_of(disk)] == [2, 2]
    genus_two = [record | {"mesh": record["mesh"] | {"betti": (1, 4, 1)}} for record in bob]
    assert [row["expected"] for row in rows_of(genus_two)] == [4, 4]
