"""The soup: initialisation on a point cloud, saving and loading."""

import errno
import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from paper_artifact.errors import InputError
from paper_artifact.randomness import stream
from paper_artifact.soup.initialise import farthest_points, initial_soup
from paper_artifact.soup.state import MLP_SHAPES, initial_mlp, load_soup, save_soup


def cloud(seed: int, count: int) -> np.ndarray:
    return stream(seed, "soup test cloud").normal(size=(count, 3))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 60), st.data())
def test_farthest_points_against_a_naive_reference(seed, count, data):
    points = cloud(seed, count)
    wanted, first = data.draw(st.integers(1, count)), data.draw(st.integers(0, count - 1))
    chosen = [first]
    while len(chosen) < wanted:
        chosen.append(int(cdist(points, points[chosen]).min(1).argmax()))
    assert farthest_points(points, wanted, first).tolist() == chosen


def test_initial_triangles_are_equilateral_on_distinct_points_with_a_quarter_of_their_spacing():
    points = cloud(1, 400)
    soup = initial_soup(points, 90, 5)
    corners = soup.vertices.detach().numpy().astype(np.float64)
    assert soup.vertices.dtype == torch.float32 and corners.shape == (90, 3, 3)
    centres = corners.mean(1)
    distance = cdist(centres, points)
    chosen = distance.argmin(1)
    np.testing.assert_allclose(distance.min(1), 0, atol=1e-6)  # the centroid is the point itself
    assert len(set(chosen)) == 90

    between = cdist(points[chosen], points[chosen])
    np.fill_diagonal(between, np.inf)
    radius = 0.25 * between.min(1).mean()
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    np.testing.assert_allclose(np.linalg.norm(corners - centres[:, None], axis=-1), radius, rtol=1e-5)
    np.testing.assert_allclose(sides, np.sqrt(3) * radius, rtol=1e-5)

    # The first two thirds are farthest points, from the first on.
    wanted = farthest_points(points, 60, chosen[0])
    assert chosen[:60].tolist() == wanted.tolist()
    assert not soup.features.any() and not soup.opacity.any()
    assert all(tensor.is_leaf and tensor.requires_grad for tensor in soup.tensors())


def test_orientations_are_uniform():
    corners = initial_soup(cloud(2, 3000), 3000, 0).vertices.detach().numpy()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Of a uniform direction: mean 0, covariance 1/3; five standard errors.
    assert np.abs(normals.mean(0)).max() < 5 / np.sqrt(3 * 3000)
    np.testing.assert_allclose(normals.T @ normals / 3000, np.eye(3) / 3, atol=5 * 0.3 / np.sqrt(3000))


def test_more_triangles_than_points_takes_every_point_once():
    points = cloud(3, 20)
    corners = initial_soup(points, 50, 0).vertices.detach().numpy()
    assert len(corners) == 20
    assert sorted(cdist(corners.mean(1), points).argmin(1)) == list(range(20))


def test_the_start_depends_on_the_seed_alone():
    points = cloud(4, 100)
    first, second, other = (initial_soup(points, 30, seed) for seed in (1, 1, 2))
    assert all(torch.equal(a, b) for a, b in zip(first.tensors(), second.tensors(), strict=True))
    assert not torch.equal(first.vertices, other.vertices) and not torch.equal(first.mlp[0], other.mlp[0])


def test_mlp_starts_kaiming_xavier_and_zero():
    weights = initial_mlp(0)
    assert tuple(tuple(tensor.shape) for tensor in weights) == MLP_SHAPES
    assert not any(tensor.any() for tensor in weights[1::2])
    # Kaiming-uniform sqrt(6/16) for the hidden layers, Xavier-uniform sqrt(6/(16+3)) for the last; 256 draws
    # come near the bound.
    for tensor, bound in zip(weights[::2], (np.sqrt(6 / 16), np.sqrt(6 / 16), np.sqrt(6 / 19)), strict=True):
        assert 0.9 * bound < tensor.abs().max() <= bound


@pytest.mark.parametrize(
    "points, count, words",
    [
        (np.zeros((1, 3)), 5, "at least two finite points"),
        (np.full((9, 3), np.nan), 5, "at least two finite points"),
        (np.zeros((9, 2)), 5, "at least two finite points"),
        (np.ones((9, 3)), 5, "coincide"),
        (np.eye(9, 3), 1, "at least two triangles"),
    ],
)
def test_a_cloud_that_cannot_start_a_soup_is_refused(points, count, words):
    with pytest.raises(InputError, match=words):
        initial_soup(points, count, 0)


@pytest.fixture
def stored(tmp_path):
    soup = initial_soup(cloud(5, 60), 40, 3)
    path = tmp_path / "below" / "soup.npz"
    save_soup(path, soup)
    return soup, path


def test_save_and_load_give_the_same_bits(stored):
    soup, path = stored
    again = load_soup(path)
    assert len(again) == 40
    for before, after in zip(soup.tensors(), again.tensors(), strict=True):
        assert torch.equal(before, after) and before.dtype == after.dtype
    assert [file.name for file in path.parent.iterdir()] == ["soup.npz"]


def test_select_carries_everything_along_and_copies(stored):
    soup, _ = stored
    wanted = torch.tensor([7, 0, 7])
    chosen = soup.select(wanted)
    assert torch.equal(chosen.vertices, soup.vertices[wanted]) and chosen.mlp is soup.mlp
    with torch.no_grad():
        chosen.vertices.zero_()
    assert soup.vertices.any(dim=-1).all()
    moved = soup.select(wanted, torch.ones(3, 3, 3))
    assert torch.equal(moved.vertices, torch.ones(3, 3, 3))
    assert torch.equal(moved.opacity, soup.opacity[wanted])


def rewritten(path, **changes) -> None:
    with np.load(path) as data:
        arrays = {name: data[name] for name in data}
    np.savez(path, **{name: array for name, array in (arrays | changes).items() if array is not None})


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"mlp_3": None}, "not a readable soup"),
        ({"vertices": np.zeros((40, 9))}, "does not hold a soup"),
        ({"vertices": np.float32(1)}, "does not hold a soup"),
        ({"opacity": np.zeros((39, 3))}, "does not hold a soup"),
        ({"features": np.array(["a", "b"])}, "not a readable soup"),
        ({"opacity": np.ones((40, 3), complex)}, "not a readable soup"),
        ({"features": np.full((40, 3, 7), np.nan)}, "not finite"),
        ({"features": np.full((40, 3, 7), 3e38, np.float32)}, "does not hold a soup: colours beyond 1e.08"),
        (0, "soup.npz is not a readable soup"),
        (10, "soup.npz is not a readable soup"),
        (0.5, "soup.npz is not a readable soup"),
        (-20, "soup.npz is not a readable soup"),
    ],
)
def test_a_soup_that_is_foreign_or_cut_off_is_refused(stored, changes, words):
    """changes: other arrays, or where the file ends (a share or a number of bytes)."""
    _, path = stored
    if isinstance(changes, dict):
        rewritten(path, **changes)
    else:
        data = path.read_bytes()
        path.write_bytes(data[: int(changes * len(data)) if isinstance(changes, float) else changes])
    with pytest.raises(InputError, match=words):
        load_soup(path)


def test_a_soup_that_may_not_be_read(stored, monkeypatch):
    """The tests run as root, who may read all: the error is the system's."""
    _, path = stored

    def refuse(path):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("paper_artifact.soup.state.load_npz", refuse)
    with pytest.raises(InputError, match=r"cannot read .*soup.npz: Permission denied; check its permissions"):
        load_soup(path)


@pytest.mark.parametrize("changes", [{"opacity": np.ones((40, 3), np.float32)}, {"offset": np.ones(3)}])
def test_a_soup_that_is_not_its_records_is_refused(tmp_path, changes):
    path, record = tmp_path / "soups" / "a.npz", tmp_path / "runs" / "a.json"
    digest = save_soup(path, initial_soup(cloud(5, 60), 40, 3))
    record.parent.mkdir()
    record.write_text(json.dumps({"soup": {"sha256": digest}}))
    assert len(load_soup(path)) == 40
    rewritten(path, **changes)
    with pytest.raises(InputError, match="not the soup of its record"):
        load_soup(path)
    record.write_text(json.dumps({"soup": {"triangles": 40}}))  # as the records of version 0.2.0
    assert len(load_soup(path)) == 40
