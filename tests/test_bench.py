"""The benchmarks on tiny cases: what they report, never how long it took."""

from __future__ import annotations

import argparse
import json
import re
import threading

import pytest

from paper_artifact import cli, kernel_cache
from paper_artifact.bench import compilation, gpu, raster, speed, topology
from paper_artifact.bench.child import run_child
from paper_artifact.bench.reach import large_row, photographs_row
from paper_artifact.bench.run import run_row
from paper_artifact.cli import _bench_parts as bench_parts
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.raster.threads import thread_count
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


def test_a_child_tells_lines_and_fails_with_its_last_words(tmp_path):
    told = []
    program = (
        "import os, sys; print('one'); print('two'); print(os.getcwd(), file=sys.stderr); print(sys.argv[1])"
    )
    result = run_child(program, {"M": 3}, told.append, folder=tmp_path)
    assert result == ({"M": 3}, [str(tmp_path)]) and told == ["one", "two"]
    with pytest.raises(RuntimeError, match="the benchmark run failed: ValueError: no luck"):
        run_child("raise ValueError('no luck')", None)


def test_photographs_are_loaded_and_trained_on(tmp_path):
    told = []
    row = photographs_row(tmp_path, 4, 40, budget=50, steps=2, told=told.append)
    assert (row["views"], row["size"], row["N"]) == (4, 40, 50) and told == [
        "loading",
        "step 1 of 2",
        "step 2 of 2",
    ]
    assert 50 < row["loaded_mb"] <= row["peak_mb"]


def test_a_large_cloud_tells_its_stages():
    told = []
    row = large_row(500, "soup", told.append)
    assert told == ["delaunay", "filtration", "reduction", "pairs"] and row["M"] == 500
    assert len(row["bars"]) == 3 and row["bars"][0] == 499 and row["peak_mb"] > 50


def test_every_module_with_kernels_is_used_and_counted():
    told = []
    row, _ = run_child(compilation._PROGRAM, None, told.append)  # with the cache of this checkout
    assert told == list(compilation.WORKS)
    assert row["cpu"] > 0 and row["compiled"] + row["loaded"] > 0 and len(row["unused"]) < row["kernels"]
    kept = re.compile(r"^@njit\(.*cache=True", re.MULTILINE)
    files = [
        path.relative_to(REPOSITORY)
        for path in kernel_cache.PACKAGE.rglob("*.py")
        if kept.search(path.read_text())
    ]
    assert row["modules"] == sorted(".".join(path.with_suffix("").parts) for path in files)


def test_a_resized_soup_covers_the_same_surface(tiny_scene):
    soup = initial_soup(tiny_scene.points, 40, 0)

    def area(corners):
        a, b, c = corners.detach().unbind(1)
        return float((b - a).cross(c - a, dim=1).norm(dim=1).sum())

    for count in (41, 80, 300):
        larger = speed.resized_soup(soup, count)
        assert len(larger) == count and area(larger.vertices) == pytest.approx(area(soup.vertices), rel=1e-5)
        assert larger.features.shape == (count, 3, 7) and larger.opacity.shape == (count, 3)
    assert len(speed.resized_soup(soup, 10)) == 10
    with pytest.raises(InputError, match="at least one"):
        speed.resized_soup(soup, 0)


def test_step_rows_and_thread_rows(tiny_scene, tmp_path):
    case = (tiny_scene, initial_soup(tiny_scene.points, 60, 0))
    rows = list(speed.step_rows(tmp_path, (50, 100), (32, 48), repetitions=1, case=case))
    assert [(row["size"], row["N"]) for row in rows] == [(32, 50), (32, 100), (48, 50), (48, 100)]
    assert all(row["ms"] > 0 and row["wall_ms"] > 0 and row["views"] == 4 for row in rows)
    before = thread_count()
    rows = speed.thread_rows(tmp_path, (32,), repetitions=1, case=case)
    assert [(row["threads"], row["speedup"]) for row in rows][0] == (1, 1.0) and rows[1]["threads"] == 2
    assert thread_count() == before
    with pytest.raises(InputError, match="at least one repetition"):
        list(speed.step_rows(tmp_path, repetitions=0, case=case))


def test_the_law_is_found_again_in_rows_that_follow_it():
    law = {"a": 0.5, "b": 0.04, "c": 0.2, "d": 0.003}
    rows = []
    for n in (1_000, 10_000, 30_000):
        for size in (100, 400, 1600):
            pixels = 4 * size**2
            ms = 0.5 + 0.04 * pixels / 1e3 + 0.2 * n / 1e3 + 0.003 * (n * pixels) ** 0.5 / 1e3
            rows.append({"N": n, "size": size, "views": 4, "ms": ms})
    constants, residuals = speed.fit_law(rows)
    assert constants == pytest.approx(law, rel=1e-6) and abs(residuals).max() < 1e-9
    rows[0]["ms"] *= 2
    assert abs(speed.fit_law(rows)[1]).max() > 0.1 and "at most" in speed.law_text(*speed.fit_law(rows))
    with pytest.raises(InputError, match="as many measurements"):
        speed.fit_law(rows[:3])


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["nonsense", "raster"], "unknown part nonsense; choose among raster, run, compile, reach"),
        (["raster", "--steps=0"], "--steps must be at least 1, got 0"),
    ],
)
def test_bad_arguments_are_refused_before_any_measurement(arguments, words, monkeypatch, capsys):
    monkeypatch.setattr(bench_parts, "print_raster", None)  # calling it would fail
    assert cli.main(["bench", *arguments]) == 2
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
    turns = [
        {"size": 200, "threads": number, "wall_ms": 9.0 / number, "cpu_ms": 9.0, "speedup": 1.0 * number}
        for number in (1, 2)
    ]
    monkeypatch.setattr(speed, "thread_rows", lambda folder: turns)
    monkeypatch.setattr(
        "paper_artifact.bench.reach.large_row",
        lambda told: {"cloud": "soup", "M": 10**6, "cpu": 20.0, "wall": 21.0, "peak_mb": 3500},
    )
    counts = {"kernels": 60, "compiled": 0, "loaded": 60, "notices": 0, "unused": ["left"]}
    compiled = [
        {"what": compilation.COLD, "cpu": 30.0, "wall": 31.0} | counts | {"compiled": 70, "loaded": 0},
        {"what": compilation.KEPT, "cpu": 5.0, "wall": 6.0} | counts,
        {"what": compilation.CLOSED, "cpu": 30.0, "wall": 31.0} | counts | {"compiled": 70, "notices": 1},
    ]
    monkeypatch.setattr(compilation, "compilation_rows", lambda told: compiled)
    rows = [{"M": m, "fast_ms": m / 64, "gudhi_ms": m / 8, "ratio": 8.0, "tetrahedra": m} for m in (64, 128)]
    monkeypatch.setattr("paper_artifact.bench.persistence.persistence_rows", lambda **options: rows)
    assert (
        cli.main(["bench", "raster", "run", "compile", "persistence", "loss", "--steps=10", "--quiet"]) == 0
    )
    printed = capsys.readouterr().out
    assert "M =    128   ours      2.0" in printed and "time grows as M^p, p = 1.00" in printed
    assert "174 ms at M = 2048, 1920 ms at M = 20000" in printed, "as results/published/text_cost.csv has it"
    assert "(paper: 46 s beside 33 to 41 s)" in printed
    assert "M =  2048, 3000 pulls: refresh   30.0 (persistence   20.0)   frozen step   1.50" in printed
    assert "2.50     31.2 × the trainer's" in printed and "that" in printed
    assert (
        "2 thread(s): CPU   40.0 s, wall   61.0 s" in printed
        and "peak memory 512 MiB (photometric 30.0 s)" in printed
    )
    assert "the paper's, on its GPU: 33–41 s" in printed and "2.00 × as fast as one" in printed
    assert "60 kernels kept, 0 compilations, 60 loaded" in printed and "told 1 time(s)" in printed
    assert "not compiled here: left" in printed
    assert "compilation alone, first less second: 25.0 s of CPU" in printed
    assert "M = 1000000: CPU 20.0 s, wall 21.0 s, peak memory 3500 MiB" in printed


def test_gpu_memory_is_read_while_the_run_goes_on(monkeypatch, tmp_path, capsys):
    readings = iter([100, 150, 400, *[120] * 100])
    asked = threading.Event()

    def read():
        value = next(readings)
        if value == 400:
            asked.set()
        return value

    monkeypatch.setattr(gpu, "INTERVAL", 0.001)
    row = gpu.peak_during(lambda: {"allocated_mib": 7.0 if asked.wait(60) else 0.0}, read)
    assert row == {"allocated_mib": 7.0, "before_mib": 100, "peak_mib": 400}
    monkeypatch.setattr(gpu, "ASK", (str(tmp_path / "no-nvidia-smi"),))
    with pytest.raises(InputError, match="needs an NVIDIA GPU"):
        gpu.used_mib()
    assert not gpu.gpu_is_here()
    bench_parts.print_gpu(tmp_path, argparse.Namespace(steps=3, quiet=True))
    assert "not measured, no NVIDIA GPU" in capsys.readouterr().out
    # Where there is one: the whole protocol with a few steps.
    monkeypatch.undo()
    if gpu.gpu_is_here():
        assert gpu.memory_row("C0", tmp_path, 3)["allocated_mib"] > 0
