"""Diagrams, bottleneck, point-set distances and dumps against gudhi, scipy and closed forms."""

import gudhi
import gudhi.hera
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.distance import cdist

from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import diagram_of, longest_bars, significant_counts
from paper_artifact.evaluate.geometry import chamfer_sum, point_distances
from paper_artifact.evaluate.image import SEEN_IN, seen_samples, views_that_show
from paper_artifact.evaluate.scores import (
    discriminating_dimension,
    evaluate_samples,
    evaluate_soup,
    make_target,
    soup_samples,
    tail,
    tails,
)
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_soup
from paper_artifact.soup.state import Soup, initial_mlp
from paper_artifact.topology.floor import measurement_floor


def icosphere(radius: float = 1.0) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return checked_mesh(ball.vertices, ball.faces, "ball", (1, 0, 1))


def test_diagram_is_in_radii_over_the_diagonal():
    points = stream(3, "test").normal(size=(300, 3))
    diagram = diagram_of(points, diagonal=2.5)
    tree = gudhi.AlphaComplex(points=points, precision="safe").create_simplex_tree()
    tree.compute_persistence()
    for dimension, bars in enumerate(diagram):
        oracle = np.sqrt(tree.persistence_intervals_in_dimension(dimension).clip(min=0)) / 2.5
        oracle = oracle[np.isfinite(oracle[:, 1]) & (oracle[:, 1] - oracle[:, 0] > 1e-7)]
        bars = bars[bars[:, 1] - bars[:, 0] > 1e-7]
        np.testing.assert_allclose(bars[np.lexsort(bars.T)], oracle[np.lexsort(oracle.T)], atol=1e-9)
    with pytest.raises(InputError, match="diagonal"):
        diagram_of(points, diagonal=0)


def test_counts_and_longest_bars():
    bars = np.array([[0.0, 0.1], [0.0, 0.5], [0.2, 0.4], [0.1, 0.13]])
    assert significant_counts((bars, bars[:1], bars[:0]), floor=0.15) == (2, 0, 0)
    np.testing.assert_array_equal(longest_bars(bars, floor=0.3, at_least=1), bars[[1, 2]])
    assert len(longest_bars(np.repeat(bars, 20, axis=0), floor=0.01)) == 24
    assert longest_bars(bars[:0], floor=0.1).shape == (0, 2)


def test_floor_is_six_median_spacings_and_follows_the_closed_form():
    points = stream(0, "test").random((400, 3))
    nearest = np.where(np.eye(400, dtype=bool), np.inf, cdist(points, points)).min(axis=1)
    assert measurement_floor(points, diagonal=2.0) == pytest.approx(6 * np.median(nearest) / 2.0, rel=1e-12)
    square = np.column_stack([stream(1, "test").random((20000, 2)), np.zeros(20000)])
    assert measurement_floor(square, 1.0) == pytest.approx(6 * np.sqrt(np.log(2) / (np.pi * 20000)), rel=0.03)
    with pytest.raises(InputError, match="at least 2 points"):
        measurement_floor(points[:1], 1.0)


def test_chamfer_and_hausdorff_equal_brute_force():
    generator = stream(1, "test")
    a, b, diagonal = generator.random((70, 3)), generator.random((110, 3)) + 0.2, 3.0
    distances = cdist(a, b)
    forward, backward = distances.min(axis=1), distances.min(axis=0)
    measured = point_distances(a, b, diagonal)
    assert measured["chamfer"] == pytest.approx((forward.mean() + backward.mean()) / 2 / diagonal, rel=1e-12)
    assert measured["chamfer_sum"] == pytest.approx(2 * measured["chamfer"], rel=1e-12)
    assert measured["chamfer_sum"] == chamfer_sum(a, b, diagonal)
    expected = max(np.quantile(forward, 0.95), np.quantile(backward, 0.95)) / diagonal
    assert measured["hausdorff95"] == pytest.approx(expected, rel=1e-12)
    assert point_distances(a, a, diagonal)["chamfer"] == 0
    for bad in (a[:0], np.full((3, 3), np.nan), np.zeros((3, 2))):
        with pytest.raises(InputError, match="second sample"):
            point_distances(a, bad, diagonal)


def test_dump_of_a_shrunken_sphere_reads_the_known_change():
    target = make_target(icosphere(), count=4000)
    assert target.dimension == 2 and target.counts == (0, 0, 1)
    vertices = icosphere(0.9).vertices[icosphere().faces]
    dump = evaluate_soup(vertices, np.full((len(vertices), 3), 0.8), target, seed=1, step=500)
    # The void's death is the sphere's radius / diagonal: a tenth of 1 / D is lost, and every point is .1 off.
    assert dump["step"] == 500 and dump["counts"] == [0, 0, 1]
    assert dump["bottleneck"][2] == pytest.approx(0.1 / target.diagonal, rel=0.1)
    assert dump["chamfer"] == pytest.approx(0.1 / target.diagonal, rel=0.05)
    assert dump["chamfer_sum"] == pytest.approx(2 * dump["chamfer"], rel=1e-6)
    assert dump["bars"][2][0][1] == pytest.approx(0.9 / target.diagonal, rel=0.02)
    assert evaluate_soup(vertices, np.full((len(vertices), 3), 0.8), target, seed=1, step=500) == dump


def test_soup_samples_follow_area_times_opacity():
    unit = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    vertices = np.stack([unit, 2 * unit + [10, 0, 0], unit + [20, 0, 0]])
    opacity = np.array([[1.0, 1, 1], [0.1, 0.2, 0.3], [0, 0, 0]])
    samples = soup_samples(vertices, opacity, 30000, stream(0, "test"))
    # mass .5·1 against 2·.2: shares 5/9 and 4/9; a clear triangle gets nothing.
    assert (samples[:, 0] < 5).mean() == pytest.approx(5 / 9, abs=0.015)
    assert (samples[:, 0] < 15).all()
    for bad_vertices, bad_opacity in (
        (vertices, opacity * 2),
        (vertices * np.nan, opacity),
        (vertices[0], opacity),
        (vertices, opacity[:2]),
        (vertices, -opacity),
    ):
        with pytest.raises(InputError, match="soup"):
            soup_samples(bad_vertices, bad_opacity, 10, stream(0, "test"))
    with pytest.raises(InputError):
        soup_samples(vertices, opacity * 0, 10, stream(0, "test"))


def test_tail_is_the_mean_of_the_last_three_steps():
    same = {"chamfer": 0.01, "hausdorff95": 0.02, "counts": [0, 0, 1]}
    dumps = [{"step": step, "bottleneck": [0, 0, step / 1000]} | same for step in (2500, 100, 2300, 2400)]
    assert tail(dumps, 2) == pytest.approx(2.4)
    summary = tails(dumps)
    assert summary["steps"] == [2300, 2400, 2500] and summary["bottleneck"] == pytest.approx([0, 0, 2.4])
    with pytest.raises(InputError, match="last 3 dumps"):
        tail(dumps[:2], 2)


def test_discriminating_dimension():
    assert discriminating_dimension((2, 0, 2), (1, 0, 2)) == 0
    assert discriminating_dimension((1, 2, 1), (0, 2, 1)) == 1
    assert discriminating_dimension((1, 0, 0), (0, 0, 1)) == 2
    assert discriminating_dimension(None, (0, 0, 1)) == 2
    with pytest.raises(InputError, match="0, 1 or 2"):
        make_target(icosphere(), count=100, dimension=3)


def test_evaluate_samples_refuses_diverged_samples():
    target = make_target(icosphere(), count=300)
    samples = target.samples.copy()
    samples[7, 1] = np.nan
    with pytest.raises(InputError):
        evaluate_samples(samples, target)
    with pytest.raises(InputError, match="beyond 1e\\+150; scale both samples"):
        point_distances(1e300 * target.samples, target.samples, 1.0)
    with pytest.raises(InputError, match="the points of the first sample are not numbers"):
        point_distances([["a", "b", "c"]], target.samples, 1.0)


def test_a_view_shows_what_faces_it_and_nothing_behind(tiny_scene):
    ball = trimesh.creation.icosphere(subdivisions=1)
    corners = torch.tensor(np.concatenate([ball.triangles, ball.triangles / 2]), dtype=torch.float32)
    soup = Soup(corners, torch.zeros(160, 3, 7), torch.full((160, 3), 9.0), initial_mlp(0))
    opacity = soup.corner_opacity()
    points, triangles, _ = sample_soup(corners.numpy(), opacity, 4000, stream(0, "seen"))
    times, outer = views_that_show(soup, tiny_scene, points, triangles), triangles < 80
    assert not times[~outer].any()
    towards = tiny_scene.camera_centres[tiny_scene.train] - ball.triangles_center[:, None]
    facing = (np.einsum("fvk,fk->fv", towards, ball.face_normals) > 0).sum(1)[triangles[outer]]
    assert (times[outer] <= facing).all() and (times[outer] == facing).mean() > 0.5
    seen = seen_samples(soup, opacity, tiny_scene, 500, stream(0, "seen"))
    assert seen.shape == (500, 3) and np.linalg.norm(seen, axis=1).min() > 0.8
    with pytest.raises(InputError, match=f"0 of 800 points of the soup are seen in {SEEN_IN} views of"):
        seen_samples(soup, opacity * (np.arange(160) >= 80)[:, None], tiny_scene, 100, stream(0, "seen"))
