"""The target bundle: what it holds and refuses, its file, and the law of the spacing behind its floor."""

from __future__ import annotations

import json

import numpy as np
import pytest

from paper_artifact.errors import InputError
from paper_artifact.topology.bundle import build_bundle, build_from_mesh, bundle_from_json, load_bundle
from paper_artifact.topology.floor import measurement_floor, median_spacing, uniform_spacing
from tests.topology_cases import sphere


def test_bundle_of_a_sphere_is_its_void():
    bundle = build_bundle(sphere(0), 2 * 3**0.5, shape="sphere")
    assert bundle.dimensions == (2,)
    assert [len(bars) for bars in bundle.bars] == [0, 0, 1]
    assert bundle.bars[2][0, 1] == pytest.approx(
        1 / (2 * 3**0.5), rel=0.05
    )  # death at the centre: radius 1 over the diagonal
    assert bundle.reasons[2].startswith("matched: 1 significant") and bundle.reasons[1].startswith(
        "not acted on"
    )
    assert bundle.floor == measurement_floor(sphere(0), 2 * 3**0.5)


def test_bundle_refuses_empty_dimensions_and_names_them():
    with pytest.raises(InputError, match="no significant bar in dimension 1 at M = 400"):
        build_bundle(sphere(0), 3.46, dimensions=(1,))
    with pytest.raises(InputError, match="dimension 3 does not exist"):
        build_bundle(sphere(0), 3.46, dimensions=(3,))
    with pytest.raises(InputError, match="cannot be suppressed"):
        build_bundle(sphere(0), 3.46, suppress=(2,))
    with pytest.raises(InputError, match="in any dimension"):
        build_bundle(np.random.default_rng(0).random((100, 3)), 3**0.5)
    both = build_bundle(sphere(0), 3.46, suppress=(1,))
    assert both.dimensions == (1, 2) and both.reasons[1].startswith("suppressed on purpose")


def test_bundle_json_round_trip_and_damage(tmp_path):
    bundle = build_bundle(sphere(0), 2 * 3**0.5, shape="sphere")
    path = tmp_path / "bundle.json"
    bundle.save(path)
    again = load_bundle(path)
    assert again.to_json() == bundle.to_json()
    value = json.loads(path.read_text())
    for change in (
        {"format": "other"},
        {"floor": 9.0},
        {"bars": [[], []]},
        {"samples": None},
        {"dimensions": []},
        {"diagonal": 0.0},
    ):
        with pytest.raises(InputError):
            bundle_from_json({**value, **change})
    path.write_text("{")
    with pytest.raises(InputError, match="cannot read the bundle"):
        load_bundle(path)


def test_bundle_from_mesh_is_a_function_of_its_seed_and_knows_its_mesh():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([[a, b, c] for a, b, c, d in quads] + [[a, c, d] for a, b, c, d in quads])
    first, again = (build_from_mesh(corners, faces, 600, 1, shape="cube") for _ in range(2))
    other = build_from_mesh(corners, faces, 600, 2, shape="cube")
    assert first.to_json() == again.to_json() and first.source == other.source and first.floor != other.floor
    assert first.diagonal == pytest.approx(3**0.5) and first.dimensions == (2,)


def test_uniform_spacing_law():
    points = np.random.default_rng(0).random((20000, 3)) * [1, 1, 0]
    assert median_spacing(points) == pytest.approx(uniform_spacing(1.0, 20000), rel=0.02)
    with pytest.raises(InputError, match="positive area"):
        uniform_spacing(0.0, 10)
