"""The benchmarks on tiny cases: what they report, never how long it took."""

from __future__ import annotations

import json

import pytest

from paper_artifact import cli
from paper_artifact.bench import raster, topology
from paper_artifact.bench.run import run_row
from paper_artifact.cli import bench
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
    assert cli.main(["bench", "raster", "run", "--steps", "10"]) == 0
    printed = capsys.readouterr().out
    assert "2.50     31.2 × the trainer's" in printed and "that" in printed
    assert (
        "40.0 s of CPU =  20.0 s per thread" in printed
        and "peak memory 512 MB (photometric 30.0 s)" in printed
    )
