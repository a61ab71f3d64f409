"""Notebook 19: tables of solids on rows made by hand, the resumed measurement, voxels on a small soup."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from paper_artifact.errors import InputError
from paper_artifact.ingest.solidify import Rung, Wanted
from paper_artifact.report import measured, solid_peers, solids
from paper_artifact.scene.shapes import make_shape


def row(shape, arm, seed, offset, genus, inside, taken, chamfer=np.nan):
    return {
        "shape": shape, "condition": arm, "seed": seed, "offset": offset, "b0": 1, "b1": 2 * genus, "b2": 1,
        "genus": genus, "inside": inside, "triangles": 1000, "meets": taken, "taken": taken,
        "chamfer": chamfer, "hausdorff95": chamfer, "moved": 0.95, "crossings": 0, "seconds": 5.0,
    }  # fmt: skip


@pytest.fixture
def table() -> pd.DataFrame:
    return pd.DataFrame(
        [
            row("torus", "C0", 0, 0.008, 4, 0.5, False),
            row("torus", "C0", 0, 0.01, 1, 0.5, True, 0.004),
            row("torus", "C1", 0, 0.008, 1, 0.6, True, 0.003),
            row("torus", "C2", 0, 0.02, 30, 0.0, False),
            row("sphere", "C0", 0, 0.008, 0, 0.6, True, 0.005),
            row("sphere", "C1", 0, 0.008, 0, 0.6, True, 0.002),
        ]
    )


def test_smallest_offsets_and_what_pays(table):
    offsets = solids.smallest_offsets(table)
    assert offsets.loc[("torus", 0), "C0"] == 0.01 and np.isinf(offsets.loc[("torus", 0), "C2"])
    assert np.isnan(offsets.loc[("sphere", 0), "C2"])
    pays = solids.pays_table(table)
    against = pays.loc["smallest sound ε: C1 against C0"]
    assert (against["smaller"], against["equal"], against["larger"]) == (1, 1, 0)
    assert pays.loc["smallest sound ε: C1 against C2", "smaller"] == 1, "none is larger than any"
    assert pays.loc["Chamfer of the solid: C1 against C0", "smaller"] == 2


def test_tables_say_what_there_is(table):
    smallest = solids.smallest_table(table)
    assert smallest.loc["torus", "ε C2"] == "none" and smallest.loc["sphere", "ε C2"] == ""
    assert (
        smallest.loc["torus", "wanted β"] == "(1, 2, 1)" and smallest.loc["torus", "Chamfer % C1"] == "0.30"
    )
    genus = solids.genus_table(table)
    assert genus.loc[("torus", "C0"), 0.01] == "[1]" and genus.loc[("torus", "C2"), 0.02] == "30 open"
    assert "NOT MEASURED, seed 0: sphere C2" in solids.covered_text(table)
    assert solids.cost_table(table).loc["C0", "solids"] == 2
    assert solids.offsets_figure(table).axes[0].get_xscale() == "log"


def test_ways_are_compared_over_the_runs_that_all_have(table):
    peers = pd.DataFrame(
        [{"shape": "torus", "condition": arm, "seed": 0, "way": "voxels", "passes": True, "genus": 1,
          "meets": arm == "C1", "chamfer": 0.01} for arm in ("C0", "C1", "C2")]
    )  # fmt: skip
    ways = solids.ways_table(table, peers)
    assert ways.loc[("voxels", "C1"), "wanted topology"] == 1 and ways["runs"].eq(1).all()
    assert ways.loc[("offset 0.008", "C0"), "wanted topology"] == 0
    assert ways.loc[("offset 0.008", "C2"), "wanted topology"] == 0, "not tried: coarser ones had failed"
    assert ways.loc[("offset chosen", "C0"), "Chamfer % where wanted"] == "0.40"
    assert (
        ways.loc[("voxels", "C2"), "right genus"] == 1
        and ways.loc[("offset 0.008", "C0"), "right genus"] == 0
    )
    assert len(solids.ways_table(table, pd.DataFrame())) == 6, "no peer measured"


def test_every_soup_of_the_solids_was_given_to_the_other_ways():
    stored, peers = measured.read("solids"), measured.read("solid_peers")
    runs = set(stored[solids.RUN].itertuples(index=False, name=None))
    assert set(peers["way"]) == set(solid_peers.WAYS)
    assert solid_peers.truth_table(peers)["shapes"].eq(len(solids.shapes_of_solids())).all()
    for _, own in peers[peers["condition"] != solid_peers.TRUTH].groupby("way"):
        assert not own.duplicated(solids.RUN).any()
        assert set(own[solids.RUN].itertuples(index=False, name=None)) == runs
    found = [tuple(row) for row in peers[["b0", "b1", "b2"]].to_numpy()]
    wanted = [solids.wanted_for(shape).betti for shape in peers["shape"]]
    same = np.array([one == other for one, other in zip(found, wanted, strict=True)])
    assert (peers["meets"] == (same & peers["passes"])).all() and peers["chamfer"].gt(0).all()
    ways = solids.ways_table(stored, peers)
    assert ways["runs"].eq(15).all() and (ways["wanted topology"] <= ways["right genus"]).all()


def test_an_open_ground_truth_asks_for_a_thick_shell():
    assert solids.wanted_for("bowl_wide") == Wanted((1, 0, 1), body=False)
    assert solids.wanted_for("double_torus") == Wanted((1, 4, 1), body=True)


def test_the_ladder_is_left_when_finer_offsets_cannot_help():
    def rung(genus: int) -> Rung:
        return Rung(0.01, (1, 2 * genus, 1), genus, 0.5, 0, 0, (1, 1, 1))

    wanted = Wanted((1, 2, 1), body=True)
    assert not solids._enough([rung(0), rung(2)], wanted), "no hit yet"
    assert not solids._enough([rung(0), rung(1)], wanted)
    assert solids._enough([rung(0), rung(1), rung(2)], wanted) and solids._enough([rung(30)], wanted)


def test_the_measurement_goes_on_from_what_is_stored(table, tmp_path, monkeypatch):
    path = tmp_path / "solids.csv"
    table.to_csv(path, index=False)
    monkeypatch.setattr(solids, "solidify_soup", None)
    assert len(solids.measure_solids(soups=tmp_path, path=path)) == len(table), "no soup there: nothing new"
    assert len(pd.read_csv(measured.write("solids", tmp_path, soups=tmp_path))) == len(table)
    with pytest.raises(InputError, match="takes no --soups"):
        measured.write("cost", tmp_path, soups=tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        measured.write("solids", tmp_path, soups=tmp_path / "nowhere")


def test_voxels_of_a_closed_torus_have_its_topology():
    found = solid_peers.judged("torus", solid_peers.voxels(make_shape("torus")), "torus by voxels")
    assert found["meets"] and found["genus"] == 1 and found["chamfer"] < 0.02
