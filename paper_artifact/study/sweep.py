"""Running a table of runs: what is recorded is not run again, what was killed resumes, one failing run stops no other."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import mean
from typing import Callable, Iterator

from paper_artifact.errors import InputError
from paper_artifact.record.record import read_record, record_path, write_record
from paper_artifact.train.config import RunConfig
from paper_artifact.train.run import find_mesh, with_condition


@dataclass(frozen=True)
class Outcome:
    """One run's end: its configuration, seconds of wall time, and the reason it failed (None when it is recorded)."""

    config: RunConfig
    seconds: float
    failure: str | None


def complete(configs: list[RunConfig]) -> list[RunConfig]:
    """Return the configurations with their conditions written out (see `with_condition`); meshes are loaded once per shape."""
    meshes = {shape: find_mesh(shape) for shape in dict.fromkeys(config.shape for config in configs)}
    return [with_condition(config, meshes[config.shape]) for config in configs]


def missing(configs: list[RunConfig], results: Path) -> list[RunConfig]:
    """Return those without a record in results/runs. A damaged record raises InputError: it is never silently overwritten."""
    todo = []
    for config in configs:
        path = record_path(config, results / "runs")
        if path.is_file():
            read_record(path)
        else:
            todo.append(config)
    return todo


class Estimate:
    """Remaining wall seconds, from the runs of this sweep that ended: per condition where there are any, else their common mean."""

    def __init__(self, todo: list[RunConfig], workers: int) -> None:
        self._left = [config.condition for config in todo]
        self._workers, self._seconds = workers, {}

    def ended(self, config: RunConfig, seconds: float) -> None:
        """Take note of an ended run."""
        self._left.remove(config.condition)
        self._seconds.setdefault(config.condition, []).append(seconds)

    def text(self) -> str:
        """Return "about N min left", or that it is not known before the first run has ended."""
        if not self._seconds:
            return "time left unknown until a run ends"
        common = mean(value for values in self._seconds.values() for value in values)
        total = sum(mean(self._seconds[condition]) if condition in self._seconds else common for condition in self._left)
        return f"about {total / self._workers / 60:.0f} min left"


def run_processes(todo: list[RunConfig], results: Path, workers: int, device: str) -> Iterator[Outcome]:
    """Yield outcomes as they end; each run is a process of its own (`paper_artifact.study.worker`), at most `workers` at once."""
    children: set[subprocess.Popen] = set()
    stopping = threading.Event()

    def one(config: RunConfig) -> Outcome:
        begin = time.perf_counter()
        if stopping.is_set():
            return Outcome(config, 0.0, "not started: the sweep was stopped")
        child = subprocess.Popen([sys.executable, "-m", "paper_artifact.study.worker", json.dumps(asdict(config)), str(results), device],
                                 stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        children.add(child)
        _, errors = child.communicate()
        children.discard(child)
        failure = None
        if child.returncode:
            lines = errors.strip().splitlines()
            failure = lines[-1] if lines else f"the process ended with {child.returncode}"
        return Outcome(config, time.perf_counter() - begin, failure)

    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, config) for config in todo]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:  # also on Ctrl-C: checkpoints let the killed runs resume
            stopping.set()
            for child in list(children):
                child.terminate()


def run_dask(todo: list[RunConfig], results: Path, scheduler: str, device: str) -> Iterator[Outcome]:
    """Yield outcomes of the same runs on a Dask cluster; records come back to this machine, soups stay on the workers' disks.

    Runs of a worker that dies are given to another one. Raises InputError when dask is not installed or the scheduler not reached.
    """
    try:
        from dask.distributed import Client
        from dask.distributed import as_completed as dask_as_completed
    except ModuleNotFoundError as error:
        raise InputError("--executor dask needs the optional extra: pip install 'paper_artifact[cluster]'") from error
    from paper_artifact.study.remote import remote_run

    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler at {scheduler} ({error}); start one with `dask scheduler`") from error
    with client:
        begin = time.perf_counter()
        futures = {client.submit(remote_run, asdict(config), device, pure=False, retries=2): config for config in todo}
        for future in dask_as_completed(list(futures)):
            config, failure = futures[future], None
            try:
                write_record(future.result(), results / "runs")
            except Exception as error:  # whatever happened over there is this run's failure, not the sweep's
                failure = f"{type(error).__name__}: {error}".splitlines()[0]
            yield Outcome(config, time.perf_counter() - begin, failure)


def sweep(configs: list[RunConfig], results: Path, *, workers: int = 1, device: str = "cpu", scheduler: str | None = None,
          report: Callable[[str, int, int], None] | None = None) -> list[Outcome]:
    """Run what is not recorded yet and return the outcomes; report(text, ended, total) is called when a run ends.

    scheduler: address of a Dask scheduler, None for local processes. Raises InputError for bad input before any run starts.
    """
    if workers < 1:
        raise InputError(f"--workers must be at least 1, got {workers}")
    todo = missing(complete(configs), results)
    estimate = Estimate(todo, workers)
    if report:
        report(f"{len(configs) - len(todo)} of {len(configs)} recorded; {estimate.text()}", 0, len(todo))
    outcomes = []
    running = run_dask(todo, results, scheduler, device) if scheduler else run_processes(todo, results, workers, device)
    for outcome in running:
        outcomes.append(outcome)
        estimate.ended(outcome.config, outcome.seconds)
        if report:
            name = f"{outcome.config.shape} {outcome.config.condition} seed {outcome.config.seed}"
            report(f"{name} {'FAILED' if outcome.failure else 'done'}; {estimate.text()}", len(outcomes), len(todo))
    return outcomes
