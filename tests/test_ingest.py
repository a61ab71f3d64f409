"""Ingest: exact distances against trimesh, shells of known topology, pockets, bit-identical rebuilds, the pot
and the teapot.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import lifetimes, measure
from paper_artifact.ingest import hot_pot
from paper_artifact.ingest import solidify as module
from paper_artifact.ingest.distance import distance_grid
from paper_artifact.ingest.hot_pot import inventory, shells_as_indexed
from paper_artifact.ingest.solidify import Solid, solidify, without_pockets, write_shell
from paper_artifact.mesh import Mesh, checked_mesh, load_mesh
from paper_artifact.scene.shapes import find_mesh
from tests import certify_shapes as shapes


@cache
def pot() -> Solid:
    return hot_pot.pot_solid()


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
    along = np.hypot(
        np.hypot(np.maximum(points[:, 0] - 3, 0) + np.maximum(-points[:, 0], 0), points[:, 1]), points[:, 2]
    )
    beside = np.hypot(
        np.hypot(np.maximum(points[:, 1] - 2, 0) + np.maximum(-points[:, 1], 0), points[:, 0]), points[:, 2]
    )
    np.testing.assert_allclose(values.reshape(-1), np.minimum(np.minimum(along, beside), 1), atol=1e-6)


def test_a_sphere_grows_by_the_offset():
    ball = raw(*shapes.ball())
    solid = solidify(ball, offset=0.05, cells=2)
    radii = np.linalg.norm(solid.shell.vertices, axis=1)
    assert (
        solid.certificate.passed and solid.certificate.betti == (1, 0, 1) and solid.shell.betti == (1, 0, 1)
    )
    assert solid.pockets == 1, "the inside of the sphere is a pocket"
    assert radii.max() <= 1 + solid.offset + 1e-3 * solid.cell and radii.min() > 0.97 + solid.offset
    assert trimesh.Trimesh(solid.shell.vertices, solid.shell.faces, process=False).volume > 0
    assert solid.certificate.components[0].volume > 0, "wound outwards"


@pytest.mark.parametrize(
    "name, surface, betti, pockets",
    [
        ("open plate with two holes", (shapes.plate(2)[0], shapes.plate(2)[1][::2]), None, None),
        ("plate with two holes", shapes.plate(2), (1, 4, 1), 1),
        ("two balls", shapes.joined(shapes.ball(), shapes.ball(centre=(4, 0, 0))), (2, 0, 2), 2),
        ("balls that meet", shapes.joined(shapes.ball(), shapes.ball(centre=(1, 0, 0))), (1, 0, 1), 3),
        ("nested balls", shapes.joined(shapes.ball(), shapes.ball(0.5, inwards=True)), (1, 0, 1), 2),
        ("bowl", shapes.bowl(), (1, 0, 1), 0),
        (
            "Möbius strip",
            (
                np.array(
                    [
                        [
                            np.cos(a) * (1 + s * np.cos(a / 2)),
                            np.sin(a) * (1 + s * np.cos(a / 2)),
                            s * np.sin(a / 2),
                        ]
                        for a in np.linspace(0, 2 * np.pi, 40, endpoint=False)
                        for s in (-0.3, -0.1, 0.1, 0.3)
                    ]
                ),
                shapes.band(40, twist=True)[1],
            ),
            (1, 2, 1),
            0,
        ),
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
    assert (
        count == 1
        and filled[4, 4, 4] == np.float32(0.99)
        and filled[2, 2, 2] == np.float32(0.99)
        and filled[0, 0, 0] == 2.0
    )


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


def test_the_raw_pot_is_as_raw_as_the_papers():
    shell = hot_pot.raw_pot()
    certificate = pot().raw
    assert shells_as_indexed(shell) == 9
    assert {len(polygon) for polygon in shell.polygons} == {4, 12}
    assert not certificate.passed and certificate.nonmanifold_edges == 120 and certificate.open_edges == 164


def test_the_pot_is_one_body_of_genus_three():
    certificate = pot().certificate
    assert (
        certificate.passed and certificate.genus == 3 and certificate.betti == (1, 6, 1) and pot().pockets > 0
    )
    rows = inventory(hot_pot.raw_pot(), pot())
    assert (
        "9 open shells" in rows[0][0]
        and "120 non-manifold junction edges" in rows[0][1]
        and "(1, 6, 1)" in rows[2][1]
    )
    mesh = trimesh.Trimesh(pot().shell.vertices, pot().shell.faces, process=False)
    assert mesh.is_watertight and mesh.euler_number == -4


@pytest.mark.parametrize("samples, voids", [(2048, 0), (4096, 0), (8192, 1)])
def test_the_flue_first_clears_the_floor_at_8192_and_no_loop_ever_does(samples, voids):
    diagram, floor = measure(pot().shell, samples, 0)
    assert lifetimes(diagram[1]).max() < 0.75 * floor
    assert (lifetimes(diagram[2]) > floor).sum() == voids
    if voids:
        assert 1.1 < lifetimes(diagram[2]).max() / floor < 1.35


def test_the_pot_is_a_shape_like_any_other(monkeypatch):
    monkeypatch.setattr(hot_pot, "pot_solid", pot)
    mesh = find_mesh("pot")
    assert mesh.name == "pot" and mesh.betti == (1, 6, 1)


def test_the_teapot_becomes_one_closed_body_with_its_handle(tmp_path, capsys):
    path = tmp_path / "teapot.ply"
    assert cli.main(["ingest", "teapot", "--out", str(path), "--json", str(tmp_path / "t.json")]) == 0
    printed = capsys.readouterr().out
    assert "160 open edges" in printed and "pass: closed surface, genus 1" in printed
    assert certify_mesh(load_mesh(path)).betti == (1, 2, 1)
    stored = json.loads((tmp_path / "t.json").read_text())
    assert (
        stored["raw"]["open_edges"] == 160
        and stored["certificate"]["verdict"] == "pass"
        and stored["pockets_dropped"] > 0
    )


def test_the_verb_refuses_before_it_works(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(module, "distance_grid", None)
    assert cli.main(["ingest", "sphere", "--out", str(tmp_path / "a.glb")]) == 2
    assert "must end in" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
