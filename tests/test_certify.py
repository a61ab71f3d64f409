"""Certificates against surfaces of known homology, ranks of boundary matrices, trimesh's counts, and the
paper's dispositions.
"""

import json
from functools import cache
from itertools import combinations

import numpy as np
import pytest
import trimesh

from paper_artifact.certify.certificate import certificate_text, certify_mesh
from paper_artifact.certify.homology import betti_numbers, make_complex
from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh, load_mesh
from paper_artifact.study import dispositions as disposition
from tests import certify_shapes as shapes


def rank(rows: list[int]) -> int:
    """Of rows of bits over Z/2, by elimination."""
    pivots: dict[int, int] = {}
    for row in rows:
        while row and row.bit_length() in pivots:
            row ^= pivots[row.bit_length()]
        if row:
            pivots[row.bit_length()] = row
    return len(pivots)


def betti_by_ranks(faces: np.ndarray) -> tuple[int, int, int]:
    """From the ranks of the two boundary matrices."""
    triangles = {tuple(sorted(face)) for face in np.asarray(faces).tolist()}
    edges = {
        edge: place for place, edge in enumerate(sorted({e for t in triangles for e in combinations(t, 2)}))
    }
    first = rank([1 << a ^ 1 << b for a, b in edges])
    second = rank([sum(1 << edges[edge] for edge in combinations(each, 2)) for each in triangles])
    return len(np.unique(faces)) - first, len(edges) - first - second, len(triangles) - second


@pytest.mark.parametrize("name", shapes.KNOWN)
def test_known_surfaces_against_ranks_and_trimesh(name):
    (vertices, faces), betti, verdict, words = shapes.KNOWN[name]
    certificate = certify_mesh(Mesh(vertices, faces, name))
    assert certificate.verdict == verdict, certificate.reasons
    assert words in (certificate.kind if certificate.passed else "; ".join(certificate.reasons))
    assert certificate.euler == betti[0] - betti[1] + betti[2]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(digits_vertex=9)
    assert certificate.betti == betti == betti_by_ranks(mesh.faces)
    assert certificate.euler_as_given == mesh.euler_number
    edges, times = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    assert (certificate.open_edges, certificate.nonmanifold_edges) == ((times == 1).sum(), (times > 2).sum())
    assert (certificate.open_edges + certificate.nonmanifold_edges == 0) == mesh.is_watertight
    if certificate.nonmanifold_edges == 0:
        assert (certificate.reversed_edges == 0) == mesh.is_winding_consistent
    labels = trimesh.graph.connected_component_labels(mesh.edges, len(mesh.vertices))
    assert len(certificate.components) == labels.max() + 1
    if certificate.passed:
        assert sum(each.volume for each in certificate.components) == pytest.approx(mesh.volume)


@pytest.mark.parametrize("seed", range(60))
def test_random_complexes_against_ranks(seed):
    rng = np.random.default_rng(seed)
    faces = np.array([rng.choice(rng.integers(4, 14), 3, replace=False) for _ in range(rng.integers(1, 70))])
    used, faces = np.unique(faces, return_inverse=True)
    simplices = make_complex(faces.reshape(-1, 3), len(used))
    betti = betti_numbers(simplices)
    assert tuple(betti.sum(axis=0)) == betti_by_ranks(faces.reshape(-1, 3))
    assert (betti[:, 0] - betti[:, 1] + betti[:, 2] == simplices.counts() @ [1, -1, 1]).all()


def test_every_triangle_of_many_points_has_all_voids():
    faces = np.array([[a, b, c] for a in range(14) for b in range(a) for c in range(b)])
    assert betti_numbers(make_complex(faces, 14)).tolist() == [[1, 0, 286]]  # binomial(13, 3)


def test_a_triangle_given_twice_is_a_fault_of_the_file_alone():
    vertices, faces = shapes.joined(shapes.plate(1), (np.eye(3) + 9, np.array([[0, 1, 2], [1, 0, 2]])))
    certificate = certify_mesh(Mesh(vertices, faces, "mesh"))
    assert certificate.reasons == ("1 duplicate face",) and certificate.genus is None
    assert certificate.kind == "1 × closed surface, genus 1; 1 × triangle given twice"
    assert certificate.betti == (2, 2, 1) == betti_by_ranks(faces)


def test_order_of_faces_and_vertices_changes_nothing():
    vertices, faces = shapes.joined(shapes.plate(3), shapes.band(12, twist=True))
    rng = np.random.default_rng(5)
    for _ in range(5):
        renamed = rng.permutation(len(vertices))
        shuffled = np.argsort(renamed)[faces][rng.permutation(len(faces))]
        assert certify_mesh(Mesh(vertices[renamed], shuffled, "mesh")).betti == (2, 7, 1)


def test_the_weld_is_counted():
    vertices, faces = shapes.plate(1)
    corners = vertices[faces].reshape(-1, 3)
    soup = np.concatenate([corners, corners[:1], corners[:1], corners[1:2]])
    indexed = np.arange(len(soup)).reshape(-1, 3)
    certificate = certify_mesh(Mesh(soup, indexed, "soup"))
    assert certificate.passed and certificate.betti == (1, 2, 1)
    assert certificate.open_edges_as_indexed == indexed.size and certificate.collapsed_faces == 1
    assert any("1 face dropped by the weld" in note for note in certificate.notes)


def test_boundaries_are_certified_as_such_on_request():
    bowl, strip = Mesh(*shapes.bowl(), "bowl"), Mesh(*shapes.band(9, twist=True), "strip")
    certificate, stages = certify_mesh(bowl, with_boundary=True), []
    assert certificate.passed and not certificate.closed
    assert (certificate.kind, certificate.boundary_loops) == ("disk", 1)
    judged = certify_mesh(bowl, with_boundary=None, progress=stages.append)
    assert judged == certificate and stages[0] == "weld" and "exact homology" in stages
    unsure, twisted = (certify_mesh(strip, with_boundary=each) for each in (None, True))
    assert not unsure.passed and not unsure.with_boundary
    assert not twisted.passed and "crosscap" in twisted.kind
    assert (twisted.boundary_loops, twisted.components[0].genus) == (1, 1)


def test_winding_is_judged():
    vertices, faces = shapes.ball()
    flipped = faces.copy()
    flipped[7] = flipped[7, ::-1]
    certificate = certify_mesh(Mesh(vertices, flipped, "mesh"))
    assert certificate.reasons == ("inconsistent winding at 3 edges",) and certificate.orientable
    inwards = certify_mesh(Mesh(*shapes.ball(inwards=True), "mesh"))
    assert inwards.passed and "wound inwards" in inwards.notes[0] and inwards.components[0].volume < 0


@cache
def candidate(key: str) -> disposition.Disposition:
    return disposition.dispositions((key,))[0]


@pytest.mark.parametrize("key", [key for key in disposition.candidates() if key != "max-planck"])
def test_the_papers_dispositions(key):
    assert candidate(key).agrees, candidate(key).measured


DETAILS = {
    "ogre": {"open_edges_as_indexed": 236, "open_edges": 200},
    "teapot": {"open_edges_as_indexed": 1036, "open_edges": 160},
    "beast": {"nonmanifold_edges": 2, "duplicate_faces": 2, "euler_as_given": 4},
    "cow": {"betti": (1, 1, 1), "euler": 1, "pinched_vertices": 1},
}


def test_the_measured_details_of_the_failures():
    for key, details in DETAILS.items():
        assert {name: getattr(candidate(key).certificate, name) for name in details} == details
    assert len(candidate("ogre").certificate.components) == 44
    assert candidate("horse").certificate.components[0].volume < 0


def test_the_candidate_that_cannot_be_had_is_listed():
    (row,) = disposition.dispositions(("max-planck",))
    assert row.certificate is None and "not obtainable" in row.measured


def test_the_verb_prints_writes_and_exits(tmp_path, command):
    (vertices, faces), _, _, _ = shapes.KNOWN["pinched vertex"]
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "pinched.off")
    printed = command(f"certify {tmp_path}/pinched.off --json {tmp_path}/c.json", code=1).out
    assert "FAIL" in printed and "1 pinched vertex" in printed and "(1, 0, 2)" in printed
    stored = json.loads((tmp_path / "c.json").read_text())
    assert stored["betti"] == [1, 0, 2] and stored["verdict"] == "fail"
    assert stored["components"][0]["pinched_vertices"] == 1
    open_bowl = command("certify bowl_narrow --quiet").out
    assert "PASS as a surface with boundary (1 boundary loop; not closed)" in open_bowl
    assert "FAIL" in command("certify bowl_narrow --closed --quiet", code=1).out


def test_many_components_are_cut_short_in_the_table():
    many = shapes.joined(*[shapes.tetrahedron(3.0 * i) for i in range(20)])
    certificate = certify_mesh(Mesh(*many, "mesh"))
    assert certificate.betti == (20, 0, 20) and "and 8 smaller components" in certificate_text(certificate)


def test_a_file_is_certified_as_it_was_written(tmp_path):
    vertices, faces = shapes.plate(2)
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "plate.stl")
    certificate = certify_mesh(load_mesh(tmp_path / "plate.stl", welded=False))
    assert certificate.passed and certificate.genus == 2 and certificate.vertices_as_indexed == 3 * len(faces)


BOX = trimesh.creation.box()


@pytest.mark.parametrize(
    "mesh, words",
    [
        (Mesh(np.where(BOX.vertices > 0, np.nan, BOX.vertices), BOX.faces, "box"), "NaN or infinite coord"),
        (Mesh(BOX.vertices, BOX.faces + 8, "box"), "box has a face that refers to vertex"),
        (Mesh(1e300 * BOX.vertices, BOX.faces, "box"), "extends over 1e.300, too large"),
        (Mesh(0 * BOX.vertices, BOX.faces, "box"), "no triangle with three different corners"),
        (BOX, "a Trimesh is no Mesh"),
        (None, "a NoneType is no Mesh"),
    ],
)
def test_what_is_no_mesh_gets_no_certificate(mesh, words):
    """What else arrays can be: test_mesh."""
    with pytest.raises(InputError, match=words):
        certify_mesh(mesh)
