"""Table 2 and the gallery: on hand-made records, and on the committed soups."""

from __future__ import annotations

import pytest
from matplotlib.colors import to_hex

from paper_artifact.catalogue import colour_of, shape_row, shapes_of, study_config
from paper_artifact.evaluate.diagram import significant_counts
from paper_artifact.evaluate.scores import evaluate_soup, make_target
from paper_artifact.evaluate.staircase import measure
from paper_artifact.files import RESULTS
from paper_artifact.record.store import config_of, find_records, write_record
from paper_artifact.report import gallery, generality
from paper_artifact.report.kit import frames, tables
from paper_artifact.report.kit.records import Collected, collect_study, soup_path
from paper_artifact.scene.shapes import surface
from tests.report_records import study_record

ARMS = ("C0", "C2", "C1")  # whose soups are committed


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """bob and eight pass, rocker-arm's C1 overlaps its C0; bob's control loses a loop; of the voids only
    spot's C0."""
    folder = tmp_path_factory.mktemp("runs")
    means = {
        "bob": {"C0": 0.04, "C1": 0.02, "C2": 0.044},
        "rocker-arm": {"C0": 0.008, "C1": 0.008, "C2": 0.011},
        "eight": {"C0": 0.03, "C1": 0.01, "C2": 0.03},
    }
    for shape, arms in means.items():
        for condition, mean in arms.items():
            for seed in range(3):
                lost = shape == "bob" and condition == "C2"
                write_record(
                    study_record(shape, condition, seed, mean + 1e-4 * seed, counts=(0, 1 if lost else 2, 1)),
                    folder,
                )
    write_record(study_record("spot", "C0", 0, 0.055), folder)
    return collect_study("table2", folder=folder)


def test_table_2_ours_beside_the_papers(study):
    table = generality.generality_table(study)
    assert table.loc["bob", ("C1", "ours")] == ".0201±.0001 (2.00×) [2/2/2]"
    assert (
        table.loc["bob", ("C2", "ours")].endswith("[1/1/1]")
        and table.loc["fandisk", ("C0", "ours")] == "not recorded"
    )
    assert table.loc["fandisk", ("C1", "paper")] == ".0052±.0008 (10.4×)"
    assert (
        table.loc["spot", ("C0", "ours")] == ".0550 [1]"
        and table.loc["spot", ("verdict", "ours")] == "incomplete"
    )
    # the mean of C0 / C1: 401/201, 81/81, 301/101
    assert table.loc["loop group", ("C1", "ours")] == "1.99× ± 0.99, 2 of 3 pass"
    assert (
        table.loc["loop group", ("C1", "paper")] == "1.52× ± 0.55"
        and table.loc["void group", ("C1", "ours")] == "not all recorded"
    )


def test_verdicts_stand_beside_those_of_the_papers_tails(study):
    lines = tables.verdict_table(study)
    assert lines["verdict"].to_dict() == {
        "bob": "pass",
        "rocker-arm": "no effect",
        "eight": "pass",
        "spot": "incomplete",
    }
    assert (
        lines.loc["bob", "paper's tails give"] == "pass"
        and lines.loc["rocker-arm", "paper's tails give"] == "no effect"
    )
    assert lines.loc["rocker-arm", "Chamfer C1 / C0"] == "1.00" and lines.loc["spot", "Chamfer C1 / C0"] == ""
    assert (
        lines.loc["bob", "lost (seeds)"] == "C2 (0, 1, 2)" and lines.loc["bob", "phantoms (seeds)"] == "none"
    )
    assert lines.loc["spot", "lost (seeds)"] == "unknown"
    seeds = tables.seed_table(study)
    assert (seeds.loc[("rocker-arm", "C1"), "Chamfer / C0"], seeds.loc[("rocker-arm", "C1"), "paper's"]) == (
        "1.00",
        "1.00",
    )
    assert (
        seeds.loc[("spot", "C1"), "our tails"] == "not recorded"
        and seeds.loc[("spot", "C1"), "Chamfer / C0"] == ""
    )


def test_the_ramp_off_the_analytic_family(study):
    table = generality.generality_table(study)["C3"]
    assert table.loc["bob"].tolist() == ["not recorded", ".0171±.0026"] and (table.drop("bob") == "").all(
        axis=None
    )


def test_every_arm_is_counted_against_the_bundle(study):
    judged = frames.verdicts(study)["bob"]  # the hand-made bundle has two bars
    assert judged.missing == {"C0": (), "C1": (), "C2": (0, 1, 2)} and judged.phantoms["C0"] == ()


def test_expected_counts_are_the_bundles():
    """Of an external mesh the records expect what its clean surface shows at the density of the loss,
    measured again."""
    runs = frames.runs(collect_study("table2"))
    for shape in ("bob", "rocker-arm", "spot"):
        row = shape_row(shape)
        counted = significant_counts(*measure(surface(shape), row.samples, row.bundle_seed))
        assert set(runs[runs["shape"] == shape]["expected"]) == {counted[row.judged]}


def test_counts_and_margins_beside_the_clean_surface(study):
    counts, margins = generality.count_table(study), generality.margin_table(study)
    assert list(counts.index) == ["bob", "rocker-arm", "eight"]  # spot's one run has no bundle
    assert (
        counts.loc["bob", "clean surface, bundle"] == "2 at M = 2048" and counts.loc["bob", "C2"] == "1/1/1"
    )
    assert counts.loc["bob", "C3"] == "not recorded"
    assert margins.loc["bob", "C1"] == "1.50 / 1.50 / 1.50"  # second bar .03, floor .02


def test_the_gallery_says_what_is_not_kept():
    nothing = Collected((), (("bob", "C0", 0),))
    titles = [axis.get_title() for axis in gallery.gallery_figure(nothing, ("bob",), ARMS, size=32).axes]
    assert titles == ["ground truth", "C0: not recorded", "C2: not recorded", "C1: not recorded"]
    assert set(gallery.gallery_table(nothing, ("bob",), ARMS)["record"]) == {"not recorded"}


@pytest.fixture(scope="module")
def committed():
    return {
        (each["config"]["shape"], each["config"]["condition"]): each
        for each in find_records(RESULTS / "runs")
        if config_of(each) == study_config(each["config"]["shape"], each["config"]["condition"])
    }


def test_the_gallerys_soups_are_committed(committed):
    absent = [
        (shape, arm)
        for shape in shapes_of("loop group", "void group")
        for arm in ARMS
        if (shape, arm) not in committed or not soup_path(committed[shape, arm]).is_file()
    ]
    assert absent == []


def test_badges(committed):
    chosen = Collected(tuple(committed["bob", arm] for arm in ARMS), ())
    figure = gallery.gallery_figure(chosen, ("bob",), ARMS, size=48)
    badges = [axis.texts[0] for axis in figure.axes]
    table = gallery.gallery_table(chosen, ("bob",), ARMS)
    for badge, (_, row) in zip(badges[1:], table.iterrows(), strict=True):
        right = row["record"] == str(row["expected"])
        assert badge.get_text() == f"# significant: {row['record']}" and row["soup"] == row["record"]
        assert to_hex(badge.get_bbox_patch().get_facecolor()) == ("#ffffff" if right else gallery.WRONG)
        assert to_hex(badge.get_bbox_patch().get_edgecolor()) == (colour_of("C1") if right else gallery.WRONG)
    assert (table["record"] != "2").any(), "bob's control loses a loop"


@pytest.mark.parametrize("run", [("bob", "C1"), ("fandisk", "C2"), ("horse", "C0")], ids="-".join)
def test_a_committed_soup_is_the_one_of_its_record(committed, run):
    """Measured again, the soup gives the record's last dump."""
    record = committed[run]
    _, soup = gallery.soup_of(Collected((record,), ()), *run)
    target = make_target(surface(run[0]), cache=None)
    again = evaluate_soup(
        soup.vertices.detach().numpy(),
        soup.corner_opacity(),
        target,
        seed=0,
        step=record["dumps"][-1]["step"],
    )
    last = record["dumps"][-1]
    assert again["counts"] == last["counts"]
    for name in ("bottleneck", "chamfer", "hausdorff95"):
        assert again[name] == pytest.approx(last[name], rel=1e-5)
