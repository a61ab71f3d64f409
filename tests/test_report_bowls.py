"""The bowls' certificates, margins and outcomes."""

from __future__ import annotations

import numpy as np
import pytest

from paper_artifact.report import bowls
from paper_artifact.report.kit import tables
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import collect_study
from paper_artifact.scene.shapes import BOWL_RIMS, make_shape
from tests import report_records


@pytest.fixture(scope="module")
def stairs():
    return bowls.staircases((0,))


@pytest.fixture
def study(tmp_path):
    """Both bowls: C0, C1, C2 of the narrow one with three seeds, one C0 run of the wide one."""
    for condition, tail, count in (("C0", 0.05, 1), ("C1", 0.01, 1), ("C2", 0.12, 0)):
        for seed in range(3):
            record = report_records.study_record(
                "bowl_narrow", condition, seed, tail + 0.001 * seed, counts=(0, 0, count)
            )
            report_records.write_record(record, tmp_path)
    report_records.write_study(tmp_path, {("bowl_wide", "C0", 1): 0.04})
    return collect_study("bowls", folder=tmp_path)


def test_disks_with_the_paper_s_openings():
    table = bowls.certificate_table()
    for shape, nominal in BOWL_RIMS.items():
        column = table[shape]
        found = [column[name] for name in ("verdict", "surface", "boundary loops", "Euler characteristic")]
        assert found == ["pass", "disk", 1, 1]
        assert float(column["ours, mean"]) == pytest.approx(nominal, abs=0.005)
        rim = bowls.opening(make_shape(shape))
        assert rim.min() < nominal < rim.max() and np.ptp(rim) < 0.07
    assert len(bowls.bowl_figure(40).axes) == 2


def test_margins_beside_the_paper_s(stairs):
    table = bowls.margin_table(stairs)
    assert set(table["counts"]) == {"(1,0,1)"} and len(table) == 8
    for row in published("S9").itertuples():
        ours = float(table.loc[(row.shape, row.samples), f"H{row.dimension}, seed 0"])
        assert table.loc[(row.shape, row.samples), f"H{row.dimension}, paper"] == f"{row.value:.2f}"
        assert ours == pytest.approx(row.value, rel=0.05 if row.dimension == 2 else 0.3), row
    assert table.loc[("bowl_wide", 20_000), "H2, paper"] == "—"


def test_the_bundles_hold_one_void_at_2048(stairs):
    table = bowls.bundle_table()
    assert (table["bars"] == 1).all() and (table["M"] == 2048).all() and (table["acts on"] == "H2").all()
    own = stairs[(stairs["shape"] == "bowl_wide") & (stairs["samples"] == 2048)].iloc[0]
    assert table.loc["bowl_wide", "margin"] == pytest.approx(own["h2_1"] / own["floor"], abs=0.006)


def test_outcomes_and_what_is_missing(study, stairs):
    table = bowls.outcome_table(study, stairs)
    assert len(table) == 6 and table.loc[("bowl_narrow", "C1"), "our tails"] == ".0100/.0110/.0120"
    assert table.loc[("bowl_narrow", "C1"), "paper's tails"] == ".0137/.0126/.0151"
    assert (
        table.loc[("bowl_wide", "C1"), "our tails"] == "not recorded"
        and table.loc[("bowl_wide", "C2"), "paper's"] == "3.1"
    )
    low, high = map(float, table.loc[("bowl_wide", "C0"), "half the void"].split("–"))
    assert low <= high == pytest.approx(0.077, abs=0.001)
    cell = tables.matrix_table(study).loc["C0", ("bowl_wide", "ours")]
    assert cell == ".0400, 1 of 3 seeds"


def test_counts_are_held_against_the_bundle_not_the_disks_homology(study):
    table = tables.verdict_table(study)
    assert (
        table.loc["bowl_narrow", "verdict"] == "pass"
        and table.loc["bowl_narrow", "paper's tails give"] == "pass"
    )
    assert table.loc["bowl_narrow", "lost (seeds)"] == "C2 (0, 1, 2)"
    assert table.loc["bowl_narrow", "phantoms (seeds)"] == "none"
    assert table.loc["bowl_wide", "verdict"] == "incomplete"
