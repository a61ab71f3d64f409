"""The measurements of data_scripts/measure on tiny cases: what they report, never how long it took."""

import importlib
import signal
import subprocess
import sys
import threading
import types

import numpy as np
import pandas as pd
import pytest
import torch

from paper_artifact.alpha.persistence import STAGES, gudhi_persistence
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.sampling import face_areas
from paper_artifact.soup.initialise import initial_soup

FOLDER = REPOSITORY / "data_scripts" / "measure"
NAMES = ("oineus", "oineus.diff", "diode", "torch_topological", "torch_topological.nn")


@pytest.fixture
def scripts(monkeypatch):
    """Return the scripts as modules: they import each other by their names."""
    monkeypatch.syspath_prepend(str(FOLDER))
    names = ("common", "cost", "gpu", "memory", "peers", "peers_task", "speed")
    return types.SimpleNamespace(**{name: importlib.import_module(name) for name in names})


@pytest.fixture
def stand_ins(scripts, monkeypatch):
    """Modules with the peers' calls, on gudhi's pairs; they have no distribution, so no version.

    oineus.diff gives squared circumradii by torch's own autograd, torch-topological the longest edges.
    """
    for script in (scripts.peers, scripts.peers_task):
        monkeypatch.setattr(script, "version_of", lambda peer: "stand-in")
    modules = {name: types.ModuleType(name) for name in NAMES}
    modules["oineus"].diff = modules["oineus.diff"]
    modules["oineus.diff"].alpha_filtration = lambda points: points
    modules["oineus.diff"].persistence_diagram = lambda points, **_: gudhi_diagrams(points, squared_radii)
    modules["torch_topological.nn"].AlphaComplex = lambda: (
        lambda points: [types.SimpleNamespace(diagram=each) for each in gudhi_diagrams(points, longest_edges)]
    )
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


def gudhi_diagrams(points, values):
    found = gudhi_persistence(points.detach().numpy())
    simplices = [map(torch.from_numpy, (each.birth_simplices, each.death_simplices)) for each in found]
    return [torch.stack([values(points[each]) for each in both], dim=1) for both in simplices]


def squared_radii(corners):
    """By the Gram matrix of the edges at the first corner: R² = yᵀ G y with 2 G y = diag G."""
    if corners.shape[1] == 1:
        return corners.new_zeros(len(corners))
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.transpose(1, 2)
    y = torch.linalg.solve(gram, torch.diagonal(gram, dim1=1, dim2=2) / 2)
    return torch.einsum("ni,nij,nj->n", y, gram, y)


def longest_edges(corners):
    return torch.cdist(corners, corners).amax(dim=(1, 2))


def test_cost_has_every_stage(scripts):
    row = scripts.cost.row_of("soup", 300, turns=1)
    for key in ("gudhi", "fast"):
        stages = [row[f"{key}_{stage}_ms"] for stage in STAGES]
        assert min(stages) >= 0 and 0 < sum(stages) <= 1.5 * row[f"{key}_ms"]
    assert row["M"] == 300 and row["tetrahedra"] > 300 and row["ratio"] == row["gudhi_ms"] / row["fast_ms"]


def test_a_peer_that_computes_the_same_differs_from_one_that_does_not(scripts, stand_ins):
    peers, notes = scripts.peers, []
    ours, same, other = peers.rows_of("torus", 120, 2, peers.PEERS, notes)
    assert notes == [] and [row["library"] for row in (same, other)] == ["oineus.diff", "torch-topological"]
    assert ours["ratio"] == ours["forward_ratio"] == 1 and ours["bar_difference"] == 0
    assert same["bar_difference"] < 1e-12 and same["gradient_difference"] < 1e-9
    assert other["bar_difference"] > 1e-3 and other["gradient_difference"] > 0.1
    for row in (ours, same, other):
        assert row["turns"] == 2 and row["ratio"] == pytest.approx(row["ms"] / ours["ms"])


def test_a_slow_peer_is_timed_once_and_a_failing_one_is_a_line(scripts, stand_ins, monkeypatch):
    peers, notes = scripts.peers, []
    monkeypatch.setattr(peers, "SLOW", -1.0)
    sys.modules["torch_topological.nn"].AlphaComplex = lambda: (_ for _ in ()).throw(RuntimeError("no\nluck"))
    rows = list(peers.peer_rows(notes, (100, 150), ("torus",)))
    kept = [(row["library"], row["M"], row["turns"]) for row in rows]
    assert kept == [(peers.OURS, 100, 7), ("oineus.diff", 100, 1), (peers.OURS, 150, 3)]
    assert notes[0] == "torch-topological: failed on torus, M = 100 (RuntimeError: no luck)"
    assert notes[1].startswith("oineus.diff: not measured on torus beyond M = 100, where it took")


def test_a_missing_peer_is_named_with_how_to_install_it(scripts, monkeypatch):
    for name in NAMES:
        monkeypatch.setitem(sys.modules, name, None)
    install = "oineus.diff: does not import .*install it with: pip install oineus"
    with pytest.raises(SystemExit, match=install):
        scripts.peers.collected(scripts.peers.PEERS, None)


def test_differences(scripts):
    bars, ours = scripts.peers.bar_difference, np.array([[0.1, 0.2], [0.3, 0.9]])
    assert bars(ours, ours[::-1]) == 0 and bars(ours, ours + 0.25) == pytest.approx(0.25)
    assert bars(ours, ours[:1]) == np.inf and bars(ours[:0], ours[:0]) == 0
    twelve = np.column_stack([np.zeros(12), np.arange(1.0, 13.0)])
    assert bars(twelve, twelve[2:]) == 0  # the ten longest alone
    assert scripts.peers.gradient_difference(ours, ours * 1.5) == pytest.approx(0.5)
    assert np.isnan(scripts.peers.gradient_difference(ours, np.full((2, 2), np.nan)))


def test_everyone_is_given_the_same_task(scripts, stand_ins):
    """Our loss and the one of tensors agree; a library that computes the same takes our steps."""
    task, notes = scripts.peers_task, []
    small = task.Task("a small hole", lambda: task.slab(200), (1, 1, 0), 1, 8e-3, steps=40)
    points = torch.tensor(small.cloud())
    loss = task.BettiLoss(small.betti, diagonal=1.0, guard=0.0, suppress="all", dimensions=(1,))
    same = task.stated_loss(scripts.peers.our_diagrams, small, points).item()
    assert loss(points).item() == pytest.approx(same, rel=1e-9)
    rows = list(task.task_rows(notes, (small,), task.PEERS[:1]))
    names = ["BettiLoss", "BettiLoss, K = 10", "diagrams", "oineus.diff"]
    assert [row["library"].removeprefix("paper_artifact, ") for row in rows] == names and not notes
    assert rows[0]["step"] == rows[2]["step"] == rows[3]["step"] > 0 and rows[0]["ratio"] == 1
    assert not task.holds(small.cloud(), small)


def test_a_resized_soup_covers_the_same_surface(scripts, tiny_scene):
    soup = initial_soup(tiny_scene.points, 40, 0)

    def area(soup):
        corners = soup.vertices.detach().numpy().reshape(-1, 3)
        return face_areas(corners, np.arange(len(corners)).reshape(-1, 3)).sum()

    for count in (41, 80, 300):
        larger = scripts.speed.resized_soup(soup, count)
        assert len(larger) == count and area(larger) == pytest.approx(area(soup), rel=1e-5)
        assert larger.features.shape == (count, 3, 7) and larger.opacity.shape == (count, 3)
    assert len(scripts.speed.resized_soup(soup, 10)) == 10


def test_a_longer_or_other_table_is_kept(scripts, tmp_path, capsys):
    table, path = pd.DataFrame({"size": [1, 2], "ms": [0.5, 0.7]}), tmp_path / "a.csv"
    for each in (table, table[:1], table.assign(more=1)):
        scripts.common.write(each, path)
    assert len(pd.read_csv(path)) == 2 and len(pd.read_csv(tmp_path / "a-new.csv")) == 1
    assert [*pd.read_csv(tmp_path / "a-new-new.csv")] == ["size", "ms", "more"]
    assert capsys.readouterr().out.count("kept: ") == 3
    (tmp_path / "a-new.csv").write_text("my notes\n")
    scripts.common.write(pd.DataFrame({"other": [1]}), path)
    assert (tmp_path / "a-new.csv").read_text() == "my notes\n"
    assert [*pd.read_csv(tmp_path / "a-new-new-new.csv")] == ["other"]
    assert len(scripts.common.kept(path, ["size"])) == 2 and not len(
        scripts.common.kept(tmp_path / "b", ["x"])
    )
    with pytest.raises(SystemExit, match="is no table of this script"):
        scripts.common.kept(path, ["name"])


def test_steps_are_timed_by_size_and_triangles(scripts, tiny_scene):
    soup = initial_soup(tiny_scene.points, 60, 0)
    rows = list(scripts.speed.step_rows(tiny_scene, soup, (50, 100), (32, 48), 1))
    assert [(row["size"], row["N"]) for row in rows] == [(32, 50), (32, 100), (48, 50), (48, 100)]
    assert all(row["ms"] > 0 and row["wall_ms"] > 0 for row in rows)


def test_peak_memory_is_of_a_process_by_itself(scripts, tmp_path):
    row = scripts.memory.photographs_row(str(tmp_path / "photographs"), 4, 40, 50, 2)
    assert 50 < row["loaded MiB"] <= row["peak MiB"] and row["CPU s"] > 0
    assert scripts.common.in_own_process(sum, (1, 2)) == 3


def test_gpu_memory_is_read_while_the_run_goes_on(scripts, monkeypatch):
    readings, asked = iter([100, 150, 400, *[120] * 100]), threading.Event()

    def read():
        value = next(readings)
        if value == 400:
            asked.set()
        return value

    monkeypatch.setattr(scripts.gpu, "INTERVAL", 0.001)
    row = scripts.gpu.peak_during(lambda: 7.0 if asked.wait(60) else 0.0, read)
    assert row == {"allocated": 7.0, "before": 100, "peak": 400}


@pytest.mark.parametrize(
    "script, words",
    [
        ("same_bits.py --only spere", "no run's name holds 'spere'; choose among C1"),
        ("same_bits.py --setting nonsense", "no setting's name holds 'nonsense'"),
        ("mug/make_mug.py --out {file}/x.ply", "cannot write"),
        ("measure/against.py --against {file}", "is no checkout of this repository"),
        ("measure/windows.py --out {file}/x", "cannot write"),
        ("alpha_wheel.py {file}", "File exists"),
    ],
)
def test_scripts_refuse_before_they_work(script, words, tmp_path):
    (file := tmp_path / "file").write_text("mine")
    command = [sys.executable, *script.format(file=file).split()]
    ended = subprocess.run(command, cwd=REPOSITORY / "data_scripts", capture_output=True, text=True)
    assert ended.returncode and words in ended.stderr and "Traceback" not in ended.stderr
    assert file.read_text() == "mine"


def test_an_interrupted_script_says_so(scripts, capsys):
    for error, words in ((KeyboardInterrupt(), "interrupted"), (InputError("no soup at a"), "no soup at a")):
        sys.excepthook(type(error), error, None)
        assert words in capsys.readouterr().err.splitlines()[0]
    sys.excepthook(ValueError, ValueError("a fault"), None)
    assert "ValueError: a fault" in capsys.readouterr().err


def test_an_interrupt_that_an_import_of_a_script_swallows_ends_it(tmp_path):
    swallows = "import os, signal\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(.2)\n"
    (tmp_path / "swallows.py").write_text(f"import time\n{swallows}except BaseException:\n    pass\n")
    script = f"import sys\nsys.path.append({str(REPOSITORY / 'data_scripts' / 'measure')!r})\nimport common\n"
    (tmp_path / "a.py").write_text(f"{script}import swallows, time\ntime.sleep(60)\nprint('lost')\n")
    ended = subprocess.run(
        [sys.executable, "-c", RESTORED, str(tmp_path / "a.py")],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == -signal.SIGINT and ended.stdout == ""
    assert ended.stderr.startswith("a.py: interrupted; ") and len(ended.stderr.splitlines()) == 1


# Runs a script as a terminal does: a background job's children would ignore Ctrl-C.
RESTORED = """import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.executable, sys.orig_argv[:1] + sys.argv[1:])
"""
