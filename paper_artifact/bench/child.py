"""A measurement in a process of its own: for peak memory, for a first start."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

Told = Callable[[str], object]


def run_child(
    program: str,
    argument: Any,
    told: Told | None = None,
    environment: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> tuple[Any, list[str]]:
    """Return (what the program says, the lines of its stderr).

    program: Python source that finds `argument` as JSON in sys.argv[1] and prints one line of JSON, an object
    or a list, which is returned; every other line goes to told. environment: variables that differ from this
    process's; one OpenMP thread anyway. folder: where it runs, here by default. Raises RuntimeError with the
    last line of stderr when it fails.
    """
    result = "null"
    with tempfile.TemporaryFile("w+") as errors:  # no pipe: nobody reads it while stdout is read
        child = subprocess.Popen(
            [sys.executable, "-c", program, json.dumps(argument)],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            cwd=folder,
            env={**os.environ, "OMP_NUM_THREADS": "1", **(environment or {})},
        )
        try:
            with child:
                for line in map(str.strip, child.stdout or ()):
                    if line.startswith(("{", "[")):
                        result = line
                    elif told is not None:
                        told(line)
        finally:
            child.kill()  # nothing once it has ended; on Ctrl-C it must not go on
        errors.seek(0)
        complaints = errors.read().strip().splitlines()
    if child.returncode:
        raise RuntimeError(f"the benchmark run failed: {(complaints or ['no message'])[-1]}")
    return json.loads(result), complaints
