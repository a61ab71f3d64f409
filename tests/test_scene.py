"""Scenes on disk: build, reuse, refuse; load this package's scenes and foreign ones; the `scene` verb."""

import json
import os
import shutil
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from paper_artifact.archives import load_npz
from paper_artifact.cli import main
from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh, mesh_hash
from paper_artifact.scene.build import SceneConfig, build_scene, scene_folder, scene_key
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.shapes import make_shape
from tests.colmap_text import write_text_model

VIEW = "images/view_004.png"
SMALL = SceneConfig(views=10, size=24, supersample=2, points=400)


@pytest.fixture(scope="module")
def torus_scene(tmp_path_factory):
    return build_scene(make_shape("torus"), SMALL, tmp_path_factory.mktemp("scene") / "torus")


@pytest.fixture
def damaged(torus_scene, tmp_path):
    """A copy of the scene that a test may damage."""
    shutil.copytree(torus_scene, tmp_path / "copy")
    described = json.loads((tmp_path / "copy" / "scene.json").read_text())
    del described["files"]  # as an older version built it: a change is seen by what it breaks alone
    (tmp_path / "copy" / "scene.json").write_text(json.dumps(described))
    return tmp_path / "copy"


def test_a_built_scene_reads_back_with_the_stated_frames(torus_scene):
    scene, mesh = load_scene(torus_scene), make_shape("torus")
    assert scene.names == tuple(f"view_{index:03d}.png" for index in range(10))
    assert scene.images.shape == (10, 3, 24, 24) and scene.images.dtype == np.uint8
    assert scene.images.min() < 255 and scene.images.max() == 255
    assert scene.holdout.tolist() == [0, 8] and scene.train.tolist() == [1, 2, 3, 4, 5, 6, 7, 9]
    assert scene.points.dtype == scene.world_to_clip.dtype == scene.camera_centres.dtype == np.float32
    assert scene.background.tolist() == [1, 1, 1] and scene.radius == pytest.approx(mesh.radius)
    np.testing.assert_allclose(np.linalg.norm(scene.camera_centres, axis=1), 3 * mesh.radius, rtol=1e-5)
    ring = np.hypot(np.hypot(scene.points[:, 0], scene.points[:, 1]) - 1, scene.points[:, 2])
    np.testing.assert_allclose(ring, 0.38, atol=2e-3)
    # The projected cloud lies where a view shows the surface (a point on the outline may miss a pixel's four
    # samples), and the surface where the cloud is.
    for view in range(10):
        clip = np.column_stack([scene.points, np.ones(400)]) @ scene.world_to_clip[view].T
        assert (clip[:, 3] > 0).all()
        pixel = np.floor((clip[:, :2] / clip[:, 3:] + 1) * 12).astype(int)
        assert (scene.colours(view)[pixel[:, 1], pixel[:, 0]].min(axis=1) < 1).mean() > 0.95
        rows, columns = np.nonzero(scene.colours(view).max(axis=2) < 0.99)
        assert cKDTree(pixel).query(np.column_stack([columns, rows]))[0].max() < 3


def test_the_ground_truth_mesh_is_kept_to_the_bit(torus_scene):
    mesh, kept = make_shape("torus"), load_npz(torus_scene / "ground_truth.npz")
    assert (kept["name"].item(), kept["betti"].tolist()) == ("torus", [1, 2, 1])
    assert (kept["vertices"] == mesh.vertices).all() and (kept["faces"] == mesh.faces).all()
    described = json.loads((torus_scene / "scene.json").read_text())
    assert described["mesh"]["sha256"] == mesh_hash(mesh) and described["config"]["views"] == 10
    assert described["key"] == scene_key(mesh, SMALL)


def test_the_same_scene_is_not_built_twice_and_gives_the_same_files(torus_scene, tmp_path):
    before = {file: file.stat().st_mtime_ns for file in torus_scene.rglob("*")}
    assert build_scene(make_shape("torus"), SMALL, torus_scene) == torus_scene
    assert {file: file.stat().st_mtime_ns for file in torus_scene.rglob("*")} == before
    other = build_scene(make_shape("torus"), SMALL, tmp_path / "other")
    for file in (file for file in torus_scene.rglob("*") if file.is_file()):
        assert (other / file.relative_to(torus_scene)).read_bytes() == file.read_bytes()


def test_another_scene_or_foreign_content_is_never_overwritten(torus_scene, tmp_path):
    for shape, config in (("torus", replace(SMALL, seed=1)), ("cube", SMALL)):
        with pytest.raises(InputError, match="another mesh or configuration"):
            build_scene(make_shape(shape), config, torus_scene)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    with pytest.raises(InputError, match="no scene of this package"):
        build_scene(make_shape("cube"), SMALL, tmp_path / "mine")
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "precious"


def test_folders_by_content_differ_with_mesh_and_configuration(tmp_path):
    cube, torus = make_shape("cube"), make_shape("torus")
    cases = product((cube, torus), (SMALL, replace(SMALL, size=32)))
    folders = {scene_folder(mesh, config, tmp_path) for mesh, config in cases}
    assert len(folders) == 4 and {folder.parent for folder in folders} == {tmp_path}


@pytest.mark.parametrize(
    "field, value",
    [
        ("views", -1),
        ("views", 1),
        ("views", 4.5),
        ("size", 0),
        ("supersample", 0),
        ("points", 3),
        ("seed", -1),
        ("background", "pink"),
    ],
)
def test_bad_configurations_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        SceneConfig(**{field: value})


def test_a_mesh_so_large_that_its_scene_would_not_be_read_is_refused(tmp_path):
    torus = make_shape("torus")
    with pytest.raises(InputError, match="scale it down"):
        build_scene(replace(torus, vertices=1e25 * torus.vertices), SceneConfig(), tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


def test_a_foreign_scene_in_text_with_transparent_images(damaged):
    (damaged / "scene.json").unlink()
    (damaged / "ground_truth.npz").unlink()
    model = read_model(damaged / "sparse" / "0")
    for file in (damaged / "sparse" / "0").iterdir():
        file.unlink()
    write_text_model(model, damaged / "sparse" / "0")
    for file in (damaged / "images").iterdir():
        pixels = np.asarray(Image.open(file))
        Image.fromarray(np.dstack([pixels, np.zeros(pixels.shape[:2], np.uint8)])).save(file)
    scene = load_scene(damaged)
    assert scene.background.tolist() == [1, 1, 1] and (scene.images == 255).all()
    assert scene.radius == pytest.approx(make_shape("torus").diagonal / 2, rel=0.05)


def test_images_smaller_than_the_camera_are_welcome_in_the_same_aspect(damaged):
    before = load_scene(damaged)
    for file in (damaged / "images").iterdir():
        Image.open(file).resize((12, 12)).save(file)
    half = load_scene(damaged)
    assert half.images.shape == (10, 3, 12, 12)
    np.testing.assert_array_equal(half.world_to_clip, before.world_to_clip)


BRIGHT = '{"background": [1, 1, 9], "radius": 1}'


@pytest.mark.parametrize(
    "damage, words",
    [
        (lambda folder: (folder / VIEW).unlink(), "no image at .*view_004.png"),
        (lambda folder: (folder / VIEW).write_text("no picture"), "view_004.png is no image of the kinds"),
        (lambda folder: os.truncate(folder / VIEW, 200), "view_004.png is damaged or no image"),
        (
            lambda folder: Image.new("RGB", (12, 12)).save(folder / VIEW),
            r"several sizes, 24×24 \(\d+\), 12×12 \(1\), .*photos",
        ),
        (lambda folder: Image.new("RGB", (60, 24)).save(folder / VIEW), "60×24 pixels, another aspect"),
        (lambda folder: Image.new("I;16", (24, 24)).save(folder / VIEW), "convert it to 8-bit RGB"),
        (lambda folder: (folder / "sparse" / "0" / "points3D.bin").unlink(), "points3D.bin"),
        (lambda folder: (folder / "scene.json").write_text("{"), "scene.json is damaged"),
        (lambda folder: (folder / "scene.json").write_text(BRIGHT), "out of range"),
    ],
)
def test_damaged_scenes_are_refused(damaged, damage, words):
    damage(damaged)
    with pytest.raises(InputError, match=words):
        load_scene(damaged)


@pytest.mark.parametrize("name", ["sparse/0/points3D.bin", "images/view_003.png", "ground_truth.npz"])
def test_one_flipped_bit_of_a_built_scene_is_refused(torus_scene, tmp_path, name):
    shutil.copytree(torus_scene, tmp_path / "flipped")
    file = tmp_path / "flipped" / name
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    for read in (load_scene, lambda folder: build_scene(make_shape("torus"), SMALL, folder)):
        with pytest.raises(InputError, match=f"{name} is not as it was built"):
            read(tmp_path / "flipped")


TINY = ["--views", "3", "--size", "16", "--points", "50", "--supersample", "1"]


def test_the_verb_makes_a_scene_of_a_shape_and_of_a_mesh_file(tmp_path, capsys):
    words = ["--shape", "cube", "--out", str(tmp_path / "a cube"), "--background", "black"]
    assert main(["scene", *words, *TINY]) == 0
    printed, progress = capsys.readouterr()
    assert "cube (12 triangles" in printed and "3 views" in printed and progress == ""  # no terminal
    assert printed.endswith(f"next: python -m paper_artifact train --scene '{tmp_path / 'a cube'}'\n")
    assert load_scene(tmp_path / "a cube").background.tolist() == [0, 0, 0]
    mesh = tmp_path / "pyramid.off"
    mesh.write_text("OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")
    assert main(["scene", "--mesh", str(mesh), "--out", str(tmp_path / "pyramid"), *TINY]) == 0
    kept = load_npz(tmp_path / "pyramid" / "ground_truth.npz")
    assert (kept["name"].item(), kept["betti"].size, len(kept["faces"])) == ("pyramid", 0, 4)


def test_the_verb_refuses_bad_usage_and_bad_input(tmp_path, capsys):
    with pytest.raises(SystemExit) as refused:
        main(["scene", "--shape", "cube"])
    assert refused.value.code == 2 and "required: --out" in capsys.readouterr().err
    out = ["--out", str(tmp_path / "x")]
    for words in ([], ["--shape", "cube", "--mesh", "a.obj"]):
        assert main(["scene", *words, *out]) == 2
        assert "give one of --shape NAME, --mesh FILE and --transforms" in capsys.readouterr().err
    assert main(["scene", "--shape", "klein_bottle", *out]) == 1
    assert "unknown shape" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_the_mesh_hash_sees_geometry_and_not_the_name():
    cube = make_shape("cube")
    assert mesh_hash(cube) == mesh_hash(Mesh(cube.vertices, cube.faces, "other"))
    assert mesh_hash(cube) != mesh_hash(Mesh(cube.vertices * 2, cube.faces, "cube"))
