"""Reports read exactly the study's records, and say what is missing."""

from __future__ import annotations

import pytest

from paper_artifact import cli
from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.record.store import make_record, write_record
from paper_artifact.report import baseline
from paper_artifact.report.kit import frames, records
from tests.report_records import study_record, write_study

TAILS = {("sphere", "C0", 0): 0.06, ("sphere", "C0", 1): 0.07, ("torus", "C0", 0): 0.04}


@pytest.fixture
def folder(tmp_path):
    write_study(tmp_path, TAILS)
    return tmp_path


def test_takes_the_studys_configuration_and_no_other(folder):
    other = study_record("sphere", "C0", 2, 0.9)
    config = study_config("sphere", "C0", 2, vertex_lr=0.5)
    foreign = make_record(config, other["dumps"], other["tails"], other["timings"], mesh=other["mesh"])
    write_record(foreign, folder)
    found = records.collect([("sphere", "C0", seed) for seed in range(3)], folder=folder)
    assert [record["config"]["seed"] for record in found.records] == [0, 1]
    assert found.missing == (("sphere", "C0", 2),)
    assert len(found.of("sphere")) == 2 and found.of("sphere", "C1") == ()
    assert [record["config"]["seed"] for record in found.of("sphere", "C0", 1)] == [1]


def test_what_is_missing_comes_with_a_command_that_parses(folder):
    found = records.collect([("sphere", "C0", 0), ("sphere", "C1", 3), ("sphere", "C1", 4)], folder=folder)
    text = records.missing_text(found)
    assert (
        "2 of 3 runs" in text
        and "sphere C1, seed 3, 4: python -m paper_artifact train sphere --condition C1 --seed 3" in text
    )
    words = records.command("sphere", "C1", 3).split()[3:]
    parser, runners = cli._parser(words[0])
    assert parser.parse_args(words).verb in runners
    complete = records.collect([("sphere", "C0", 0)], folder=folder)
    assert records.missing_text(complete) == "all 1 runs are recorded"


def test_unknown_profile(tmp_path):
    with pytest.raises(InputError, match="profile"):
        records.collect([("sphere", "C0", 0)], "half", folder=tmp_path)


def test_baseline_tables(folder):
    found = records.collect(
        [(shape, "C0", seed) for shape in ("sphere", "torus") for seed in (0, 1)], folder=folder
    )
    table = baseline.seed_table(found)
    assert table["tail"].tolist() == [0.06, 0.07, 0.04] and table["Chamfer %"].tolist() == [0.5] * 3
    beside = baseline.beside_paper(found)
    assert (
        beside.loc["sphere", "our tail"] == pytest.approx(0.065)
        and beside.loc["sphere", "paper's tail"] == ".0623"
    )
    assert (
        beside.loc["sphere", "± sd"] == pytest.approx(0.0071)
        and beside.loc["torus", "paper's tail"] == ".0424"
    )
    assert (
        beside.loc["sphere", "paper's Chamfer %"] == "0.50" and beside.loc["torus", "paper's Chamfer %"] == ""
    )
    trajectory = baseline.trajectory_table(found)
    assert trajectory[("sphere", "bottleneck")].iloc[-1] == 0.065 and trajectory.index[-1] == 2500
    figure = baseline.trajectory_figure(found)
    assert [len(axis.lines) for axis in figure.axes] == [2, 2, 2, 4], "last: triangles and the two budgets"


def test_without_any_record(tmp_path):
    found = records.collect([("sphere", "C0", 0)], folder=tmp_path)
    assert (
        baseline.seed_table(found).empty
        and baseline.beside_paper(found).empty
        and baseline.trajectory_table(found).empty
    )
    assert baseline.trajectory_figure(found).axes


def test_frames_share_their_keys(folder):
    """Runs, arms and the paper's values join by shape and condition; what is not recorded stays, with
    nothing in it."""
    wanted = [("torus", "C0", 0), ("sphere", "C1", 0), ("sphere", "C0", 1), ("sphere", "C0", 0)]
    found = records.collect(wanted, folder=folder)
    runs, arms, paper = frames.runs(found), frames.arms(found), frames.paper_arms("tail_bottleneck", "1")
    assert runs[["shape", "seed"]].values.tolist() == [["sphere", 1], ["sphere", 0], ["torus", 0]]
    assert runs["tail"].tolist() == [0.07, 0.06, 0.04] and runs["dimension"].tolist() == [2, 2, 1]
    assert arms[frames.ARM].values.tolist() == [["sphere", "C0"], ["sphere", "C1"], ["torus", "C0"]]
    assert arms["seeds"].tolist() == [(0, 1), (), (0,)] and arms["wanted"].tolist() == [2, 1, 1]
    assert arms["mean"].tolist()[::2] == pytest.approx([0.065, 0.04]) and arms["mean"].isna().tolist()[1]
    assert arms["ratio"].isna().all() and arms["chamfer ratio"].tolist()[0] == 1
    joined = arms.merge(paper, on=frames.ARM, how="left").set_index(frames.ARM)
    assert joined["printed"].tolist() == [".0623", ".0156", ".0424"]
    assert joined.loc[("sphere", "C1"), "ratio_y"] == "4.0"
    assert frames.shapes(found) == ["sphere", "torus"] and frames.conditions(found) == ["C0", "C1"]


def test_the_papers_values_keep_the_papers_digits():
    paper = frames.paper("chamfer_ratio_to_C0", "chamfer").set_index(frames.ARM)["printed"]
    assert paper["rocker-arm", "C1"] == "1.00" and paper["bob", "C2"] == "2"
    assert frames.paper("tail_bottleneck", "S7")["seed"].notna().all()
    assert set(frames.paper("significant_count", "S3")["samples"]) >= {512, 2048}
