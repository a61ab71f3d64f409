"""One run in a process of its own: `python -m paper_artifact.study.worker CONFIG_JSON RESULTS`.

A crash, a kill or a leak of one run cannot touch another; one thread each, since two such processes beat one with two threads.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path


def config_from(values: dict):
    """Return the RunConfig of a dict that went through JSON (lists back to tuples)."""
    from paper_artifact.train.config import RunConfig

    def tuples(value):
        return tuple(tuples(item) for item in value) if isinstance(value, list) else value

    return RunConfig(**{name: tuples(value) for name, value in values.items()})


def run_one(values: dict, results: Path | str, device: str = "cpu") -> dict:
    """Run the configuration (a dict) and return its record; one CPU thread."""
    import torch

    from paper_artifact.train.run import run

    torch.set_num_threads(1)
    return run(config_from(values), results=Path(results), device=device)


def main() -> int:
    """Run the configuration on the command line; the last line of stderr says what went wrong, if anything."""
    os.environ["OMP_NUM_THREADS"] = "1"
    from paper_artifact.errors import InputError
    from paper_artifact.train.loop import TrainingError

    try:
        run_one(json.loads(sys.argv[1]), sys.argv[2], sys.argv[3])
    except (InputError, TrainingError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
