"""Reports read exactly the study's records, and say what is missing."""

from __future__ import annotations

import pytest

from paper_artifact import cli
from paper_artifact.errors import InputError
from paper_artifact.record.store import write_record
from paper_artifact.report import baseline, runs
from tests.report_records import study_record, write_study

TAILS = {("sphere", "C0", 0): 0.06, ("sphere", "C0", 1): 0.07, ("torus", "C0", 0): 0.04}


@pytest.fixture
def folder(tmp_path):
    write_study(tmp_path, TAILS)
    return tmp_path


def test_takes_the_studys_configuration_and_no_other(folder):
    other = study_record("sphere", "C0", 2, 0.9)
    other["config"]["vertex_lr"] = 0.5
    from paper_artifact.record.store import make_record

    foreign = make_record(
        other["config"], other["dumps"], other["tails"], other["timings"], mesh=other["mesh"]
    )
    write_record(foreign, folder)
    found = runs.collect([("sphere", "C0", seed) for seed in range(3)], folder=folder)
    assert [record["config"]["seed"] for record in found.records] == [0, 1]
    assert found.missing == (("sphere", "C0", 2),)
    assert len(found.of("sphere")) == 2 and found.of("sphere", "C1") == ()


def test_what_is_missing_comes_with_a_command_that_parses(folder):
    found = runs.collect([("sphere", "C0", 0), ("sphere", "C1", 3), ("sphere", "C1", 4)], folder=folder)
    text = runs.missing_text(found)
    assert (
        "2 of 3 runs" in text
        and "sphere C1, seed 3, 4: python -m paper_artifact train sphere --condition C1 --seed 3" in text
    )
    words = runs.command("sphere", "C1", 3).split()[3:]
    parser, runners = cli._parser(words[0])
    assert parser.parse_args(words).verb in runners
    complete = runs.collect([("sphere", "C0", 0)], folder=folder)
    assert runs.missing_text(complete) == "all 1 runs are recorded"


def test_unknown_profile(tmp_path):
    with pytest.raises(InputError, match="profile"):
        runs.collect([("sphere", "C0", 0)], "half", folder=tmp_path)


def test_baseline_tables(folder):
    found = baseline.recorded(("sphere", "torus"), (0, 1), folder=folder)
    table = baseline.seed_table(found)
    assert table["tail"].tolist() == [0.06, 0.07, 0.04] and table["Chamfer %"].tolist() == [0.5] * 3
    beside = baseline.beside_paper(found)
    assert (
        beside.loc["sphere", "our tail"] == pytest.approx(0.065)
        and beside.loc["sphere", "paper's tail"] == 0.0623
    )
    assert (
        beside.loc["sphere", "± sd"] == pytest.approx(0.0071)
        and beside.loc["torus", "paper's tail"] == 0.0424
    )
    assert beside.loc["sphere", "paper's Chamfer %"] == 0.5
    trajectory = baseline.trajectory_table(found)
    assert trajectory[("sphere", "bottleneck")].iloc[-1] == 0.065 and trajectory.index[-1] == 2500
    figure = baseline.trajectory_figure(found)
    assert [len(axis.lines) for axis in figure.axes] == [2, 2, 2]


def test_without_any_record(tmp_path):
    found = baseline.recorded(("sphere",), (0,), folder=tmp_path)
    assert (
        baseline.seed_table(found).empty
        and baseline.beside_paper(found).empty
        and baseline.trajectory_table(found).empty
    )
    assert baseline.trajectory_figure(found).axes
