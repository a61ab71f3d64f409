"""The verbs evaluate and export on a soup made from a known surface."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from paper_artifact.cli.output import next_command
from paper_artifact.config import GivenConfig, RunConfig
from paper_artifact.record.store import write_record
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.folder import scene_digest
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import Soup, initial_mlp, save_soup
from tests.tiny_run import bare_record

ASKED = "--downscale 2 --background '#102030' --holdout 3"  # what `trained_on_a_scene` was


@pytest.fixture()
def soup_file(tmp_path):
    """The icosphere of radius .95 as a soup of opaque orange triangles, saved as the trainer saves it."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.95)
    vertices = torch.from_numpy(np.asarray(ball.triangles, dtype=np.float32))
    features = torch.zeros(len(vertices), 3, 7)
    features[:, :, 0], features[:, :, 2], features[:, :, 3] = 4.0, -4.0, -30.0
    path = tmp_path / "sphere-C0-s0.npz"
    save_soup(path, Soup(vertices, features, torch.full((len(vertices), 3), 6.0), initial_mlp(0)))
    return path


def test_evaluate_prints_a_table_and_writes_json(soup_file, tmp_path, command):
    out = tmp_path / "dump.json"
    printed = command(f"evaluate {soup_file} --target sphere --samples 3000 --json {out} --quiet").out
    result = json.loads(out.read_text())
    assert result["dimension"] == 2 and result["counts"] == result["target_counts"] == [0, 0, 1]
    # The void dies at the radius: .05 / (2 sqrt 3) lost.
    assert result["bottleneck"][2] == pytest.approx(0.05 / (2 * 3**0.5), rel=0.15)
    assert f"{result['bottleneck'][2]:.5f}" in printed and "<- discriminating" in printed
    rows = [line.split() for line in printed.splitlines()]
    assert ["components", "1", "1"] in [row[:1] + row[2:] for row in rows], "not 0, the number of finite bars"


def test_evaluate_of_a_mesh_file(tmp_path, command):
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.ply")
    said = command(f"evaluate {tmp_path}/ball.ply --target {tmp_path}/ball.ply --samples 2000").out
    assert said.endswith(f"next: python -m paper_artifact certify {tmp_path}/ball.ply\n")


@pytest.mark.parametrize(
    "words, code, reason",
    [
        ("--target klein", 1, "unknown shape"),
        ("--target sphere --samples 2", 2, "at least 4"),
        ("", 2, "give --target SHAPE|MESH, or --scene DIR"),
        ("--target sphere --holdout 3", 2, "--holdout without --scene DIR"),
    ],
)
def test_evaluate_names_bad_input(soup_file, words, code, reason, command):
    assert reason in command(f"evaluate {soup_file} {words}", code=code).err


def test_the_next_command_replaces_no_file(soup_file, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("mesh.ply", "mesh-2.ply"):
        (tmp_path / name).write_text("mine")
    said = command(f"export {soup_file} --formats ply --out e").out
    assert said.splitlines()[-1] == next_command("solidify", soup_file, "--out", "mesh-3.ply")


def test_export_writes_every_format(soup_file, tmp_path, command):
    out, kinds = tmp_path / "exports", ("glb", "html", "ply", "view0.png", "view1.png", "views.png")
    said = command(f"export {soup_file} --out {out} --views 2 --size 48 --target sphere").out
    names = sorted(path.name for path in out.glob("[!.]*"))
    assert names == [f"sphere-C0-s0.{kind}" for kind in kinds]
    *paths, following = said.splitlines()
    assert sorted(path.rsplit("/", 1)[-1] for path in paths) == names
    assert following == next_command("solidify", soup_file, "--target", "sphere", "--out", "mesh.ply")
    with Image.open(out / "sphere-C0-s0.view0.png") as image:
        pixels = np.asarray(image)
    # An orange ball in the middle, the white background in the corner.
    expected = 255 / (1 + np.exp(-np.array([4.0, 0.0, -4.0])))
    np.testing.assert_allclose(pixels[24, 24], expected, atol=1.5)
    assert (pixels[0, 0] == 255).all()
    mesh = trimesh.load_mesh(out / "sphere-C0-s0.ply", process=False)
    assert len(mesh.faces) == 1280 and "ground truth" in (out / "sphere-C0-s0.html").read_text()
    command(f"export {soup_file} --out {out} --formats png --views 1 --size 48")  # one view is gone now
    assert sorted(path.name for path in out.glob("*1.png")) == []
    assert len([*out.glob("[!.]*")]) == len(kinds) - 1


@pytest.fixture()
def trained_on_a_scene(soup_file, tmp_path):
    """A scene, and the soup of a run whose record says how its photographs were read."""
    scene = tmp_path / "ball"
    build_scene(make_shape("sphere"), SceneConfig(views=10, size=48, supersample=1, points=200), scene)
    given = GivenConfig(scene_digest(scene), downscale=2.0, background="#102030", holdout="3")
    record = bare_record(RunConfig("ball", given=given))
    path = write_record(record, tmp_path / "runs")
    (tmp_path / "soups").mkdir()
    return scene, soup_file.rename(tmp_path / "soups" / f"{path.stem}.npz"), path


def test_a_soup_is_evaluated_as_its_run_was_trained(trained_on_a_scene, tmp_path, command):
    scene, soup, record = trained_on_a_scene

    def scores(words=""):
        out = tmp_path / "scores.json"
        told = command(f"evaluate {soup} --scene {scene} --samples 300 --json {out} {words}").err
        images = json.loads(out.read_text())["images"]
        return images["psnr"], images["views"], told

    by_hand, found = scores(ASKED), scores()
    assert found[:2] == by_hand[:2] and by_hand[2] == ""
    told = f"--downscale 2 --background #102030 --holdout 3, as the run was trained ({record}); give others"
    assert found[2].startswith(told) and found[2].count("\n") == 1
    part = scores("--holdout 5 --downscale 1")
    assert part[2].startswith("--background #102030, as the run")
    assert part[:2] == scores("--holdout 5 --downscale 1 --background '#102030'")[:2]
    assert len({found[0], part[0], scores("--background white")[0]}) == 3
    # A record of another scene says nothing of this one.
    Image.linear_gradient("L").resize((48, 48)).save(next((scene / "images").iterdir()))
    (scene / "scene.json").unlink()
    other = scores()
    assert f"{record} is of another scene than {scene}" in other[2]
    record.unlink()
    assert scores() == (other[0], other[1], "")


def test_export_leaves_a_file_alone_that_it_did_not_write(soup_file, tmp_path, command):
    (tmp_path / f"{soup_file.stem}.ply").write_text("precious")
    said = command(f"export {soup_file} --formats ply --out {tmp_path}", code=1).err
    assert "was not written by this command" in said
    assert (tmp_path / f"{soup_file.stem}.ply").read_text() == "precious"
    for _ in range(2):
        command(f"export {soup_file} --formats ply --out {tmp_path}/new")
    other = tmp_path / "other" / soup_file.name
    other.parent.mkdir()
    shutil.copy(soup_file, other)
    said = command(f"export {other} --formats ply --out {tmp_path}/new", code=1).err
    assert "was not written by this command" in said  # but from another soup of this name
    command(f"export {other} --formats ply --out {tmp_path}/other/new")
    moved = other.parent.rename(tmp_path / "moved")
    command(f"export {moved / other.name} --formats ply --out {moved}/new")


@pytest.mark.parametrize(
    "frame",
    [
        {"offset": [0.0, 1.0], "exponent": 0},
        {"offset": [0.0, 1.0, 2.0]},
        {"exponent": 3},
        {"offset": [np.nan, 0.0, 0.0], "exponent": 0},
        {"offset": ["a", "b", "c"], "exponent": 0},
        {"offset": [0.0, 0.0, 0.0], "exponent": 5000},
        {"offset": [0.0, 0.0, 0.0], "exponent": 1.7},
    ],
)
def test_a_soup_with_a_damaged_frame_is_refused(frame, soup_file, tmp_path, command):
    with np.load(soup_file) as data:
        np.savez(soup_file, **data, **frame)
    said = command(f"export {soup_file} --formats ply --out {tmp_path}/out", code=1).err
    assert "the frame (offset, exponent) of the soup" in said


def test_a_soup_is_exported_as_its_run_was_trained(trained_on_a_scene, tmp_path, command):
    scene, soup, _ = trained_on_a_scene
    line = f"export {soup} --scene {scene} --formats png --out {tmp_path}"
    told = command(f"{line}/a")
    *paths, following = told.out.splitlines()
    assert "as the run was trained" in told.err and all(Path(path).is_file() for path in paths)
    assert following == next_command("solidify", soup, "--scene", scene, "--out", "mesh.ply")
    command(f"{line}/b {ASKED}")
    files = [sorted((tmp_path / each).glob("[!.]*")) for each in "ab"]
    assert len(files[0]) == 5  # four held-out views, and all on one sheet
    assert [each.read_bytes() for each in files[0]] == [each.read_bytes() for each in files[1]]
    with Image.open(files[0][0]) as picture:
        assert picture.size == (24, 24)


def test_a_soup_without_extent_has_no_views(soup_file, tmp_path, command):
    data = dict(np.load(soup_file))
    np.savez(tmp_path / "point.npz", **data | {"vertices": 0 * data["vertices"]})
    said = command(f"export {tmp_path / 'point.npz'} --formats png --out {tmp_path / 'new'}", code=1).err
    assert "are all at one point" in said
