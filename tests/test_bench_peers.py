"""The benchmark beside other libraries, on small clouds with stand-ins: what it reports, never how long."""

from __future__ import annotations

import functools
import sys
import types

import numpy as np
import pytest
import torch

from paper_artifact import cli
from paper_artifact.alpha.persistence import gudhi_persistence
from paper_artifact.bench import peers, words_task
from paper_artifact.cli import bench
from paper_artifact.errors import InputError

NAMES = ("oineus", "oineus.diff", "diode", "torch_topological", "torch_topological.nn")
SMALL = words_task.Task("a small hole", lambda: words_task.slab(200), (1, 1, 0), 1, 8e-3, steps=40)


@pytest.fixture
def absent(monkeypatch):
    for name in (*NAMES, "topologylayer", "topologylayer.nn"):
        monkeypatch.setitem(sys.modules, name, None)


@pytest.fixture
def stand_ins(monkeypatch):
    """Modules with the peers' calls, on gudhi's pairs.

    oineus.diff gives squared circumradii by torch's own autograd, torch-topological the longest edges.
    """
    modules = {name: types.ModuleType(name) for name in NAMES}
    modules["oineus"].diff = modules["oineus.diff"]
    modules["oineus.diff"].alpha_filtration = lambda points: points
    modules["oineus.diff"].persistence_diagram = lambda points, n_threads: dict(
        enumerate(gudhi_diagrams(points, squared_radii))
    )
    modules["torch_topological.nn"].AlphaComplex = lambda: (
        lambda points: [
            types.SimpleNamespace(diagram=diagram) for diagram in gudhi_diagrams(points, longest_edges)
        ]
    )
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


def gudhi_diagrams(points, values):
    both = [
        (pairs.birth_simplices, pairs.death_simplices) for pairs in gudhi_persistence(points.detach().numpy())
    ]
    return [
        torch.stack([values(points[torch.from_numpy(simplices)]) for simplices in sides], dim=1)
        for sides in both
    ]


def squared_radii(corners):
    """By the Gram matrix of the edges at the first corner: R² = yᵀ G y with 2 G y = diag G."""
    if corners.shape[1] == 1:
        return corners.new_zeros(len(corners))
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.transpose(1, 2)
    y = torch.linalg.solve(gram, torch.diagonal(gram, dim1=1, dim2=2) / 2)
    return torch.einsum("ni,nij,nj->n", y, gram, y)


def longest_edges(corners):
    if corners.shape[1] == 1:
        return corners.new_zeros(len(corners))
    first, second = np.triu_indices(corners.shape[1], 1)
    return (corners[:, first] - corners[:, second]).norm(dim=2).max(dim=1).values


def torus(size):
    return peers.CLOUDS["torus"](size, np.random.default_rng(3))


def test_our_gradient_is_the_finite_difference():
    points = torus(80)
    loops, gradient, _, _ = peers.loss_and_gradient(peers.our_diagrams, points)
    assert len(loops) > 20
    rng, step = np.random.default_rng(0), 1e-6
    for _ in range(5):
        direction = rng.standard_normal(points.shape)
        values = []
        for sign in (1, -1):
            moved = peers.our_diagrams(torch.from_numpy(points + sign * step * direction))[1]
            values.append(float((moved[:, 1] - moved[:, 0]).square().sum()))
        assert (values[0] - values[1]) / (2 * step) == pytest.approx((gradient * direction).sum(), rel=1e-5)


def test_our_diagrams_are_the_persistence():
    points = torus(200)
    for ours, pairs in zip(
        peers.our_diagrams(torch.from_numpy(points)), gudhi_persistence(points), strict=True
    ):
        np.testing.assert_allclose(ours.numpy(), pairs.diagram, atol=1e-12)


def test_a_peer_that_computes_the_same_is_told_from_one_that_does_not(stand_ins):
    missing = []
    ours, same, other = peers.peer_rows((120,), ("torus",), 2, missing=missing)
    assert not missing and [row["library"] for row in (ours, same, other)] == [
        peers.OURS,
        "oineus.diff",
        "torch-topological",
    ]
    assert (
        ours["ratio"] == ours["forward_ratio"] == 1
        and ours["bar_difference"] == ours["gradient_difference"] == 0
    )
    assert (
        same["bar_difference"] < 1e-12 and same["gradient_difference"] < 1e-9 and same["bars"] == ours["bars"]
    )
    assert (
        other["bar_difference"] > 1e-3
        and other["gradient_difference"] > 0.1
        and "longest edge" in other["note"]
    )
    for row in (ours, same, other):
        assert row["turns"] == 2 and row["ratio"] == pytest.approx(row["ms"] / ours["ms"])


def test_a_slow_peer_is_timed_once_and_left_out_of_larger_clouds(stand_ins, monkeypatch):
    monkeypatch.setattr(peers, "SLOW", -1.0)
    missing = []
    rows = list(peers.peer_rows((150, 100), ("torus",), 3, peers.PEERS[:1], missing))
    assert [(row["library"], row["M"], row["turns"]) for row in rows] == [
        (peers.OURS, 100, 3),
        ("oineus.diff", 100, 1),
        (peers.OURS, 150, 3),
    ]
    assert missing[0].startswith("oineus.diff: not measured on torus beyond M = 100, where it took")


def test_a_peer_that_fails_is_one_line(stand_ins, monkeypatch):
    def broken(points):
        raise RuntimeError("needs a build\nwith attachments")

    monkeypatch.setattr(sys.modules["oineus.diff"], "alpha_filtration", broken)
    missing = []
    rows = list(peers.peer_rows((100,), ("soup",), 1, missing=missing))
    assert [row["library"] for row in rows] == [peers.OURS, "torch-topological"]
    assert missing == ["oineus.diff: failed on soup, M = 100 (RuntimeError: needs a build with attachments)"]


def test_differences():
    ours = np.array([[0.1, 0.2], [0.3, 0.9]])
    assert peers.bar_difference(ours, ours[::-1]) == 0 and peers.bar_difference(
        ours, ours + 0.25
    ) == pytest.approx(0.25)
    assert peers.bar_difference(ours, ours[:1]) == np.inf and peers.bar_difference(ours[:0], ours[:0]) == 0
    twelve = np.column_stack([np.zeros(12), np.arange(1.0, 13.0)])
    assert peers.bar_difference(twelve, twelve[2:]) == 0  # the ten longest alone
    assert peers.gradient_difference(ours, ours * 1.5) == pytest.approx(0.5)
    assert np.isnan(peers.gradient_difference(ours, np.full((2, 2), np.nan)))


@pytest.mark.parametrize(
    "arguments, words",
    [
        (((100,), ("nonsense",)), "unknown cloud 'nonsense'"),
        (((99,),), "at least 100 points"),
        (((100,), ("torus",), 0), "one repetition"),
    ],
)
def test_bad_input(arguments, words):
    with pytest.raises(InputError, match=words):
        list(peers.peer_rows(*arguments))


def test_the_verb_prints_our_row_and_how_to_install_the_others(absent, own_threads, monkeypatch, capsys):
    monkeypatch.setattr(peers, "peer_rows", functools.partial(peers.peer_rows, (100,), ("torus",)))
    monkeypatch.setattr(words_task, "task_rows", functools.partial(words_task.task_rows, (SMALL,)))
    assert cli.main(["bench", "peers", "--repetitions", "1"]) == 0
    printed = capsys.readouterr()
    assert "torus M =   100  paper_artifact" in printed.out and "1.0 × ours" in printed.out
    assert "a small hole      paper_artifact, BettiLoss         held from step" in printed.out
    assert printed.out.count("TopologyLayer: does not import (") == 1
    assert printed.out.count("torch-topological: does not import (") == 1
    assert (
        "oineus.diff: does not import (ModuleNotFoundError" in printed.out
        and "pip install oineus eagerpy diode" in printed.out
    )
    assert (
        "install it with: pip install torch-topological" in printed.out
        and "Traceback" not in printed.out + printed.err
    )


def test_peers_are_a_default_part_only_where_one_is_installed(absent, monkeypatch):
    assert bench._default_parts() == ("raster", "run", "compile", "reach", "persistence", "loss", "gpu")
    monkeypatch.setattr(peers, "installed", lambda peer: peer.name == "oineus.diff")
    assert bench._default_parts() == bench.PARTS


def test_everyone_is_given_the_same_task(stand_ins):
    """Our loss and the one of tensors agree; a library that computes the same takes our steps."""
    points = torch.tensor(SMALL.cloud())
    loss = words_task.BettiLoss(SMALL.betti, diagonal=1.0, guard=0.0, suppress="all", dimensions=(1,))
    both = [loss(points), words_task.words_loss(peers.our_diagrams, SMALL, points)]
    assert both[0].item() == pytest.approx(both[1].item(), rel=1e-9)
    missing = []
    rows = list(words_task.task_rows((SMALL,), words_task.PEERS[:1], missing))
    assert [row["library"].removeprefix("paper_artifact, ") for row in rows] == [
        "BettiLoss",
        "BettiLoss, K = 10",
        "diagrams",
        "oineus.diff",
    ]
    assert not missing and rows[0]["step"] == rows[2]["step"] == rows[3]["step"] > 0
    assert rows[0]["ratio"] == 1 and rows[3]["seconds"] > 0
    assert not words_task.holds(SMALL.cloud(), SMALL)
