"""What a Dask worker executes: one run in a child process and a folder of its own, whose record is the return value."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path


def remote_run(values: dict, device: str) -> dict:
    """Run the configuration (a dict) on this worker and return its record. Raises RuntimeError with the run's own last line."""
    with tempfile.TemporaryDirectory() as folder:
        child = subprocess.run([sys.executable, "-m", "paper_artifact.study.worker", json.dumps(values), folder, device],
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if child.returncode:
            raise RuntimeError((child.stderr.strip().splitlines() or [f"the run ended with {child.returncode}"])[-1])
        (record,) = (Path(folder) / "runs").glob("*.json")
        return json.loads(record.read_text(encoding="utf-8"))
