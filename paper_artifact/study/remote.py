"""What a Dask worker executes: one run in a child process and a folder of its own, whose record is the return
value."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from paper_artifact.record.store import read_record
from paper_artifact.study.worker import failure_of, start_run


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
