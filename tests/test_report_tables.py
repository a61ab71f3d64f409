"""Tables and figures of the notebooks on hand-made records and small measurements."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
from matplotlib.colors import to_hex

from paper_artifact import catalogue
from paper_artifact.catalogue import Condition, Shape
from paper_artifact.config import LossConfig
from paper_artifact.report import generality, matrix, plans
from paper_artifact.report.kit import tables
from paper_artifact.report.kit.records import collect, collect_study, target_of
from paper_artifact.study import studies
from paper_artifact.study.studies import STUDIES, study_configs
from tests.report_records import write_study

PANELS = (("torus", "C6"), ("torus", "C1"), ("sphere", "C1"))
MEANS = {"C0": 0.06, "C1": 0.015, "C2": 0.13, "C6": 0.016}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The sphere complete but for C2g, C3, C5, C7 and C7h; the torus with one seed of C0, C1, C6; nothing
    else."""
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
    assert table.loc["C5", ("sphere", "ours")] == "not recorded" and table.loc["C5", ("cube", "ours")] == ""
    assert table.loc["C5", ("sphere", "paper")] == ".0082±.0007 (7.6×)"
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


def test_an_h0_tail_is_the_most_isolated_sample():
    """On the committed records: the bar after the merging one, left alone or matched to the target's longest
    noise bar, whichever is cheaper, costs the bottleneck distance, unless the merging bar's error is larger;
    in every arm."""
    table = matrix.component_table(collect_study("table1"), "two_spheres")
    assert (table["merging bar off by"] < 0.003).all()
    assert (table["what binds, per seed"] - table["bottleneck, H0"]).abs().max() < 2e-4
    for one in ("next bar alone", "less the target's noise bar"):
        assert (table[one] - table["bottleneck, H0"]).abs().max() > 1e-3, "neither way fits all arms"


def test_wasserstein_parts_are_the_least_over_all_matchings():
    generator = np.random.default_rng(3)
    for _ in range(20):
        a, b = (np.sort(generator.random((count, 2)), axis=1) for count in (3, 4))
        alone = [np.diff(bars, axis=1)[:, 0] / 2 for bars in (a, b)]
        least = min(
            sum(np.abs(a[i] - b[j]).max() for i, j in zip(rows, columns, strict=True))
            + sum(half.sum() for half in alone)
            - alone[0][list(rows)].sum()
            - alone[1][list(columns)].sum()
            for size in range(4)
            for rows in combinations(range(3), size)
            for columns in permutations(range(4), size)
        )
        assert sum(matrix.wasserstein_parts(a, b)) == pytest.approx(least)
    assert matrix.wasserstein_parts(np.array([[0.0, 1.0]]), np.empty((0, 2))) == (0.0, 0.5)


def test_the_double_torus_s_wasserstein_distance_is_two_half_lifetimes_and_what_is_matched():
    table = matrix.wasserstein_table(collect_study("table1"), "double_torus")
    bars = target_of("double_torus").diagram[1]
    halves = np.sort((bars[:, 1] - bars[:, 0]) / 2)[::-1][2:4].sum()
    assert (table["left alone"] - halves).abs().max() < 1e-4 and (table["of it matched"] > 0).all()
    assert table.loc["C0", "paper"] == ".0527-.0528"


def test_clean_clouds_are_gabriel_and_totals_are_sums():
    table = plans.gabriel_table()
    assert len(table) == 7 and (table["of them Gabriel"] == "100 %").all()
    assert set(table["positions, H0"].iloc[:-1]) == {"2"} and set(table["positions, H1"].iloc[:-1]) == {"3–5"}
    assert table["positions, H2"].iloc[:-1].isin(["4–7", "7"]).all()
    totals = plans.total_table()
    numbers = totals.iloc[:-1].astype(int)
    assert (numbers.iloc[:-1].sum() == numbers.loc["all"]).all() and numbers.loc[
        "all", "Gabriel failures"
    ] == 0
    assert totals.loc["paper, logged", "refreshes"] == "5500+"


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
    ):
        assert figure.axes
    assert tables.trajectory_table(empty, "sphere").empty


def test_a_new_row_of_the_catalogue_is_tabulated_and_plotted(tmp_path, monkeypatch):
    """A made-up condition and a made-up shape, and a study that runs them: no report names either."""
    arm = Condition("C2x", "made up", "#123456", LossConfig(rho=0.3))
    shape = Shape("doughnut", "loop group", 1, (0, 2, 1))
    monkeypatch.setattr(catalogue, "CONDITIONS", (*catalogue.CONDITIONS[:3], arm, *catalogue.CONDITIONS[3:]))
    monkeypatch.setattr(catalogue, "SHAPES", (shape, *catalogue.SHAPES))
    conditions = ("C0", "C1", "C2", "C2x", "C3")
    monkeypatch.setitem(STUDIES, "made up", (studies.Block(("bob", "doughnut"), conditions, range(2)),))
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
