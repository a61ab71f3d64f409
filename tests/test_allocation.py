"""The allocation study's field and levers: the paper's formula, the width-matched control, budget parity."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from paper_artifact.catalogue import study_config
from paper_artifact.config import AllocationConfig, RunConfig
from paper_artifact.errors import InputError
from paper_artifact.pipeline import make_run_allocation, make_run_importance
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.split import bisected
from paper_artifact.soup.state import Soup, initial_mlp
from paper_artifact.topology.floor import median_spacing
from paper_artifact.topology.importance import Kernels, feature_kernels, importance_field
from tests.raster_cases import cameras
from tests.raster_cases import soup as random_soup
from tests.test_alpha_pairs import torus


def test_kernels_are_the_papers():
    points = torus(800)
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    narrow, wide = (feature_kernels(points, diagonal, AllocationConfig(spread=s)) for s in (1.0, 3.0))
    for one, three in zip(narrow, wide, strict=True):
        assert len(one.centres) >= 3 and np.array_equal(one.centres, three.centres)
        assert {tuple(row) for row in one.centres} <= {tuple(row) for row in points}
        np.testing.assert_allclose(three.widths, 3 * one.widths)
        mass = [each.weights * each.widths**2 for each in (one, three)]
        np.testing.assert_allclose(*mass)
        assert one.widths.min() >= 3 * median_spacing(points) * (1 - 1e-12)
        assert one.widths.max() <= diagonal / 2
    death = feature_kernels(points, diagonal, AllocationConfig(simplices="death"))
    for one, fewer in zip(narrow, death, strict=True):  # a feature's last simplex alone
        assert {tuple(row) for row in fewer.centres} < {tuple(row) for row in one.centres}
    assert len(death[0].centres) % 3 == 0  # loops die with a triangle
    kernels = narrow[0]
    query = np.array([[0.3, 0.2, 0.1], [1.0, 0.0, 0.4]])
    squares = ((query[:, None] - kernels.centres) ** 2).sum(axis=2)
    by_hand = (kernels.weights * np.exp(-squares / (2 * kernels.widths**2))).sum(axis=1)
    np.testing.assert_allclose(kernels.at(query), by_hand, rtol=1e-12)


def test_the_field_is_normalised_per_dimension_and_takes_the_nearest_sample():
    dense = torus(5000)
    weak = Kernels(dense[:1], np.array([1e-6]), np.array([0.3]))
    strong = Kernels(dense[99:100], np.array([1e6]), np.array([0.3]))
    field = importance_field([weak, strong], dense)
    assert field.values.min() >= 0 and field.values.max() == 1.0
    assert field.values[0] == field.values[99] == 1.0  # a dimension's weight does not matter, only its shape
    assert np.array_equal(field(dense[:50] + 1e-9), field.values[:50])
    raw = np.stack([each.at(dense) / np.percentile(each.at(dense), 99.5) for each in (weak, strong)])
    np.testing.assert_allclose(field.values, np.minimum(raw, 1).max(axis=0))


def test_random_centres_keep_number_weights_and_widths_and_differ_by_seed():
    mesh = make_shape("sphere")
    fields = {
        (name, seed): make_run_importance(config, config.allocation, mesh)
        for name in ("B4", "B5")
        for seed in (0, 1)
        for config in [study_config("sphere", name, seed, allocation={"samples": 512})]
    }
    assert np.array_equal(fields["B4", 0].values, fields["B4", 1].values)
    assert not np.allclose(fields["B5", 0].values, fields["B5", 1].values)
    assert make_run_allocation(study_config("sphere", "C1"), mesh, mesh.vertices) == (None, None)
    resampler, start = make_run_allocation(study_config("sphere", "B1"), mesh, mesh.vertices)
    assert resampler is None and start.shape == (len(mesh.vertices),) and 0 <= start.min() < start.max() <= 1


def test_noise_in_place_of_the_field_prefers_no_place():
    mesh = make_shape("sphere")
    blind = {"centres": "noise", "protection": 0.0, "subdivided": 0.2}
    configs = [study_config("sphere", "B5", seed, allocation=blind) for seed in (0, 1)]
    first, second = (make_run_importance(config, config.allocation, mesh) for config in configs)
    assert not np.allclose(first.values, second.values)
    for octant in np.sign(first.samples[:8]):  # its mean over part of the sphere is the whole's
        assert abs(first.values[(first.samples * octant > 0).all(axis=1)].mean() - 0.5) < 0.03
    neighbours = cKDTree(first.samples).query(first.samples, k=2)[1][:, 1]
    assert abs(np.corrcoef(first.values, first.values[neighbours])[0, 1]) < 0.03  # nothing of a field is left
    corners, counts = np.random.default_rng(0).normal(size=(50, 3, 3)), np.arange(50)[::-1]
    resampler = Resampler(configs[0], importance=first)
    assert np.array_equal(np.argsort(resampler.order(corners, counts)), np.argsort(counts))


def soup_of(count: int, seed: int = 0) -> Soup:
    parts = random_soup(seed, count, 0.3)
    opacity = torch.logit(parts["opacity"]).float()
    return Soup(parts["vertices"].float(), torch.zeros(count, 3, 7), opacity, initial_mlp(0)).trainable()


def test_protection_and_respawn_choose_the_important():
    corners = np.zeros((10, 3, 3), np.float32) + np.arange(10)[:, None, None]

    def importance(points):
        return points[:, 0] / 9

    counts = np.arange(10)[::-1]

    def made(**prior) -> Resampler:
        return Resampler(
            RunConfig("x", budget=300, allocation=AllocationConfig(**prior)), importance=importance
        )

    order = made(protection=2.0).order(corners, counts)
    np.testing.assert_allclose(order, counts + 2.0 * np.quantile(counts, 0.9) * np.arange(10) / 9)
    assert np.array_equal(made(protection=0.0).order(corners, counts), counts)
    visible = np.arange(10) != 9
    assert list(made(subdivided=0.01).halved(corners, visible)) == [6, 7, 8]


def test_halves_cover_the_parent():
    corners = np.random.default_rng(1).random((6, 3, 3)).astype(np.float32)
    halves, origins = bisected(corners, np.array([1, 4]))
    assert len(halves) == 8 and list(origins) == [0, 1, 2, 3, 4, 5, 1, 4]
    new, old = (np.cross(each[:, 1] - each[:, 0], each[:, 2] - each[:, 0]) for each in (halves, corners))
    size, whole = np.linalg.norm(new, axis=1), np.linalg.norm(old, axis=1)
    np.testing.assert_allclose(np.bincount(origins, size), whole, rtol=1e-5)
    np.testing.assert_allclose(size[[1, 4]], whole[[1, 4]] / 2, rtol=1e-5)
    assert (np.einsum("nk,nk->n", new, old[origins]) > 0).all()


@pytest.mark.parametrize("count", [50, 90])
@pytest.mark.parametrize("split_height", [0.1, 0.3, 1.0])
def test_a_resampling_leaves_exactly_as_many_triangles_as_the_plain_rule(count, split_height):
    config = replace(study_config("sphere", "B4"), budget=60, split_height=split_height)
    views = cameras(3, 5).numpy().astype(np.float32)

    def importance(points):
        return 1 / (1 + points[:, 0] ** 2)

    resampler = Resampler(config, importance=importance)
    soup, report = resampler.resample(soup_of(count), views, 40, 40, 100)
    assert report["pruned"] == min(count, 60)
    # The plain rule on the same pruned soup: only the order of pruning differs.
    none = replace(config, allocation=replace(config.allocation, subdivided=0.0))
    plain = Resampler(none, importance=importance)
    expected, plain_report = plain.resample(soup_of(count), views, 40, 40, 100)
    assert len(soup) == report["after"] == plain_report["after"] >= report["pruned"]
    assert (report["after"] > report["pruned"]) == (split_height < 1)
    # Where splitting cuts every triangle small anyway, halving some first changes nothing.
    assert torch.equal(soup.vertices, expected.vertices) == (split_height == 0.1)
    late, late_report = resampler.resample(soup_of(count), views, 40, 40, 2400)
    assert late_report["after"] == late_report["pruned"] == len(late)  # nothing is made when nothing is split


def test_halving_stops_at_the_least_importance():
    corners, visible = np.random.default_rng(1).random((40, 3, 3)).astype(np.float32), np.arange(40) % 4 > 0

    def importance(points):
        return points[:, 0]

    for share, least in ((0.2, 0.0), (1.0, 0.5), (0.2, 0.5)):
        config = replace(
            study_config("sphere", "B4", allocation={"subdivided": share, "subdivided_from": least}),
            budget=40,
        )
        halved = Resampler(config, importance=importance).halved(corners, visible)
        values = np.where(visible, corners.mean(axis=1)[:, 0], -1)
        wanted = [i for i in np.argsort(-values)[: round(share * 40)] if values[i] >= least]
        assert sorted(wanted) == halved.tolist() and 0 < len(wanted) < 40


def test_a_share_of_less_than_a_triangle_and_a_target_without_features_are_refused():
    with pytest.raises(InputError, match="no significant feature at M = 100"):
        feature_kernels(np.random.default_rng(0).random((100, 3)), 3**0.5, AllocationConfig())
    with pytest.raises(InputError, match="budget of 3 triangles is smaller than the protected share"):
        config = replace(study_config("sphere", "B2"), budget=3)
        Resampler(config, importance=lambda points: points[:, 0])


def test_the_first_triangles_follow_the_importance():
    points = torus(4000)
    weight = (points[:, 0] > 0).astype(float)
    plain, placed = (initial_soup(points, 600, 0, each).vertices.detach().numpy() for each in (None, weight))
    share = [(each.mean(axis=1)[:, 0] > 0).mean() for each in (plain, placed)]
    assert abs(share[0] - 0.5) < 0.05 and share[1] > 0.62
    centres = [each[:400].mean(axis=1) for each in (plain, placed)]
    np.testing.assert_allclose(*centres, atol=1e-6)  # the farthest-point part is the same
