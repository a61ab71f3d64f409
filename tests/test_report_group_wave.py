"""The group wave: stored staircases against a new measurement and the paper, quoted bars, polygons."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from paper_artifact.audit.rule import WORKING
from paper_artifact.catalogue import shape_row, shapes_of, study_config
from paper_artifact.certify.certificate import certify, certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.report import group_wave, measured
from paper_artifact.report.kit.published import published
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.shapes import make_shape
from paper_artifact.scene.sources import sources
from paper_artifact.staircase import agreement, staircases
from paper_artifact.study.dispositions import Disposition, dispositions
from paper_artifact.study.studies import STUDIES

BOX = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
SIDES = ("f 1 2 4 3\n", "f 5 7 8 6\n", "f 1 5 6 2\n", "f 3 4 8 7\n", "f 1 3 7 5\n", "f 2/1 6/2 8/3 4/4\n")


@pytest.fixture(scope="module")
def stored():
    return measured.read("group_wave")


def test_the_stored_staircases_are_what_a_measurement_gives(stored):
    assert len(stored) == len(group_wave.external_shapes()) * (40 + 3 * 5)
    again = staircases(("eight", "rocker-arm"), (2048,), (0, 7))
    lines, difference = agreement(stored, again)
    assert lines == 4 and difference < 1e-4


def test_the_counts_of_seed_0_are_the_paper_s(stored):
    paper = published("S11")
    paper = paper[paper["quantity"] == "significant_count"]
    own = stored[stored["seed"] == 0].set_index(["shape", "samples"])
    for row in paper.itertuples():
        line = own.loc[(row.shape, row.samples)]
        bars = sum(line[f"h{int(row.dimension)}_{rank}"] > line["floor"] for rank in range(1, 5))
        assert bars + (row.dimension == 0) == row.value, row
    table = group_wave.table_s11(stored)
    assert (table.loc[("eight", "ours")] == table.loc[("eight", "paper")]).all()
    assert ("bob", "paper") not in table.index and table.loc[("spot", "ours"), "M = 8192"] == "(1,0,2)"


def test_the_quoted_bars_are_found(stored):
    notes = {"loop 4": 1, "second H2 bar": 2, "void": 2, "loop 3; half is the pin .0249": 1, "": 1}
    found = [group_wave.noted_bar(note, dimension) for note, dimension in notes.items()]
    assert found == ["loop 4", "void 2", "void 1", "loop 3", "loop 1"]
    table = group_wave.quoted_table(stored)
    assert len(table) == 20 and list(
        table.index[table["paper in range"] == "no"].get_level_values("shape")
    ) == ["rocker-arm", "eight", "cheburashka"]
    assert table.loc[("eight", 8192, "margin, loop 4"), "paper"] == "1.69"
    own = stored[(stored["shape"] == "horse") & (stored["samples"] == 20_000)]["h2_1"]
    assert float(table.loc[("horse", 20_000, "lifetime, void 1"), "median"]) == pytest.approx(
        np.median(own), abs=5.1e-5
    )


def test_pins_are_half_lifetimes_and_near_the_paper_s(stored):
    table = group_wave.pin_table(stored)
    pins = {"eight": "C0", "armadillo": "C0", "horse": "C0", "bob": "C2", "spot": "C2", "fandisk": "C2"}
    assert table["of condition"].to_dict() == pins
    assert table["bar"].tolist() == ["loop 3", "void 1", "void 1", "loop 2", "void 1", "void 1"]
    own = stored[(stored["shape"] == "eight") & (stored["samples"] == 20_000)]["h1_3"]
    assert float(table.loc["eight", "half its lifetime"]) == pytest.approx(own.mean() / 2, abs=5.1e-5)
    assert (
        table["half its lifetime"].astype(float) - table["paper's pinned tail"].astype(float)
    ).abs().max() < 6e-4


def test_seed_dependence_names_the_bar_at_the_floor():
    lengths = {f"h{d}_{rank}": 0.0 for d in range(3) for rank in range(1, 5)}
    lines = [
        {"shape": "x", "samples": samples, "seed": seed, "floor": 1.0, **lengths, "h1_1": 3.0, "h2_1": height}
        for samples, heights in ((100, (0.9, 1.2, 1.1)), (200, (2.0, 2.0, 2.0)))
        for seed, height in enumerate(heights)
    ]
    table = group_wave.seed_dependence(pd.DataFrame(lines))
    assert list(table.index) == [("x", 100)]
    row = table.loc[("x", 100)]
    assert (
        row["counts"] == "(1,1,1) 2×, (1,1,0) 1×"
        and row["bar at the floor"] == "void 1"
        and row["median"] == 1.1
    )


def test_polygons_are_counted_before_any_split(tmp_path):
    path = tmp_path / "box.obj"
    path.write_text(BOX + "".join(SIDES))
    assert group_wave.polygon_counts(path) == (0, 0, 2)
    path.write_text(BOX + "".join(SIDES[1:]))
    assert group_wave.polygon_counts(path) == (4, 0, 1)
    path.write_text(
        BOX + "v 0 0 0\n" + "".join(SIDES).replace("f 1 5", "f 9 5") + "f -9 -8 5\n"
    )  # a doubled point, a fin
    assert group_wave.polygon_counts(path) == (1, 2, 2)
    path.write_text(BOX + "f 1 2 3\nf 2 3 4\n")
    assert group_wave.polygon_counts(path) is None and group_wave.polygon_counts(tmp_path / "box.ply") is None


def test_dispositions_as_tables(monkeypatch, tmp_path):
    sphere = make_shape("sphere")
    inward = certify(sphere.vertices, sphere.faces[:, ::-1], "horse")
    rows = [
        Disposition("horse", "pass (g0)", "void group", "pass (g0)", True, inward),
        Disposition("max-planck", "fail: 161 open edges", "-", "not obtainable", None, None),
    ]
    monkeypatch.setattr(group_wave, "mesh_path", lambda key: tmp_path / f"{key}.ply")
    table = group_wave.table_s12(rows)
    assert table.loc["horse", "agrees"] == "yes" and table.loc["max-planck", "agrees"] == "—"
    assert table.loc["horse", "paper's origin"] == "CyberWare / GaTech"
    detail = group_wave.detail_table(rows)
    assert (
        list(detail.index) == ["horse"]
        and detail.loc["horse", "wound"] == "inwards"
        and detail.loc["horse", "χ"] == 2
    )


def test_the_plan_is_the_catalogue_s_and_the_study_s():
    plan = group_wave.plan()
    assert set(plan["pool"]["candidates"]) == set(published("S12")["shape"])
    assert all(sources()[key].repository in (*plan["pool"]["collections"], "") for key in ("horse", "eight"))
    for group, members in plan["members"].items():
        assert tuple(members) == shapes_of(group)
        for name, facts in members.items():
            row = shape_row(name)
            own = {"samples": row.samples, "bundle_seed": row.bundle_seed, "budget": row.budget}
            assert facts == own | {"dimensions": None if row.dimensions is None else list(row.dimensions)}
    block = STUDIES["table2"][0]
    shapes, conditions, seeds = block.shapes, block.conditions, block.seeds
    assert set(shapes) == {name for members in plan["members"].values() for name in members}
    runs, config = plan["runs"], study_config("horse", "C1")
    assert (runs["conditions"], runs["seeds"]) == (list(conditions), list(seeds))
    assert (runs["steps"], runs["views"], runs["size"]) == (config.steps, config.views, config.size)
    loss = config.loss
    assert (runs["rho"], tuple(runs["ramp"]), runs["refresh_every"]) == (
        loss.rho,
        loss.ramp,
        loss.refresh_every,
    )
    assert list(plan["rule"]["working_densities"]) == list(WORKING)
    table = group_wave.plan_table()
    assert "eight (M = 8192)" in table.loc[("members", "loop group"), ""]


def test_a_stored_certificate_is_what_the_mesh_gives_now():
    stored = group_wave.certificates()
    obtainable = {key for key in published("S12")["shape"] if sources()[key].obtainable}
    assert set(stored) == obtainable | {"bob", "spot", "fandisk"}
    for key in ("eight", "spot"):
        now = certify_mesh(find_mesh(key, welded=False)).to_json()
        assert group_wave.same_certificate(now, stored[key])
        assert not group_wave.same_certificate(now | {"euler": now["euler"] + 1}, stored[key])
        inward = json.loads(json.dumps(now))
        inward["components"][0]["volume"] *= -1
        assert not group_wave.same_certificate(inward, stored[key])
    decided = dispositions(["cow", "eight"])
    assert group_wave.certificate_text(decided) == "2 of 2 certificates are those in results/certificates/"
    verdicts = published("S12").set_index("shape")["certificate"]
    assert all(stored[key]["verdict"] == verdicts[key] for key in obtainable)


def test_a_damaged_plan_is_named(tmp_path):
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(InputError, match="plan.json"):
        group_wave.plan(tmp_path / "plan.json")
