"""The gate's tables: components against scipy's single linkage, and the two ends of a bridged merge."""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from paper_artifact.report import gate


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
    assert table.loc["ours reaches it"].tolist() == [True, True] and table.loc[
        "significant before"
    ].tolist() == [0, 0]
    assert len(gate.gate_figure(runs).axes) == 6 and gate.factor_table(runs)["paper's"].tolist() == [
        "450×",
        "450×",
    ]


def test_lemma():
    table = gate.lemma_table(steps=10)
    assert table["points moved"].tolist() == [True, False] and table["loss is zero"].tolist() == [False, True]
