"""Meshes: exact welding, polygons, scene files, and every input that must be refused in a clear sentence."""

import numpy as np
import pytest
import trimesh

from paper_artifact.errors import InputError
from paper_artifact.mesh import checked_mesh, load_mesh, weld
from paper_artifact.sampling import face_areas


def open_edges(faces: np.ndarray) -> int:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] == 1).sum())


def box() -> trimesh.Trimesh:
    return trimesh.creation.box(extents=(1.0, 2.0, 3.0))


@pytest.mark.parametrize("kind", ["obj", "ply", "off", "stl", "glb"])
def test_every_common_format_gives_the_same_closed_surface(tmp_path, kind):
    path = tmp_path / f"box.{kind}"
    box().export(path)
    mesh = load_mesh(path)
    assert (len(mesh.vertices), len(mesh.faces), open_edges(mesh.faces)) == (8, 12, 0)
    assert mesh.name == "box" and mesh.betti is None
    assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int64
    assert mesh.diagonal == pytest.approx(np.sqrt(14)) and mesh.radius == pytest.approx(np.sqrt(14) / 2)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume == pytest.approx(6)


def test_welding_can_be_left_out(tmp_path):
    box().export(tmp_path / "box.stl")
    assert len(load_mesh(tmp_path / "box.stl").vertices) == 8
    assert len(load_mesh(tmp_path / "box.stl", welded=False).vertices) == 36


def test_polygons_are_cut_by_the_fan(tmp_path):
    path = tmp_path / "polygons.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nv -1 0 0\nf 1 2 3 4 5\nf 1 5 6\n")
    mesh = load_mesh(path)
    expected = (0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)
    assert {*map(frozenset, mesh.faces.tolist())} == {*map(frozenset, expected)}


def test_weld_is_exact_keeps_the_order_and_drops_what_is_no_surface():
    tiny = np.nextafter(1.0, 2.0)
    vertices = np.array(
        [[9, 9, 9], [1, 0, 0], [0, 0, 0], [0, 1, 0], [-0.0, 0, 0], [tiny, 0, 0], [5, 5, 5]], dtype=float
    )
    faces = np.array([[2, 1, 3], [4, 3, 5], [2, 4, 1]])
    welded, indexed = weld(vertices, faces)
    np.testing.assert_array_equal(welded, [[1, 0, 0], [0, 0, 0], [0, 1, 0], [tiny, 0, 0]])
    np.testing.assert_array_equal(indexed, [[1, 0, 2], [1, 2, 3]])


def test_face_areas_against_trimesh():
    ball = trimesh.creation.icosphere(2)
    np.testing.assert_allclose(face_areas(ball.vertices, ball.faces), ball.area_faces, rtol=1e-12)


def test_arrays_are_checked_like_files():
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    with pytest.raises(InputError, match="soup has no triangles"):
        checked_mesh(square, np.zeros((0, 3), int), "soup")
    for vertices, faces, words in (
        (square, [[0, 1, -1]], "vertex -1"),
        (square, np.array([[0, 1, 2]]) + 0.9, "soup has a face that refers to vertex 0.9, no whole"),
        (square, [[0, 1, np.nan]], "vertex nan, no whole"),
        (square, [[0, 1, 2, 0]], r"vertices \(3, 3\) and faces \(1, 4\)"),
        (square[:, :2], [[0, 1, 2]], r"vertices \(3, 2\)"),
        ("abc", [[0, 1, 2]], "the vertices of soup are not numbers"),
        (square, [["a", "b", "c"]], "the faces of soup are not numbers"),
        (square * 1e200, [[0, 1, 2]], "soup extends over 1e.200, too large for areas; scale it"),
        (square * 1e-200, [[0, 1, 2]], "soup extends over 1e-200, too small"),
    ):
        with pytest.raises(InputError, match=words):
            checked_mesh(vertices, faces, "soup")
    assert checked_mesh(square.tolist(), [[0.0, 1.0, 2.0]], "soup").faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("scale", ["[1e400, 1, 1]", "[1e308, 1, 1]"])
def test_numbers_beyond_double_precision_are_refused_without_a_warning(tmp_path, scale):
    for name, content in trimesh.Scene(box()).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    file = tmp_path / "model.gltf"
    scaled = file.read_text().replace('"nodes":[{', f'"nodes":[{{"scale":{scale},', 1)
    file.write_text(scaled.replace('"matrix"', '"none"'))
    with pytest.raises(InputError, match="NaN or infinite coordinates|too large for areas"):
        load_mesh(file)
