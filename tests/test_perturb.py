"""What photographs do to a scene: what suffers, what stays clean, and that a clean scene keeps its key."""

import hashlib
import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.mesh import mesh_hash
from paper_artifact.scene.build import (
    FIXED,
    SCENE_FORMAT,
    Perturbation,
    SceneConfig,
    build_scene,
    moved_camera,
    perturbed_cloud,
    scene_key,
)
from paper_artifact.scene.cameras import fibonacci_cameras
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.shapes import make_shape

SMALL = SceneConfig(views=10, size=24, supersample=2, points=400)
SPHERE = make_shape("sphere")


def scene_of(folder, background: str = "white", **changes) -> Scene:
    config = replace(SMALL, background=background, perturbation=Perturbation(**changes))
    return load_scene(build_scene(SPHERE, config, folder))


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Scene:
    return scene_of(tmp_path_factory.mktemp("scenes") / "clean")


def test_a_clean_scene_keeps_the_key_it_had():
    values = asdict(SMALL) | FIXED
    del values["perturbation"]
    content = {"format": SCENE_FORMAT, "config": values, "mesh": mesh_hash(SPHERE), "name": "sphere"}
    text = json.dumps(content, sort_keys=True)
    assert scene_key(SPHERE, SMALL) == hashlib.sha256(text.encode()).hexdigest()
    keys = {
        scene_key(SPHERE, replace(SMALL, perturbation=Perturbation(image_noise=x))) for x in (0, 0.1, 0.2)
    }
    assert len(keys) == 3


def test_image_noise_is_in_the_training_views_alone(clean, tmp_path):
    noisy = scene_of(tmp_path / "noisy", image_noise=0.05)
    assert (noisy.images[noisy.holdout] == clean.images[clean.holdout]).all()
    difference = (noisy.colours(noisy.train) - clean.colours(clean.train))[clean.colours(clean.train) < 0.8]
    assert difference.std() == pytest.approx(0.05, rel=0.05) and abs(difference.mean()) < 0.005
    assert (noisy.world_to_clip == clean.world_to_clip).all() and (noisy.points == clean.points).all()


def test_camera_noise_moves_the_training_cameras_alone(clean, tmp_path):
    moved = scene_of(tmp_path / "moved", camera_noise=0.01)
    assert (moved.images == clean.images).all()
    steps = (moved.camera_centres - clean.camera_centres) / SPHERE.diagonal
    assert (steps[moved.holdout] == 0).all()
    assert 0.005 < steps[moved.train].std() < 0.015 and (steps[moved.train] != 0).all()
    camera = fibonacci_cameras(SPHERE, 10, 24)[1]
    assert moved_camera(camera, Perturbation(camera_noise=0.01), 1.0, 1).quaternion == camera.quaternion


def test_the_cloud_gets_gaps_noise_and_outliers():
    positions = np.random.default_rng(0).random((1000, 3))
    colours = np.arange(3000, dtype=np.uint8).reshape(1000, 3)
    cut, kept = perturbed_cloud(positions, colours, Perturbation(cloud_missing=0.3), 1.0)
    rows = (positions[:, None, 0] == cut[None, :, 0]).argmax(axis=0)
    assert len(cut) == 700 and (positions[rows] == cut).all() and (colours[rows] == kept).all()
    noisy, _ = perturbed_cloud(positions, colours, Perturbation(cloud_noise=0.01), 2.0)
    assert (noisy - positions).std() == pytest.approx(0.02, rel=0.05)
    outlying, _ = perturbed_cloud(positions, colours, Perturbation(cloud_outliers=0.05), 1.0)
    assert ((outlying != positions).all(axis=1)).sum() == 50
    assert perturbed_cloud(positions, colours, Perturbation(), 1.0)[0] is positions


def test_a_patterned_surrounding_is_behind_the_training_views(clean, tmp_path):
    scene = scene_of(tmp_path / "texture", background="texture")
    corners = scene.colours(scene.train)[:, 0, 0]
    assert scene.background.tolist() == [0.5, 0.5, 0.5] and corners.std(axis=0).min() > 0.05
    assert np.abs(scene.colours(scene.holdout)[:, 0, 0] - 0.5).max() < 0.01
    middle = scene.images[:, :, 12, 12]
    assert (middle == clean.images[:, :, 12, 12]).all()


def test_values_out_of_range_are_refused():
    for name, value, range_of in (("image_noise", -0.1, "1"), ("cloud_missing", 0.95, "0.9")):
        words = f"{name} must be at least 0 and below {range_of}, got {value}"
        with pytest.raises(InputError, match=words):
            study_config("sphere", "C0", **{name: value})
