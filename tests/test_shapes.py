"""The analytic shapes: topology as certified, geometry against closed forms."""

import numpy as np
import pytest
import trimesh

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.scene.shapes import BOWL_RIMS, SHAPES, make_shape

CLOSED = [name for name in SHAPES if not name.startswith("bowl")]
KNOWN = {  # diagonal and, where it has a closed form, volume
    "sphere": (2 * np.sqrt(3), 4 * np.pi / 3),
    "cube": (np.sqrt(3), 1.0),
    "torus": (np.sqrt(2 * 2.76**2 + 0.76**2), 2 * np.pi**2 * 0.38**2),
    "cylinder": (2 * np.sqrt(3), 2 * np.pi),
    "two_spheres": (np.sqrt(5.6**2 + 8), 8 * np.pi / 3),
    "double_torus": (5.318, None),
}


@pytest.mark.parametrize("name", SHAPES)
def test_betti_numbers_are_those_of_the_complex(name):
    mesh = make_shape(name)
    assert mesh.name == name and mesh.betti == certify_mesh(mesh, with_boundary=True).betti


@pytest.mark.parametrize("name", CLOSED)
def test_closed_oriented_outwards_with_the_known_diagonal_and_volume(name):
    mesh = make_shape(name)
    outside = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert outside.is_watertight and outside.is_winding_consistent and outside.volume > 0
    diagonal, volume = KNOWN[name]
    assert mesh.diagonal == pytest.approx(diagonal, rel=1e-4)
    assert volume is None or outside.volume == pytest.approx(volume, rel=2e-3)
    np.testing.assert_allclose(mesh.centre, 0, atol=1e-9)


def surface_distance(name: str, points: np.ndarray) -> np.ndarray:
    """Signed distance of points to the smooth surface, negative inside."""

    def torus(x, tube):
        return np.hypot(np.hypot(points[:, 0] - x, points[:, 1]) - 1, points[:, 2]) - tube

    if name == "sphere":
        return np.linalg.norm(points, axis=1) - 1
    if name == "two_spheres":
        return np.minimum(*(np.linalg.norm(points - [x, 0, 0], axis=1) - 1 for x in (-1.8, 1.8)))
    if name == "torus":
        return torus(0, 0.38)
    return np.minimum(torus(-1, 0.30), torus(1, 0.30))


@pytest.mark.parametrize("name", ["sphere", "two_spheres", "torus", "double_torus"])
def test_vertices_lie_on_the_surface_and_facets_within_a_few_ten_thousandths_of_the_diagonal(name):
    mesh = make_shape(name)
    np.testing.assert_allclose(surface_distance(name, mesh.vertices), 0, atol=1e-12)
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    assert np.abs(surface_distance(name, centroids)).max() < 2e-4 * mesh.diagonal


@pytest.mark.parametrize("name, rim", BOWL_RIMS.items())
def test_bowls_open_at_the_top_with_the_measured_rim(name, rim):
    mesh = make_shape(name)
    sides = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(sides, axis=0, return_counts=True)
    boundary = mesh.vertices[edges[counts == 1].reshape(-1)]
    assert (boundary[:, 2] > 0.8).all()
    assert np.hypot(boundary[:, 0], boundary[:, 1]).mean() == pytest.approx(rim, abs=0.03)
