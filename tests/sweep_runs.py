"""Two runs of the smallest kind for the sweep's tests, and a way to stop one in the middle, at a step that is
known."""

import os
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from paper_artifact.catalogue import study_config

SMALLEST = {"steps": 12, "budget": 30, "views": 8, "size": 32, "initial_ratio": 3.0, "resample_every": 4}
SMALLEST |= {"samples": 300, "dump_steps": (6, 10, 12)}
CONFIGS = tuple(study_config("sphere", seed=seed, **SMALLEST) for seed in (0, 1))
STEP = 8  # of the checkpoint after which `blocked_run` stops

# Imported by every Python that finds it on PYTHONPATH. The first run that has put its second checkpoint (of
# STEP) in place leaves a marker and waits for ever; all others go on.
_BLOCK = """
import os, time

replace, marker, written = os.replace, os.environ["BLOCKED_RUN"], []

def replace_and_wait(old, new, **options):
    replace(old, new, **options)
    written.extend([new] * (os.path.basename(os.path.dirname(new)) == "checkpoints"))
    if len(written) != 2:
        return
    try:
        os.close(os.open(marker + ".lock", os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return
    with open(marker + ".new", "w") as file:
        file.write(f"{os.getpid()} {os.getppid()}")
    replace(file.name, marker)
    while True:
        time.sleep(1)

os.replace = replace_and_wait
"""


@dataclass
class Marker:
    """What a stopped run leaves: pid: of its process, parent: of the process that started it, step: of its
    last checkpoint."""

    path: Path
    step: int = STEP
    pid: int = 0
    parent: int = 0

    def wait(self, process=None) -> None:
        """Wait until a run has been stopped; process: what must not end before (a Popen), if any."""
        while not self.path.exists():
            assert process is None or process.poll() is None, "the sweep ended without a run that was stopped"
            time.sleep(0.05)
        self.pid, self.parent = (int(word) for word in self.path.read_text().split())


def blocked_run(folder: Path, monkeypatch) -> Marker:
    """Let the first run that is started from now on stop after its checkpoint of STEP, until its process is
    killed."""
    (folder / "path").mkdir()
    (folder / "path" / "sitecustomize.py").write_text(_BLOCK)
    monkeypatch.setenv("PYTHONPATH", str(folder / "path"), prepend=os.pathsep)
    monkeypatch.setenv("BLOCKED_RUN", str(folder / "blocked"))
    return Marker(folder / "blocked")


def wait_for_end(pid: int) -> None:
    """Wait until the process `pid` is no more (a zombie that nobody has waited for counts as ended)."""
    while True:
        try:
            os.kill(pid, 0)
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                return
        except (ProcessLookupError, FileNotFoundError):
            return
        time.sleep(0.05)


def results_with_scene(folder: Path, copy_of: Path | None = None) -> Path:
    """Make a results folder, with the scenes of another one where given."""
    folder.mkdir()
    if copy_of:
        shutil.copytree(copy_of / "scenes", folder / "scenes")
    return folder


def same_run(first: dict, second: dict) -> bool:
    """Say whether two records are of the same run, whatever machine, time and stops it had."""
    circumstances = {"timings", "host", "resumed_at", "cpu_seconds", "digest"}
    one, other = (
        {name: value for name, value in record.items() if name not in circumstances}
        for record in (first, second)
    )
    return one == other
