"""Solids of soups: analytic soups of known topology, the offset taken, the way back, crossings, errors."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from paper_artifact import cli
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.cli.solids import offset_table
from paper_artifact.errors import InputError
from paper_artifact.export.solid import (
    SoupSolid,
    distances_to,
    placed,
    solidify_mesh,
    solidify_soup,
    write_solid,
)
from paper_artifact.frame import Frame
from paper_artifact.ingest.crossings import crossing_faces
from paper_artifact.ingest.distance import nearest_on
from paper_artifact.ingest.solidify import Rung, check_ladder, plateau, wanted_of
from paper_artifact.ingest.surgery import without_holes
from paper_artifact.mesh import Mesh, checked_mesh, load_mesh
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import Soup, initial_mlp, save_soup
from tests import certify_shapes as shapes

OFFSETS = (0.02, 0.025, 0.03)


def soup_of(vertices: np.ndarray, faces: np.ndarray, apart: float = 0.0, opacity: float = 4.0) -> Soup:
    """A mesh's triangles as a soup, each shrunk by the share `apart`; red grows with x, green and blue are
    .5."""
    corners = np.asarray(vertices)[faces]
    corners = corners + apart * (corners.mean(axis=1, keepdims=True) - corners)
    features = torch.zeros(len(corners), 3, 7)
    features[:, :, 0] = torch.from_numpy(corners[:, :, 0]).float()
    features[:, :, 3] = -20.0  # the base colour alone
    return Soup(
        torch.from_numpy(corners).float(), features, torch.full((len(corners), 3), opacity), initial_mlp(0)
    )


@cache
def torus() -> SoupSolid:
    mesh = make_shape("torus")
    return solidify_soup(soup_of(mesh.vertices, mesh.faces, apart=0.2), (1, 2, 1), OFFSETS, name="torus")


def test_a_torus_in_pieces_becomes_one_closed_torus():
    solid, mesh = torus(), make_shape("torus")
    assert solid.rung is solid.rungs[0] and solid.rung.genus == 1 and solid.rung.inside > 0.3
    again = trimesh.Trimesh(solid.mesh.vertices, solid.mesh.faces, process=False)
    assert again.is_watertight and again.is_winding_consistent and again.volume > 0
    assert again.euler_number == solid.certificate.euler == 0 and solid.certificate.betti == (1, 2, 1)
    assert solid.crossings == 0 and not crossing_faces(solid.mesh.vertices, solid.mesh.faces).any()
    assert solid.moved.mean() > 0.9
    true = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    distance = trimesh.proximity.closest_point(true, solid.mesh.vertices[::97])[1]
    assert np.median(distance) < 0.1 * solid.rung.offset * solid.diagonal, "it has gone back to the soup"


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_a_damaged_mesh_becomes_one_closed_torus(far):
    """A double sheet with holes: two tori, one inside the other, without a tenth of the triangles."""
    torus = make_shape("torus")
    normals = trimesh.Trimesh(torus.vertices, torus.faces, process=False).vertex_normals
    inner = (torus.vertices - 0.02 * normals, torus.faces[:, ::-1])
    vertices, faces = shapes.joined((torus.vertices, torus.faces), inner)
    kept = faces[np.random.default_rng(0).random(len(faces)) > 0.1]
    damaged = checked_mesh(vertices + far, kept, "scan")
    assert not certify_mesh(damaged).passed
    rungs = []
    solid = solidify_mesh(damaged, (1, 2, 1), (0.03,), 2.0, rungs.append)
    assert solid.certificate.passed and solid.certificate.betti == (1, 2, 1) and len(rungs) == 1
    assert solid.crossings == 0 and np.allclose(solid.colours, 0.7) and solid.hollow == ()
    whole = Mesh(torus.vertices + far, torus.faces, "torus")
    assert distances_to(placed(solid.mesh, solid.frame), whole, samples=4000)["hausdorff95"] < 0.02


def solid_of(vertices, faces, betti, *offsets) -> SoupSolid:
    return solidify_mesh(checked_mesh(vertices, faces, "mesh"), betti, offsets, 2.0, lambda rung: None)


def test_a_sheet_has_the_numbers_but_no_inside():
    solid = solid_of(*shapes.bowl(), (1, 0, 1), 0.02, 0.03)
    assert solid.mesh is None and solid.hollow == solid.rungs
    with pytest.raises(InputError, match="no solid to write"):
        write_solid("never.ply", solid)
    assert len(solid.holes) == 1 and "Too wide for a disc: 1 opening up to 31 % of D" in offset_table(solid)


def test_a_thin_wall_is_a_body_without_an_inside():
    """A tube whose wall is 1.4 ε thick; one sheet of it is none."""
    tube = trimesh.creation.annulus(0.45, 0.5, 1.0)
    solid = solid_of(tube.vertices, tube.faces, (1, 2, 1), 0.02, 0.025)
    assert solid.rung is solid.rungs[0] and len(solid.rungs) == 2 and solid.certificate.betti == (1, 2, 1)
    assert solid.rung.inside == 0 and solid.rung.backed > 0.9 and "by its thin walls" in offset_table(solid)
    made = trimesh.Trimesh(solid.mesh.vertices, solid.mesh.faces, process=False)
    assert 1 < made.volume / tube.volume < 1.3
    sheet = tube.faces[np.linalg.norm(tube.vertices[tube.faces][:, :, :2], axis=2).min(axis=1) > 0.48]
    solid = solid_of(tube.vertices, sheet, (1, 2, 1), 0.02)
    assert solid.mesh is None and solid.hollow == solid.rungs and solid.rungs[0].backed < 0.1


@pytest.mark.parametrize("body", [True, False])
def test_holes_of_a_scan_are_closed_where_a_body_is_wanted(body):
    """A sphere with two holes that share a corner, and one apart; as a sheet it keeps them."""
    sphere = trimesh.creation.icosphere(4)
    rings = [set(each) for each in sphere.vertex_neighbors]
    other = next(v for v in range(len(rings)) if len(rings[v] & rings[0]) == 1 and v not in rings[0])
    gone = np.isin(sphere.faces, [0, other]).any(axis=1)
    gone |= sphere.face_normals @ -sphere.vertices[0] > 0.95
    solid = solid_of(sphere.vertices, sphere.faces[~gone], (1, 0, 1) if body else (1, 2, 0), 0.008)
    if body:
        assert solid.certificate.betti == (1, 0, 1) and solid.rung.inside > 0.8
        assert len(solid.holes) == 3 and "Closed by discs: 3 holes up to 20 % of D" in offset_table(solid)
    else:
        assert solid.holes == () and solid.certificate.betti == (1, 4, 1)


def test_discs_close_every_hole_also_one_of_many_corners():
    circle = np.linspace(0, 2 * np.pi, 1001)[:-1]
    rims = [np.stack([np.cos(circle), np.sin(circle), np.full(1000, z)], axis=1) for z in (0.0, 3.0)]
    at, after = np.arange(1000), np.roll(np.arange(1000), -1)
    sides = np.concatenate(
        [np.stack([at, after, 1000 + at], 1), np.stack([1000 + after, 1000 + at, after], 1)]
    )
    whole, across = without_holes(Mesh(np.concatenate(rims), sides, "tube"), 2.5)
    assert certify_mesh(whole).betti == (1, 0, 1) and np.allclose(across, 2)
    assert abs(whole.vertices[whole.faces].mean(axis=1)[len(sides) :, 2] - 1.5).min() > 1.49
    kept, across = without_holes(Mesh(np.concatenate(rims), sides, "tube"), 1.9)
    assert len(kept.faces) == len(sides) and len(across) == 2
    loose = Mesh(np.eye(3), np.array([[0, 1, 2]]), "triangle")
    assert without_holes(loose, 9.0)[1] == []


def test_colours_are_the_soups():
    solid = torus()
    expected = 1 / (1 + np.exp(-solid.mesh.vertices[:, 0]))
    assert np.abs(solid.colours[:, 0] - expected).max() < 0.05 and np.allclose(solid.colours[:, 1:], 0.5)


@pytest.mark.parametrize(
    "surface, betti, body",
    [
        (shapes.ball(), (1, 0, 1), True),
        (shapes.joined(shapes.ball(), shapes.ball(centre=(4, 0, 0))), (2, 0, 2), True),
        (shapes.bowl(), (1, 0, 1), False),
    ],
)
def test_nothing_wanted_takes_what_lasts(surface, betti, body):
    solid = solidify_soup(soup_of(*surface), None, OFFSETS)
    assert (solid.wanted.betti, solid.wanted.body) == (betti, body) and solid.lasting > 0.9
    assert solid.certificate.passed and solid.certificate.betti == betti and solid.crossings == 0


def test_nothing_is_written_where_no_numbers_last():
    """A chain of balls whose gaps close one by one: another number of components at every offset."""
    places = np.cumsum([0.0, 2.05, 2.1, 2.15, 2.2, 2.25, 2.3])
    chain = shapes.joined(*(shapes.ball(centre=(each, 0, 0)) for each in places))
    solid = solidify_soup(soup_of(*chain), None, (0.002, 0.0026, 0.0041, 0.0056, 0.0071, 0.0087), cells=1)
    assert solid.lasting < 1 / 3 and solid.mesh is None and solid.rung is None
    assert "no Betti numbers were stated, and none last over a third" in offset_table(solid)


def rung(offset: float, genus: int, inside: float) -> Rung:
    return Rung(offset, (1, 2 * genus, 1), genus, inside, 0.0, 0, 0, (1, 1, 1))


def test_the_plateau_is_the_widest_in_log_offset_with_an_inside():
    steps = (0.001, 0, 0.0), (0.01, 0, 0.0), (0.012, 1, 0.5), (0.02, 1, 0.4), (0.021, 0, 0.4)
    ladder = [rung(*step) for step in steps]
    assert plateau(ladder) == ((1, 2, 1), pytest.approx(np.log(0.02 / 0.012) / np.log(21)))
    assert plateau(ladder[:2]) == ((1, 0, 1), 1.0) and plateau(ladder[2:3]) == ((1, 2, 1), 1.0)


def test_written_solids_read_back_and_repeat(tmp_path):
    vertices, faces = shapes.plate(1)
    for name in ("a", "b"):
        solid = solidify_soup(soup_of(vertices, faces), (1, 2, 1), (0.03,))
        for kind in ("ply", "glb"):
            assert write_solid(tmp_path / f"{name}.{kind}", solid).betti == (1, 2, 1)
    for kind in ("ply", "glb"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
        assert np.array_equal(load_mesh(tmp_path / f"a.{kind}", welded=False).vertices, solid.mesh.vertices)
    colours = trimesh.load(tmp_path / "a.ply", process=False).visual.vertex_colors[:, :3]
    assert np.abs(colours / 255 - solid.colours).max() < 0.003
    for frame, words in (
        (Frame((2.0**51, 0.0, 0.0)), "coincide at coordinates"),
        (Frame(exponent=800), "too large"),
    ):
        with pytest.raises(InputError, match=words):
            write_solid(tmp_path / "far.ply", replace(solid, frame=frame))
    assert not (tmp_path / "far.ply").exists()


def test_nearest_points_agree_with_trimesh():
    rng = np.random.default_rng(2)
    soup = rng.normal(size=(40, 3, 3))
    points = rng.normal(size=(300, 3))
    found = nearest_on(soup, points, 9.0)
    mesh = trimesh.Trimesh(soup.reshape(-1, 3), np.arange(120).reshape(-1, 3), process=False)
    _, distance, _ = trimesh.proximity.closest_point(mesh, points)
    np.testing.assert_allclose(np.linalg.norm(found.points - points, axis=1), distance, atol=1e-9)
    assert found.weights.min() >= 0 and np.allclose(found.weights.sum(axis=1), 1)
    with pytest.raises(InputError, match="farther than"):
        nearest_on(soup, points + 100, 1.0)


def test_crossings_are_found_and_only_those():
    vertices, faces = shapes.ball()
    assert not crossing_faces(vertices, faces).any()
    assert not crossing_faces(*shapes.plate(2)).any(), "flat neighbours lie in one plane and do not meet"
    twice = shapes.joined((vertices, faces), shapes.ball(centre=(1.5, 0.1, 0.2)))
    marked = crossing_faces(*twice)
    centres = twice[0][twice[1]].mean(axis=1)
    assert marked.any() and (np.abs(centres[marked, 0] - 0.75) < 0.5).all()
    second = np.arange(len(twice[0])) >= len(vertices)
    assert np.array_equal(crossing_faces(*twice, changed=second), marked), "one of each pair has changed"
    assert not crossing_faces(*twice, changed=np.zeros(len(twice[0]), dtype=bool)).any()
    pierced = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [3, 3, 1.0]])
    assert crossing_faces(pierced, np.array([[0, 1, 2], [3, 4, 5]])).all()
    pierced[3:] += 9
    assert not crossing_faces(pierced, np.array([[0, 1, 2], [3, 4, 5]])).any()
    folded = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.3, 0]])
    assert crossing_faces(folded, np.array([[0, 1, 2], [1, 0, 3]])).all()
    for points in (np.zeros((0, 3)), np.eye(3)):
        assert crossing_faces(points, np.zeros((0, 3), int)).shape == (0,)
    with pytest.raises(InputError, match="finite"):
        crossing_faces(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))


@pytest.mark.parametrize(
    "betti, words",
    [((0, 0, 0), "b0 ≥ 1"), ((1, -2, 1), "none negative"), ((1, 2), "b0,b1,b2"), ((1, 3, 1), "twice"),
     ((2, 0, 1), "b2 = b0"), ((1, 0, 2), "b2 = b0")],
)  # fmt: skip
def test_impossible_betti_numbers_are_refused(betti, words):
    with pytest.raises(InputError, match=words):
        wanted_of(betti)
    for possible, body in (((1, 2, 1), True), ((1, 1, 0), False)):
        assert wanted_of(possible).betti == (1, 2, 1) and wanted_of(possible).body is body


@pytest.mark.parametrize("offsets", [(), (0.0,), (0.5,), (-0.01, 0.01), (float("nan"),)])
def test_bad_offsets_are_refused(offsets):
    with pytest.raises(InputError, match="offset"):
        check_ladder(offsets)


def test_a_soup_without_opaque_triangles_is_refused():
    with pytest.raises(InputError, match="no triangle has an opacity"):
        solidify_soup(soup_of(*shapes.ball(), opacity=-4.0), (1, 0, 1), (0.03,))


def test_the_verb(tmp_path: Path, capsys):
    mesh = make_shape("torus")
    save_soup(tmp_path / "t.npz", soup_of(mesh.vertices, mesh.faces))
    out, stored = tmp_path / "t.glb", tmp_path / "t.json"
    words = ["solidify", str(tmp_path / "t.npz"), "--out", str(out), "--quiet", "--json", str(stored)]
    assert cli.main([*words, "--target", "torus", "--offsets", "0.025,0.03"]) == 0
    printed = capsys.readouterr().out
    assert "ε = 0.025 D is the smallest that gives 1 component, 2 loops, 1 void" in printed
    assert "Chamfer" in printed
    report = json.loads(stored.read_text())
    assert report["solid"]["certificate"]["genus"] == 1
    assert 0 < report["distance"]["chamfer"] < 0.02 and report["distance"]["hausdorff95"] < 0.05
    assert cli.main([*words, "--offsets", "0.03"]) == 0
    alone = "one offset was tried: 1 component, 2 loops, 1 void, a body, says nothing"
    assert alone in capsys.readouterr().out
    assert cli.main([*words, "--offsets", "0.025,0.03"]) == 0
    lasting = "1 component, 2 loops, 1 void, a body, lasts over 100 % of the ladder, from ε = 0.025 D"
    assert lasting in capsys.readouterr().out
    out.unlink()
    assert cli.main([*words, "--betti", "1,4,1", "--offsets", "0.03"]) == 1
    assert "no offset gives 1 component, 4 loops, 1 void" in capsys.readouterr().out and not out.exists()
    assert json.loads(stored.read_text())["solid"] is None
    bowl = trimesh.Trimesh(*shapes.bowl(), process=False)
    bowl.export(tmp_path / "bowl.obj")
    words = ["solidify", str(tmp_path / "bowl.obj"), "--out", str(out), "--quiet", "--offsets", "0.03"]
    assert cli.main([*words, "--betti", "1,0,1"]) == 1
    printed = capsys.readouterr().out
    assert "gives 1 component, 0 loops, 1 void, but encloses 0.00 of its volume" in printed
    assert "--betti 1,0,0" in printed and not out.exists()
    assert cli.main([*words, "--betti", "1,0,0"]) == 0 and certify_mesh(load_mesh(out)).passed


def test_the_verb_refuses_before_it_works(tmp_path: Path, capsys):
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 cut off")
    for words, code, answer in (
        (["--out", "a.obj"], 2, "must end in .ply or .glb"),
        (["--out", "a.ply", "--betti", "0,0,0"], 2, "b0 ≥ 1"),
        (["--out", "a.ply", "--betti", "one"], 2, "takes numbers"),
        (["--out", "a.ply", "--offsets", "0.4"], 2, "offset must be"),
        (["--out", "a.ply", "--cells", "0.1"], 2, "at least one grid cell"),
        (["--out", "a.ply", "--radius", "1"], 2, "belong to --scene DIR"),
        (["--out", "a.ply"], 1, "not a readable soup"),
    ):
        assert cli.main(["solidify", str(tmp_path / "bad.npz"), *words]) == code
        assert answer in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.npz"]


def test_what_to_try_next_lies_between_too_many_handles_and_too_few():
    def solid(*genera):
        rungs = [rung(0.02 + 0.01 * place, genus, 0.4) for place, genus in enumerate(genera)]
        return SoupSolid(tuple(rungs), wanted_of((1, 2, 1)), None, 1.0)

    assert "--offsets 0.032,0.034,0.036,0.038, or" in offset_table(solid(9, 3, 0))
    assert "--offsets 0.05,0.06,0.08,0.1,0.12, or" in offset_table(solid(9, 3, 2))
