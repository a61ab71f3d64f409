"""Tables and figures of the notebooks on hand-made records and small measurements."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from paper_artifact import catalogue
from paper_artifact.catalogue import Condition, Shape
from paper_artifact.config import LossConfig
from paper_artifact.errors import InputError
from paper_artifact.report import cost, generality, matrix, measured, plans, staircase, windows
from paper_artifact.report.kit import tables
from paper_artifact.report.kit.records import collect, collect_study
from paper_artifact.scene.shapes import make_shape
from paper_artifact.study.studies import STUDIES, study_configs
from paper_artifact.topology.bundle import build_from_mesh
from paper_artifact.topology.floor import significant
from tests.report_records import write_study

PANELS = (("torus", "C6"), ("torus", "C1"), ("sphere", "C1"))
MEANS = {"C0": 0.06, "C1": 0.015, "C2": 0.13, "C6": 0.016}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The sphere complete but for C2g, C3, C7 and C7h; the torus with one seed of C0, C1, C6; nothing else."""
    folder = tmp_path_factory.mktemp("runs")
    runs = {("sphere", name, seed): mean + 0.001 * seed for name, mean in MEANS.items() for seed in range(5)}
    runs |= {("torus", name, 0): 0.04 for name in ("C0", "C1", "C6")}
    write_study(folder, runs)
    return collect_study("table1", folder=folder)


def test_matrix_says_what_is_recorded_and_what_is_not(study):
    table = tables.matrix_table(study)
    assert table.loc["C1", ("sphere", "ours")] == ".0170±.0016 (3.65×), 5 seeds"
    assert (
        table.loc["C0", ("torus", "ours")] == ".0400, 1 of 5 seeds"
        and table.loc["C3", ("sphere", "ours")] == "not recorded"
    )
    assert table.loc["C1", ("sphere", "paper")] == ".0156±.0013 (4.0×)" and table.loc[
        "C2g", ("sphere", "paper")
    ].startswith(".0972")
    assert table.loc["C5", ("sphere", "ours")] == "" and table.loc["C5", ("sphere", "paper")].startswith(
        ".0082"
    )
    assert len(study.records) + len(study.missing) == len(study_configs("table1"))


def test_verdicts_and_reasons(study):
    judged = tables.verdict_table(study)
    assert judged.loc["sphere", "verdict"] == "pass" and judged.loc["torus", "verdict"] == "incomplete"
    assert (
        judged.loc["sphere", "phantoms (seeds)"] == "none"
        and float(judged.loc["sphere", "Welch C0 − C1"]) > 10
    )
    assert judged.loc["sphere", "reason"].startswith("C1 .0150-.0190 is below C0 .0600-.0640")
    welch = matrix.welch_table(study)
    assert welch.loc[("torus", "C6 vs C1")].tolist() == ["needs five recorded seeds of each", "12.4"]
    assert welch.loc[("sphere", "C6 vs C1"), "ours"] == "1.0"
    chamfer = matrix.chamfer_table(study)
    assert (
        chamfer.loc["C0", ("sphere", "paper")] == "0.50" and chamfer.loc["C0", ("sphere", "ours")] == "0.500"
    )


def test_figures_draw_what_the_tables_say(study):
    figure = tables.trajectory_figure(study, ("sphere", "torus"))
    lines = figure.axes[0].lines
    assert [line.get_label() for line in lines] == ["C0", "C1", "C2", "C6"]
    np.testing.assert_allclose(
        lines[1].get_ydata(), tables.trajectory_table(study, "sphere")["C1"], atol=1e-4
    )
    assert tables.seed_table(study).loc[("sphere", "C1"), "our tails"] == ".0150/.0160/.0170/.0180/.0190"
    assert len(matrix.seed_figure(study, ("sphere", "torus")).axes) == 2
    assert matrix.diagram_table(study, "sphere").loc["C0", "step 2500"] == "(0.0200, 0.2500)"
    assert (
        len(matrix.diagram_figure(study, "sphere", conditions=("C0", "C1", "C2"), steps=(100, 2500)).axes)
        == 6
    )


def test_an_h0_tail_is_the_most_isolated_sample():
    """On the committed records: half of the bar after the merging one is the bottleneck distance, to the sampling's spacing."""
    table = matrix.component_table(collect_study("table1"), "two_spheres")
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
    assert plans.composition_table(study, PANELS)["refreshes"].tolist() == [200, 200, 200]
    assert len(plans.plan_figure(study, PANELS).axes) == 3


def test_reports_of_nothing(tmp_path):
    empty = collect([("sphere", "C0", 0)], folder=tmp_path)
    assert tables.matrix_table(empty).loc["C0", ("sphere", "ours")] == "not recorded"
    assert tables.verdict_table(empty).empty and plans.plan_table(empty).empty
    assert tables.seed_table(empty)["our tails"].tolist() == ["not recorded"]
    assert plans.composition_table(empty, PANELS).empty and matrix.chamfer_table(empty).empty
    for figure in (
        tables.trajectory_figure(empty),
        matrix.seed_figure(empty),
        plans.plan_figure(empty, PANELS),
        matrix.diagram_figure(empty, "sphere", steps=(100,)),
    ):
        assert figure.axes
    assert (
        len(cost.share_table(empty)) == 1
        and matrix.diagram_table(empty, "sphere").empty
        and tables.trajectory_table(empty, "sphere").empty
    )


def test_staircase_counts_the_bundles_bars():
    mesh = make_shape("torus")
    table = staircase.staircase(mesh, (512, 1024), (0, 1))
    bundle = build_from_mesh(mesh.vertices, mesh.faces, 1024, 1)
    row = table[(table["samples"] == 1024) & (table["seed"] == 1)]
    assert row["floor"].iloc[0] == pytest.approx(bundle.floor)
    assert staircase.counts(row, 1).iloc[0] == len(bundle.bars[1])
    assert row["h1_1"].iloc[0] == pytest.approx(np.ptp(bundle.bars[1][0]))
    assert staircase.agreement(table, table) == (4, 0.0)
    assert staircase.signature_table(table).loc["torus", 1024] == "(1,1,0)"
    assert abs(staircase.law_table(table).loc["torus", 1024] - 1) < 0.1


def test_stored_staircase_matches_what_the_code_measures():
    stored = measured.read("staircase")
    assert len(stored) == 8 * 6 * 5
    lines, difference = staircase.agreement(
        stored, staircase.measure_all(("cube", "bowl_wide"), (512,), (3,))
    )
    assert lines == 2 and difference < 1e-4
    figure = staircase.floor_figure(stored, {"torus": (1, (1, 2), "loop")})
    assert len(figure.axes[0].lines) == 4
    crossing = staircase.crossing_table(stored, {"torus": (1, (1, 2), "loop")})["clears the floor from M ≈"]
    assert crossing.tolist()[0] == "≤ 512" and 1024 < int(crossing.iloc[1]) < 2048


def test_windows():
    margins = windows.margin_table(("torus", "cube", "bowl_wide"), (0, 1))
    torus = margins[(margins["shape"] == "torus") & (margins["seed"] == 0)]
    assert torus["in"].tolist() == [True, True, False]
    table = windows.window_table(margins)
    assert table.loc["torus", "paper's IN"] == "1.33" and "loop 2" in table.loc["torus", "tightest IN"]
    assert table.loc["cube", "largest OUT"] == "—" and "loop 1" in table.loc["bowl_wide", "largest OUT"]
    window = windows.global_window(margins)
    assert (
        window.loc["paper", ["k from", "k to"]].tolist() == [5.12, 6.77]
        and (window["k from"] < 6).all()
        and (window["k to"] > 6).all()
    )
    low = 6 * torus[~torus["in"]]["margin"].max()
    assert window.loc["ours, seed 0", "k from"] == pytest.approx(low, abs=0.006)  # rounded to two digits
    assert windows.window_figure(margins).axes


def test_a_flip_point_is_where_the_bundle_changes():
    mesh = make_shape("torus")
    margins = windows.margin_table(("torus",), (0,))
    flip = 6 * margins[margins["in"]]["margin"].min()
    kept = [
        len(build_from_mesh(mesh.vertices, mesh.faces, 2048, 0, k=k).bars[1])
        for k in (flip - 0.01, flip + 0.01)
    ]
    assert kept == [2, 1]


def test_cost_tables(study):
    stored = cost.measure_all((200, 800), 1)
    table = cost.beside_paper(stored)
    assert (
        list(table.index) == ["M = 200", "M = 800", "growth exponent"]
        and table.loc["growth exponent", "paper ms"] == 1.05
    )
    assert set(cost.stage_table(stored).index) == set(cost.STAGES) and "gudhi 3" in cost.machine(stored)
    assert len(cost.cost_figure(stored).axes[0].lines) == 4
    growth = cost.growth_table(stored)
    assert (
        list(growth.index) == ["torus", "soup", "smooth torus"]
        and growth["exponent, tetrahedra"].between(0.8, 1.4).all()
    )
    share = cost.share_table(study)
    assert (
        share.loc["sphere", "loss adds %"] == round(100 * 10 / 35)
        and share.iloc[-1]["loss adds %"] == "112–139"
    )


def test_measurements_are_written_and_read(tmp_path, monkeypatch):
    monkeypatch.setattr(
        cost, "measure_all", lambda progress=None: pd.DataFrame({"M": [2048], "fast_ms": [1 / 3]})
    )
    path = measured.measure("cost", tmp_path)
    assert path.read_text() == "M,fast_ms\n2048,0.333333\n" and measured.read("cost", tmp_path)[
        "M"
    ].tolist() == [2048]
    with pytest.raises(InputError, match="python -m paper_artifact measure staircase"):
        measured.read("staircase", tmp_path)
    with pytest.raises(InputError, match="no measurement"):
        measured.measure("nothing", tmp_path)


def test_significance_by_counts_is_the_floors():
    table = pd.DataFrame(
        [{"floor": 0.1} | {f"h1_{rank}": value for rank, value in enumerate((0.5, 0.11, 0.1, 0.05), 1)}]
    )
    assert staircase.counts(table, 1).tolist() == [2]
    assert staircase.counts(table, 1, multiplier=3).tolist() == [3]
    assert significant(np.array([[0, 0.5], [0, 0.11], [0, 0.1], [0, 0.05]]), 0.1).sum() == 2


def test_a_new_row_of_the_catalogue_is_tabulated_and_plotted(tmp_path, monkeypatch):
    """A made-up condition and a made-up shape, and a study that runs them: no report names either."""
    arm = Condition("C2x", "made up", "#123456", LossConfig(rho=0.3))
    shape = Shape("doughnut", "loop group", 1, (0, 2, 1))
    monkeypatch.setattr(catalogue, "CONDITIONS", (*catalogue.CONDITIONS[:3], arm, *catalogue.CONDITIONS[3:]))
    monkeypatch.setattr(catalogue, "SHAPES", (shape, *catalogue.SHAPES))
    conditions = ("C0", "C1", "C2", "C2x", "C3")
    monkeypatch.setitem(STUDIES, "made up", ((("bob", "doughnut"), conditions, range(2)),))
    tails = dict(zip(conditions, (0.04, 0.02, 0.05, 0.01, 0.015), strict=True))
    runs = {
        (shape, name, seed): tail + 0.001 * seed
        for shape in ("bob", "doughnut")
        for name, tail in tails.items()
        for seed in range(2)
    }
    write_study(tmp_path, runs)
    study = collect_study("made up", folder=tmp_path)
    assert not study.missing
    matrix_table = tables.matrix_table(study)
    assert list(matrix_table.index) == list(conditions)
    assert list(matrix_table.columns.unique(0)) == ["doughnut", "bob"]  # the catalogue's order
    assert matrix_table.loc["C2x", ("doughnut", "ours")] == ".0105±.0007 (3.86×), 2 seeds"
    assert tables.verdict_table(study).loc["doughnut", "verdict"] == "pass"
    assert tables.seed_table(study).loc[("doughnut", "C2x"), "our tails"] == ".0100/.0110"
    assert tables.trajectory_table(study, "doughnut")["C2x"].iloc[-1] == 0.0105
    assert matrix.chamfer_table(study).loc["C2x", ("doughnut", "ours")] == "0.500"
    assert plans.plan_table(study).loc[("doughnut", "C2x"), "refreshes"] == 400
    generality_table = generality.generality_table(study)
    assert generality_table.loc["doughnut", ("C2x", "ours")] == ".0105±.0007 (3.86×) [2/2]"
    assert list(generality_table.index) == ["doughnut", "bob", "loop group"]
    axis = tables.trajectory_figure(study).axes[0]
    assert axis.get_title().startswith("doughnut")
    colours = {line.get_label(): line.get_color() for line in axis.lines}
    assert list(colours) == list(conditions) and colours["C2x"] == "#123456"
    bars = matrix.seed_figure(study).axes[0].patches
    assert [to_hex(bar.get_facecolor()) for bar in bars][3] == "#123456"
