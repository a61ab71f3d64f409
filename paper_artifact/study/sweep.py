"""Running a table of runs: what is recorded is not run again, what was killed resumes, one failing run stops
no other; and how long it will still take."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from statistics import mean

from paper_artifact.config import RunConfig, config_values
from paper_artifact.errors import InputError
from paper_artifact.record.store import read_record, recorded_path, write_record
from paper_artifact.scene.given import called, is_own, resolve
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.study.worker import failure_of, start_run


@dataclass(frozen=True)
class Outcome:
    """One run's end."""

    config: RunConfig
    seconds: float  # of wall time
    failure: str | None  # why it failed, None when it is recorded


@dataclass(frozen=True)
class Step:
    """What a run in progress tells."""

    config: RunConfig
    step: int  # taken by now
    seconds: float  # of wall time since its process was started


class Estimate:
    """Remaining wall time. A run in progress is followed by its steps; one that waits is expected to take as
    long as those of its condition, else as all others: those that ended, else those in progress."""

    def __init__(self, todo: list[RunConfig], workers: int) -> None:
        self._left, self._workers = list(todo), workers
        self._ended: dict[str, list[float]] = {}  # by condition, seconds of the runs that this sweep recorded
        self._first: dict[RunConfig, Step] = {}  # of the runs in progress
        self._latest: dict[RunConfig, Step] = {}

    def stepped(self, step: Step) -> None:
        """Take note of a step."""
        self._first.setdefault(step.config, step)
        self._latest[step.config] = step

    def ended(self, outcome: Outcome) -> None:
        """Take note of an ended run; how long a failing one took tells nothing about the others."""
        self._left.remove(outcome.config)
        self._first.pop(outcome.config, None)
        self._latest.pop(outcome.config, None)
        if outcome.failure is None:
            self._ended.setdefault(outcome.config.condition, []).append(outcome.seconds)

    def _pace(self, config: RunConfig) -> float | None:
        """Return the seconds per step of a run in progress, its start left out; None before its second
        sign."""
        first, latest = self._first.get(config), self._latest.get(config)
        if first is None or latest is None or latest.step <= first.step:
            return None
        return (latest.seconds - first.seconds) / (latest.step - first.step)

    def seconds(self) -> float | None:
        """Return the seconds left, None while nothing is known."""
        paces = {config: pace for config in self._left if (pace := self._pace(config)) is not None}
        known = {condition: list(values) for condition, values in self._ended.items()}
        for config, pace in paces.items():
            if config.condition not in self._ended:
                whole = self._first[config].seconds + pace * config.steps
                known.setdefault(config.condition, []).append(whole)
        if self._left and not known:
            return None
        common = mean(value for values in known.values() for value in values) if known else 0.0
        total = 0.0
        for config in self._left:
            if config in paces:
                total += paces[config] * (config.steps - self._latest[config].step)
            else:
                total += mean(known.get(config.condition, [common]))
        return total / max(1, min(self._workers, len(self._left)))

    def text(self) -> str:
        """Return "about N min left", or that it is not known yet."""
        seconds = self.seconds()
        return "time left not known yet" if seconds is None else f"about {seconds / 60:.0f} min left"

    def running(self) -> str:
        """Return the runs in progress, each with the percentage of its steps."""
        return ", ".join(
            f"{run_name(config)} {100 * latest.step // config.steps} %"
            for config, latest in self._latest.items()
        )


def run_name(config: RunConfig) -> str:
    """Return "SHAPE CONDITION seed SEED"."""
    return f"{called(config)} {config.condition} seed {config.seed}"


def missing(configs: list[RunConfig], results: Path) -> list[RunConfig]:
    """Return those without a record in results/runs; one's own data are read to be known again.

    A damaged record raises InputError: it is never silently overwritten.
    """
    todo = []
    for config in configs:
        run = resolve(config).config if is_own(config) else config
        path = recorded_path(run, results / "runs")
        if path is None:
            todo.append(config)
        else:
            read_record(path)
    return todo


def run_processes(
    todo: list[RunConfig], results: Path, workers: int, device: str
) -> Iterator[Outcome | Step]:
    """Yield outcomes as runs end, and steps meanwhile; each run is a process of its own
    (`paper_artifact.study.worker`), at most `workers` at once."""
    children: set[subprocess.Popen] = set()
    events: SimpleQueue[Step | Future[Outcome]] = SimpleQueue()
    stopping, lock = threading.Event(), threading.Lock()

    def one(config: RunConfig) -> Outcome:
        begin = time.perf_counter()
        try:
            with lock:  # no child may start unseen while the others are being stopped
                if stopping.is_set():
                    return Outcome(config, 0.0, "not started: the sweep was stopped")
                child = start_run(config_values(config), results, device)
                children.add(child)
            failure = failure_of(
                child, lambda step: events.put(Step(config, step, time.perf_counter() - begin))
            )
            children.discard(child)
        except OSError as error:
            failure = f"the process could not be started: {error.strerror}"
        return Outcome(config, time.perf_counter() - begin, failure)

    with ThreadPoolExecutor(workers) as pool:
        for config in todo:
            pool.submit(one, config).add_done_callback(events.put)
        try:
            left = len(todo)
            while left:
                event = events.get()
                left -= isinstance(event, Future)
                yield event.result() if isinstance(event, Future) else event
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
        raise InputError("--executor dask needs the optional extra: pip install '.[cluster]'") from error
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

    from paper_artifact.study.worker import remote_run

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
    ends and, for local processes, every few seconds of each run's training.

    scheduler: address of a Dask scheduler, None for local processes. Raises InputError for bad input before
    any run starts.
    """
    if workers < 1:
        raise InputError(f"--workers must be at least 1, got {workers}")
    for shape in dict.fromkeys(config.shape for config in configs if not is_own(config)):
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
            for event in running:
                if isinstance(event, Step):
                    estimate.stepped(event)
                    text = estimate.running()
                else:
                    outcomes.append(event)
                    estimate.ended(event)
                    text = f"{run_name(event.config)} {'FAILED' if event.failure else 'done'}"
                if report:
                    report(f"{text}; {estimate.text()}", len(outcomes), len(todo))
    return outcomes
