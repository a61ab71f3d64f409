"""The benchmarks on tiny cases: what they report, never how long it took."""

from __future__ import annotations

import json

import pytest

from paper_artifact import cli
from paper_artifact.bench import raster, topology
from paper_artifact.bench.run import run_row
from paper_artifact.cli import bench
from paper_artifact.errors import InputError
from paper_artifact.soup.initialise import initial_soup


def test_raster_rows(tiny_scene, monkeypatch, tmp_path):
    monkeypatch.setattr(
        raster, "sphere_case", lambda results: (tiny_scene, initial_soup(tiny_scene.points, 40, 0))
    )
    rows = raster.raster_rows(tmp_path, repetitions=2)
    passes = {row["what"]: row for row in rows if row["ratio"] is not None}
    assert set(passes) == {
        f"forward + backward, {name}" for name in (raster.TRAINER, "twin float32", "twin float64")
    }
    assert passes[f"forward + backward, {raster.TRAINER}"]["ratio"] == 1 and all(
        row["ms"] > 0 for row in rows
    )
    stages = [row["what"].split("numba: ")[1] for row in rows if row["ratio"] is None]
    assert len(stages) == 6 and all(stage.endswith("(wall)") for stage in stages)


def test_loss_rows(tiny_scene, monkeypatch, tmp_path):
    monkeypatch.setattr(
        topology, "sphere_case", lambda results, steps: (tiny_scene, initial_soup(tiny_scene.points, 400, 0))
    )
    rows = topology.loss_rows(tmp_path, repetitions=1)
    assert (
        len(rows) == 3 and rows[0]["ratio"] == 1 and all(row["ms"] > 0 and row["ratio"] > 0 for row in rows)
    )


def test_plan_rows_have_more_pulls_than_points():
    rows = topology.plan_rows((300, 600), repetitions=1)
    assert [row["M"] for row in rows] == [300, 600]
    for row in rows:
        assert row["pulls"] > row["M"] and row["refresh_ms"] > 0 and row["frozen_ms"] > 0
    with pytest.raises(InputError, match="at least one repetition"):
        topology.plan_rows((300,), repetitions=0)


def test_run_row_measures_the_training_loop_with_its_term(tiny_results):
    row = run_row("sphere", "C1", 4, 2, tiny_results, views=8, size=64, budget=30, initial_ratio=2.0)
    assert {"photometric", "optimiser", "topology"} <= set(row["seconds"]) and "evaluate" not in row[
        "seconds"
    ]
    assert row["cpu"] > 0 and row["wall"] > 0 and row["peak_mb"] > 50 and 0 < row["loss"] < 1
    json.dumps(row, allow_nan=False)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["nonsense", "raster"], "unknown part nonsense; choose among raster, run, persistence, loss"),
        (["raster", "--steps=0"], "--steps must be at least 1, got 0"),
    ],
)
def test_bad_arguments_are_refused_before_any_measurement(arguments, words, monkeypatch, capsys):
    monkeypatch.setattr(bench, "_raster", None)  # calling it would fail
    assert cli.main(["bench", *arguments]) == 1
    assert words in capsys.readouterr().err


def test_the_verb_prints_rows(own_threads, monkeypatch, capsys):
    monkeypatch.setattr(
        raster,
        "raster_rows",
        lambda folder: [
            {"what": "this", "ms": 2.5, "ratio": 31.25},
            {"what": "that", "ms": 1.0, "ratio": None},
        ],
    )
    monkeypatch.setattr(
        "paper_artifact.bench.topology.loss_rows",
        lambda folder: [{"what": "refresh", "ms": 20.0, "ratio": 1.0}],
    )
    monkeypatch.setattr(
        "paper_artifact.bench.run.run_row",
        lambda shape, condition, steps, threads, folder: {
            "cpu": 40.0,
            "wall": 61.0,
            "peak_mb": 512.0,
            "seconds": {"photometric": 30.0},
        },
    )
    monkeypatch.setattr(
        "paper_artifact.bench.topology.plan_rows",
        lambda: [{"M": 2048, "pulls": 3000, "refresh_ms": 30.0, "persistence_ms": 20.0, "frozen_ms": 1.5}],
    )
    rows = [{"M": m, "fast_ms": m / 64, "gudhi_ms": m / 8, "ratio": 8.0, "tetrahedra": m} for m in (64, 128)]
    monkeypatch.setattr("paper_artifact.bench.persistence.persistence_rows", lambda **options: rows)
    assert cli.main(["bench", "raster", "run", "persistence", "loss", "--steps", "10"]) == 0
    printed = capsys.readouterr().out
    assert "M =    128   ours      2.0" in printed and "time grows as M^1.00" in printed
    assert "174 ms at M = 2048, 1920 ms at M = 20000" in printed, "as results/published/text_cost.csv has it"
    assert "(paper: 46 s beside 33 to 41 s)" in printed
    assert "M =  2048, 3000 pulls: refresh   30.0 (persistence   20.0)   frozen step   1.50" in printed
    assert "2.50     31.2 × the trainer's" in printed and "that" in printed
    assert (
        "40.0 s of CPU =  20.0 s per thread" in printed
        and "peak memory 512 MB (photometric 30.0 s)" in printed
    )
