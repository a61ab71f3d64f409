"""Density staircases: counts are the bundle's, margins decide as bundles do; the group wave's plan and
certificates are the catalogue's and the meshes'. That the stored tables are what the code measures: notebooks
03, 04 and 10, whose outputs are compared."""

import json

import numpy as np
import pytest

from paper_artifact import staircase as kit
from paper_artifact.catalogue import SHAPES, shape_row, shapes_of, study_config
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.results import measured, published
from paper_artifact.scene.fetch import sources
from paper_artifact.scene.shapes import find_mesh, make_shape
from paper_artifact.study.dispositions import polygon_counts, same_certificate
from paper_artifact.study.studies import STUDIES
from paper_artifact.topology.bundle import build_from_mesh

BOX = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\n"
SIDES = ["f 1 5 7 3\n", "f 2 4 8 6\n", "f 1 2 6 5\n", "f 3 7 8 4\n", "f 1 3 4 2\n", "f 5 6 8 7\n"]


def test_staircase_counts_the_bundles_bars():
    mesh = make_shape("torus")
    table = kit.staircase(mesh, (512, 1024), (0, 1))
    bundle = build_from_mesh(mesh.vertices, mesh.faces, 1024, 1)
    row = table[(table["samples"] == 1024) & (table["seed"] == 1)]
    assert row["floor"].iloc[0] == pytest.approx(bundle.floor)
    assert kit.counts(row, 1).iloc[0] == len(bundle.bars[1])
    assert row["h1_1"].iloc[0] == pytest.approx(np.ptp(bundle.bars[1][0]))
    assert kit.agreement(table, table) == (4, 0.0)
    assert kit.signature_table(table).loc["torus", 1024] == "(1,1,0)"


def test_bars_are_the_staircase_s_lifetimes():
    stored = measured("staircase")
    found = kit.bars(stored)
    assert len(found) == (stored.filter(regex=r"^h\d_\d$") > 0).to_numpy().sum()
    own = stored[stored["shape"] == "torus"]
    chosen = found[(found["shape"] == "torus") & (found["bar"] == "loop 2")]
    assert chosen["lifetime"].tolist() == own["h1_2"].tolist()
    np.testing.assert_allclose(chosen["margin"], own["h1_2"] / own["floor"])
    significant_bars = found[found["margin"] > 1].groupby(kit.KEYS).size()
    values = kit.significant_counts(stored).groupby(kit.KEYS)["value"].sum() - 1  # without the infinite bar
    assert significant_bars.to_dict() == values[values > 0].to_dict()


def test_margins_decide_as_the_bundles_do():
    stored, mesh = measured("windows"), make_shape("torus")
    assert set(stored["shape"]) == {each.name for each in SHAPES if each.group != "allocation"}
    margins = kit.bundle_margins(("torus",), (0,))
    flip = 6 * margins[margins["inside"]]["margin"].min()
    for k, bars in ((flip - 0.01, 2), (flip + 0.01, 1)):
        assert len(build_from_mesh(mesh.vertices, mesh.faces, 2048, 0, k=k).bars[1]) == bars
    with pytest.raises(InputError, match="pebble"):
        kit.bundle_margins(("pebble",), (0,))


def test_polygons_are_counted_before_any_split(tmp_path):
    path = tmp_path / "box.obj"
    doubled = BOX + "v 0 0 0\n" + "".join(SIDES).replace("f 1 5", "f 9 5") + "f -9 -8 5\n"  # and a fin
    for text, found in (
        (BOX + "".join(SIDES), (0, 0, 2)),
        (BOX + "".join(SIDES[1:]), (4, 0, 1)),
        (doubled, (1, 2, 2)),
        (BOX + "f 1 2 3\nf 2 3 4\n", None),
    ):
        path.write_text(text)
        assert polygon_counts(path) == found
    assert polygon_counts(tmp_path / "box.ply") is None


def test_the_plan_is_the_catalogue_s_and_the_study_s():
    plan = json.loads((REPOSITORY / "results" / "plan" / "group_wave.json").read_text())
    assert set(plan["pool"]["candidates"]) == set(published("S12")["shape"])
    for group, members in plan["members"].items():
        assert tuple(members) == shapes_of(group)
        for name, facts in members.items():
            row = shape_row(name)
            own = {"samples": row.samples, "bundle_seed": row.bundle_seed, "budget": row.budget}
            assert facts == own | {"dimensions": None if row.dimensions is None else list(row.dimensions)}
    block, runs, config = STUDIES["table2"][0], plan["runs"], study_config("horse", "C1")
    assert set(block.shapes) == {name for members in plan["members"].values() for name in members}
    assert (runs["conditions"], runs["seeds"]) == (list(block.conditions), list(block.seeds))
    assert (runs["steps"], runs["views"], runs["size"]) == (config.steps, config.views, config.size)
    loss = config.loss
    assert (runs["rho"], tuple(runs["ramp"])) == (loss.rho, loss.ramp)
    assert runs["refresh_every"] == loss.refresh_every


def test_a_stored_certificate_is_what_the_mesh_gives_now():
    """The candidates': notebook 10."""
    stored = json.loads((REPOSITORY / "results" / "certificates" / "spot.json").read_text())
    now = certify_mesh(find_mesh("spot", welded=False)).to_json()
    assert same_certificate(now, stored) and sources()["spot"].obtainable
    assert not same_certificate(now | {"euler": now["euler"] + 1}, stored)
    inward = json.loads(json.dumps(now))
    inward["components"][0]["volume"] *= -1
    assert not same_certificate(inward, stored)
