"""The gate's tables: components against scipy's single linkage, and the two ends of a bridged merge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from paper_artifact.export.figures import new_figure
from paper_artifact.report import gate
from paper_artifact.study.repair import Trajectory


def test_component_sizes_are_single_linkage():
    points = np.random.default_rng(0).random((300, 3))
    for radius in (0.02, 0.04, 0.06):
        labels = fcluster(linkage(points, "single"), 2 * radius, "distance")
        assert gate.component_sizes(points, radius).tolist() == sorted(
            np.bincount(labels)[1:].tolist(), reverse=True
        )


def test_a_bridge_is_cut_where_it_is_sparse_and_stands_where_it_is_dense():
    runs = gate.run_gate(("T4", "T4d"), record_every=200)
    severed = gate.severed_table(runs)
    assert severed["the second one"].tolist() == ["a half", "a single point"]
    table = gate.gate_table(runs)
    assert table.loc["significant before"].tolist() == [0, 0] and table.loc["after"].tolist() == [1, 1]
    factors = gate.factor_table(runs)
    assert len(gate.gate_figure(runs).axes) == 6 and factors["paper's factor"].tolist() == ["450×", "450×"]
    for _, run in runs.values():
        step, value = gate.at_factor(run, 450)
        before = run.bottleneck[run.steps < step]
        assert value <= run.bottleneck[0] / 450 < before.min()
    assert not (factors["first at step"] == "never").any()


def test_the_value_at_a_factor_and_zeros_on_a_line_of_their_own():
    cloud = np.zeros((3, 3))
    curve = np.array([0.09, 0.03, 0.009, 0.0, 0.0])
    run = Trajectory("T2", np.arange(5) * 20, curve, *[np.zeros(5, int)] * 3, cloud, cloud)
    assert gate.at_factor(run, 8.8) == (40, 0.009) and gate.at_factor(run, np.inf) == (60, 0.0)
    assert gate.at_factor(replace(run, bottleneck=curve + 0.01), np.inf) == (None, None)
    axis = new_figure(1, 1, 3, 2)[1][0][0]
    gate._draw_curve(axis, run, 8.8)
    (drawn,) = axis.collections
    assert len(drawn.get_offsets()) == 2 and drawn.get_offsets()[:, 1].max() < 0.009
    labels = dict(zip((each.get_text() for each in axis.get_yticklabels()), axis.get_yticks(), strict=True))
    assert list(labels) == ["0", "0.001", "0.01", "0.1"] and labels["0"] == drawn.get_offsets()[0, 1]
    assert labels["0"] < labels["0.001"] < curve[2] < labels["0.1"] < axis.get_ylim()[1] * 1.01


def test_lemma():
    table = gate.lemma_table(steps=10)
    assert table["points moved"].tolist() == [True, False] and table["loss is zero"].tolist() == [False, True]
