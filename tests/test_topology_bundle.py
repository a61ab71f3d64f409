"""The target bundle: what it holds and refuses, its file, and the law of the spacing behind its floor."""

import json

import numpy as np
import pytest

from paper_artifact.errors import InputError
from paper_artifact.scene.shapes import make_shape
from paper_artifact.topology.bundle import build_bundle, build_from_mesh, bundle_from_json, load_bundle
from paper_artifact.topology.floor import measurement_floor, median_spacing, uniform_spacing
from tests.topology_cases import sphere


def test_bundle_of_a_sphere_is_its_void():
    bundle = build_bundle(sphere(0), 2 * 3**0.5, shape="sphere")
    assert bundle.dimensions == (2,)
    assert [len(bars) for bars in bundle.bars] == [0, 0, 1]
    # Death at the centre: radius 1 over the diagonal.
    assert bundle.bars[2][0, 1] == pytest.approx(1 / (2 * 3**0.5), rel=0.05)
    assert bundle.reasons[2].startswith("matched: 1 significant")
    assert bundle.reasons[1].startswith("not acted on")
    assert bundle.floor == measurement_floor(sphere(0), 2 * 3**0.5)


def test_bundle_refuses_empty_dimensions_and_names_them():
    for words, options in (
        ("no significant bar in dimension 1 at M = 400", {"dimensions": (1,)}),
        ("dimension 3 does not exist", {"dimensions": (3,)}),
        ("cannot be suppressed", {"suppress": (2,)}),
        ("no dimension to act in", {"dimensions": ()}),
        ("in any dimension", {"points": np.random.default_rng(0).random((100, 3))}),
    ):
        with pytest.raises(InputError, match=words):
            build_bundle(**{"points": sphere(0), "diagonal": 3.46} | options)
    for dimensions in (3, np.array(3), (1.0,), "1", (-1,)):
        for name in ("dimensions", "suppress"):
            with pytest.raises(InputError, match="does not exist in three-dimensional space"):
                build_bundle(sphere(0), 3.46, **{name: dimensions})
    numbers = {"k": np.float32(6), "seed": np.int64(3), "dimensions": np.int64(2)}
    both = build_bundle(sphere(0), np.float32(3.46), suppress=np.array([1]), **numbers)
    assert json.loads(json.dumps(both.to_json()))["dimensions"] == [1, 2]
    assert both.dimensions == (1, 2) and both.reasons[1].startswith("suppressed on purpose")


BAD: dict[str, tuple[dict, str]] = {
    "text": ({"points": "abc"}, "points are not numbers"),
    "plane": ({"points": sphere(0)[:, :2]}, r"of shape \(n, 3\), got \(400, 2\)"),
    "nothing": ({"points": np.zeros((0, 3))}, r"at least 2 points .* got \(0, 3\)"),
    "not finite": ({"points": sphere(0) * np.inf}, "coordinates that are finite"),
    "huge": ({"points": 1e308 * sphere(0)}, "below 1e307; remove others, scale all"),
    "masked": ({"points": np.ma.masked_less(sphere(0), 0)}, "the mask of the points would be lost"),
    "diagonal 0": ({"diagonal": 0.0}, "must be a positive length, got 0.0"),
    "diagonal text": ({"diagonal": "3"}, "must be a positive length, got '3'"),
    "diagonal of another unit": ({"diagonal": 1e-300}, "give the diagonal in their unit"),
    "k nan": ({"k": np.nan}, "k is nan; give a positive number, 6 in the paper"),
    "k negative": ({"k": -1}, "k is -1; give a positive number"),
    "k 0": ({"k": 0}, "k is 0; give a positive number"),
    "k infinite": ({"k": np.inf}, "k is inf; give a positive number"),
    "twice": ({"points": np.repeat(sphere(0), 2, axis=0)}, "most points repeat others"),
    "seed": ({"seed": -1}, "seed is -1; give a whole number of at least 0"),
    "half a seed": ({"seed": 0.5}, "seed is 0.5; give a whole number"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_no_bundle_is_built_of(name):
    changes, words = BAD[name]
    with pytest.raises(InputError, match=words):
        build_bundle(**{"points": sphere(0), "diagonal": 3.46, **changes})


@pytest.mark.parametrize("scale", [2.0**-1000, 1e-200, 1e-100, 1e100, 1e200, 2.0**1000])
def test_a_bundle_is_the_same_at_any_scale(scale):
    one, far = build_bundle(sphere(0), 3.46), build_bundle(scale * sphere(0), scale * 3.46)
    assert far.floor == pytest.approx(one.floor) and far.dimensions == one.dimensions == (2,)
    np.testing.assert_allclose(far.bars[2], one.bars[2])
    assert median_spacing(scale * sphere(0)) == pytest.approx(scale * median_spacing(sphere(0)))


def test_bundle_json_round_trip_and_damage(tmp_path):
    bundle = build_bundle(sphere(0), 2 * 3**0.5, shape="sphere")
    path = tmp_path / "bundle.json"
    bundle.save(path)
    again = load_bundle(path)
    assert again.to_json() == bundle.to_json()
    value = json.loads(path.read_text())
    bad = {
        "format": "other",
        "floor": 9.0,
        "bars": [[], []],
        "samples": None,
        "dimensions": [],
        "diagonal": 0,
    }
    odd = {"dimensions": [0.5], "samples": 1024.5, "seed": "0", "floor": str(value["floor"])}
    for name, change in [*bad.items(), *odd.items()]:
        with pytest.raises(InputError):
            bundle_from_json(value | {name: change})
    path.write_text("{")
    with pytest.raises(InputError, match="cannot read the bundle"):
        load_bundle(path)


def test_bundle_from_mesh_is_a_function_of_its_seed_and_knows_its_mesh():
    cube = make_shape("cube")
    corners, faces = cube.vertices, cube.faces
    for changes, words in (
        ({"vertices": np.zeros((0, 3)), "faces": np.zeros((0, 3), int)}, "cube has no triangles"),
        ({"vertices": corners[:, :2]}, r"cube has vertices \(8, 2\) and faces \(12, 3\)"),
        ({"vertices": corners * np.nan}, "NaN or infinite"),
        ({"vertices": 1e200 * corners}, "no finite, positive area"),
        ({"faces": faces + 0.4}, "refers to vertex .*, no whole number"),
        ({"samples": 2.5}, "number of samples is 2.5; give a whole number from 0"),
        ({"samples": 10**400}, "number of samples is 10+; give a whole number from 0"),
        ({"seed": -1}, "seed is -1; give a whole number from 0"),
        ({"seed": 2**63}, "seed is 9223372036854775808; give a whole number from 0"),
    ):
        with pytest.raises(InputError, match=words):
            build_from_mesh(**{"vertices": corners, "faces": faces, "samples": 9, "shape": "cube"} | changes)
    first, again = (build_from_mesh(corners, faces, 600, 1, shape="cube") for _ in range(2))
    other = build_from_mesh(corners, faces, 600, 2, shape="cube")
    assert first.to_json() == again.to_json() and first.source == other.source and first.floor != other.floor
    assert first.diagonal == pytest.approx(3**0.5) and first.dimensions == (2,)


def test_uniform_spacing_law():
    points = np.random.default_rng(0).random((20000, 3)) * [1, 1, 0]
    assert median_spacing(points) == pytest.approx(uniform_spacing(1.0, 20000), rel=0.02)
    with pytest.raises(InputError, match="positive area"):
        uniform_spacing(0.0, 10)
