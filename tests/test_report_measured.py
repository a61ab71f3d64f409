"""Notebooks 03, 04, 07: staircases, floor windows, costs on small measurements; what is stored."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from paper_artifact import staircase as kit
from paper_artifact.bench.persistence import growth_text
from paper_artifact.catalogue import SHAPES, study_config
from paper_artifact.errors import InputError
from paper_artifact.report import cost, measured, speed, staircase, starts, windows
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.records import collect, collect_study
from paper_artifact.results import published
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.topology.bundle import build_from_mesh
from paper_artifact.topology.floor import significant
from tests.report_records import write_study


def test_staircase_counts_the_bundles_bars():
    mesh = make_shape("torus")
    table = kit.staircase(mesh, (512, 1024), (0, 1))
    bundle = build_from_mesh(mesh.vertices, mesh.faces, 1024, 1)
    row = table[(table["samples"] == 1024) & (table["seed"] == 1)]
    assert row["floor"].iloc[0] == pytest.approx(bundle.floor)
    assert kit.counts(row, 1).iloc[0] == len(bundle.bars[1])
    assert row["h1_1"].iloc[0] == pytest.approx(np.ptp(bundle.bars[1][0]))
    assert kit.agreement(table, table) == (4, 0.0)
    assert kit.signature_table(table).loc["torus", 1024] == "(1,1,0)"
    assert abs(staircase.law_table(table).loc["torus", 1024] - 1) < 0.1


def test_stored_staircase_matches_what_the_code_measures():
    stored = measured.read("staircase")
    assert len(stored) == 8 * 6 * 5
    lines, difference = kit.agreement(stored, kit.staircases(("cube", "bowl_wide"), (512,), (3,)))
    assert lines == 2 and difference < 1e-4
    figure = staircase.floor_figure(stored, {"torus": ("loop 1", "loop 2")})
    assert len(figure.axes[0].lines) == 4
    crossing = staircase.crossing_table(stored, {"torus": ("loop 1", "loop 2")})["clears the floor from M ≈"]
    assert crossing.tolist()[0] == "≤ 512" and 1024 < int(crossing.iloc[1]) < 2048


def test_the_paper_stands_below_ours_shape_by_shape():
    table = staircase.table_s3(measured.read("staircase"))
    shapes = [shape for shape in published("S3")["shape"].unique() for _ in range(2)]
    assert list(table.index) == list(zip(shapes, ["ours", "paper"] * 3, strict=True))
    assert list(table.columns) == [f"M = {samples}" for samples in (512, 1024, 2048, 4096)]
    assert table.loc[("double_torus", "paper")].tolist() == ["0 / 0", "2 / 0", "2 / 0", "4 / 0"]
    assert table.loc[("torus", "ours")].tolist() == table.loc[("torus", "paper")].tolist()
    floors = staircase.floor_table(measured.read("staircase"))
    assert floors.loc[("torus", 2048), "paper's floor"] == ".0623"
    assert floors.loc[("double_torus", 20_000), ["paper's floor", "paper's r_med"]].tolist() == [
        ".0171",
        ".0028",
    ]


def test_bars_are_the_staircase_s_lifetimes():
    stored = measured.read("staircase")
    found = kit.bars(stored)
    assert len(found) == (stored.filter(regex=r"^h\d_\d$") > 0).to_numpy().sum()
    chosen = found[(found["shape"] == "torus") & (found["bar"] == "loop 2")]
    own = stored[stored["shape"] == "torus"]
    assert chosen["lifetime"].tolist() == own["h1_2"].tolist()
    np.testing.assert_allclose(chosen["margin"], own["h1_2"] / own["floor"])
    significant_bars = found[found["margin"] > 1].groupby(kit.KEYS).size()
    values = kit.significant_counts(stored).groupby(kit.KEYS)["value"].sum() - 1  # without the infinite bar
    assert significant_bars.to_dict() == values[values > 0].to_dict()


def test_windows():
    margins = windows.margin_table(("torus", "cube", "bowl_wide"), (0, 1))
    torus = margins[(margins["shape"] == "torus") & (margins["seed"] == 0)]
    assert torus["inside"].tolist() == [True, True, False]
    table = windows.table_s13(margins)
    assert table.loc["torus", "paper's IN"] == "1.33" and "loop 2" in table.loc["torus", "tightest IN"]
    assert table.loc["cube", "largest OUT"] == "—" and "loop 1" in table.loc["bowl_wide", "largest OUT"]
    window = windows.global_window(margins)
    assert window.loc["paper", ["k from", "k to"]].tolist() == ["5.12", "6.77"]
    ends = window.loc[["ours, the bundles' seeds", "ours, median margins"], ["k from", "k to"]].astype(float)
    assert (ends["k from"] < 6).all() and (ends["k to"] > 6).all()
    flips = {seed: 6 * group[~group["inside"]]["margin"].max() for seed, group in margins.groupby("seed")}
    assert float(ends.loc["ours, the bundles' seeds", "k from"]) == pytest.approx(flips[0], abs=0.006)
    spread = window.loc["ours, 2 seeds: least–median–largest"]
    low, median, high = map(float, spread["k from"].split("–"))
    assert [low, high] == pytest.approx(sorted(flips.values()), abs=0.006)
    assert (
        median == pytest.approx((low + high) / 2, abs=0.01) and spread["bound by (OUT)"] == "torus void 1 2×"
    )
    assert windows.window_figure(margins).axes


def test_the_stored_margins_are_these_and_the_torus_s_void_is_a_matter_of_the_seed():
    stored = measured.read("windows")
    again = windows.margin_table(("torus", "bob"), (0,))
    assert windows.agreement_text(stored, again).startswith(f"6 of {len(stored)} ")
    assert windows.agreement_text(stored, again).endswith("True")
    moved = again.assign(margin=again["margin"] + 0.001)
    assert windows.agreement_text(stored, moved).endswith("False")
    table = windows.torus_table(stored)
    assert table["paper"].tolist() == [".0623", "1.33", "0.83"]
    void = stored[(stored["shape"] == "torus") & (stored["bar"] == "void 1")]["margin"]
    assert len(void) == 200 and table.loc["void 1 / floor", "least"] == f"{void.min():.2f}"
    assert void.min() < 0.83 < void.median(), "the paper's value is at the low end of the seeds"


def test_the_window_s_shapes_are_the_catalogue_s():
    """Table S13 has every shape that the study bundles: all but the cylinder, of the allocation study."""
    rows = set(published("S13")["shape"]) - {"all"}
    assert rows == {each.name for each in SHAPES if each.group != "allocation"}


def test_a_flip_point_is_where_the_bundle_changes():
    mesh = make_shape("torus")
    margins = windows.margin_table(("torus",), (0,))
    flip = 6 * margins[margins["inside"]]["margin"].min()
    kept = [
        len(build_from_mesh(mesh.vertices, mesh.faces, 2048, 0, k=k).bars[1])
        for k in (flip - 0.01, flip + 0.01)
    ]
    assert kept == [2, 1]


def test_cost_tables():
    stored = cost.measure_cost((200, 800), 1)
    table = cost.persistence_table(stored)
    assert list(table.index) == ["M = 200", "M = 800", "M = 800 / M = 200", "growth exponent"]
    assert (table["paper ms"] == "").all(), "the paper measures neither size"
    assert set(cost.stage_table(stored).index) == set(cost.STAGES) and "gudhi 3" in cost.machine(stored)
    assert len(cost.cost_figure(stored).axes[0].lines) == 4
    growth = cost.growth_table(stored)
    assert list(growth.index) == ["torus", "soup", "smooth torus"]
    assert growth["exponent, tetrahedra"].astype(float).between(0.8, 1.4).all()


def test_the_paper_s_costs_are_what_it_prints():
    table = cost.persistence_table(measured.read("cost"))
    assert table["paper ms"].tolist() == ["174", "388", "740", "1920", "11.0", ""]
    times = table["gudhi ms"].iloc[:4].astype(float)
    assert table["gudhi ms"].iloc[4] == pytest.approx(times.iloc[3] / times.iloc[0], abs=0.1)


def test_growth_is_fitted_over_all_sizes():
    stored = measured.read("cost")
    line = cost.persistence_table(stored).loc["growth exponent"]
    assert line["ours ms"] == growth_text(cost.torus_rows(stored).to_dict("records"))
    assert "±" in line["ours ms"] and "±" in cost.growth_table(stored).loc["soup", "exponent, gudhi"]


def test_speed_tables(tiny_scene, monkeypatch):
    case = (tiny_scene, initial_soup(tiny_scene.points, 60, 0))
    seconds = iter((10.0, 15.0, 12.0, 16.0, 11.0, 17.0))
    monkeypatch.setattr(speed, "run_row", lambda *arguments: dict.fromkeys(("cpu", "wall"), next(seconds)))
    stored = speed.measure_speed((50, 100), (32, 48), repetitions=1, runs=3, steps=100, case=case)
    assert list(stored["what"]) == ["step"] * 4 + ["run"] * 2 and (stored["ms"] > 0).all()
    steps = speed.step_table(stored)
    assert list(steps.index) == ["32 px", "48 px"] and list(steps.columns) == ["N = 50", "N = 100"]
    runs = speed.run_table(stored)
    assert runs["ours, one core"].tolist() == ["11.0 s", "16.0 s", "5.0 s"], "medians of runs in turn"
    assert runs["paper, GPU"].tolist() == ["33–41 s", "", "46 s"]
    assert speed.law_table(stored).loc["off by, at most", "value"].endswith(" %")
    assert len(speed.speed_figure(stored).axes[0].lines) == 5, "points and a line per N, the study's size"
    assert "medians of 1 turns" in speed.machine(stored)


def test_what_was_not_measured_is_said(tmp_path):
    nothing = measured.find("speed", tmp_path)
    tables = (
        speed.step_table(nothing),
        speed.law_table(nothing),
        speed.run_table(nothing)[["ours, one core"]],
    )
    assert speed.machine(nothing) == speed.NOT_MEASURED
    assert all((table == speed.NOT_MEASURED).all(axis=None) for table in tables)
    assert speed.speed_figure(nothing).axes[0].texts[0].get_text() == speed.NOT_MEASURED
    run = {"what": "run", "condition": "C0", "ms": 8.0, "steps": 2500}
    table = speed.run_table(pd.DataFrame([run]))["ours, one core"]
    assert table.tolist() == ["20.0 s", speed.NOT_MEASURED, speed.NOT_MEASURED]


def test_what_the_loss_adds_to_a_run(tmp_path):
    wanted = [("sphere", condition, 0) for condition in ("C0", "C1")]
    write_study(tmp_path, dict.fromkeys(wanted, 0.02))
    share = cost.share_table(collect(wanted, folder=tmp_path))
    assert share.loc["sphere", "loss adds %"] == round(100 * 10 / 35)
    assert share.loc["sphere", "share of training %"] == round(100 * 10 / 45)
    paper = share.iloc[-1]
    assert (paper["loss adds s"], paper["loss adds %"]) == ("46", "")
    assert not [name for name in share if "CPU" in name], "runs on an idle and a busy machine do not compare"
    assert (
        len(cost.share_table(collect(wanted[:1], folder=tmp_path))) == 1
    )  # no arm with the loss: the paper alone


def test_measurements_are_written_and_read(tmp_path, monkeypatch):
    monkeypatch.setattr(
        cost, "measure_cost", lambda progress=None: pd.DataFrame({"M": [2048], "fast_ms": [1 / 3]})
    )
    path = measured.write("cost", tmp_path)
    assert path.read_text() == "M,fast_ms\n2048,0.333333\n" and measured.read("cost", tmp_path)[
        "M"
    ].tolist() == [2048]
    with pytest.raises(InputError, match="python -m paper_artifact measure staircase"):
        measured.read("staircase", tmp_path)
    with pytest.raises(InputError, match="no measurement"):
        measured.write("nothing", tmp_path)


def test_significance_by_counts_is_the_floors():
    table = pd.DataFrame(
        [{"floor": 0.1} | {f"h1_{rank}": value for rank, value in enumerate((0.5, 0.11, 0.1, 0.05), 1)}]
    )
    assert kit.counts(table, 1).tolist() == [2]
    assert significant(np.array([[0, 0.5], [0, 0.11], [0, 0.1], [0, 0.05]]), 0.1).sum() == 2


def test_the_stored_starts_are_step_0_of_every_arm_that_starts_there():
    stored = measured.read("starts")
    assert stored.groupby("shape").size().eq(5).all()
    fresh = starts.start_rows("sphere", (3,))
    own = stored.query("shape == 'sphere' and seed == 3").reset_index(drop=True)
    pd.testing.assert_frame_equal(own, fresh, rtol=1e-5, check_dtype=False)
    dumps = frames.dumps(collect_study("allocation"))
    first = dumps[dumps["step"] == 0]
    assert {"C0", "B2", "B5"} <= set(first["condition"]) and "B1" not in set(first["condition"])
    same = first[(first["shape"] == "sphere") & (first["seed"] == 3)]
    assert len(same) == 5 and same["bottleneck"].nunique() == 1
    assert same["bottleneck"].iloc[0] == pytest.approx(fresh["bottleneck"].iloc[0], rel=1e-5)
    assert starts.start_of({**vars(study_config("sphere")), "budget": 900, "allocation": None}) is None
