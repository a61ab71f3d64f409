"""The audit's pre-registered rule and the study's protocol (the catalogue's rows) held together, on the
stored staircases: they agree but for two shapes, which are named here with the reason."""

from functools import cache

import numpy as np
import pandas as pd
import pytest

from paper_artifact.audit.rule import WORKING, Decision, Rung, decide
from paper_artifact.catalogue import SHAPES, Shape
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.evaluate.diagram import KEPT
from paper_artifact.results import measured
from paper_artifact.scene.shapes import find_mesh, surface
from paper_artifact.staircase import staircase

# shape: what the rule chooses (class, M, the loss's dimensions) where the protocol has another; and why.
DIFFERENT = {
    # The rule goes on to the density that shows all four loops, and the void with them. The protocol keeps
    # the paper's M = 2048, where two loops lie below the floor: Table 1's stretch case is that ceiling.
    "double_torus": (1, 8192, (1, 2)),
    # At sampling seed 0, the audit's, the void lies at .98 of the floor and is left out. The paper's bundle
    # holds it, so the protocol takes seed 1, where the rule says the same as the protocol.
    "bob": (1, 2048, (1,)),
}


@cache
def staircases() -> pd.DataFrame:
    """The stored ones, and the pot's, which notebook 11 measures."""
    pot = staircase(surface("pot"), WORKING, (0,))
    return pd.concat([measured("staircase"), measured("group_wave"), pot], ignore_index=True)


def rungs(shape: str, seed: int) -> list[Rung]:
    every = staircases()
    own = every[(every["shape"] == shape) & (every["seed"] == seed) & every["samples"].isin(WORKING)]

    def margins(row: dict, dimension: int) -> tuple:
        return tuple(row[f"h{dimension}_{rank}"] / row["floor"] for rank in range(1, KEPT + 1))

    return [
        Rung(
            int(row["samples"]), seed, row["floor"], tuple(margins(row, dimension) for dimension in range(3))
        )
        for row in own.to_dict("records")
    ]


def decided(row: Shape, seed: int) -> Decision:
    certificate = certify_mesh(find_mesh(row.name, welded=False))
    if not certificate.passed and not certificate.closed:
        certificate = certify_mesh(find_mesh(row.name, welded=False), with_boundary=True)
    return decide(rungs(row.name, seed), certificate)


def protocol(row: Shape) -> tuple[int, int, tuple[int, ...]]:
    """The row's class, density and dimensions; None there means every dimension with a significant bar."""
    (rung,) = [each for each in rungs(row.name, row.bundle_seed) if each.samples == row.samples]
    shown = tuple(int(dimension) for dimension in np.flatnonzero(rung.counts))
    return row.judged, row.samples, row.dimensions or shown


def choice(decision: Decision) -> tuple[int | None, int | None, tuple[int, ...]]:
    return decision.dimension, decision.samples, decision.dimensions


@pytest.mark.parametrize("row", SHAPES, ids=lambda row: row.name)
def test_the_rule_chooses_the_protocol(row):
    decision = decided(row, 0)
    assert choice(decision) == DIFFERENT.get(row.name, protocol(row))
    assert (choice(decision) != protocol(row)) == (row.name in DIFFERENT)


def test_bob_differs_by_the_sampling_seed_alone():
    bob = next(row for row in SHAPES if row.name == "bob")
    assert choice(decided(bob, bob.bundle_seed)) == protocol(bob) == (1, 2048, (1, 2))
    (rung,) = [each for each in rungs("bob", 0) if each.samples == 2048]
    assert 0.95 < rung.margins[2][0] < 1 and "sampling seed" in " ".join(decided(bob, 0).warnings)


def test_the_double_torus_has_its_other_loops_below_the_floor_of_the_protocol():
    two_rungs = {each.samples: each for each in rungs("double_torus", 0)}
    assert two_rungs[2048].counts == (0, 2, 0) and two_rungs[8192].counts == (0, 4, 1)
    assert max(two_rungs[2048].margins[1][2:]) < 0.9
