"""One run in a process of its own: `python -m paper_artifact.study.worker CONFIG_JSON RESULTS DEVICE
[watched]`.

A crash, a kill or a leak of one run cannot touch another; one thread each, since two such processes beat one
with two threads.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from paper_artifact.record.store import read_record

SIGN = "step "  # begins a line on the run's stderr that says how far it is; all others are its complaints
EVERY = 5.0  # seconds between two such lines


def start_run(values: dict, results: Path | str, device: str) -> subprocess.Popen:
    """Start the run of a configuration (a dict) that writes under `results`; wait for it with `failure_of`.

    The process ends when this one does, even by SIGKILL: it watches its stdin, a pipe that only this process
    holds open.
    """
    command = [
        sys.executable,
        "-m",
        "paper_artifact.study.worker",
        json.dumps(values),
        str(results),
        device,
        "watched",
    ]
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )


def failure_of(child: subprocess.Popen, stepped: Callable[[int], object] | None = None) -> str | None:
    """Wait for a process of `start_run` and return why it failed in one line, None when its record is
    written.

    stepped(step) is called now and then while it trains.
    """
    reason = ""
    with child:
        for line in map(str.strip, child.stderr):  # not communicate(), which would close stdin: the run's end
            if line.startswith(SIGN) and line[len(SIGN) :].isdecimal():
                if stepped is not None:
                    stepped(int(line[len(SIGN) :]))
            else:
                reason = line or reason
        child.wait()
    if child.returncode < 0:
        return f"the process was ended by signal {-child.returncode}"
    return (reason or f"the process ended with exit code {child.returncode}") if child.returncode else None


def tell_steps() -> Callable[[int, str], None]:
    """Return a `progress` for a run that writes lines for `failure_of` to stderr: the first step, then one
    every EVERY seconds."""
    due = 0.0

    def tell(step: int, text: str) -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + EVERY
            print(f"{SIGN}{step}", file=sys.stderr, flush=True)

    return tell


def run_one(
    values: dict, results: Path | str, device: str = "cpu", progress: Callable[[int, str], None] | None = None
) -> dict:
    """Run the configuration (a dict) and return its record; one CPU thread. progress: see `pipeline.run`."""
    import torch

    from paper_artifact.config import config_from
    from paper_artifact.pipeline import run

    torch.set_num_threads(1)
    return run(config_from(values), results=Path(results), device=device, progress=progress)


def main() -> int:
    """Run the configuration on the command line; the last line of stderr says what went wrong, if
    anything."""
    if sys.argv[4:] == ["watched"]:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["OMP_NUM_THREADS"] = "1"
    from paper_artifact.errors import InputError
    from paper_artifact.train.state import TrainingError

    try:
        run_one(json.loads(sys.argv[1]), sys.argv[2], sys.argv[3], tell_steps())
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


def remote_run(values: dict, device: str) -> tuple[dict, float]:
    """Run the configuration (a dict) on this worker; return its record and the seconds of wall time that it
    took here.

    The run's process ends with the worker. Raises RuntimeError with the run's own last line when it fails.
    """
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        failure = failure_of(start_run(values, folder, device))
        if failure:
            raise RuntimeError(failure)
        (path,) = (Path(folder) / "runs").glob("*.json")
        return read_record(path), time.perf_counter() - begin
