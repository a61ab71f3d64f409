"""A newcomer adds a condition, a shape and a study as CONTRIBUTING.md says, in a fork of their own, and
touches no other file.

The fork is a copy of the package with four insertions: the condition's row and the shape's row in the
catalogue, the shape's geometry, the study's runs. Everything below happens in processes that import the fork.
"""

from __future__ import annotations

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
from matplotlib.colors import to_hex
from paper_artifact.catalogue import colour_of, in_order
from paper_artifact.record.store import find_records
from paper_artifact.report.kit import frames, tables
from paper_artifact.report.kit.records import Collected, command
from paper_artifact.report.matrix import seed_figure
from paper_artifact.study.verdict import rows_of, verdict

records = tuple(find_records("results/runs"))
collected = Collected(records, (), Path("results"))
matrix = tables.matrix_table(collected)
lines = tables.trajectory_figure(collected).axes[0].get_lines()
judged = verdict(rows_of(records), loss="C8")["pebble"]
print(json.dumps({
    "arms": frames.arms(collected)[["shape", "condition", "ratio"]].astype(str).values.tolist(),
    "matrix": [matrix.index.tolist(), matrix.columns.tolist()],
    "seeds": tables.seed_table(collected).reset_index()["condition"].tolist(),
    "verdicts": tables.verdict_table(collected).index.tolist(),
    "lines": {line.get_label(): to_hex(line.get_color()) for line in lines},
    "bars": [to_hex(bar.get_facecolor()) for bar in seed_figure(collected).axes[0].patches],
    "outcome": [judged.loss, judged.outcome, judged.dimension, sorted(judged.below)],
    "losses": {record["config"]["condition"]: record["config"]["loss"] for record in records},
    "command": command("pebble", "C8", 0),
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


def test_only_three_files_differ(fork):
    differing = {
        path.relative_to(fork.root).as_posix()
        for path in fork.root.rglob("*.py")
        if path.read_text() != (REPOSITORY / path.relative_to(fork.root)).read_text()
    }
    assert differing == {f"paper_artifact/{file}" for file, _, _ in ROWS}


def test_the_made_up_condition_and_shape_are_trained_swept_tabulated_plotted_and_judged(fork):
    settings = [
        f"--set={name}={value}".replace(" ", "") for name, value in SETTINGS.items() if name != "steps"
    ]
    trained = fork.run(
        *["-m", "paper_artifact", "train", "pebble", "--condition", "C8", "--steps", "20", "--quiet"],
        *settings,
    )
    assert "pebble C8 seed 0; tail bottleneck H2" in trained
    assert "missing: pebble C8 seed 0" in fork.run("-m", "paper_artifact", "sweep", "pebbles", "--list")
    before, failures, left = json.loads(fork.run("-c", SWEEP).splitlines()[-1])
    assert before == ["C0", "C2"], "what was trained alone is a run of the study"
    assert failures == [None, None] and left == 0

    told = json.loads(fork.run("-c", REPORT).splitlines()[-1])
    assert [arm[:2] for arm in told["arms"]] == [["pebble", "C0"], ["pebble", "C2"], ["pebble", "C8"]]
    assert float(told["arms"][2][2]) > 0
    assert told["matrix"] == [["C0", "C2", "C8"], [["pebble", "ours"], ["pebble", "paper"]]]
    assert told["seeds"] == ["C0", "C2", "C8"] and told["verdicts"] == ["pebble"]
    assert told["lines"]["C8"] == "#123456" and "#123456" in told["bars"]
    loss, outcome, dimension, rivals = told["outcome"]
    assert loss == "C8" and dimension == 2 and rivals == ["C0", "C2"] and outcome != "incomplete"
    assert told["losses"]["C0"] is None and told["losses"]["C8"]["rho"] == 0.2
    assert told["losses"]["C8"]["samples"] == 1024, "the loss takes the shape's own density"
    assert told["command"].endswith("train pebble --condition C8 --seed 0")
