"""Scenes far from the origin, huge or tiny: the same run up to rounding, in the user's coordinates."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from paper_artifact.catalogue import SHAPES
from paper_artifact.config import RunConfig
from paper_artifact.frame import SAME, Frame, frame_for
from paper_artifact.mesh import Mesh
from paper_artifact.pipeline import run
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import load_frame, load_soup
from tests.odd_meshes import obj
from tests.tiny_run import tiny_config

FAR = np.array([1e8, -2e8, 3e8])
PLACES = {"far": (1.0, FAR), "huge": (1e12, 0 * FAR), "tiny": (1e-12, 0 * FAR), "both": (1e-5, FAR)}


def moved(mesh: Mesh, scale: float, offset: np.ndarray) -> Mesh:
    return replace(mesh, vertices=mesh.vertices * scale + offset)


def test_the_map_is_exact_back_and_forth_and_none_for_the_study():
    points = np.array([[1.5, 2.25, -3.0], [0.125, 0.5, 4.0]])
    frame = frame_for(FAR, 2.0**40)
    assert frame == Frame(exponent=41), "so large a scene is not far away"
    np.testing.assert_array_equal(frame.outward(frame.inward(points)), points)
    far = frame_for(FAR, 1.0)
    assert far == Frame(tuple(FAR.tolist())) and far.length(3.0) == 3.0
    np.testing.assert_array_equal(far.inward(points + FAR), points)
    assert frame_for(np.array([3.0, 4.0, 9.0]), 1.0) == SAME and SAME.inward(points) is points
    for shape in SHAPES:
        if shape.group in ("analytic", "bowls", "allocation"):
            mesh = make_shape(shape.name)
            assert frame_for(mesh.centre, mesh.radius) == SAME and mesh.framed(SAME) is mesh


@pytest.mark.parametrize("place", PLACES)
def test_a_scene_is_written_where_its_mesh_lies_and_read_near_the_origin(place, tmp_path):
    scale, offset = PLACES[place]
    cube, config = make_shape("cube"), SceneConfig(views=4, size=32, supersample=2, points=300)
    here = load_scene(build_scene(cube, config, tmp_path / "here"))
    there = load_scene(build_scene(moved(cube, scale, offset), config, tmp_path / "there"))
    assert here.frame == SAME and there.frame != SAME
    # A place at 3e8 is a multiple of 6e-8, so a cube of 1e-5 there is itself a little deformed.
    slack = 1e-6 + 2 * np.spacing(np.abs(offset).max()) / scale
    if place != "both":
        assert np.abs(there.images.astype(int) - here.images).max() <= 3
    user = there.frame.outward(there.points.astype(np.float64))
    expected = here.points.astype(np.float64) * scale + offset
    assert np.abs(user - expected).max() < slack * scale * 10
    assert 0.4 < there.radius < 1.5
    away = [
        np.linalg.norm(each.camera_centres - each.points.mean(axis=0), axis=1) / each.radius
        for each in (there, here)
    ]
    np.testing.assert_allclose(*away, rtol=20 * slack)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """{place: (record, soup, its frame)} of a short run on the sphere with the loss."""
    found = {}
    settings = {"steps": 12, "views": 6, "size": 32, "condition": "C1", "loss": {"samples": 256}}
    config: RunConfig = tiny_config(**settings, dump_steps=(12,), samples=400)
    for place, (scale, offset) in {"here": (1.0, 0 * FAR), **PLACES}.items():
        if place != "both":
            results = tmp_path_factory.mktemp(place)
            mesh = moved(make_shape("sphere"), scale, offset)
            record = run(config, mesh=mesh, results=results, device="cpu")
            (path,) = (results / "soups").iterdir()
            found[place] = record, load_soup(path), load_frame(path), path
    return found


@pytest.mark.parametrize("place", ["far", "huge", "tiny"])
def test_a_run_gives_the_same_there(runs, place):
    here, there = runs["here"][0], runs[place][0]
    scale, offset = PLACES[place]
    assert "frame" not in here and there["frame"] == runs[place][2].to_json()
    # To rounding at first, which a step's random thresholds turn into a pixel here and there.
    np.testing.assert_allclose(there["losses"]["loss"][:3], here["losses"]["loss"][:3], rtol=2e-3)
    np.testing.assert_allclose(there["losses"]["loss"], here["losses"]["loss"], rtol=0.05)
    assert there["images"]["psnr"] == pytest.approx(here["images"]["psnr"], abs=0.5)
    assert there["dumps"][0]["chamfer"] == pytest.approx(here["dumps"][0]["chamfer"], rel=0.1)
    assert there["mesh"]["diagonal"] == pytest.approx(scale * here["mesh"]["diagonal"], rel=1e-6)
    assert there["bundle"]["bars"][2][0] == pytest.approx(here["bundle"]["bars"][2][0], rel=1e-3)


@pytest.mark.parametrize("place", ["far", "huge"])
def test_exports_and_evaluations_are_in_the_users_coordinates(runs, place, tmp_path, command):
    scale, offset = PLACES[place]
    record, soup, frame, path = runs[place]
    expected = frame.outward(soup.vertices.numpy().astype(np.float64))
    command(f"export {path} --out={tmp_path} --formats ply glb --quiet")
    ply = trimesh.load_mesh(tmp_path / f"{path.stem}.ply", process=False)
    np.testing.assert_allclose(ply.triangles, expected, rtol=1e-15, atol=1e-7 * scale)
    glb = trimesh.load_scene(tmp_path / f"{path.stem}.glb", process=False)
    assert np.abs(glb.bounds - ply.bounds).max() < 2 * scale
    mesh = moved(make_shape("sphere"), scale, offset)
    truth, out = tmp_path / "truth.obj", tmp_path / "scores.json"
    truth.write_bytes(obj(mesh.vertices, mesh.faces))
    command(f"evaluate {path} --target {truth} --samples=400 --json={out} --quiet")
    assert json.loads(out.read_text())["chamfer"] == pytest.approx(record["dumps"][0]["chamfer"], rel=0.2)
