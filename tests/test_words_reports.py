"""The reports on words with hand-made records, and what they measure."""

from __future__ import annotations

import numpy as np
import pytest

from paper_artifact.errors import InputError
from paper_artifact.report import demos, dirty, realism, recruitment, words, words_hurt
from paper_artifact.report.kit.records import Collected
from paper_artifact.topology import cleaned
from paper_artifact.topology.clean import projected, trimmed
from tests.report_records import study_record

BARS = (recruitment.hole_bar, recruitment.strays_bar)


def recorded(shape, arm, seed, tail, warned=(), margins=(2.0, 0.3), **changes) -> dict:
    """A record under the arm's name; of a loss in words with a first refresh and an audit."""
    record = study_record(shape, arm.partition(", ")[0], seed, tail, **changes)
    record["config"]["condition"] = arm
    if arm[0] == "T":
        dimensions = {"2": {"margins": list(margins), "wanted": 1}}
        record["topology"] = [
            {"event": "refresh", "step": 501, "samples": 2048, "dimensions": dimensions},
            {"event": "audit", "step": 501, "warnings": list(warned), "notes": []},
            {"event": "lambda", "step": 501, "lambda_peak": 0.25},
        ]
        record["statement"] = {"betti": record["config"]["loss"]["betti"], "diagonal": 1.0, "samples": 2048}
        record["timings"] = {"photometric": 10.0, "topology": 4.0, "evaluate": 3.0}
    return record


def study(**tails) -> Collected:
    """Three seeds of the sphere: {arm: tails}."""
    records = [
        recorded("sphere", arm, seed, tail) for arm, each in tails.items() for seed, tail in enumerate(each)
    ]
    return Collected(tuple(records), (("torus", "T1", 0), ("torus", "C0", 0)))


RUNS = study(
    C0=(0.06, 0.07, 0.08), C1=(0.01, 0.01, 0.02), C2=(0.1, 0.1, 0.1), T1=(0.02, 0.01, 0.03), T2=(0.07,) * 3
)


def test_words_are_judged_by_the_papers_rule():
    table = words.outcome_table(RUNS)
    assert table.loc["sphere", "T1: outcome"] == "pass" and table.loc["sphere", "T2: outcome"] == "no effect"
    assert table.loc["sphere", "words"] == "1,0,1" and table.loc["torus", "T1"] == "—"
    text = words.outcome_text(RUNS)
    assert "T1, the test: pass 1; of 1" in text and "T2, the test: no effect 1 (sphere); of 1" in text
    assert (
        "T1, devised on: not recorded" in text and "T1's range to C1's: below 0, overlaps 1, above 0" in text
    )
    rows = words.design_table(RUNS)
    assert rows.loc[("sphere", "T1"), "range to C1's"] == "overlaps"
    assert words.seconds_table(RUNS).loc[("T1", 2048), "seconds"] == "4.0"
    assert len(words.outcome_figure(RUNS).axes) == 1


def test_what_reaches_beyond_the_target_is_told():
    runs = study(C0=(0.06,), C1=(0.01,), T1=(0.02,), T2=(0.02,))
    deaths = {"C0": 0.1, "C1": 0.2, "T1": 0.25, "T2": 0.208}
    for record in runs.records:
        arm = record["config"]["condition"]
        record["dumps"] = [{"bars": [[], [], [[0.0, 0.05], [0.01, deaths[arm]]]]}]
        record["bundle"] = {"bars": [[], [], [[0.01, 0.2]]]} if arm == "C1" else None
    table = words.reach_table(Collected(runs.records, (("torus", "T1", 0),)))
    assert table.loc["sphere"].tolist() == ["0.50", "1.00", "1.25", "1.04", "T1"]
    assert set(table.loc["torus"]) == {"not recorded", ""}


def test_an_ablation_stands_beside_the_same_seeds():
    ablated = Collected(
        (recorded("sphere", "T1, pull=8.0", 0, 0.05, loss={"pull": 8.0}),), (("sphere", "T1, rho=1.0", 0),)
    )
    table = words.ablation_table(RUNS, ablated)
    assert table.loc[("sphere", "T1"), "seed by seed"] == ".0200"
    assert table.loc[("sphere", "T1, pull=8.0"), "tail"] == ".0500 (1.20×)"
    assert table.loc[("sphere", "T1, rho=1.0"), "tail"] == "not recorded"


def lies() -> Collected:
    few = {"betti": (1, 0, 0)}
    records = (
        recorded(
            "sphere", "T1, betti=(1, 0, 0)", 0, 0.04, ["you said no void; …"], loss=few, margins=(4.0, 0.1)
        ),
        recorded("sphere", "T1, betti=(1, 1, 1)", 0, 0.02, loss={"betti": (1, 1, 1)}),
    )
    records[0]["topology"][0]["dimensions"]["2"]["wanted"] = 0
    return Collected(records, (("sphere", "T2, betti=(1, 0, 2)", 0),))


def test_lies_are_told_by_kind_and_harm():
    assert words_hurt.kinds("torus", (2, 1, 1)) == ["too many components", "too few loops"]
    assert words_hurt.kinds("torus", (1, 2, 1)) == []
    table = words_hurt.lie_table(lies(), RUNS)
    few = table.loc[("sphere", "1,0,0", "T1")]
    assert (
        few["kind"] == "too few voids"
        and few["÷ true words'"] == "2.00"
        and few["the audit"] == "warned: no void"
    )
    assert few["not seen at the end"] == "—"
    unseen = recorded("sphere", "T1, betti=(1, 0, 2)", 1, 0.02, loss={"betti": (1, 0, 2)})
    unseen["topology"][0]["dimensions"]["2"]["wanted"] = 2
    table = words_hurt.lie_table(Collected((unseen,), ()), RUNS)
    assert table.loc[("sphere", "1,0,2", "T1"), "not seen at the end"] == "2 voids"
    text = words_hurt.lie_text(Collected((*lies().records, unseen), ()), RUNS)
    assert "0 of 6 runs with true words, 1 of 2 runs with too many, 0 of 1 runs with too few" in text
    harmed = "T1, too few voids: 1 of 1 runs harmed (1 beyond 1.5 times the true words' tail, worst 2.0)"
    assert f"{harmed}; warned of 1" in text
    assert "T1, too many loops: 0 of 1 runs harmed" in text
    thresholds = words_hurt.threshold_table(lies(), RUNS)
    assert thresholds.loc["warned beyond 1 floors"].tolist() == ["0 of 6", "1 of 1", "0 of 1"]
    assert thresholds.loc["longest surplus bar", "too few"] == "4.00"


def test_realism_and_the_five_lines():
    changes = {"views": 10}
    troubled = Collected(
        tuple(
            recorded("sphere", f"{arm}, views=10", seed, tail, **changes)
            for arm, tails in (("C0", (0.06, 0.08)), ("T1", (0.05, 0.05)), ("T2", (0.07, 0.09)))
            for seed, tail in enumerate(tails)
        ),
        (("sphere", "C1, views=10", 0),),
    )
    table = realism.realism_table(troubled, RUNS, "sphere")
    assert table.loc["views=10", "T1"] == ".0500 (1.4×)" and table.loc["views=10", "C1"] == "not recorded"
    assert table.loc["views=10", "T2"] == ".0800 (0.9× !)", "the ranges overlap"
    assert table.loc[realism.AS_IT_IS, "seeds"] == "2/2/2/2", "of the seeds of the troubled runs alone"
    text = realism.realism_text(troubled, RUNS)
    assert "T2, sphere: every seed below C0's under 0 of 1 troubles; in the mean alone under none; " in text
    assert "no better under views=10; beyond 1.5 times its clean tail under none" in text
    assert "T1, sphere: every seed below C0's under 1 of 1 troubles; in the mean alone under none; " in text
    assert "no better under none; beyond 1.5 times its clean tail under views=10" in text
    assert "C1, sphere: not recorded" in text
    lines = words_hurt.advice(RUNS, lies(), troubled)
    assert len(lines) == 5 and "T1 passes on 1 of 1 shapes, T2 on 0 of 1 shapes" in lines[1]
    assert "say more, not fewer: too many classes harmed 0 of 1 runs, too few 1 of 1" in lines[3]
    assert "every seed is below C0's: C1 in 0 of 0, T1 in 1 of 1, T2 in 0 of 1 cases" in lines[4]
    assert "double_torus not recorded" in lines[2] and "of 2 shapes; the mug's handle" in lines[4]
    nothing = Collected((), (("sphere", "T1", 0), ("double_torus", "T1", 0)))
    assert len(words_hurt.advice(nothing, nothing, nothing)) == 5 and words.outcome_text(nothing)


def test_recruitment_claims_the_strays_where_ranking_claims_the_hole(monkeypatch):
    monkeypatch.setattr(recruitment, "STEPS", 20)
    recruitment.descended.cache_clear()
    grown, claims = {}, {}
    for name, strays in (("C1", False), ("C1", True), ("T2", True)):
        before, after, claim = recruitment.descended(name, strays)
        grown[name, strays] = recruitment.hole_bar(after)[1] - recruitment.hole_bar(before)[1]
        claims[name, strays] = claim["strays"]
    recruitment.descended.cache_clear()
    assert claims == {("C1", False): False, ("C1", True): True, ("T2", True): False}
    assert abs(grown["C1", True]) < 0.002 < 0.004 < min(grown["C1", False], grown["T2", True])
    hole, strays = (bar(recruitment.disc(recruitment.NARROW, True)) for bar in BARS)
    assert np.ptp(hole) > np.ptp(strays)  # the strays' bar is the shorter one


def test_a_demonstration_grows_a_hole():
    own = demos.course("grow a hole")
    first, last = own.margins[0], own.margins[-1]
    assert own.reached is not None and first[0] < 0.5 < 1 < last[0] and last[1] < 0.5
    assert len(demos.strip_figure("grow a hole").axes) == demos.PICTURES
    table = demos.demo_table(["grow a hole"])
    assert table["words hold from step"].iloc[0] == own.reached and len(table) == demos.PICTURES
    with pytest.raises(InputError, match="no demonstration is called 'dig'; choose one of grow a hole"):
        demos.course("dig")


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
    with pytest.raises(InputError, match="cleaning needs at least 4 finite points"):
        cleaned(np.full((9, 3), np.nan))


def test_the_stored_measurement_says_which_filter_keeps_noise_below_the_guard():
    table = dirty.measure_dirty(("sphere",), (2048,))
    assert len(table) == len(dirty.TROUBLES) * len(dirty.FILTERS) * 3
    longest = table[table["dimension"] == 0].set_index(["trouble", "filter"])["noise"]
    assert longest["outliers 5 %", "as it is"] > 1 and longest["outliers 5 %", "trimmed, projected"] < 0.5
    assert "trimmed, projected: noise-born bars below 0.5" in dirty.dirty_text(table)
