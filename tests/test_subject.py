"""What photographs are of: cameras around a made subject on a made table, and the verb that uses it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from paper_artifact import cli, pipeline
from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.frame import Frame
from paper_artifact.mesh import load_mesh
from paper_artifact.randomness import stream
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.cameras import look_at
from paper_artifact.scene.colmap import read_model, write_model
from paper_artifact.scene.folder import model_folder
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.scene.subject import subject_of, within
from paper_artifact.soup.state import Soup, save_soup
from paper_artifact.topology import term
from tests.test_solidify import soup_of

MIDDLE, DISTANCE = np.array([1.0, -2.0, 0.5]), 4.0
WIDTH = DISTANCE * np.tan(np.radians(25))  # half of what a camera of 50 degrees sees there


def ring(count: int = 12, turned: float = 1.0):
    """Cameras around MIDDLE, 40 degrees up, each aimed a little beside it; turned -1: away from it."""
    random = stream(0, "test")
    for angle in 2 * np.pi * np.arange(count) / count:
        out = np.array([np.cos(angle) * np.cos(0.7), np.sin(angle) * np.cos(0.7), np.sin(0.7)])
        place = MIDDLE + DISTANCE * out
        yield look_at(place, place - turned * (DISTANCE * out) + 0.02 * random.normal(size=3), 100)


def table(height: float = -0.3) -> np.ndarray:
    """A cloud: a wide table of 600 points at z = `height`, noisy, and 200 points of a thing above it."""
    random = stream(1, "test")
    flat = np.column_stack([MIDDLE[:2] + 4 * random.random((600, 2)) - 2, np.full(600, height)])
    flat[:, 2] += 0.003 * random.normal(size=600)
    return np.concatenate([flat, MIDDLE + 0.4 * random.normal(size=(200, 3)) * [1, 1, 0.5]])


def test_the_subject_is_where_the_cameras_look_above_the_plane_it_stands_on():
    subject = subject_of(list(ring()), table(), radius=0.5, ground=0.05)
    assert np.linalg.norm(subject.centre - MIDDLE) < 0.02
    assert subject.radius == pytest.approx(0.5 * WIDTH, rel=0.02)
    assert subject.up[2] > 0.9999 and subject.lowest == pytest.approx(-0.3 + 0.05 * WIDTH, abs=0.01)
    points = MIDDLE + [[0, 0, 0], [0.9, 0, 0], [0, 0, -0.7], [0, 0, -0.82], [0, 0, 0.9], [5, 0, 0]]
    assert subject.holds(points).tolist() == [True, True, True, False, True, False]
    kept = subject_of(list(ring()), table(), radius=0.5, ground=0)
    assert kept.holds(points).tolist() == [True, True, True, True, True, False]


def test_the_ground_is_found_from_either_side_and_again():
    turned = table() * [1, -1, -1]
    cameras = [look_at(camera.position * [1, -1, -1], MIDDLE * [1, -1, -1], 100) for camera in ring()]
    subject = subject_of(cameras, turned)
    assert subject.up[2] < -0.9999, "y down or z down: up is where the cameras are"
    again = subject_of(cameras, turned)
    assert np.array_equal(subject.up, again.up) and subject.lowest == again.lowest


def test_a_wall_a_trunk_and_a_floating_thing_have_no_ground():
    random, cameras = stream(2, "test"), list(ring())
    thing = MIDDLE + 0.3 * random.normal(size=(300, 3))
    wall = np.column_stack([np.full(500, MIDDLE[0] - 1), MIDDLE[1:] + 2 * random.random((500, 2)) - [1, 0.8]])
    angle, height = 2 * np.pi * random.random(500), 2 * random.random(500) - 1
    trunk = MIDDLE + np.column_stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), height])
    for cloud in (thing, np.concatenate([thing, wall]), trunk):
        assert subject_of(cameras, cloud).lowest == -np.inf
    with_table = np.concatenate([table(), *[wall] * 2])
    assert subject_of(cameras, with_table).lowest == pytest.approx(-0.3 + 0.03 * WIDTH, abs=0.01)


def test_cameras_without_a_subject_are_refused():
    parallel = [look_at(np.array([x, 0.0, 0.0]), np.array([x, 5.0, 0.0]), 100) for x in range(5)]
    for cameras, cloud, words, answer in (
        (parallel, table(), {}, "parallel axes"),
        (list(ring(turned=-1.0)), table(), {}, "away from each other"),
        (list(ring()), table()[:2] + 50, {}, "--ground 0 keeps the ground"),
        (list(ring()), table(), {"radius": 0.0}, "must be positive"),
        (list(ring()), table(), {"ground": -1.0}, "must be positive"),
    ):
        with pytest.raises(InputError, match=answer):
            subject_of(cameras, cloud, **words)


def joined(*soups: Soup) -> Soup:
    parts = zip(*(soup.tensors()[:3] for soup in soups), strict=True)
    return Soup(*(torch.cat(each) for each in parts), soups[0].mlp)


def test_the_verb_takes_the_subject_out_of_a_scenes_soup(tiny_scene, tmp_path, capsys):
    """tiny_scene: cameras around the unit sphere at the origin, no ground."""
    torus = make_shape("torus")
    thing = soup_of(torus.vertices * (0.8 / torus.radius), torus.faces)
    wall = soup_of(torus.vertices + [9.0, 0, 0], torus.faces)
    save_soup(tmp_path / "s.npz", joined(thing, wall))
    out = tmp_path / "s.ply"
    words = ["solidify", str(tmp_path / "s.npz"), f"--out={out}", "--offsets=0.03", "--quiet"]
    assert cli.main([*words, "--betti=1,2,1"]) == 1 and not out.exists(), "with the wall there are two"
    capsys.readouterr()
    scene = [f"--scene={tiny_scene.path}", "--ground=0", "--radius=0.8"]
    assert cli.main([*words, "--betti=1,2,1", *scene]) == 0
    count = len(torus.faces)
    assert f"{count} of {2 * count} triangles are of what the cameras look at" in capsys.readouterr().out
    assert np.abs(load_mesh(out).vertices).max() < 0.9
    save_soup(tmp_path / "s.npz", wall)
    assert cli.main([*words, *scene]) == 1 and "--radius widens the ball" in capsys.readouterr().err
    assert cli.main([*words, "--radius=2"]) == 2 and "belong to --scene" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["ply", "glb"])
@pytest.mark.parametrize(("offset", "exponent"), [((1e8, -1e8, 3.0), 0), ((0.0, 0.0, 0.0), 40)])
def test_a_solid_is_in_the_users_coordinates(tmp_path, kind, offset, exponent):
    torus, frame = make_shape("torus"), Frame(offset, exponent)
    save_soup(tmp_path / "s.npz", soup_of(torus.vertices, torus.faces), frame)
    save_soup(tmp_path / "here.npz", soup_of(torus.vertices, torus.faces))
    for name in ("s", "here"):
        words = ["solidify", str(tmp_path / f"{name}.npz"), f"--out={tmp_path / name}.{kind}", "--quiet"]
        assert cli.main([*words, "--betti=1,2,1", "--offsets=0.03"]) == 0
    here, there = (load_mesh(tmp_path / f"{name}.{kind}", welded=False) for name in ("here", "s"))
    np.testing.assert_array_equal(there.vertices, frame.outward(here.vertices))
    assert np.array_equal(there.faces, here.faces)
    assert trimesh.Trimesh(there.vertices, there.faces, process=False).is_watertight


def test_stated_numbers_are_the_subjects_and_not_the_tables(tmp_path, monkeypatch):
    """A sphere whose cloud has a plane below: samples, cloud and evaluation leave the plane out."""
    folder = tmp_path / "ball"
    build_scene(make_shape("sphere"), SceneConfig(views=11, size=44, supersample=2, points=400), folder)
    assert within(load_scene(folder)) is None, "rendered: all is the subject's"
    (folder / "scene.json").unlink()
    assert within(load_scene(folder)) is None, "no ground"
    model = read_model(model_folder(folder))
    flat = np.column_stack([stream(2, "test").uniform(-1.5, 1.5, (900, 2)), np.full(900, -1.1)])
    positions, count = np.concatenate([model.positions, flat]), len(model.positions) + 900
    colours, errors = np.zeros((count, 3), np.uint8), np.zeros(count)
    cloud = {"positions": positions, "colours": colours, "errors": errors}
    write_model(replace(model, point_ids=np.arange(count), **cloud), model_folder(folder))
    scene = load_scene(folder)
    holds = within(scene)
    assert holds(scene.points)[-900:].sum() == 0 and holds(scene.points)[:-900].mean() > 0.9
    assert holds(scene.points[-900:]).all(), "where nothing is the subject's, all is"
    drawn, sample = [], term.sample_soup

    def spy(vertices, alpha, *arguments):
        drawn.append((vertices.mean(axis=1), alpha.mean(axis=1)))
        return sample(vertices, alpha, *arguments)

    def judged(corners, *arguments):
        assert holds(corners.mean(axis=1)).all() and len(corners)
        return evaluate(corners, *arguments)

    evaluate = pipeline.evaluate_alone
    monkeypatch.setattr(pipeline, "evaluate_alone", judged)
    monkeypatch.setattr(term, "sample_soup", spy)
    loss = {"betti": (1, 0, 1), "samples": 512}
    values = {"steps": 24, "budget": 300, "samples": 400, "resample_every": 8, "dump_steps": (24,)}
    said = []
    config = study_config(str(folder), "T3", 0, loss=loss, **values)
    record = pipeline.run(config, results=tmp_path / "results", device="cpu", tell=said.append)
    for middles, alpha in drawn:
        assert 0 < holds(middles).sum() < len(middles) and np.array_equal(alpha > 0, holds(middles))
    assert drawn and any("points of the subject, too few to speak for M = 512" in each for each in said)
    assert record["statement"]["shown"] == [None, None, None] and "lambda" not in str(record["topology"])
    assert len(record["dumps"]) == 1
