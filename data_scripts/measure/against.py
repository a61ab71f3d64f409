"""Is this tree slower than another one? Runs of both in turn, each in a process of its own, as ratios.

    python data_scripts/measure/against.py --against DIR [--steps 300] [--turns 3] [--threads 1]

DIR is another checkout of this repository with its compiled kernels at hand: the first turn is not counted. A
line per condition: this tree's median over the other's, of the whole process and of the steps' own seconds
(photometric, topology, optimiser). CPU seconds on one thread, wall seconds on more; the load is printed.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from common import count, options

CHILD = """
import json, resource, sys, tempfile
from paper_artifact.cli import main
from pathlib import Path
with tempfile.TemporaryDirectory() as folder:
    words = ["train", "sphere", "--condition", sys.argv[1], "--steps", sys.argv[2], "--threads", sys.argv[3]]
    words += ["--set", f"dump_steps={sys.argv[2]},", "--device", "cpu", "--quiet", "--results", folder]
    assert main(words) == 0
    record = json.loads(next((Path(folder) / "runs").glob("*.json")).read_text())
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({"cpu": used.ru_utime + used.ru_stime} | record["timings"]))
"""


def seconds(tree: Path, condition: str, steps: int, threads: int) -> dict[str, float]:
    """Return the seconds of one run of a tree: "wall" and "cpu" of the process, "steps" of its steps."""
    begin = time.perf_counter()
    command = [sys.executable, "-c", CHILD, condition, str(steps), str(threads)]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{tree}: {done.stderr.strip()}")
    found = json.loads(done.stdout.splitlines()[-1])
    stages = sum(found.get(stage, 0.0) for stage in ("photometric", "topology", "optimiser"))
    return {"wall": time.perf_counter() - begin, "cpu": found["cpu"], "steps": stages}


def main() -> None:
    """Run as the docstring says."""
    numbers = {"steps": 300, "turns": 3, "threads": 1}
    extra = {name: {"type": count, "default": value} for name, value in numbers.items()}
    given = options(__doc__, against={"type": Path, "required": True, "help": "another checkout"}, **extra)
    trees = {"here": Path(__file__).resolve().parents[2], "there": given.against.resolve()}
    if not (trees["there"] / "paper_artifact").is_dir():
        raise SystemExit(f"{given.against} is no checkout of this repository; name another with --against")
    print(f"load before: {os.getloadavg()[0]:.1f}")
    for condition in ("C0", "C1"):
        taken: dict[str, list[dict[str, float]]] = {name: [] for name in trees}
        for turn in range(given.turns + 1):
            for name, tree in trees.items():
                run = seconds(tree, condition, given.steps, given.threads)
                if turn:
                    taken[name].append(run)
        parts = []
        for kind in ("cpu" if given.threads == 1 else "wall", "steps"):
            here, there = (statistics.median(run[kind] for run in taken[name]) for name in trees)
            parts.append(f"{kind} {here:.2f} s against {there:.2f} s, ratio {here / there:.2f}")
        print(f"{condition}, {given.threads} thread(s): {'; '.join(parts)}", flush=True)
    print(f"load after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
