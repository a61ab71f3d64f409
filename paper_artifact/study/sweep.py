"""Running a table of runs: what is recorded is not run again, what was killed resumes, one failing run stops
no other."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from paper_artifact.config import RunConfig, config_values
from paper_artifact.errors import InputError
from paper_artifact.record.store import read_record, recorded_path, write_record
from paper_artifact.scene.find import find_mesh
from paper_artifact.study.worker import failure_of, start_run


@dataclass(frozen=True)
class Outcome:
    """One run's end: its configuration, seconds of wall time, and the reason it failed (None when it is
    recorded)."""

    config: RunConfig
    seconds: float
    failure: str | None


def missing(configs: list[RunConfig], results: Path) -> list[RunConfig]:
    """Return those without a record in results/runs. A damaged record raises InputError: it is never silently
    overwritten."""
    todo = []
    for config in configs:
        path = recorded_path(config, results / "runs")
        if path is None:
            todo.append(config)
        else:
            read_record(path)
    return todo


class Estimate:
    """Remaining wall time, from the runs that this sweep recorded: by condition where there are any, else
    their mean."""

    def __init__(self, todo: list[RunConfig], workers: int) -> None:
        self._left = [config.condition for config in todo]
        self._workers, self._seconds = workers, {}

    def ended(self, outcome: Outcome) -> None:
        """Take note of an ended run; how long a failing one took tells nothing about the others."""
        self._left.remove(outcome.config.condition)
        if outcome.failure is None:
            self._seconds.setdefault(outcome.config.condition, []).append(outcome.seconds)

    def seconds(self) -> float | None:
        """Return the seconds left, None while nothing is known. Runs in progress count in full."""
        if not self._seconds and self._left:
            return None
        common = (
            mean(value for values in self._seconds.values() for value in values) if self._seconds else 0.0
        )
        total = sum(
            mean(self._seconds[condition]) if condition in self._seconds else common
            for condition in self._left
        )
        return total / max(1, min(self._workers, len(self._left)))

    def text(self) -> str:
        """Return "about N min left", or that it is not known yet."""
        seconds = self.seconds()
        return (
            "time left unknown until a run ends" if seconds is None else f"about {seconds / 60:.0f} min left"
        )


def run_processes(todo: list[RunConfig], results: Path, workers: int, device: str) -> Iterator[Outcome]:
    """Yield outcomes as they end; each run is a process of its own (`paper_artifact.study.worker`), at most
    `workers` at once."""
    children: set[subprocess.Popen] = set()
    stopping, lock = threading.Event(), threading.Lock()

    def one(config: RunConfig) -> Outcome:
        begin = time.perf_counter()
        try:
            with lock:  # no child may start unseen while the others are being stopped
                if stopping.is_set():
                    return Outcome(config, 0.0, "not started: the sweep was stopped")
                child = start_run(config_values(config), results, device)
                children.add(child)
            failure = failure_of(child)
            children.discard(child)
        except OSError as error:
            failure = f"the process could not be started: {error.strerror}"
        return Outcome(config, time.perf_counter() - begin, failure)

    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, config) for config in todo]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:  # also on Ctrl-C: checkpoints let the killed runs resume
            with lock:
                stopping.set()
                for child in list(children):
                    child.terminate()


def connect(scheduler: str):
    """Return a Dask client of the scheduler at this address. InputError when dask is not installed or nobody
    answers."""
    try:
        from dask.distributed import Client
    except ModuleNotFoundError as error:
        raise InputError(
            "--executor dask needs the optional extra: pip install 'paper_artifact[cluster]'"
        ) from error
    try:
        return Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler at {scheduler} ({error}); start one with `dask scheduler`"
        ) from error


def run_dask(todo: list[RunConfig], results: Path, client, device: str) -> Iterator[Outcome]:
    """Yield outcomes of the same runs on a Dask cluster (`connect`); records come back to this machine, soups
    do not.

    Runs of a worker that dies are given to another one; a run that fails is not tried again.
    """
    from dask.distributed import as_completed as dask_as_completed

    from paper_artifact.study.remote import remote_run

    futures = {
        client.submit(remote_run, config_values(config), device, pure=False): config for config in todo
    }
    for future in dask_as_completed(list(futures)):
        seconds, failure = 0.0, None
        try:
            record, seconds = future.result()
            write_record(record, results / "runs")
        except Exception as error:  # whatever happened over there is this run's failure, not the sweep's
            failure = (str(error).strip() or type(error).__name__).splitlines()[0]
        yield Outcome(futures[future], seconds, failure)


def sweep(
    configs: list[RunConfig],
    results: Path,
    *,
    workers: int = 1,
    device: str = "cpu",
    scheduler: str | None = None,
    report: Callable[[str, int, int], None] | None = None,
) -> list[Outcome]:
    """Run what is not recorded yet and return the outcomes; report(text, ended, total) is called when a run
    ends.

    scheduler: address of a Dask scheduler, None for local processes. Raises InputError for bad input before
    any run starts.
    """
    if workers < 1:
        raise InputError(f"--workers must be at least 1, got {workers}")
    for shape in dict.fromkeys(config.shape for config in configs):
        find_mesh(shape)  # a mesh that cannot be had is told before any run starts
    todo = missing(configs, results)
    outcomes: list[Outcome] = []
    with connect(scheduler) if scheduler and todo else nullcontext() as client:
        if client is not None:
            workers = max(1, sum(client.nthreads().values()))
        estimate = Estimate(todo, workers)
        if report:
            report(f"{len(configs) - len(todo)} of {len(configs)} recorded; {estimate.text()}", 0, len(todo))
        with closing(
            run_processes(todo, results, workers, device)
            if client is None
            else run_dask(todo, results, client, device)
        ) as running:
            for outcome in running:
                outcomes.append(outcome)
                estimate.ended(outcome)
                if report:
                    name = f"{outcome.config.shape} {outcome.config.condition} seed {outcome.config.seed}"
                    report(
                        f"{name} {'FAILED' if outcome.failure else 'done'}; {estimate.text()}",
                        len(outcomes),
                        len(todo),
                    )
    return outcomes
