"""The repair gate: the loss alone repairs defective clouds, at least by the paper's factors (App. C)."""

from __future__ import annotations

import numpy as np
import pytest

from paper_artifact.errors import InputError
from paper_artifact.study.repair import make_probe, repair


@pytest.mark.parametrize(
    "name, dimension, significant", [("T1", 2, 1), ("T2", 1, 1), ("T3", 0, 1), ("T4", 0, 0)]
)
def test_probes_start_defective(name, dimension, significant):
    probe = make_probe(name)
    assert probe.dimension == dimension and len(probe.start) == len(probe.target) == probe.bundle.samples
    assert len(probe.bundle.bars[dimension]) == (0 if name == "T2" else 1)
    start = repair(probe, steps=0)
    assert start.significant.tolist() == [significant] and start.bottleneck[0] > 0.035
    assert np.array_equal(make_probe(name).start, probe.start) and not np.array_equal(
        make_probe(name, 1).start, probe.start
    )


@pytest.mark.parametrize("name, factor", [("T1", 8.8), ("T2", np.inf), ("T3", 1229), ("T4", 450)])
def test_repairs_by_at_least_the_papers_factor(name, factor):
    probe = make_probe(name)
    run = repair(probe, record_every=200)
    assert run.factor >= factor and run.significant[-1] == len(probe.bundle.bars[probe.dimension])
    assert run.loss[-1] < run.loss[0] and np.isfinite(run.final).all()


def test_only_recruitment_moves_the_bridged_merge():
    """Lemma 1 in practice: no significant live H0 bar for the target, so nothing moves unless recruited."""
    probe = make_probe("T4")
    still = repair(probe, steps=20, recruitment=False)
    assert np.array_equal(still.final, still.start) and not still.recruited.any() and not still.loss.any()
    moved = repair(probe, steps=20)
    assert moved.recruited[0] == 1 and not np.array_equal(moved.final, moved.start)


def test_unknown_probe():
    with pytest.raises(InputError, match="unknown repair probe 'T9'"):
        make_probe("T9")
