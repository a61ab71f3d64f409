"""Running a table of runs: what is recorded is not run again, what was killed resumes, one failing run stops
no other; and how long it will still take.

Each run is a process by itself, `python -m paper_artifact.study.sweep CONFIG_JSON RESULTS DEVICE`: a crash, a
kill or a leak of one cannot touch another; one thread each, since two such processes beat one with two
threads. A pool of threads waits for them, or the workers of a Dask cluster do.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from statistics import mean
from typing import Any

from paper_artifact.config import RunConfig, config_from, config_values
from paper_artifact.errors import InputError
from paper_artifact.files import check_writable, partial_folder
from paper_artifact.record.store import read_record, recorded_path, write_record
from paper_artifact.scene.given import called, is_own, resolve
from paper_artifact.scene.shapes import find_mesh

SIGN = "step "  # begins a line on a run's stderr that says how far it is; all others are its complaints
EVERY = 5.0  # seconds between two such lines
CHANGED = "{} was saved anew while the sweep ran; run the sweep again"


@dataclass(frozen=True)
class Outcome:
    """One run's end."""

    config: RunConfig
    seconds: float  # of wall time, 0 where it failed
    failure: str | None  # why it failed, None when it is recorded


@dataclass(frozen=True)
class Step:
    """How far a run in progress is."""

    config: RunConfig
    step: int  # taken by now
    seconds: float  # of wall time since its process was started


class Estimate:
    """Remaining wall time: the steps that are left, each as long as those of its condition, else of all."""

    def __init__(self, todo: list[RunConfig], workers: int) -> None:
        self._taken, self._workers = dict.fromkeys(todo, 0), workers  # steps
        self._first: dict[RunConfig, Step] = {}  # of the runs in progress
        self._paces: dict[RunConfig, float] = {}  # seconds a step

    def stepped(self, step: Step) -> None:
        """Take note of a step; from the second on they have a pace, which leaves out the start."""
        first = self._first.setdefault(step.config, step)
        self._taken[step.config] = step.step
        if step.step > first.step:
            self._paces[step.config] = (step.seconds - first.seconds) / (step.step - first.step)

    def ended(self, outcome: Outcome) -> None:
        """Take note of an ended run; a failing one says nothing about the others."""
        for table in (self._taken, self._first, self._paces):
            table.pop(outcome.config, None)
        if outcome.failure is None:
            self._paces[outcome.config] = outcome.seconds / outcome.config.steps

    def _pace(self, config: RunConfig) -> float:
        alike = [pace for run, pace in self._paces.items() if run.condition == config.condition]
        return self._paces.get(config) or mean(alike or self._paces.values())

    def seconds(self) -> float | None:
        """Return the seconds left, None while nothing is known."""
        if self._taken and not self._paces:
            return None
        left = sum((config.steps - taken) * self._pace(config) for config, taken in self._taken.items())
        return left / max(1, min(self._workers, len(self._taken)))

    def text(self) -> str:
        """Return "about N min left", or that it is not known yet."""
        seconds = self.seconds()
        return "time left not known yet" if seconds is None else f"about {seconds / 60:.0f} min left"

    def running(self) -> str:
        """Return the runs in progress, each with the percentage of its steps."""
        return ", ".join(
            f"{run_name(config)} {100 * self._taken[config] // config.steps} %" for config in self._first
        )


def run_name(config: RunConfig) -> str:
    """Return "SHAPE CONDITION seed SEED"."""
    return f"{called(config)} {config.condition} seed {config.seed}"


def missing(configs: list[RunConfig], results: Path) -> dict[RunConfig, RunConfig]:
    """Return those without a record in results/runs, each with the configuration of its run: one's own data
    are read to be known again (`resolve`).

    A damaged record raises InputError: it is never silently overwritten.
    """
    todo = {}
    for config in configs:
        run = resolve(config).config if is_own(config) else config
        path = recorded_path(run, results / "runs")
        if path is None:
            todo[config] = run
        else:
            read_record(path)
    return todo


def start_run(values: dict, results: Path | str, device: str) -> subprocess.Popen:
    """Start the run of a configuration (a dict) that writes under `results`.

    The process ends when this one does, even by SIGKILL: it watches its stdin, a pipe that only this process
    holds open.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "paper_artifact.study.sweep", json.dumps(values), str(results), device],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def failure_of(child: subprocess.Popen, stepped: Callable[[int], object]) -> str | None:
    """Wait for a process of `start_run` and return why it failed in one line, None when its record is
    written. stepped(step) is called now and then while it trains."""
    reason = ""
    with child:
        for line in map(str.strip, child.stderr or ()):  # not communicate(): it would close stdin
            if line.startswith(SIGN) and line[len(SIGN) :].isdecimal():
                stepped(int(line[len(SIGN) :]))
            else:
                reason = line or reason
        child.wait()
    if child.returncode < 0:
        return f"the process was ended by signal {-child.returncode}"
    return (reason or f"the process ended with exit code {child.returncode}") if child.returncode else None


def remote_run(values: dict, device: str) -> tuple[float, dict]:
    """Run the configuration (a dict) on this worker of a cluster; return the seconds of wall time and the
    record. The run's process ends with the worker. Raises RuntimeError with the run's own last line."""
    begin = time.perf_counter()
    with partial_folder() as folder:
        failure = failure_of(start_run(values, str(folder), device), lambda step: None)
        if failure:
            raise RuntimeError(failure)
        (path,) = (folder / "runs").glob("*.json")
        return time.perf_counter() - begin, read_record(path)


def run_all(
    todo: dict[RunConfig, RunConfig], results: Path, device: str, workers: int, client: Any = None
) -> Generator[Outcome | Step, None, None]:
    """Yield outcomes of what is `missing` as runs end; of local processes, at most `workers` at once, also
    steps meanwhile.

    client: of a Dask cluster, which runs them; records come back to this machine, soups do not. Runs of a
    worker that dies are given to another one; a run that fails is not tried again. Of one's own data that
    were saved anew meanwhile no run is begun or counted.
    """
    events: SimpleQueue[Step | Future] = SimpleQueue()
    children: set[subprocess.Popen] = set()
    stopping, lock = threading.Event(), threading.Lock()

    def local_run(config: RunConfig) -> tuple[float, None]:
        begin = time.perf_counter()
        if todo[config] != config and resolve(config).config != todo[config]:
            raise RuntimeError(CHANGED.format(config.shape))
        with lock:  # no child may start unseen while the others are being stopped
            if stopping.is_set():
                raise RuntimeError("not started: the sweep was stopped")
            child = start_run(config_values(config), results, device)
            children.add(child)
        failure = failure_of(child, lambda step: events.put(Step(config, step, time.perf_counter() - begin)))
        children.discard(child)
        if failure:
            raise RuntimeError(failure)
        return time.perf_counter() - begin, None

    pool = ThreadPoolExecutor(workers) if client is None else client.get_executor()
    try:
        futures: dict[Future, RunConfig] = {}
        for config in todo:
            values = config_values(config)
            future = (
                pool.submit(local_run, config) if client is None else pool.submit(remote_run, values, device)
            )
            futures[future] = config
            future.add_done_callback(events.put)
            del future
        while futures:
            event = events.get()
            if isinstance(event, Step):
                yield event
                continue
            config, seconds, failure = futures.pop(event), 0.0, None
            try:
                seconds, record = event.result()
                if record is not None:
                    write_record(record, results / "runs")
                if todo[config] != config and recorded_path(todo[config], results / "runs") is None:
                    raise RuntimeError(CHANGED.format(config.shape))
            except Exception as error:  # whatever happened there is this run's failure, not the sweep's
                failure = (str(error).strip() or type(error).__name__).splitlines()[0]
            del event  # Dask makes a run again whose worker dies while somebody holds its future
            yield Outcome(config, seconds, failure)
    finally:  # also on Ctrl-C: checkpoints let the killed runs resume
        with lock:
            stopping.set()
            for child in list(children):
                child.kill()  # a stopped one would not hear another signal
        pool.shutdown(wait=client is None)


def connect(scheduler: str) -> Any:
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


def sweep(
    configs: list[RunConfig],
    results: Path,
    *,
    workers: int = 1,
    device: str = "cpu",
    scheduler: str | None = None,
    report: Callable[[str, int, int], None] = lambda text, ended, total: None,
) -> list[Outcome]:
    """Run what is not recorded yet and return the outcomes; report(text, ended, total) is called when a run
    ends and, for local processes, every few seconds of each run's training.

    scheduler: address of a Dask scheduler, None for local processes. Raises InputError for bad input before
    any run starts.
    """
    for shape in dict.fromkeys(config.shape for config in configs if not is_own(config)):
        find_mesh(shape)  # a mesh that is not available is named before any run starts
    todo = missing(configs, results)
    outcomes: list[Outcome] = []
    with connect(scheduler) if scheduler and todo else nullcontext() as client:
        if client is not None:
            check_writable(results / "runs" / "record.json")
            if not (workers := sum(client.nthreads().values())):
                raise InputError(
                    f"the scheduler at {scheduler} has no workers; start one with `dask worker {scheduler}`"
                )
        estimate = Estimate([*todo], workers)
        report(f"{len(configs) - len(todo)} of {len(configs)} recorded; {estimate.text()}", 0, len(todo))
        with closing(run_all(todo, results, device, workers, client)) as running:
            for event in running:
                if isinstance(event, Step):
                    estimate.stepped(event)
                    text = estimate.running()
                else:
                    outcomes.append(event)
                    estimate.ended(event)
                    text = f"{run_name(event.config)} {'FAILED' if event.failure else 'done'}"
                report(f"{text}; {estimate.text()}", len(outcomes), len(todo))
    return outcomes


def main() -> int:
    """Run the configuration on the command line in this process, one CPU thread; lines on stderr say how far
    it is, and the last one what went wrong, if anything."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import torch

    from paper_artifact.pipeline import run
    from paper_artifact.train.state import TrainingError

    torch.set_num_threads(1)
    due = 0.0

    def tell(step: int, text: str) -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + EVERY
            print(f"{SIGN}{step}", file=sys.stderr, flush=True)

    config, results, device = config_from(json.loads(sys.argv[1])), Path(sys.argv[2]), sys.argv[3]
    try:
        run(config, results=results, device=device, progress=tell)
    except (InputError, TrainingError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _end_with_parent() -> None:
    while os.read(0, 1024):  # not sys.stdin: a thread that holds its lock would trouble the interpreter's end
        pass
    os._exit(1)  # files are written atomically, so any moment will do


if __name__ == "__main__":
    sys.exit(main())
