"""Notebook 13 on hand-made records: Table S2 and the torus beside the paper's, verdicts, the search's rule,
the fields that it shows."""

from __future__ import annotations

import numpy as np
import pytest

from paper_artifact.catalogue import PRIOR, study_config
from paper_artifact.record.store import write_record
from paper_artifact.report import allocation
from paper_artifact.report.kit.records import collect_study, missing_text
from paper_artifact.study.studies import study_configs
from tests.report_records import study_record

VOIDS = {"C0": 0.05, "B1": 0.051, "B2": 0.043, "B3": 0.044, "B4": 0.03, "B5": 0.0375}
LOOPS = {"C0": 0.041, "B2": 0.0425, "B3": 0.04, "B4": 0.031, "B5": 0.027}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Sphere (with B1) and torus complete, of the cylinder three seeds of C0, nothing of the cube."""
    folder = tmp_path_factory.mktemp("runs")
    for seed in range(5):
        for name, tail in VOIDS.items():
            write_record(study_record("sphere", name, seed, tail + 0.001 * seed), folder)
        for name, tail in LOOPS.items():
            loops, chamfer = (4 + (seed > 2), 0.0066) if name == "B2" else (2, 0.005)
            record = study_record("torus", name, seed, tail + 1e-4 * seed, chamfer, counts=(0, loops, 1))
            write_record(record, folder)
        if seed < 3:
            write_record(study_record("cylinder", "C0", seed, 0.0545), folder)
    return collect_study("allocation", folder=folder)


def test_what_is_missing_is_said(study):
    assert len(study.records) + len(study.missing) == len(study_configs("allocation")) == 105
    command = "python -m paper_artifact sweep allocation --shape cube --condition B2"
    assert f"cube B2, seed 0, 1, 2, 3, 4: {command}" in missing_text(study, "allocation")


def test_table_s2_ours_beside_the_papers(study):
    table = allocation.allocation_table(study)
    assert list(table.index) == ["sphere", "torus", "cube", "cylinder"]
    assert list(table.columns.unique(0)) == ["B0 = C0", "B1", "B2", "B3", "B4", "B5"]
    assert (
        table.loc["sphere", ("B4", "ours")] == ".0320±.0016" and table.loc["sphere", "B4"]["paper"] == ".0357"
    )
    assert table.loc["sphere", "B0 = C0"]["paper"] == ".0535" and table.loc["cube", "B5"]["paper"] == ".0270"
    assert table.loc["cube", ("B2", "ours")] == "not recorded" and table.loc["torus", ("B1", "ours")] == ""
    gains = allocation.gain_table(study)
    assert gains.loc["sphere", ("B4", "ours")] == "38 %" and gains.loc["cube", ("B4", "paper")] == "53 %"
    assert gains.loc["torus", ("B2", "paper")] == "-4 %" and gains.loc["cube", ("B4", "ours")] == ""


def test_verdicts_by_the_studys_rule(study):
    table = allocation.verdict_table(study)
    wide = table.loc[("sphere", "B4 vs B5: wide: topological beats random?")]
    assert wide["ours"] == "pass" and wide["Welch"] == "7.5" and wide["Welch, paper"] == "2.2"
    assert wide["paper's means"] == ".0357 / .0374" and wide["reason"].startswith(
        "B4 .0300-.0340 is below C0"
    )
    narrow = table.loc[("sphere", "B2 vs B3: narrow: topological beats random?")]
    assert narrow["ours"] == "tied by control" and "overlaps B3" in narrow["reason"]
    assert wide["range to control's"] == "below" and narrow["range to control's"] == "overlaps"
    loops = table.loc["torus"]["ours"].tolist()
    assert loops == ["pass", "worse", "beaten by control"]
    assert table.loc[("cylinder", "B4 vs B5: wide: topological beats random?"), "ours"] == "incomplete"
    assert "cube" not in table.index.get_level_values(0)
    text = allocation.start_text(study)
    assert text == "B1 on the sphere: .0530±.0016 against .0520±.0016, Welch 1.0 (paper .0546 against .0535)"


def test_the_torus_paragraph(study):
    table = allocation.torus_table(study)
    assert table.loc["B2"].tolist() == [".0427", ".0425", "4.4 (4/4/4/5/5)", "4.4", "1.32", "1.32"]
    assert table.loc["B0 = C0"].tolist() == [".0412", ".0409", "2.0 (2/2/2/2/2)", "", "1.00", "1.01"]
    text = allocation.torus_text(study)
    assert text.count(": yes") == 5 and "B2 makes phantom loops (ours: +2.4 a run): yes" in text


def test_the_search_and_its_rule(tmp_path):
    configs = study_configs("allocation_search")
    assert {config.shape for config in configs} == {"sphere"} and len(configs) == 36
    levers = {(config.allocation.protection, config.allocation.subdivided) for config in configs}
    assert (PRIOR.protection, PRIOR.subdivided) in levers and len(levers) == 18
    # What is frozen is a run of the allocation study itself.
    assert study_config("sphere", "B4", 1) in configs
    goal = allocation.paper_arms()["value"]["sphere", "B4"]  # the rule: nearest to the paper's
    for config in configs[:-1]:
        part = config.allocation
        tail = goal + 0.01 * abs(part.protection - 2.0) + abs(part.subdivided - 0.05) + 0.001 * config.seed
        levers = {"protection": part.protection, "subdivided": part.subdivided}
        write_record(study_record("sphere", "B4", config.seed, tail, allocation=levers), tmp_path)
    found = collect_study("allocation_search", folder=tmp_path)
    assert "python -m paper_artifact sweep allocation_search" in missing_text(found, "allocation_search")
    assert "the rule needs every run" in allocation.search_text(found)
    assert allocation.search_table(found).loc[2.0, 0.05] == ".0362, 1.00 %"
    last = {"protection": 2.0, "subdivided": 0.2}
    write_record(study_record("sphere", "B4", 1, 0.5, allocation=last), tmp_path)
    text = allocation.search_text(collect_study("allocation_search", folder=tmp_path))
    assert text.startswith("the rule chooses protection 2, subdivided 0.05;") and text.endswith(
        "NOT THE SAME"
    )


def test_fields_are_those_of_the_runs():
    mesh, field = allocation.run_field("torus", "B2")
    table = allocation.field_table(("torus",))
    importance = field(mesh.vertices[mesh.faces].mean(axis=1))
    assert table.loc[("torus", "B2"), "least"] == pytest.approx(importance.min(), abs=0.006)
    assert table["least"].is_monotonic_increasing and table.loc[("torus", "B4"), "area above .5, %"] == 100
    figure = allocation.field_figure(("torus",), ("B2", "B4"), size=40)
    *pictures, scale = figure.axes
    assert [axis.get_title() for axis in pictures] == ["torus", ""] and "importance" in scale.get_ylabel()
    shades = [np.ptp(axis.images[0].get_array()[20, :, 0]) for axis in pictures]
    assert min(shades) > 0.2


def test_reports_of_nothing(tmp_path):
    empty = collect_study("allocation", folder=tmp_path)
    assert (allocation.allocation_table(empty).xs("ours", axis=1, level=1) != "").any(axis=None)
    assert allocation.verdict_table(empty).empty and "no runs of C0" in allocation.torus_text(empty)
    assert "no runs of B1" in allocation.start_text(empty)
    assert (allocation.torus_table(empty)["tail"] == "").all() and not allocation.gain_table(empty).empty
    search = collect_study("allocation_search", folder=tmp_path)
    assert allocation.search_table(search).empty and "needs every run" in allocation.search_text(search)
