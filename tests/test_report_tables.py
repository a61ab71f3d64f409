"""Tables and figures of the notebooks on hand-made records and small measurements."""

from __future__ import annotations

import numpy as np
import pytest

from paper_artifact.report import cost, matrix, plans
from paper_artifact.report.runs import collect
from paper_artifact.study.studies import study_configs
from tests.report_records import write_study

MEANS = {"C0": 0.06, "C1": 0.015, "C2": 0.13, "C6": 0.016}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The sphere complete but for C2g, C3, C7 and C7h; the torus with one seed of C0, C1, C6; nothing else."""
    folder = tmp_path_factory.mktemp("runs")
    runs = {("sphere", name, seed): mean + 0.001 * seed for name, mean in MEANS.items() for seed in range(5)}
    runs |= {("torus", name, 0): 0.04 for name in ("C0", "C1", "C6")}
    write_study(folder, runs)
    return matrix.collect_study("table1", folder=folder)


def test_matrix_says_what_is_recorded_and_what_is_not(study):
    table = matrix.matrix_table(study)
    assert table.loc["C1", ("sphere", "ours")] == ".0170±.0016 (3.65×), 5 seeds"
    assert (
        table.loc["C0", ("torus", "ours")] == ".0400, 1 of 5 seeds"
        and table.loc["C3", ("sphere", "ours")] == "not recorded"
    )
    assert table.loc["C1", ("sphere", "paper")] == ".0156±.0013 (3.99×)" and table.loc[
        "C2g", ("sphere", "paper")
    ].startswith(".0972")
    assert table.loc["C5", ("sphere", "ours")] == "" and table.loc["C5", ("sphere", "paper")].startswith(
        ".0082"
    )
    assert len(study.records) + len(study.missing) == len(study_configs("table1"))


def test_verdicts_and_reasons(study):
    judged = matrix.verdicts(study)
    assert judged.loc["sphere", "verdict"] == "pass" and judged.loc["torus", "verdict"] == "incomplete"
    assert (
        judged.loc["sphere", "phantoms in C1, seeds"] == "none"
        and float(judged.loc["sphere", "Welch C0 − C1"]) > 10
    )
    text = matrix.reasons(study)
    assert (
        "sphere: pass" in text
        and "Welch, torus C6 vs C1: paper 12.4; ours needs five recorded seeds of each" in text
    )
    assert matrix.chamfer_table(study).loc["C0", "sphere, paper"] == 0.5


def test_figures_draw_what_the_tables_say(study):
    figure = matrix.trajectory_figure(study)
    lines = figure.axes[0].lines
    assert [line.get_label() for line in lines] == ["C0", "C1", "C2", "C6"]
    np.testing.assert_allclose(
        lines[1].get_ydata(), matrix.trajectory_table(study, "sphere")["C1"], atol=1e-4
    )
    assert matrix.seed_table(study).loc[("sphere", "C1"), "our tails"] == ".0150/.0160/.0170/.0180/.0190"
    assert len(matrix.seed_figure(study).axes) == 2
    assert matrix.diagram_table(study).loc["C0", "step 2500"] == "(0.0200, 0.2500)"
    assert len(matrix.diagram_figure(study, steps=(100, 2500)).axes) == 6


def test_an_h0_tail_is_the_most_isolated_sample():
    """On the committed records: half of the bar after the merging one is the bottleneck distance, to the sampling's spacing."""
    table = matrix.component_table(matrix.collect_study("table1"))
    assert (table["merging bar"] - table["of the target"]).abs().max() < 0.002
    assert (table["half the next bar"] - table["bottleneck, H0"]).abs().loc[["C0", "C2"]].max() < 0.001


def test_plans(study):
    table = plans.plan_table(study)
    assert (
        table.loc[("torus", "C1"), "recruiting %"] == 100 and table.loc[("torus", "C6"), "unreached %"] == 100
    )
    assert (
        table.loc[("sphere", "C1"), "refreshes"] == 1000
        and table.loc[("sphere", "C1"), "Gabriel failures"] == 0
    )
    assert table.loc[("torus", "C6"), "residual at M"] == pytest.approx(0.01)
    assert plans.composition_table(study)["refreshes"].tolist() == [200, 200, 200]
    assert len(plans.plan_figure(study).axes) == 3


def test_reports_of_nothing(tmp_path):
    empty = collect([("sphere", "C0", 0)], folder=tmp_path)
    assert matrix.matrix_table(empty).loc["C0", ("sphere", "ours")] == "not recorded"
    assert matrix.verdicts(empty).empty and matrix.seed_table(empty).empty and plans.plan_table(empty).empty
    assert plans.composition_table(empty).empty and matrix.chamfer_table(empty).empty
    for figure in (
        matrix.trajectory_figure(empty),
        matrix.seed_figure(empty),
        plans.plan_figure(empty),
        matrix.diagram_figure(empty, steps=(100,)),
    ):
        assert figure.axes
    assert (
        len(cost.share_table(empty)) == 1
        and matrix.diagram_table(empty).empty
        and matrix.trajectory_table(empty, "sphere").empty
    )
