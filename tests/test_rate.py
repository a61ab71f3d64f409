"""The unit of the vertices' learning rate; the budget among photographs; what a run that goes wrong says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from paper_artifact.config import RunConfig
from paper_artifact.randomness import stream
from paper_artifact.raster.arrays import FEATURES
from paper_artifact.scene.cameras import FAR, NEAR, fibonacci_cameras, look_at, picture_radii, world_to_clip
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.adam import SoupOptimiser
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.state import Soup, initial_mlp
from paper_artifact.train.watch import Watch
from tests.test_soup_adam import RATES, give_gradients, make_soup


def matrices(cameras) -> np.ndarray:
    return np.stack([world_to_clip(camera, 0.01, 100.0) for camera in cameras])


def test_a_study_scene_has_its_own_radius_at_its_centre():
    mesh = make_shape("torus")
    views = matrices(fibonacci_cameras(mesh, 12, 200))
    assert picture_radii(mesh.centre, views)[0] == pytest.approx(mesh.radius, rel=1e-12)


def test_picture_radii_are_the_lower_median_over_the_views_that_show_a_point():
    draws = stream(0, "picture radii")
    cameras = [
        replace(look_at(position, draws.normal(size=3) / 5, 90), height=140, centre_x=31.0)
        for position in draws.normal(size=(9, 3)) * (4, 4, 2)
    ]
    points = draws.normal(size=(50, 2, 3)) * 3
    radii, shown = picture_radii(points, matrices(cameras))
    for index in np.ndindex(50, 2):
        found = []
        for camera in cameras:
            x, y, depth = camera.rotation @ points[index] + np.asarray(camera.translation)
            column = camera.focal_x * x / depth + camera.centre_x
            row = camera.focal_y * y / depth + camera.centre_y
            if depth > 0 and 0 <= column <= camera.width and 0 <= row <= camera.height:
                half = np.sqrt(camera.width * camera.height / (camera.focal_x * camera.focal_y)) / 2
                found.append(depth * half / (3 * np.tan(np.radians(25))))
        assert shown[index] == bool(found)
        if found:
            assert radii[index] == pytest.approx(sorted(found)[(len(found) - 1) // 2], rel=1e-9)
    assert 0 < shown.mean() < 1 and (radii[~shown] == radii[shown].min()).all()


def test_units_scale_with_the_scene_and_are_one_where_it_states_its_radius(tiny_scene):
    corners = tiny_scene.points[:30].reshape(10, 3, 3)
    assert (tiny_scene.units(corners) == 1).all()
    given = replace(tiny_scene, rendered=False)
    units = given.units(corners)
    assert units.shape == (10, 3) and units.dtype == np.float32 and 0.6 < units.min() < units.max() < 1.4
    # the cloud's extent does not matter, only what the cameras are away from a point
    assert np.allclose(replace(given, radius=5 * given.radius).units(corners) * 5, units, rtol=1e-6)


def test_a_step_is_as_long_as_its_units_for_both_optimisers():
    plain, soup, twin = make_soup(20), make_soup(20), make_soup(20, torch.float64)
    start = plain.vertices.detach().clone()
    units = stream(0, "units").uniform(0.1, 10, (20, 3)).astype(np.float32)
    optimisers = [SoupOptimiser(each) for each in (plain, soup, twin)]
    for optimiser, scale in zip(optimisers, (None, units, units), strict=True):
        for step in range(3):
            give_gradients([plain, soup, twin], step)
            optimiser.step(RATES, scale)
    moved = (plain.vertices - start) * torch.from_numpy(units)[..., None]
    assert torch.allclose(soup.vertices - start, moved, atol=1e-5)
    assert torch.allclose(twin.vertices.float(), soup.vertices, atol=1e-5)
    assert torch.equal(soup.features, plain.features)


def outside_views(count: int) -> tuple[Soup, np.ndarray]:
    """A soup whose triangles lie anywhere, some of them large in a picture, and five views."""
    draws = stream(3, "outside views")
    cameras = fibonacci_cameras(make_shape("sphere"), 5, 64)
    centres = draws.uniform(-6, 6, (count, 1, 3))
    corners = (centres + draws.normal(size=(count, 3, 3)) / 2).astype(np.float32)
    tensors = torch.from_numpy(corners), torch.zeros(count, 3, FEATURES), torch.full((count, 3), 3.0)
    views = np.stack([world_to_clip(camera, NEAR, FAR) for camera in cameras]).astype(np.float32)
    return Soup(*tensors, initial_mlp(0)).trainable(), views


def test_the_budget_of_photographs_holds_from_the_first_pruning_on():
    soup, views = outside_views(400)
    config = RunConfig("x", steps=1000, dump_steps=(), budget=150, split_height=0.1)
    loose, strict = (Resampler(config, strict=each) for each in (False, True))
    assert len(loose.resample(soup, views, 64, 64, 10)[0]) > 200
    for step in (10, 20, 30):
        soup, report = strict.resample(soup, views, 64, 64, step)
        assert report["pruned"] == report["after"] == len(soup) == 150
    few = soup.select(torch.arange(60))
    assert 60 < len(strict.resample(few, views, 64, 64, 40)[0]) <= 150


@pytest.fixture
def watch(tiny_scene):
    given, said = replace(tiny_scene, rendered=False), []
    made = Watch(given, RunConfig("x", steps=600, dump_steps=()), said.append)
    return SimpleNamespace(watch=made, said=said, scene=given)


def soup_at(points: np.ndarray) -> Soup:
    corners = np.asarray(points, np.float32)[:, None] + np.float32(0.2) * np.eye(3, dtype=np.float32)
    zeros = torch.zeros(len(corners), 3, FEATURES), torch.zeros(len(corners), 3)
    return Soup(torch.from_numpy(corners), *zeros, initial_mlp(0)).trainable()


def test_a_loss_that_rises_is_said_once_and_one_that_falls_is_not(watch, monkeypatch):
    monkeypatch.setattr("paper_artifact.train.watch.view_scores", lambda *_: {"psnr": 25.0})
    soup = soup_at(watch.scene.points[:50])
    falling = list(np.geomspace(0.3, 0.1, 600))
    for step in range(100, 600, 100):
        watch.watch.look(step, falling[:step], soup)
    assert watch.said == [] == watch.watch.sentences()
    rising = falling[:250] + list(np.geomspace(0.15, 0.4, 350))
    for step in range(100, 600, 100):
        watch.watch.look(step, rising[:step], soup)
    assert len(watch.said) == 1 and "the loss does not fall" in watch.said[0]
    assert "--set vertex_lr=0.005" in watch.said[0] and watch.watch.sentences() == watch.said


def test_poor_pictures_and_triangles_that_leave_the_views_are_said(watch):
    points = watch.scene.points[:50].copy()
    losses = list(np.geomspace(0.3, 0.1, 600))
    watch.watch.look(100, losses[:100], soup_at(points))
    assert watch.said == []
    points[:20] *= 100
    watch.watch.look(200, losses[:200], soup_at(points))
    left, poor = watch.said
    assert "% of the triangles lie outside all views, 0% did at first" in left
    assert "dB, less than 16" in poor and "--set budget=2400" in poor
    watch.watch.look(300, losses[:300], soup_at(points))
    assert len(watch.said) == 2
