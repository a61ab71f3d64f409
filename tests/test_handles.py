"""Handles, holes and voids: which loop goes around what, how long it is, and surgery that removes one."""

import json

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from paper_artifact.audit.marks import view_parts
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.frame import frame_for
from paper_artifact.ingest.crossings import crossing_faces
from paper_artifact.ingest.handles import find_loops, find_voids
from paper_artifact.ingest.solidify import write_shell
from paper_artifact.ingest.surgery import cut_and_capped
from paper_artifact.mesh import Mesh, checked_mesh, load_mesh
from paper_artifact.scene.shapes import find_mesh, make_shape
from tests import certify_shapes as shapes

TURN = np.linspace(0, 2 * np.pi, 120, endpoint=False)[:, None]


def tube(path: np.ndarray, radius: float, around: int = 12) -> Mesh:
    """A tube around a closed path (n,3)."""
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = 2 * np.pi * np.arange(around)[:, None, None] / around
    points = path + radius * (np.cos(angle) * side + np.sin(angle) * np.cross(side, ahead))
    index = np.arange(around * len(path)).reshape(around, len(path))
    a, b = index.ravel(), np.roll(index, -1, axis=0).ravel()
    c, d = np.roll(index, -1, axis=1).ravel(), np.roll(np.roll(index, -1, axis=0), -1, axis=1).ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    return outward(checked_mesh(points.reshape(-1, 3), faces, "tube"))


def outward(mesh: Mesh) -> Mesh:
    volume = find_voids(mesh)[0].volume
    return mesh if volume > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.name)


def joined(*meshes: Mesh) -> Mesh:
    return Mesh(*shapes.joined(*((each.vertices, each.faces) for each in meshes)), "joined")


RING = np.concatenate([np.cos(TURN), np.sin(TURN), 0 * TURN], axis=1)
TREFOIL = np.concatenate(
    [np.sin(TURN) + 2 * np.sin(2 * TURN), np.cos(TURN) - 2 * np.cos(2 * TURN), -np.sin(3 * TURN)], axis=1
)


def crossings(mesh: Mesh) -> int:
    return int(crossing_faces(mesh.vertices.astype(np.float32).astype(float), mesh.faces).sum())


def lengths(mesh: Mesh, kind: str) -> list[float]:
    return [each.length for each in find_loops(mesh) if each.kind == kind]


def test_loops_go_around_the_handle_and_around_the_hole():
    mesh = make_shape("torus")
    assert lengths(mesh, "handle") == pytest.approx([2 * np.pi * 0.38], rel=1e-3)
    assert lengths(mesh, "hole") == pytest.approx([2 * np.pi * 0.62], rel=1e-3)
    assert find_loops(make_shape("sphere")) == ()
    inward = Mesh(mesh.vertices, mesh.faces[:, ::-1], "torus")
    assert lengths(inward, "handle") == pytest.approx(lengths(mesh, "handle"))


def test_a_cavitys_handle_is_the_airs_hole():
    ring, ball = tube(RING, 0.3), make_shape("sphere")
    mesh = joined(Mesh(2 * ball.vertices, ball.faces, ""), Mesh(ring.vertices, ring.faces[:, ::-1], ""))
    assert lengths(mesh, "hole") == pytest.approx(lengths(ring, "handle"))
    assert lengths(mesh, "handle") == pytest.approx(lengths(ring, "hole"))
    big, small = find_voids(mesh)
    assert big.volume > 0 > small.volume and small.radius == pytest.approx(0.3, rel=0.05)
    assert np.hypot(*small.centre[:2]) == pytest.approx(1, abs=0.05)
    assert big.radius == pytest.approx(2, rel=0.02)


def test_of_bodies_side_by_side_each_may_be_wound_inwards():
    mesh = make_shape("torus")
    beside = joined(
        Mesh(mesh.vertices, mesh.faces[:, ::-1], ""), Mesh(mesh.vertices + (3, 0, 0), mesh.faces, "")
    )
    for kind in ("handle", "hole"):
        assert lengths(beside, kind) == pytest.approx(2 * lengths(mesh, kind))


@pytest.mark.parametrize("name, genus", [("torus", 1), ("double_torus", 2)])
def test_each_handle_is_cut_and_each_hole_filled(name, genus):
    mesh = make_shape(name)
    loops = find_loops(mesh)
    assert [each.kind for each in loops] == ["handle"] * genus + ["hole"] * genus
    for each in loops:
        made = cut_and_capped(mesh, each)
        certificate = certify_mesh(made)
        assert certificate.passed and certificate.genus == genus - 1
        assert crossings(made) <= crossings(mesh)  # which touches itself in the double torus' crease


def test_a_coarse_mesh_is_refined_for_surgery():
    mesh = tube(RING[::20], 0.3, around=3)
    assert {each.kind for each in find_loops(mesh)} == {"handle", "hole"}
    assert all(certify_mesh(cut_and_capped(mesh, each)).genus == 0 for each in find_loops(mesh))


def test_what_no_disc_closes_is_said(tmp_path, command):
    ring = tube(RING, 0.2)
    linked = joined(ring, Mesh(ring.vertices[:, [0, 2, 1]] + [1, 0, 0], ring.faces[:, ::-1], ""))
    kinds = [each.kind for each in find_loops(linked)]
    assert kinds == ["handle", "handle", "hole", "hole"]
    with pytest.raises(InputError, match="no disc closes this hole"):
        cut_and_capped(linked, find_loops(linked)[2])
    knot = tube(TREFOIL, 0.25)
    (handle,) = find_loops(knot)  # the loop that bounds outside winds along the knot: no two shortest paths
    assert certify_mesh(cut_and_capped(knot, handle)).genus == 0
    write_shell(tmp_path / "knot.ply", Mesh(knot.vertices.astype(np.float32).astype(float), knot.faces, ""))
    said = command(f"certify {tmp_path}/knot.ply --where {tmp_path}/k.html --quiet").out
    assert "no short loop was found around 1 of 1 holes" in said


def test_the_command_marks_fills_and_cuts(tmp_path, command):
    page, found, out = (tmp_path / name for name in ("w.html", "w.json", "out.ply"))
    printed = command(f"certify torus --where {page} --json {found} --quiet").out
    assert "handle  1  red" in printed and "hole    1  blue" in printed and "void    1  green" in printed
    assert "hole 1 (blue)" in page.read_text() and '"up":[0.0,0.0,1.0]' in page.read_text()
    ring = tube(RING, 0.2)
    trimesh.Trimesh(ring.vertices, ring.faces, process=False).export(tmp_path / "t.obj")
    command(f"certify {tmp_path}/t.obj --where {page} --quiet")
    assert '"up":[0.0,1.0,0.0]' in page.read_text()
    trimesh.Trimesh(1e-20 * ring.vertices, ring.faces, process=False).export(tmp_path / "tiny.obj", digits=30)
    command(f"certify {tmp_path}/tiny.obj --where {page} --quiet")
    kinds = [each["kind"] for each in json.loads(found.read_text())["where"]]
    assert kinds == ["handle", "hole", "void"]
    for wish in ("--fill 1", f"--cut 1 --where {tmp_path}/w.ply"):
        said = command(f"certify torus {wish} --out {out} --quiet").out
        assert "PASS, closed surface, genus 0" in said and certify_mesh(load_mesh(out)).genus == 0
    assert len(load_mesh(tmp_path / "w.ply").faces) > 27648


def test_a_flat_component_encloses_nothing(tmp_path, command):
    pillow = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 4 3 2 1\n"
    beside = "v 2 0 0\nv 3 0 0\nv 2 1 0\nv 2 0 1\nf 5 7 6\nf 5 6 8\nf 6 7 8\nf 7 5 8\n"
    for text, count in ((pillow, 0), (pillow + beside, 1)):
        (tmp_path / "p.obj").write_text(text)
        for page in ("p.html", "p.ply"):
            command(f"certify {tmp_path}/p.obj --where {tmp_path}/{page} --json {tmp_path}/p.json --quiet")
        assert len(json.loads((tmp_path / "p.json").read_text())["where"]) == count


def test_of_a_surface_that_crosses_itself_what_is_said_may_be_wrong(tmp_path, command):
    u, v = np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in (40, 24)), indexing="ij")
    out = 3 + 0.8 * np.sin(v)
    points = np.stack([out * np.cos(u), out * np.sin(u), 0.4 * np.sin(2 * v)], axis=-1).reshape(-1, 3)
    a, b = (np.roll(np.arange(960).reshape(40, 24), -step, axis=0).ravel() for step in (0, 1))
    c, d = (np.roll(each.reshape(40, 24), -1, axis=1).ravel() for each in (b, a))
    eight = Mesh(points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), "eight")
    assert all((np.abs(each.centre) <= np.abs(points).max(axis=0)).all() for each in find_voids(eight))
    trimesh.Trimesh(points, eight.faces, process=False).export(tmp_path / "eight.ply")
    said = command(f"certify {tmp_path}/eight.ply --where {tmp_path}/e.html --quiet").out
    assert "triangles cross or touch others; loops and voids there may be wrong" in said
    assert "cross or touch" not in command(f"certify torus --where {tmp_path}/e.html --quiet").out


@pytest.mark.parametrize(
    "wish, code, said",
    [
        ("torus --fill 2", 1, "1 holes of torus were found, none of number 2"),
        ("bowl_wide --where w.html", 1, "is no closed certified surface"),
        ("torus --where w.png", 2, "--where writes .html or .ply"),
        ("torus --fill 1 --cut 1", 2, "one at a time"),
        ("torus --cut 1 --json ././torus_cut.ply", 2, "is written to torus_cut.ply too"),
        ("torus --cut 0", 2, "--cut must be at least 1"),
    ],
)
def test_wrong_wishes_are_one_sentence(wish, code, said, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    assert said in command(f"certify {wish} --quiet", code=code).err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", (".ply", ".obj"))
@pytest.mark.parametrize("scale, aside", [(1.0, 1e8), (1e-20, 0.0)])
def test_a_mesh_far_away_or_tiny_is_cut_where_it_is(scale, aside, ending, tmp_path):
    mesh = make_shape("torus")
    far = Mesh(scale * mesh.vertices + aside, mesh.faces, "far")
    cut = cut_and_capped(far, find_loops(far)[0])
    assert write_shell(tmp_path / f"cut{ending}", cut).genus == 0
    again = load_mesh(tmp_path / f"cut{ending}").vertices
    distances, _ = cKDTree(far.vertices / scale).query(again / scale)
    assert np.quantile(distances, 0.9) < 1e-7 and len(again) > 10_000
    shown = view_parts(far, (), frame_for(far.centre, far.radius))["mesh"].vertices
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) == len(far.vertices)


def test_more_handles_than_can_be_looked_for_are_refused(monkeypatch):
    monkeypatch.setattr("paper_artifact.ingest.handles.MOST_HANDLES", 1)
    assert len(find_loops(make_shape("torus"))) == 2
    with pytest.raises(InputError, match="has 2 handles; loops are looked for up to 1"):
        find_loops(make_shape("double_torus"))


def test_a_mesh_of_others_loses_its_hole():
    mesh = find_mesh("bob")
    assert [certify_mesh(cut_and_capped(mesh, each)).genus for each in find_loops(mesh)] == [0, 0]
