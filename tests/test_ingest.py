"""Ingest: exact distances against trimesh, shells of known topology, pockets, bit-identical rebuilds, the
teapot. What becomes of the pot: notebook 11, whose outputs are compared."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.ingest import solidify as module
from paper_artifact.ingest.distance import distance_grid
from paper_artifact.ingest.solidify import solidify, without_pockets, write_shell
from paper_artifact.mesh import Mesh, checked_mesh, load_mesh
from tests import certify_shapes as shapes


def raw(vertices: np.ndarray, faces: np.ndarray, name: str = "raw") -> Mesh:
    return checked_mesh(vertices, faces, name, welded=False)


def test_distances_are_exact_in_the_band():
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(24, 3))
    faces = np.array([rng.choice(24, 3, replace=False) for _ in range(16)])
    values, origin = distance_grid(vertices, faces, 0.15, 0.6)
    index = np.argwhere(np.ones_like(values))
    index = index[rng.choice(len(index), 4000, replace=False)]
    _, distances, _ = trimesh.proximity.closest_point(
        trimesh.Trimesh(vertices, faces, process=False), origin + 0.15 * index
    )
    np.testing.assert_allclose(values[tuple(index.T)], np.minimum(distances, 0.6), atol=2e-7)


def test_distances_to_flat_triangles_are_those_to_their_edges():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0, 0.0], [0, 1, 0], [0, 2, 0]])
    values, origin = distance_grid(vertices, np.array([[0, 1, 2], [1, 2, 3], [0, 4, 5]]), 0.25, 1.0)
    points = origin + 0.25 * np.argwhere(np.ones_like(values))
    ends = np.array([[3, 0, 0], [0, 2, 0]])  # of the two edges, from the origin
    away = [np.linalg.norm(points - points.clip(0, end), axis=1) for end in ends]
    np.testing.assert_allclose(values.reshape(-1), np.minimum(*away).clip(max=1), atol=1e-6)


@pytest.mark.parametrize("scale", (1.0, 1e-25))
def test_a_sphere_grows_by_the_offset(scale):
    vertices, faces = shapes.ball()
    solid = solidify(raw(scale * vertices, faces), offset=0.05, cells=2)
    solid = replace(solid, offset=solid.offset / scale, cell=solid.cell / scale)
    radii = np.linalg.norm(solid.shell.vertices, axis=1) / scale
    assert solid.certificate.passed and solid.certificate.betti == (1, 0, 1)
    assert solid.shell.betti == (1, 0, 1)
    assert solid.pockets == 1, "the inside of the sphere is a pocket"
    assert radii.max() <= 1 + solid.offset + 1e-3 * solid.cell and radii.min() > 0.97 + solid.offset
    assert trimesh.Trimesh(solid.shell.vertices, solid.shell.faces, process=False).volume > 0
    assert solid.certificate.components[0].volume > 0, "wound outwards"


def moebius() -> tuple[np.ndarray, np.ndarray]:
    strip = [(angle, along) for angle in np.arange(40) * np.pi / 20 for along in (-0.3, -0.1, 0.1, 0.3)]
    angle, along = np.transpose(strip)
    radius = 1 + along * np.cos(angle / 2)
    points = [np.cos(angle) * radius, np.sin(angle) * radius, along * np.sin(angle / 2)]
    return np.stack(points, axis=1), shapes.band(40, twist=True)[1]


@pytest.mark.parametrize(
    "name, surface, betti, pockets",
    [
        ("open plate with two holes", (shapes.plate(2)[0], shapes.plate(2)[1][::2]), None, None),
        ("plate with two holes", shapes.plate(2), (1, 4, 1), 1),
        ("two balls", shapes.joined(shapes.ball(), shapes.ball(centre=(4, 0, 0))), (2, 0, 2), 2),
        ("balls that meet", shapes.joined(shapes.ball(), shapes.ball(centre=(1, 0, 0))), (1, 0, 1), 3),
        ("nested balls", shapes.joined(shapes.ball(), shapes.ball(0.5, inwards=True)), (1, 0, 1), 2),
        ("bowl", shapes.bowl(), (1, 0, 1), 0),
        ("Möbius strip", moebius(), (1, 2, 1), 0),
        ("one triangle", (np.eye(3), np.array([[0, 1, 2]])), (1, 0, 1), 0),
    ],
)
def test_shells_of_known_topology(name, surface, betti, pockets):
    solid = solidify(raw(*surface, name), offset=0.02)
    assert solid.certificate.passed, solid.certificate.reasons
    if betti is None:
        assert not solid.raw.closed and solid.certificate.closed
    else:
        assert (solid.certificate.betti, solid.pockets) == (betti, pockets)


def test_noise_gives_closed_manifolds():
    rng = np.random.default_rng(11)
    for _ in range(6):
        vertices = rng.normal(size=(30, 3))
        faces = np.array([rng.choice(30, 3, replace=False) for _ in range(25)])
        certificate = solidify(raw(vertices, faces), offset=0.02).certificate
        assert certificate.closed and certificate.nonmanifold_edges == 0 and certificate.reversed_edges == 0


def test_pockets_are_filled_and_values_leave_the_grid_points():
    values = np.full((9, 9, 9), 2.0, dtype=np.float32)
    values[2:7, 2:7, 2:7] = 0.5
    values[4, 4, 4] = 3.0
    values[2, 2, 2] = 1.0
    filled, count = without_pockets(values, 1.0, 0.01)
    assert count == 1 and filled[4, 4, 4] == np.float32(0.99) and filled[2, 2, 2] == np.float32(0.99)
    assert filled[0, 0, 0] == 2.0


def test_rebuilds_are_bit_identical_and_depend_on_no_order(tmp_path):
    vertices, faces = shapes.plate(1)
    first = solidify(raw(vertices, faces), offset=0.03)
    order = np.random.default_rng(0).permutation(len(vertices))
    second = solidify(raw(vertices[order], np.argsort(order)[faces][::-1]), offset=0.03)
    assert first.sha256 == second.sha256
    write_shell(tmp_path / "a.ply", first.shell)
    write_shell(tmp_path / "b.ply", second.shell)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("ending", ["ply", "obj", "stl"])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_written_shells_hold_the_points_exactly(tmp_path, ending, scale):
    vertices, faces = shapes.plate(1)
    shell = solidify(raw(vertices * scale, faces), offset=0.05, cells=1).shell
    certificate = write_shell(tmp_path / f"shell.{ending}", shell)
    again = load_mesh(tmp_path / f"shell.{ending}")
    assert certificate.betti == (1, 2, 1) and certificate.name == "shell"
    assert np.array_equal(np.unique(again.vertices, axis=0), np.unique(shell.vertices, axis=0))


def test_a_shell_that_fails_is_not_written(tmp_path):
    with pytest.raises(InputError, match="fails its certificate"):
        write_shell(tmp_path / "bad.ply", raw(shapes.tetrahedron()[0], shapes.tetrahedron()[1][:3]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"offset": 0.0}, "offset must be"),
        ({"offset": 0.9}, "offset must be"),
        ({"offset": np.nan}, "offset must be"),
        ({"cells": 0.5}, "at least one grid cell"),
        ({"offset": 1e-4}, "take a larger offset"),
    ],
)
def test_bad_sizes_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        solidify(raw(*shapes.ball()), **arguments)


def test_what_is_too_small_for_float32_is_refused():
    vertices, faces = shapes.ball()
    with pytest.raises(InputError, match="too small for float32 points; scale raw up"):
        solidify(raw(1e-60 * vertices, faces))


def test_the_teapot_becomes_one_closed_body_with_its_handle(tmp_path, capsys):
    path = tmp_path / "teapot.ply"
    assert cli.main(["ingest", "teapot", "--out", str(path), "--json", str(tmp_path / "t.json")]) == 0
    printed = capsys.readouterr().out
    assert "160 open edges" in printed and "pass: closed surface, genus 1" in printed
    assert certify_mesh(load_mesh(path)).betti == (1, 2, 1)
    stored = json.loads((tmp_path / "t.json").read_text())
    assert stored["raw"]["open_edges"] == 160 and stored["certificate"]["verdict"] == "pass"
    assert stored["pockets_dropped"] > 0


def test_the_verb_refuses_before_it_works(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(module, "distance_grid", None)
    assert cli.main(["ingest", "sphere", "--out", str(tmp_path / "a.glb")]) == 2
    assert "must end in" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
