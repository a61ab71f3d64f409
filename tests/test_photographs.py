"""Photographs become a scene: by real structure from motion where pycolmap is, and clear words where they do
not."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.cli import main
from paper_artifact.files import REPOSITORY
from paper_artifact.mesh import load_mesh
from paper_artifact.photos.pictures import (
    evened,
    fitted_exposures,
    photographs_in,
    prepared,
    size_doubts,
    to_shown,
    unread,
)
from paper_artifact.photos.register import Registered, _stage
from paper_artifact.photos.scene import _of_one_size, doubts, empty_colour, upright, useless
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import fibonacci_cameras
from paper_artifact.scene.colmap import Intrinsics, Model, Pose, read_model
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.shapes import make_shape

MUG = REPOSITORY / "data_scripts" / "mug"


def noise(folder, count):
    folder.mkdir()
    for index in range(count):
        pixels = stream(index, "noise").integers(0, 256, (48, 64, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"{index}.jpg")
    return folder


def mug(index):
    """Return one of the mug's photographs."""
    with Image.open(MUG / "photographs" / f"mug_{index:02d}.jpg") as picture:
        return picture.convert("RGB")


def photos(folder, *words):
    """Make a scene in folder/scene of the photographs in folder/photos; return the exit code."""
    return main(["photos", str(folder / "photos"), f"--out={folder / 'scene'}", *words])


def model_of(cameras, points):
    return Model(
        cameras={
            i: Intrinsics("PINHOLE", c.width, c.height, (c.focal_x, c.focal_y, c.centre_x, c.centre_y))
            for i, c in enumerate(cameras)
        },
        images={i: Pose(f"{i}.png", i, c.quaternion, c.translation) for i, c in enumerate(cameras)},
        point_ids=np.arange(len(points)),
        positions=points,
        colours=np.zeros((len(points), 3), np.uint8),
        errors=np.zeros(len(points)),
    )


def centres_off(scene):
    """How far distances between consecutive cameras of the mug are from the true ones, up to one scale."""
    true = json.loads((MUG / "cameras.json").read_text())["centres"]
    truth = np.diff([true[name] for name in scene.names], axis=0)
    ratios = np.linalg.norm(np.diff(scene.camera_centres, axis=0), axis=1) / np.linalg.norm(truth, axis=1)
    return ratios.std() / ratios.mean()


def test_eight_photographs_of_the_mug_register_and_make_a_scene(tmp_path, capsys, monkeypatch):
    colmap, seen = pytest.importorskip("pycolmap"), {}

    def watch(name):
        real = getattr(colmap, name)

        def call(*arguments, **words):
            seen[name] = words
            return real(*arguments, **words)

        monkeypatch.setattr(colmap, name, call)

    for name in ("match_exhaustive", "incremental_mapping"):
        watch(name)
    (tmp_path / "photos").mkdir()
    for index in range(30, 38):  # of the upper ring
        shutil.copy(MUG / "photographs" / f"mug_{index:02d}.jpg", tmp_path / "photos")
    pixels = stream(0, "noise").integers(0, 256, (450, 600, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "photos" / "z.png")
    assert photos(tmp_path, "--size=200", "--quiet") == 0
    told = capsys.readouterr()
    assert "8 photographs registered" in told.out and "8 of 9 photographs registered, not z.jpg" in told.err
    options = seen["incremental_mapping"]["options"]  # every random choice is seeded
    assert seen["match_exhaustive"]["verification_options"].ransac.random_seed == 0
    assert options.random_seed == options.mapper.random_seed == options.triangulation.random_seed == 0
    assert options.num_threads == options.mapper.num_threads == 1
    scene = load_scene(tmp_path / "scene")
    assert len(scene.names) == 8 and max(scene.images.shape[2:]) == 200 and len(scene.points) > 500
    assert not list(tmp_path.glob(".paper_artifact-partial-*"))
    facts = json.loads((tmp_path / "scene" / "scene.json").read_text())
    assert np.allclose(facts["background"], 0.72, atol=0.1)  # the grey room
    assert centres_off(scene) < 0.03  # the cameras stand as they truly stood
    assert b"Processing block" in (tmp_path / "scene" / "colmap.log").read_bytes() and "I2" not in told.err
    assert "nothing ran" not in told.out and photos(tmp_path, "--size=200", "--quiet") == 0
    assert capsys.readouterr().out.startswith("nothing ran: the scene of these photographs is there already")
    assert photos(tmp_path, "--size=200", "--quiet", "--features=500") == 1
    assert "holds a scene of other" in capsys.readouterr().err


def test_upright_and_level_photographs_of_two_cameras_make_a_scene_of_one_size(tmp_path, capsys):
    pytest.importorskip("pycolmap")
    (tmp_path / "photos").mkdir()
    for index in range(30, 38):
        picture = mug(index)
        if index in (31, 34, 36):  # on their side, as an upright phone's software leaves them
            picture = picture.transpose(Image.Transpose.ROTATE_270)
        if index in (32, 35):  # of another camera, wider and with fewer pixels
            picture = picture.crop((0, 50, 600, 400)).resize((420, 245), Image.Resampling.LANCZOS)
        picture.save(tmp_path / "photos" / f"mug_{index}.jpg", quality=95)
    assert photos(tmp_path, "--size=200", "--quiet", "--features=420") == 0
    assert "8 photographs registered" in capsys.readouterr().out
    scene = load_scene(tmp_path / "scene")
    assert scene.images.shape[0] == 8 and scene.images.shape[3] > 1.6 * scene.images.shape[2] > 160
    assert centres_off(scene) < 0.03


def test_photographs_are_turned_to_one_format_and_up_is_known(tmp_path):
    picture = np.zeros((30, 40, 3), np.uint8)
    picture[:10] = 255  # bright on top
    exif = Image.Exif()
    turns = {1: 0, 3: 2, 6: 1, 8: 3}  # quarters, counter-clockwise, from how it stands to how it is stored
    (tmp_path / "in").mkdir()
    for tag, turn in turns.items():
        exif[ExifTags.Base.Orientation] = tag
        for kind, shown in (("level", picture), ("tall", np.pad(picture[:, :24], ((0, 4), (0, 0), (0, 0))))):
            for ending in ("png", "tif"):  # PIL turns the second when it is read
                file = tmp_path / "in" / f"{kind}{tag}_{ending}.{ending}"
                Image.fromarray(np.rot90(shown, turn)).save(file, exif=exif)
    Image.fromarray(picture).save(tmp_path / "in" / "plain.png")
    ready = prepared(photographs_in(tmp_path / "in"), tmp_path / "out", tmp_path / "masks", 100, False)
    assert sum(ready.groups, []) and ready.sizes == {(40, 30): 9, (34, 24): 8}
    assert {len(group) for group in ready.groups} == {9, 8}
    for name, (x, y) in ready.up.items():
        with Image.open(tmp_path / "out" / name) as stored:
            assert stored.width > stored.height and stored.getexif().get(ExifTags.Base.Orientation) is None
            light = np.asarray(stored.convert("L"), float)
        row, column = (np.average(index, weights=light) for index in np.indices(light.shape))
        towards = np.array([column / light.shape[1], row / light.shape[0]]) - 0.5
        assert towards @ (x, y) > 0.2 and abs(towards @ (y, -x)) < 0.05, name


def test_cut_outs_in_sub_folders_keep_their_masks(tmp_path, capsys):
    pytest.importorskip("pycolmap")
    for index in range(30, 38):
        folder = tmp_path / "photos" / ("upper" if index % 2 else ".") / f"ring_{index % 2}"
        folder.mkdir(parents=True, exist_ok=True)
        picture = mug(index)
        alpha = Image.new("L", picture.size, 255)
        alpha.paste(0, (0, 0, picture.width, picture.height // 5))
        if index != 30:
            picture.putalpha(alpha)
        picture.save(folder / f"mug_{index}.png")
    assert photos(tmp_path, "--size=200") == 0
    told = capsys.readouterr()
    assert "8 photographs registered" in told.out and told.err == "", "bars are silent without a terminal"
    scene = load_scene(tmp_path / "scene")
    assert scene.names[0] == "ring_0_mug_30.jpg" and scene.names[4] == "upper_ring_1_mug_31.jpg"
    assert (scene.background == 1).all()
    above = scene.images[:, :, : scene.images.shape[2] // 6]
    assert (above[1:] > 250).all() and above[0].min() < 250 and scene.images.min() < 100


def test_all_files_that_are_no_photographs_are_named_at_once(tmp_path, capsys):
    folder = noise(tmp_path / "photos", 3)
    (folder / "text.jpg").write_text("no picture")
    whole = (folder / "0.jpg").read_bytes()
    (folder / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    assert photos(tmp_path, "--quiet") == 1
    told = capsys.readouterr().err
    assert "2 of 5 files are no photographs" in told and "text.jpg is no image of the kinds PNG" in told
    assert "cut.jpg is damaged" in told and len(told.splitlines()) == 1


def test_large_tags_are_dropped_and_the_camera_is_kept(tmp_path):
    (tmp_path / "in").mkdir()
    exif = Image.Exif()
    exif[ExifTags.Base.Model] = "M" * 70_000
    exif[ExifTags.Base.ImageDescription] = "x" * 70_000
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = 4.25
    picture = Image.fromarray(stream(0, "noise").integers(0, 256, (48, 64, 3), np.uint8))
    picture.save(tmp_path / "in" / "a.png", exif=exif)
    picture.save(tmp_path / "in" / "b.tif", tiffinfo={65000: "p" * 200_000, 272: "Camera"})
    Image.new("RGB", (64, 48), (9, 9, 9)).save(tmp_path / "in" / "c.png")
    ready = prepared(photographs_in(tmp_path / "in"), tmp_path / "out", tmp_path / "masks", 100, False)
    assert sorted(map(tuple, ready.groups)) == [("a.jpg",), ("b.jpg",), ("c.jpg",)]
    with Image.open(tmp_path / "out" / "a.jpg") as kept:
        tags = kept.getexif()
        assert tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] == 4.25
        assert tags[ExifTags.Base.Model] == "M" * 100 and ExifTags.Base.ImageDescription not in tags
    assert useless(ready.blank, {"a": "1", "b": "2", "c": "1"}) == [
        "c.jpg is of a single colour and shows nothing; leave it out",
        "c and a are the same photograph; leave one out",
    ]


def test_a_terminated_registration_prints_no_stack(tmp_path):
    pytest.importorskip("pycolmap")
    code = "import os\nfrom paper_artifact.photos.register import need_pycolmap\nneed_pycolmap()\n"
    code += "os.kill(os.getpid(), 15)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, cwd=REPOSITORY)
    assert (ended.returncode, ended.stderr) == (-signal.SIGTERM, b"")


def test_sizes_that_have_little_in_common_are_told():
    assert size_doubts({(4000, 3000): 9, (4000, 2250): 3}, 800) == []
    (told,) = size_doubts({(4000, 3000): 9, (400, 300): 1}, 800)
    assert "4000×3000 (9), 400×300 (1), of which about 400×300 is common" in told


def test_photographs_of_nothing_say_how_many_registered_and_what_to_try(tmp_path, capsys):
    pytest.importorskip("pycolmap")
    noise(tmp_path / "photos", 3)
    assert photos(tmp_path, "--quiet") == 1
    told = capsys.readouterr().err
    assert "0 of 3 photographs register" in told and "overlapping" in told
    assert not (tmp_path / "scene").exists() and not list(tmp_path.glob(".paper_artifact-partial-*"))


def test_without_pycolmap_it_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    noise(tmp_path / "photos", 3)
    assert photos(tmp_path) == 1
    assert "pip install '.[photos]'" in capsys.readouterr().err


def test_folders_that_hold_too_little(tmp_path, capsys):
    folder = noise(tmp_path / "photos", 2)
    (folder / "c.HEIC").write_bytes(b"x")

    def refused(*words):
        assert photos(tmp_path, *words) == (2 if words else 1)
        return capsys.readouterr().err

    assert unread(folder) == ["1 file (.heic) not read; convert to JPEG"]
    (folder / "dense").mkdir()
    for name in ("masks", "dense/images"):
        noise(folder / name, 4)
    assert "left out as copies or masks: dense, masks; give such a folder by itself" in refused()
    assert "has 2 photographs" in refused() and "it also has .heic; convert" in refused()
    assert "--size must be from 64" in refused("--size", "9")
    for name in ("one.png", "one.bmp"):
        Image.new("RGB", (64, 48)).save(folder / name)
    assert "two photographs called one" in refused()
    (folder / "one.bmp").rename(folder / os.fsdecode(b"m\xe9g.bmp"))
    assert "még" in photographs_in(folder)
    folder.rename(tmp_path / "elsewhere")
    assert "no folder and no video file at" in refused()


def test_doubts_are_told():
    names = [f"{index}.jpg" for index in range(9)]
    good = Registered(MUG, MUG, tuple(names), 4000, 0.5, 5.0, {})
    assert doubts(good, names) == []
    told = doubts(good._replace(names=tuple(names[:2]), points=20, error=2.0), names)
    assert [line.split(" ")[0] for line in told] == ["2", "the", "the"] and "5.jpg, 6.jpg …" in told[0]


def test_the_scene_stands_upright_and_looks_the_same():
    cameras = fibonacci_cameras(make_shape("sphere"), 9, 40)[2:7]
    turn = Rotation.from_euler("xyz", [100, 20, -50], degrees=True)
    points = stream(0, "points").normal(size=(30, 3))
    true = model_of(cameras, points)

    def posed(index, rotation, **changes):
        quaternion = tuple(rotation.as_quat(scalar_first=True))
        return replace(true.images[index], quaternion=quaternion, **changes)

    rotations = [Rotation.from_matrix(camera.rotation) * turn.inv() for camera in cameras]
    poses = {index: posed(index, rotation) for index, rotation in enumerate(rotations)}
    bent = replace(true, images=poses, positions=turn.apply(points))
    side = Rotation.from_euler("z", -90, degrees=True)  # one picture lies on its side, its top to the left
    first = posed(0, side * rotations[0], translation=tuple(side.apply(true.images[0].translation)))
    lying = replace(bent, images=poses | {0: first})
    told, turned = upright(lying, {"0.png": (-1.0, 0.0)}), upright(bent)
    assert np.allclose(told.positions, turned.positions)
    assert not np.allclose(upright(lying).positions, turned.positions, atol=0.1)
    up = sum(-turned.camera(index).rotation[1] for index in turned.images)
    assert np.allclose(up[:2], 0, atol=1e-9) and up[2] > 0
    for index in true.images:
        cameras = [(each.camera(index), each.positions) for each in (turned, true)]
        assert np.allclose(*(c.rotation @ p.T + np.array(c.translation)[:, None] for c, p in cameras))


def test_pictures_of_several_sizes_are_cropped_and_the_empty_part_is_found(tmp_path):
    cameras = list(fibonacci_cameras(make_shape("sphere"), 6, 96)[1:4])
    points = 0.2 * stream(0, "points").normal(size=(400, 3))  # amid the picture
    model = model_of(cameras, points)
    wide = model.cameras[0]
    model.cameras[0] = Intrinsics("PINHOLE", 104, 100, (*wide.parameters[:2], 52.0, 50.0))
    (tmp_path / "in").mkdir(), (tmp_path / "out").mkdir()
    for index, camera in model.cameras.items():
        pixels = np.full((camera.height, camera.width, 3), (20, 120, 220), np.uint8)
        middle = slice(camera.height // 2 - 20, camera.height // 2 + 20)
        pixels[middle, camera.width // 2 - 20 : camera.width // 2 + 20] = 255
        Image.fromarray(pixels).save(tmp_path / "in" / f"{index}.png")
    cropped, small = _of_one_size(model, tmp_path / "in", tmp_path / "out", {})
    assert {(c.width, c.height) for c in cropped.cameras.values()} == {(96, 96)}
    assert cropped.cameras[0].parameters[2:] == (48.0, 48.0)
    pictures = [np.asarray(Image.open(tmp_path / "out" / f"{index}.png")) for index in range(3)]
    assert all((each == pictures[1]).all() for each in pictures)
    assert np.allclose(empty_colour(cropped, small), np.array((20, 120, 220)) / 255, atol=0.01)


def test_a_smaller_size_is_scaled_to_before_it_is_cropped(tmp_path):
    cameras = list(fibonacci_cameras(make_shape("sphere"), 6, 96)[1:3])
    model = model_of(cameras, stream(0, "points").normal(size=(9, 3)))
    (tmp_path / "in").mkdir(), (tmp_path / "out").mkdir()
    focal = model.cameras[0].parameters[0]
    model.cameras[0] = Intrinsics("PINHOLE", 200, 160, (focal, 2 * focal, 100.0, 80.0))
    ramp = np.linspace(0, 240, 200).astype(np.uint8)[None, :, None]
    Image.fromarray(np.broadcast_to(ramp, (160, 200, 3)).copy()).save(tmp_path / "in" / "0.png")
    Image.new("RGB", (96, 96)).save(tmp_path / "in" / "1.png")
    made, _ = _of_one_size(model, tmp_path / "in", tmp_path / "out", {})
    # 200×160 → 120×96 → the middle 96 columns: .6 of every length, 12 columns less.
    assert np.allclose(made.cameras[0].parameters, (0.6 * focal, 1.2 * focal, 48.0, 48.0))
    assert made.cameras[1] == model.cameras[1]
    row = np.asarray(Image.open(tmp_path / "out" / "0.png"), float)[48, :, 0]
    assert np.allclose(row, 240 * ((np.arange(96) + 0.5 + 12) / 0.6 - 0.5) / 199, atol=1.5)


def test_exposures_are_found_and_evened_out(tmp_path):
    draws = stream(0, "exposures")
    light, true = draws.uniform(0.05, 0.3, 500), np.array([0.6, 1.0, 1.3, 2.0])
    true = true / np.exp(np.log(true).mean())
    pairs = []
    for exposure in true:
        seen = draws.permutation(500)[:200]
        values = exposure * light[seen] * np.exp(0.05 * draws.normal(size=200))
        values[:10] = draws.uniform(0, 1, 10)  # a moving thing, a highlight
        pairs.append((seen, values))
    found = fitted_exposures(pairs)
    assert np.allclose(found, true, rtol=0.03)
    scene = draws.uniform(0.05, 0.4, (40, 40, 1)) * np.ones(3)
    scene = np.kron(scene[::8, ::8], np.ones((8, 8, 1)))
    for exposure in true:
        picture = Image.fromarray(np.rint(255 * to_shown(scene * exposure)).astype(np.uint8))
        shown = np.asarray(evened(picture, exposure), float) / 255
        assert np.abs(shown - to_shown(scene)).max() < 0.01


def test_the_committed_model_of_the_mug_is_read():
    model = read_model(MUG / "sparse" / "0")
    true = json.loads((MUG / "cameras.json").read_text())["centres"]
    assert {pose.name for pose in model.images.values()} <= set(true) and len(model.images) >= 40


def test_the_mugs_ground_truth_is_one_closed_surface_of_genus_one():
    certificate = certify_mesh(load_mesh(MUG / "mug.ply"))
    assert certificate.betti == (1, 2, 1) and certificate.open_edges == 0
    size = sum(file.stat().st_size for file in MUG.rglob("*") if file.is_file())
    assert size < 3e6


def test_a_scene_made_of_the_photographs_is_no_photograph(tmp_path):
    for place in ("", "more", "scene/images"):
        (tmp_path / place).mkdir(parents=True, exist_ok=True)
        for index in range(3):
            (tmp_path / place / f"{index}.jpg").touch()
    (tmp_path / "scene" / "scene.json").write_text("{}")
    assert sorted(photographs_in(tmp_path)) == ["0", "1", "2", "more_0", "more_1", "more_2"]
    assert len(photographs_in(tmp_path / "scene")) == 3


def test_a_stage_that_is_stopped_ends_its_block_and_a_second_stop_ends_the_process(capsys, monkeypatch):
    class Token(threading.Event):
        cancel = threading.Event.set

    token, stop = SimpleNamespace(CancellationToken=Token), Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr("paper_artifact.photos.register.need_pycolmap", lambda: token)
    before, seen = signal.getsignal(signal.SIGINT), []
    note = lambda token: seen.append((token.wait(60), signal.getsignal(signal.SIGINT)))  # noqa: E731
    with pytest.raises(KeyboardInterrupt):
        _stage(("matching", "block", 1), note, stop, False)
    assert seen == [(True, signal.SIG_DFL)] and signal.getsignal(signal.SIGINT) == before
    assert "matching stops after its present block; Ctrl-C again" in capsys.readouterr().err
