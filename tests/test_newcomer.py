"""A newcomer adds a condition, a shape and a study as CONTRIBUTING.md says, in a fork of their own, and
touches no other file.

The fork is a copy of the package with four insertions: the condition's row and the shape's row in the
catalogue, the shape's geometry, the study's runs. Everything below happens in processes that import the fork.
"""

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from paper_artifact.files import REPOSITORY
from tests.tiny_run import TINY

GEOMETRY = '''
def pebble() -> Mesh:
    """Return a pebble: an ellipsoid with half axes 1, .8 and .6."""
    vertices, faces = _icosphere(3)
    return checked_mesh(vertices * [1.0, 0.8, 0.6], faces, "pebble", (1, 0, 1))


'''
# file, the table in it, the row to add
ROWS = (
    ("catalogue.py", "SHAPES", 'Shape("pebble", "analytic", 2, (0, 0, 1), 200, 1024, (2,)),'),
    ("catalogue.py", "CONDITIONS", 'Condition("C8", "C1 twice as strong", "#123456", LossConfig(rho=0.2)),'),
    ("scene/shapes.py", "SHAPES", '"pebble": pebble,'),
    ("study/studies.py", "STUDIES", '"pebbles": (Block(("pebble",), ("C0", "C2", "C8"), range(1)),),'),
)
SETTINGS = {name: value for name, value in TINY.items() if name not in ("steps", "dump_steps", "budget")}
SETTINGS |= {"steps": 20, "dump_steps": (10, 15, 20)}

SWEEP = f"""
import json, sys
from pathlib import Path
from paper_artifact.config import with_changes
from paper_artifact.study.studies import study_configs
from paper_artifact.study.sweep import missing, sweep

configs = [with_changes(config, {SETTINGS!r}) for config in study_configs("pebbles")]
results = Path("results")
before = [config.condition for config in missing(configs, results)]
outcomes = sweep(configs, results, workers=2)
print(json.dumps([before, [outcome.failure for outcome in outcomes], len(missing(configs, results))]))
"""
REPORT = """
import json
from pathlib import Path
from paper_artifact import plot, results
from paper_artifact.verdict import arms, verdicts

tables = results.load("recorded", ["pebbles"], Path("results/runs"))
runs = tables.runs  # with the settings of a tiny run they are no runs of the study
judged = verdicts(runs, loss="C8").loc["pebble"]
print(json.dumps({
    "arms": [list(key) for key in arms(runs).index],
    "ratio": float(arms(runs)["ratio"]["pebble", "C8"]),
    "dumps": sorted(set(tables.dumps["condition"].astype(str))),
    "colour": plot.style("C8")["color"],
    "outcome": judged["outcome"],
    "dimension": int(runs["dimension"].iloc[0]),
    "loss": runs.set_index("condition")[["loss_rho", "loss_samples"]].loc["C8"].tolist(),
}))
"""


def add_row(path: Path, table: str, row: str) -> None:
    """Add a line at the end of the tuple or dict that is assigned to `table`."""
    lines = path.read_text().splitlines(keepends=True)
    for node in ast.parse("".join(lines)).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if [getattr(target, "id", None) for target in targets] == [table]:
            lines.insert(node.end_lineno - 1, f"    {row}\n")
            path.write_text("".join(lines))
            return
    raise AssertionError(f"{path} has no {table}")


class Fork:
    """A copy of the repository's package and data tables with the newcomer's rows."""

    def __init__(self, root: Path) -> None:
        self.root = root
        shutil.copytree(REPOSITORY / "paper_artifact", root / "paper_artifact")  # with its compiled kernels
        shutil.copytree(REPOSITORY / "results" / "published", root / "results" / "published")
        (root / "data_scripts").mkdir()
        shutil.copy(REPOSITORY / "data_scripts" / "meshes.csv", root / "data_scripts")
        shapes = root / "paper_artifact" / "scene" / "shapes.py"
        shapes.write_text(shapes.read_text().replace("\ndef sphere()", GEOMETRY + "\ndef sphere()", 1))
        for file, table, row in ROWS:
            add_row(root / "paper_artifact" / file, table, row)

    def run(self, *arguments: str) -> str:
        kept = {name: value for name, value in os.environ.items() if name != "PAPER_ARTIFACT_RESULTS"}
        result = subprocess.run(
            [sys.executable, *arguments],
            cwd=self.root,
            env=kept | {"PYTHONPATH": str(self.root), "MPLBACKEND": "agg"},
            capture_output=True,
            text=True,
            timeout=900,
        )
        assert result.returncode == 0, result.stderr
        return result.stdout


@pytest.fixture(scope="module")
def fork(tmp_path_factory):
    return Fork(tmp_path_factory.mktemp("fork"))


def test_the_made_up_condition_and_shape_are_trained_swept_tabulated_plotted_and_judged(fork):
    words = ["-m", "paper_artifact", "train", "pebble", "--condition", "C8", "--steps", "20", "--quiet"]
    changes = SETTINGS.items() - {("steps", 20)}
    trained = fork.run(*words, *(f"--set={name}={value}".replace(" ", "") for name, value in changes))
    assert "pebble C8 seed 0; tail bottleneck of voids" in trained
    assert "missing: pebble C8 seed 0" in fork.run("-m", "paper_artifact", "sweep", "pebbles", "--list")
    before, failures, left = json.loads(fork.run("-c", SWEEP).splitlines()[-1])
    assert before == ["C0", "C2"], "what was trained alone is a run of the study"
    assert failures == [None, None] and left == 0

    said = json.loads(fork.run("-c", REPORT).splitlines()[-1])
    assert said["arms"] == [["pebble", "C0"], ["pebble", "C2"], ["pebble", "C8"]] and said["ratio"] > 0
    assert said["dumps"] == ["C0", "C2", "C8"] and said["colour"] == "#123456"
    assert said["outcome"] == "incomplete" and said["dimension"] == 2, "one seed decides nothing"
    assert said["loss"] == [0.2, 1024], "the loss takes the shape's own density"
