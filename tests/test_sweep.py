"""The sweep: its tables, what is not run again, what is killed, what fails; by processes and by Dask."""

import json
import os
import signal
import subprocess
import sys
import threading
import weakref
from collections import Counter
from concurrent.futures import Future
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import pytest
from distributed import LocalCluster

from paper_artifact import cli
from paper_artifact.config import config_from, config_values
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.record.store import record_path
from paper_artifact.study import studies
from paper_artifact.study import sweep as sweep_module
from paper_artifact.study.studies import STUDIES, study_configs
from paper_artifact.study.sweep import Estimate, Outcome, Step, missing, run_all, sweep
from tests.sweep_runs import CONFIGS, blocked_run, results_with_scene, same_run, wait_for_end
from tests.tiny_run import find_records

# --- the tables


def table(configs) -> Counter:
    """Return the number of seeds per (shape, condition), with a check that they are 0, 1, 2, …"""
    seeds: dict[tuple[str, str], list[int]] = {}
    for config in configs:
        seeds.setdefault((config.shape, config.condition), []).append(config.seed)
    assert all(values == list(range(len(values))) for values in seeds.values())
    return Counter({key: len(values) for key, values in seeds.items()})


def test_table1_is_the_papers():
    seeds = (
        (("sphere", "torus"), ("C0", "C1", "C2", "C2g", "C3", "C5", "C6"), 5),
        (("sphere", "torus"), ("C7", "C7h"), 3),
        (("cube", "two_spheres"), ("C0", "C1", "C2"), 3),
        (("double_torus",), ("C0", "C1", "C2"), 5),
    )
    expected = {arm: count for shapes, conditions, count in seeds for arm in product(shapes, conditions)}
    assert table(study_configs("table1")) == expected


@pytest.mark.parametrize("name, runs", [("baseline", 9), ("table1", 115), ("table2", 75), ("bowls", 18)])
def test_every_run_of_a_study_has_a_record_of_its_own_and_survives_json(name, runs):
    configs = study_configs(name)
    assert len(configs) == runs == sum(table(configs).values())
    assert len({record_path(config).name for config in configs}) == runs
    for config in configs:
        back = config_from(json.loads(json.dumps(config_values(config))))
        assert back == config and record_path(back) == record_path(config)
        assert (config.steps, len(config.dump_steps), config.samples) == (2500, 12, 20_000)


def test_all_runs_of_a_shape_share_every_setting_but_the_conditions():
    for name in STUDIES:
        settings = {}
        for block in STUDIES[name]:
            varied = ("strength", "schedule", "realism", "words_dirty", "allocation_forms")
            assert not block.changes or name in varied
            for config in replace(block, changes={}).configs():
                bare = replace(config, condition="C0", seed=0, loss=None, allocation=None)
                settings.setdefault(config.shape, set()).add(bare)
        assert all(len(values) == 1 for values in settings.values())
        shared = {replace(*values, shape="", budget=1) for values in settings.values()}
        assert len(shared) == 1, "one set of hyperparameters for all shapes"


def test_a_study_cut_short_leaves_whole_seeds():
    first = study_configs("table1")[:6]
    assert {config.seed for config in first} == {0} and len(table(first)) == 6


def test_restrictions():
    restricted = table(study_configs("table1", ["torus"], ["C1", "C7"], [0, 1]))
    assert restricted == {("torus", "C1"): 2, ("torus", "C7"): 2}
    assert table(study_configs("table1", [], None, [0])).total() == 27
    assert [config.seed for config in study_configs("table1", ["cube"], ["C2"])] == [0, 1, 2]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("table1", ["sphere", "shpere"]), "has no shape shpere"),
        (("table1", ["cube"], ["C6"]), "has no run with shape"),
    ],
)
def test_names_without_a_run_are_refused(arguments, words):
    """Unknown studies, shapes, conditions and seeds, by the command line: test_bad_inputs."""
    with pytest.raises(InputError, match=words):
        study_configs(*arguments)


# --- the estimate


def test_estimate_from_fake_durations():
    configs = study_configs("table1", ["sphere"], ["C0", "C1"], [0, 1, 2])  # C0, C1, C0, C1, C0, C1
    estimate = Estimate(configs, workers=2)
    assert estimate.seconds() is None and "not known" in estimate.text()
    estimate.ended(Outcome(configs[1], 1.0, "it broke at once"))
    assert estimate.seconds() is None, "a failed run says nothing about the others"
    estimate.ended(Outcome(configs[0], 600.0, None))
    assert estimate.seconds() == 4 * 600 / 2  # C1 has not been seen: as long as the others
    assert estimate.text() == "about 20 min left"
    estimate.ended(Outcome(configs[3], 1200.0, None))
    assert estimate.seconds() == (2 * 600 + 1200) / 2
    estimate.ended(Outcome(configs[2], 660.0, None))
    assert estimate.seconds() == (630 + 1200) / 2
    estimate.ended(Outcome(configs[5], 1200.0, None))
    assert estimate.seconds() == 630, "one run left keeps one worker busy, not two"
    estimate.ended(Outcome(configs[4], 630.0, None))
    assert estimate.seconds() == 0 and estimate.text() == "about 0 min left"


def test_estimate_from_the_first_steps_on():
    configs = study_configs("table1", ["sphere"], ["C0", "C1"], [0, 1, 2])  # 2,500 steps each
    estimate = Estimate(configs, workers=2)
    estimate.stepped(Step(configs[0], 1, 20.0))
    assert estimate.seconds() is None, "one sign has no pace"
    assert estimate.running() == "sphere C0 seed 0 0 %"
    estimate.stepped(Step(configs[0], 501, 30.0))  # .02 s a step: 39.98 s left, a whole one takes 50
    assert estimate.seconds() == pytest.approx((39.98 + 5 * 50) / 2)
    estimate.stepped(Step(configs[1], 1001, 40.0))  # went on from its checkpoint, of step 1000
    estimate.stepped(Step(configs[1], 1251, 50.0))  # .04 s a step: 49.96 s left, a whole one takes 100
    assert estimate.seconds() == pytest.approx((39.98 + 49.96 + 2 * 50 + 2 * 100) / 2)
    assert estimate.running() == "sphere C0 seed 0 20 %, sphere C1 seed 0 50 %"
    estimate.ended(Outcome(configs[0], 80.0, None))
    assert estimate.seconds() == pytest.approx((49.96 + 2 * 80 + 2 * 100) / 2), "what ended is known better"
    estimate.ended(Outcome(configs[1], 60.0, "it broke"))
    assert estimate.seconds() == 4 * 80 / 2 and estimate.running() == ""


# --- runs in processes


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """(results, outcomes, reports) of a sweep by two processes at a time, never stopped."""
    results = results_with_scene(tmp_path_factory.mktemp("swept") / "results")
    return results, *sweep_with_a_vanishing_mesh(results, workers=2)


def sweep_with_a_vanishing_mesh(results, **options):
    """Return (outcomes, reports) of the two runs and one whose mesh file is gone when its run begins."""
    mesh, reports = results.parent / "vanishing.obj", []
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")

    def report(*arguments):
        reports.append(arguments)
        mesh.unlink(missing_ok=True)

    return sweep([replace(CONFIGS[0], shape=str(mesh)), *CONFIGS], results, report=report, **options), reports


def test_a_failing_run_is_told_and_the_others_are_done(swept):
    results, outcomes, reports = swept
    (failed,) = (outcome for outcome in outcomes if outcome.failure)
    assert "vanishing.obj" in failed.failure and "Traceback" not in failed.failure
    records = find_records(results / "runs")
    assert [record["config"]["seed"] for record in records] == [0, 1] and len(outcomes) == 3
    assert all(record["dumps"] and record["resumed_at"] is None for record in records)
    assert not list((results / "checkpoints").iterdir())
    assert {ended for _, ended, _ in reports} == {0, 1, 2, 3} and {total for _, _, total in reports} == {3}
    steps = [text for text, _, _ in reports if "%" in text]
    assert len(reports) == 4 + len(steps), "runs that end and steps"
    assert any("sphere C0 seed 0 8 %" in text for text in steps), "step 1 of 12"
    assert reports[0][0].startswith("0 of 3 recorded")
    assert sum("FAILED" in text for text, _, _ in reports) == 1
    assert reports[-1][0].endswith("about 0 min left")


def tiny_studies(monkeypatch):
    def config(shape, condition, seed, **_):
        return replace(CONFIGS[0], shape=shape, seed=seed)

    monkeypatch.setattr(studies, "study_config", config)


def test_what_is_recorded_is_not_run_again(swept, monkeypatch, capsys):
    results, _, _ = swept
    monkeypatch.setattr(sweep_module, "start_run", None)  # calling it would fail
    times = {path: path.stat().st_mtime_ns for path in (results / "runs").iterdir()}
    reports = []
    assert sweep(list(CONFIGS), results, report=lambda *arguments: reports.append(arguments)) == []
    assert {path: path.stat().st_mtime_ns for path in (results / "runs").iterdir()} == times
    assert reports == [("2 of 2 recorded; about 0 min left", 0, 0)]
    tiny_studies(monkeypatch)
    baseline = ["sweep", "baseline", "--shape=sphere", f"--results={results}"]
    assert cli.main([*baseline, "--quiet", "--seed=0"]) == 0
    assert "recorded before, 0 failed\nnext: python -m paper_artifact book --ru" in capsys.readouterr().out
    assert cli.main([*baseline, "--list"]) == 0
    assert "C0 seed 2\n2 of 3 runs recorded\nnext: python -m paper" in capsys.readouterr().out


def test_the_verb_lists_failures_last_and_exits_with_1(swept, monkeypatch, capsys):
    results, _, _ = swept
    asked = []

    def fail(todo, results, device, workers, client):
        asked.append((workers, device))
        yield from (Outcome(config, 1.0, f"no luck with {config.seed}") for config in todo)

    monkeypatch.setattr(sweep_module, "run_all", fail)
    tiny_studies(monkeypatch)
    arguments = ["sweep", "baseline", "--shape=sphere", "--quiet", "--workers=3", f"--results={results}"]
    assert cli.main(arguments) == 1
    assert capsys.readouterr().out.splitlines() == [
        "0 runs done, 2 were recorded before, 1 failed",
        "  sphere C0 seed 2: no luck with 2",
    ]
    assert asked == [(3, "cpu")]


def sweep_process(configs: str, results) -> subprocess.Popen:
    """Start a sweep in a process and a group of its own; it exits with 1 where a run fails."""
    program = (
        "from pathlib import Path\nfrom tests.sweep_runs import CONFIGS\n"
        "from paper_artifact.study.sweep import sweep\n"
        f"raise SystemExit(any(each.failure for each in sweep(list({configs}), Path({str(results)!r}))))"
    )
    return subprocess.Popen([sys.executable, "-c", program], cwd=REPOSITORY, start_new_session=True)


def test_a_killed_sweep_goes_on_to_the_same_record(swept, tmp_path, monkeypatch):
    results = results_with_scene(tmp_path / "results", copy_of=swept[0])
    with monkeypatch.context() as patched:
        marker = blocked_run(tmp_path, patched)
        process = sweep_process("CONFIGS[:1]", results)
        marker.wait(process)
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    wait_for_end(marker.pid)
    assert missing(list(CONFIGS), results) == {config: config for config in CONFIGS}
    assert len(list((results / "checkpoints").glob("*.pt"))) == 1
    (outcome,) = sweep([CONFIGS[0]], results)
    assert outcome.failure is None
    (record,), expected = find_records(results / "runs"), find_records(swept[0] / "runs", seed=0)[0]
    assert record["resumed_at"] == marker.step and same_run(record, expected)


def test_two_equal_sweeps_at_once_leave_one_record_of_each_run(swept, tmp_path):
    results = results_with_scene(tmp_path / "results", copy_of=swept[0])
    both = [sweep_process("CONFIGS", results) for _ in range(2)]
    assert [process.wait() for process in both] == [0, 0]
    records, expected = find_records(results / "runs"), find_records(swept[0] / "runs")
    assert len(records) == 2 and all(same_run(*pair) for pair in zip(records, expected, strict=True))
    assert not list((results / "checkpoints").iterdir()) and len(list((results / "soups").iterdir())) == 2


def test_a_damaged_record_is_never_overwritten(swept, tmp_path, monkeypatch):
    results = results_with_scene(tmp_path / "results")
    path = record_path(CONFIGS[1], results / "runs")
    path.parent.mkdir()
    text = record_path(CONFIGS[1], swept[0] / "runs").read_text()
    monkeypatch.setattr(sweep_module, "start_run", None)
    for bad in (text[: len(text) // 2], text.replace('"sphere"', '"torus"'), ""):
        path.write_text(bad)
        with pytest.raises(InputError, match=path.name):
            sweep(list(CONFIGS), results)
        assert path.read_text() == bad


def test_a_run_ended_by_a_signal_or_without_a_word(monkeypatch):
    steps = []

    def start(command):
        return lambda values, results, device: subprocess.Popen(
            [sys.executable, "-c", command], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def failure(command):
        monkeypatch.setattr(sweep_module, "start_run", start(command))
        *signs, outcome = sweep_module.run_all({CONFIGS[0]: CONFIGS[0]}, REPOSITORY, "cpu", 1)
        steps.extend(sign.step for sign in signs)
        return outcome.failure

    assert failure("import os; os.kill(os.getpid(), 9)") == "the process was ended by signal 9"
    assert failure("raise SystemExit(4)") == "the process ended with exit code 4"
    assert failure("raise ValueError('first\\nlast')") == "last"
    assert failure("import sys; print('a warning', file=sys.stderr)") is None
    words = "'a reason', 'step 1', 'step x', 'step 7'"
    told = f"import sys; print({words}, sep='\\n', file=sys.stderr); raise SystemExit(1)"
    assert failure(told) == "step x", "the last line that is no sign of progress"
    assert steps == [1, 7]


def test_a_sweep_that_is_stopped_ends_its_runs(monkeypatch):
    children = []

    def start(values, results, device):
        stopped = "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"
        command = [sys.executable, "-c", stopped if values["seed"] else "pass"]
        children.append(subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return children[-1]

    monkeypatch.setattr(sweep_module, "start_run", start)

    def interrupt(text, ended, total):
        if ended:
            raise KeyboardInterrupt

    monkeypatch.setattr(sweep_module, "missing", lambda configs, results: {each: each for each in configs})
    with pytest.raises(KeyboardInterrupt):
        sweep([replace(CONFIGS[0], seed=seed) for seed in range(5)], REPOSITORY, workers=2, report=interrupt)
    assert 0 < len(children) < 5 and {child.returncode for child in children} <= {0, -signal.SIGKILL}


@pytest.mark.parametrize(
    "argument, words",
    [
        ("--workers=0", "--workers must be at least 1, got 0"),
        ("--scheduler=tcp://127.0.0.1:1", "belong together"),
    ],
)
def test_bad_arguments_are_one_line(argument, words, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sweep_module, "start_run", None)
    assert cli.main(["sweep", "table1", argument, "--quiet", f"--results={tmp_path / 'results'}"]) == 2
    error = capsys.readouterr().err
    assert words in error and len(error.splitlines()) == 1


# --- runs on a Dask cluster


def test_a_dask_worker_killed_while_it_works_costs_no_record(swept, tmp_path, monkeypatch):
    marker = blocked_run(tmp_path, monkeypatch)
    options = {"threads_per_worker": 1, "processes": True, "host": "127.0.0.1", "dashboard_address": ":0"}
    with LocalCluster(n_workers=2, local_directory=str(tmp_path / "dask"), **options) as cluster:
        workers = {worker.pid for worker in cluster.workers.values()}

        def kill():
            marker.wait()
            os.kill(marker.parent, signal.SIGKILL)

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        options = {"scheduler": cluster.scheduler_address}
        outcomes, reports = sweep_with_a_vanishing_mesh(tmp_path / "results", **options)
        killer.join()
        assert marker.parent in workers, "the run was a child of a worker"
        wait_for_end(marker.pid)  # nothing goes on with work that nobody waits for
    (failed,) = (outcome for outcome in outcomes if outcome.failure)
    assert "vanishing.obj" in failed.failure and reports[-1][1:] == (3, 3)
    assert all(outcome.seconds > 0 for outcome in outcomes if outcome is not failed)
    records, expected = find_records(tmp_path / "results" / "runs"), find_records(swept[0] / "runs")
    assert len(records) == 2 and all(same_run(*pair) for pair in zip(records, expected, strict=True))
    assert missing(list(CONFIGS), tmp_path / "results") == {}


def test_a_run_is_let_go_once_it_is_recorded(monkeypatch):
    """Dask makes a finished run again when its worker dies, as long as somebody holds its future."""
    held = []

    def submit(work, *arguments):
        future = Future()
        future.set_result(work(*arguments))
        held.append(weakref.ref(future))
        return future

    pool = SimpleNamespace(submit=submit, shutdown=lambda **settings: None)
    monkeypatch.setattr(sweep_module, "remote_run", lambda values, device: (1.0, None))
    running = run_all(
        {config: config for config in CONFIGS},
        REPOSITORY,
        "cpu",
        1,
        SimpleNamespace(get_executor=lambda: pool),
    )
    for left in (1, 0):
        assert next(running).failure is None
        assert sum(each() is not None for each in held) == left


def test_a_scheduler_without_workers_and_results_that_cannot_be_written_are_told_at_once(tmp_path):
    options = {"processes": False, "dashboard_address": None, "scheduler_port": 0, "protocol": "tcp"}
    with LocalCluster(n_workers=0, host="127.0.0.1", **options) as cluster:
        address = cluster.scheduler_address
        with pytest.raises(InputError, match="has no workers; start one with `dask worker tcp://"):
            sweep([CONFIGS[0]], tmp_path, scheduler=address)
        (tmp_path / "file").write_text("")
        with pytest.raises(InputError, match="Not a directory"):
            sweep([CONFIGS[0]], tmp_path / "file", scheduler=address)


def test_no_scheduler_is_told_in_one_line(tmp_path):
    with pytest.raises(InputError, match="no Dask scheduler at nowhere://127.0.0.1:1 .*dask scheduler"):
        sweep([CONFIGS[0]], tmp_path, scheduler="nowhere://127.0.0.1:1")
