"""The pot's tables and the cutaway, on the real stand-in."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import trimesh

from paper_artifact.audit.measure import audit_mesh
from paper_artifact.ingest.hot_pot import pot_solid, raw_pot
from paper_artifact.report import pot as report
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected
from paper_artifact.scene.shapes import make_shape
from paper_artifact.staircase import DENSITIES, staircase
from tests import report_records


@pytest.fixture(scope="module")
def solid():
    return pot_solid()


@pytest.fixture(scope="module")
def stairs(solid):
    return staircase(solid.shell, DENSITIES, (0, 1))


def records(**tails):
    arms = [(name, seed, *scores) for name, scores in tails.items() for seed in range(3)]
    return Collected(tuple(report_records.study_record("pot", *arm) for arm in arms), ())


def test_the_inventory_stands_beside_the_paper_s(solid, stairs, tmp_path, monkeypatch):
    table = report.table_s4(raw_pot(), solid, stairs, report.collect_pot(folder=tmp_path))
    assert len(table) == published("S4")["quantity"].nunique()
    for same in ("open shells", "components", "genus", "betti"):
        assert table.loc[same, "paper's pot"] == table.loc[same, "stand-in"]
    assert (
        table.loc["raw vertices", "paper's pot"] == "6318" and table.loc["raw vertices", "stand-in"] == "1272"
    )
    assert table.loc["ratio C0 over C1", "stand-in"] == "no run recorded"
    trained = records(C0=(0.02, 0.004), C1=(0.005, 0.004), C2=(0.03, 0.006))
    table = report.table_s4(raw_pot(), solid, stairs, trained)
    assert table.loc["ratio C0 over C1", "stand-in"] == "4.0"
    assert table.loc["chamfer ratio to C0", "stand-in"].startswith("1.50, voids 1/1/1")
    assert "sha256" not in report.inventory_table(raw_pot(), solid).to_string()


def test_the_staircase_is_the_paper_s(solid, stairs):
    table = report.table_s5(stairs)
    assert (table["paper's pot"] == table["stand-in"]).all() and list(table.index) == list(DENSITIES)
    margin = {samples: report.bar_values(stairs, samples, "void 1")["margin"] for samples in (4096, 8192)}
    assert margin[8192].min() > 1 > margin[4096].max()
    voids = report.void_table(solid.shell, seeds=(0, 1))
    own = stairs[(stairs["samples"] == 8192) & (stairs["seed"] == 0)]
    assert voids.loc[0, "lifetime"] == pytest.approx(own["h2_1"].iloc[0], abs=1e-5)
    assert voids.loc["standard deviation", "death"] < 1e-3


def test_the_rule_gives_the_study_s_protocol(solid):
    text = report.decision_text(audit_mesh(solid.shell, "pot", densities=(2048, 8192)))
    assert text.startswith("class H2, M = 8192, the loss acts on (2,)") and text.endswith(
        "is this decision: True"
    )
    sphere = make_shape("sphere")
    assert report.decision_text(audit_mesh(sphere, densities=(2048,), working=(2048,))).endswith(
        "decision: False"
    )


def test_the_bar_is_the_flue(solid, stairs):
    table = report.flue_table(solid, stairs)
    for row, word in (("mouth", "birth "), ("chamber", "death ")):
        built = float(table.loc[row, "built, radius / D"])
        assert float(table.loc[row, "bar"].removeprefix(word)) == pytest.approx(built, rel=0.02)


def test_the_cut_is_half_of_the_surface_and_is_drawn_filled(solid):
    sphere = make_shape("sphere")
    vertices, faces = report.cut_open(sphere)
    half = trimesh.Trimesh(vertices, faces, process=False)
    assert half.area == pytest.approx(
        trimesh.Trimesh(sphere.vertices, sphere.faces, process=False).area / 2, rel=1e-3
    )
    assert vertices[np.unique(faces), 1].min() > -1e-9
    image = report.pot_figure(solid, 60).axes[2].images[0].get_array()
    red = (image[..., 0] > 0.5) & (image[..., 1] < 0.5)
    assert 40 < red.sum() < 900, "the wall's section, not the chamber"
    assert not red[23:32, 28:32].any(), "the chamber is open"


def test_certificates_side_by_side(solid):
    table = report.ingest_table(solid)
    assert isinstance(table, pd.DataFrame) and table.loc["open edges after the weld"].tolist() == ["164", "0"]
    assert table.loc["verdict"].tolist() == ["fail", "pass, genus 3"]
    assert table.loc["enclosed pockets filled", "after ingest"] == "20"
