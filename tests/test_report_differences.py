"""Notebook 15: every effect and every piece of arithmetic is computed, sources are complete; Fig. S9's
boxes are modules."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import torch

from paper_artifact.files import REPOSITORY
from paper_artifact.report import deviations, errata, literature, measured, schematic
from paper_artifact.report.kit.published import PUBLISHED, published
from paper_artifact.report.kit.records import Collected, collect_study
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import Soup, initial_mlp
from paper_artifact.study.repair import make_probe, repair
from tests.report_records import study_record


@pytest.fixture(scope="module")
def recorded():
    """The committed records of both tables."""
    tables = [collect_study(name) for name in ("table1", "table2")]
    return Collected(tables[0].records + tables[1].records, tables[0].missing + tables[1].missing)


def test_every_deviation_has_a_measured_effect(recorded):
    table = deviations.deviation_table(recorded)
    assert len(table) == len(deviations.DEVIATIONS) and (table != "").all().all()
    assert not table["effect"].str.contains("not recorded").any()
    assert table["effect"].str.contains("not measured").sum() == 1, "the views"
    assert "2.00–2.00" in table.loc["Chamfer", "effect"]
    assert "the same tails in every seed (paper: 6 % apart)" in table.loc["machine", "effect"]
    empty = Collected((), (("torus", "C1", 0), ("two_spheres", "C1", 0)))
    bare = deviations.deviation_table(empty)["effect"]
    assert bare["live significance"] == "torus C1 is not recorded" and bare["Chamfer"] == "no record"


def test_the_live_floor_s_share_is_counted_from_the_logs():
    record = study_record("torus", "C1", 0, 0.02)
    for number, event in enumerate(each for each in record["topology"] if each["event"] == "refresh"):
        event["dimensions"]["1"]["targets"][1]["live"] = [0.03, 0.095]  # .065, above the bundle's .06
        event["live_floor"] = 0.07 if number % 4 else 0.05
    text = deviations._floor(Collected((record,), ()), pd.DataFrame())
    assert "in 100 % of the refreshes, by the live floor in 25 %" in text


def test_an_opacity_that_is_constant_on_triangles_makes_no_difference():
    mesh = make_shape("sphere")
    corners = torch.from_numpy(mesh.vertices[mesh.faces[:400]].astype(np.float32))
    logits = torch.linspace(-2, 2, 400)[:, None].expand(400, 3)
    flat = Soup(corners, torch.zeros(400, 3, 7), logits.clone(), initial_mlp(0))
    same = deviations.opacity_effect(flat, "sphere")
    assert same["total variation"] < 1e-6
    assert same["bottleneck, mean of opacities"] == pytest.approx(same["bottleneck, opacity of the mean"])
    uneven = Soup(corners, flat.features, logits + torch.tensor([-3.0, 0.0, 3.0]) * (logits > 0), flat.mlp)
    assert deviations.opacity_effect(uneven, "sphere")["total variation"] > 0.01


def test_the_stored_gate_is_what_the_loss_does():
    stored = measured.read("deviations").set_index(["subject", "case", "quantity"])["value"]
    run = repair(make_probe("T1"), steps=140, record_every=20, final_rate=1.0)  # the first of its 600 steps
    step = deviations.at_factor(run, 8.8)[0]
    assert step == pytest.approx(stored["gate", "T1", "step of the paper's factor, rate to 1"], abs=40)
    ends = [stored["gate", "T1", f"factor at the end, rate to {rate}"] for rate in ("0.01", "1")]
    assert ends[1] < 8.8 < ends[0]


def test_every_claim_has_its_arithmetic_and_no_other():
    claims = pd.read_csv(PUBLISHED / "claims.csv", dtype=str)
    assert list(claims["key"]) == list(errata.ARITHMETIC) and claims["claim"].is_unique
    assert claims.notna().all().all()
    table = errata.error_table()
    assert len(table) == len(claims) and (table != "").all().all()


@pytest.mark.parametrize(
    ("key", "numbers"),
    [
        ("rocker_floor", ("0.0177", "0.0196")),
        ("tube_ratio", ("2.63–2.69", "3.09")),
        ("floor_anchor", ("0.0199", "0.0171")),
        ("no_ramp", ("sphere 0.8", "torus 2.5", "bob 2.4")),
        ("two_baselines", (".0535", ".0623", "2.2 σ")),
        ("default_ramp", (".0156±0.0013; five seeds (Table 1) .0156±0.0013",)),
        ("wasserstein", ("0.0072", "0.0050", "0.0100", "matched 0 and 1")),
        ("refreshes", ("63 runs", "12600")),
        ("never_clear", ("two loops at M = 20000", "4096, 8192, 20000")),
        ("identical", ("eight C1 4/3/4", "spot C0 2/1/2", "spot C1 1/2/1")),
        ("ceiling", ("0.83–0.85", "0.0264", "all 4 loops")),
    ],
)
def test_the_arithmetic_of_an_error(key, numbers):
    text, outcome = errata.ARITHMETIC[key]()
    assert all(number in text for number in numbers), text
    assert outcome


def test_the_spread_of_the_printed_tails():
    table = errata.variation_table().replace("", np.nan).astype(float)
    assert table.loc["two_spheres", "C1"] == 28.6 and table.loc["sphere", "C3"] == 2.6
    assert table.loc["armadillo", "C1"] == 0.8 and np.isnan(table.loc["armadillo", "C0"])
    with pytest.raises(ValueError, match="size 1"):
        errata.value("1", shape="sphere")


def test_table_s6_has_a_source_for_every_method_but_the_paper_s_own():
    methods, table = published("S6")["method"], literature.table_s6()
    assert list(dict.fromkeys(table.index)) == list(methods)
    without = table.index[table["link"] == ""]
    assert set(without) == {"DiffSoup + prior (§ A)", "this work"}
    found = literature.sources()
    assert found["key"].is_unique and set(found["checked"]) == {"abstract", "objective"}
    assert found["year"].str.fullmatch(r"20\d\d").all() and (found != "").all().all()
    assert found["link"].str.fullmatch(r"https://arxiv\.org/abs/\d{4}\.\d{5}").all()
    assert literature.philosophy_table().to_numpy().sum() == len(methods)


def test_the_schematic_s_boxes_are_modules():
    table = schematic.module_table()
    assert all((REPOSITORY / path).is_file() for path in table["module"])
    assert {name for arrow in schematic.ARROWS for name in arrow} == set(schematic.BOXES)
    probe = make_probe("T4")
    figure = schematic.schematic_figure(probe, repair(probe, steps=10))
    system, tug = figure.axes
    assert len(system.texts) == 2 * len(schematic.BOXES) + len(schematic.ARROWS)
    assert len(system.patches) == len(schematic.BOXES)
    assert len([text for text in tug.texts if getattr(text, "arrow_patch", None) is not None]) == 1
