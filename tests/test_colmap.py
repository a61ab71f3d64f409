"""COLMAP models: text ↔ binary round trips, files as COLMAP writes them, damaged files."""

import math
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from paper_artifact.errors import InputError
from paper_artifact.scene.colmap import Intrinsics, Model, Pose, read_model, write_model
from tests.colmap_text import write_text_model

finite, positive, pixels = st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(1, 10**6)
numbers = st.tuples(positive, positive, finite, finite)
pinholes = st.builds(Intrinsics, st.just("PINHOLE"), pixels, pixels, numbers)
simple = st.builds(Intrinsics, st.just("SIMPLE_PINHOLE"), pixels, pixels, st.tuples(positive, finite, finite))
letters = st.characters(categories=("L", "N"), include_characters="_-./ ")
names = st.text(letters, min_size=1, max_size=20).filter(
    lambda name: name == name.strip() and {*name.removeprefix("/").split("/")}.isdisjoint(("", ".", ".."))
)  # "/" and "a/../b" lie outside of the scene and are refused
quaternions = st.tuples(finite, finite, finite, finite).filter(lambda q: math.hypot(*q) > 1e-3)
points = st.tuples(finite, finite, finite, positive, *[st.integers(0, 255)] * 3)


@st.composite
def models(draw) -> Model:
    cameras = draw(st.dictionaries(st.integers(1, 1000), pinholes | simple, min_size=1, max_size=3))
    known, places = st.sampled_from(sorted(cameras)), st.tuples(finite, finite, finite)
    poses = st.builds(Pose, names, known, quaternions, places)
    images = draw(st.dictionaries(st.integers(1, 10**6), poses, max_size=4))
    table = np.array(draw(st.lists(points, max_size=5)), dtype=np.float64).reshape(-1, 7)
    ids = np.arange(len(table)) + draw(st.integers(1, 10**9))
    return Model(cameras, images, ids, table[:, :3], table[:, 4:].astype(np.uint8), table[:, 3])


def assert_equal(first: Model, second: Model) -> None:
    assert first.cameras == second.cameras and first.images == second.images
    for field in ("point_ids", "positions", "colours", "errors"):
        np.testing.assert_array_equal(getattr(first, field), getattr(second, field))


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(models())
def test_text_and_binary_hold_the_same_model_exactly(tmp_path_factory, model):
    folder = tmp_path_factory.mktemp("colmap")
    write_text_model(model, folder / "text")
    from_text = read_model(folder / "text")
    assert_equal(from_text, model)
    write_model(from_text, folder / "binary")
    from_binary = read_model(folder / "binary")
    assert_equal(from_binary, model)
    write_text_model(from_binary, folder / "again")
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        assert (folder / "again" / name).read_text() == (folder / "text" / name).read_text()


TEXT = {
    "cameras.txt": "# Camera list\n1 PINHOLE 640 480 500.5 501.5 320 240\n2 SIMPLE_PINHOLE 64 48 50 32 24\n",
    "images.txt": "# Image list\n# IMAGE_ID, ...\n7 1 0 0 0 0.1 0.2 0.3 1 b photo.png\n10.5 20.5 3 11 12 -1\n"
    "3 0.5 0.5 0.5 0.5 1 2 3 2 a.png\n\n",
    "points3D.txt": "# points\n3 1.5 2.5 3.5 10 20 30 0.25 7 0 3 1\n4 0 0 1 255 0 0 1e-3\n",
}


def write_text(folder, **changed):
    for name, content in (TEXT | {key.replace("_", "."): value for key, value in changed.items()}).items():
        (folder / name).write_text(content)
    return folder


def test_text_as_colmap_writes_it(tmp_path):
    model = read_model(write_text(tmp_path))
    assert model.cameras[2] == Intrinsics("SIMPLE_PINHOLE", 64, 48, (50.0, 32.0, 24.0))
    assert {image: pose.name for image, pose in model.images.items()} == {7: "b photo.png", 3: "a.png"}
    np.testing.assert_array_equal(model.colours, [[10, 20, 30], [255, 0, 0]])
    np.testing.assert_allclose(model.camera(3).rotation, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert (model.camera(3).focal_x, model.camera(3).focal_y, model.camera(7).focal_y) == (50, 50, 501.5)


def test_names_of_numbers_are_no_observations(tmp_path):
    lines = "".join(f"{n} 1 0 0 0 1 2 3 2 {n} of 4\n" for n in range(1, 5))
    model = read_model(write_text(tmp_path, images_txt=lines))
    assert [pose.name for pose in model.images.values()] == [f"{n} of 4" for n in range(1, 5)]
    for between in ("", "\n", "10.5 2.5 -1 3 4 -1\n"):
        lines = "".join(f"{n} 1 0 0 0 1 2 3 2 2024 01 {n}\n{between}" for n in range(1, 5))
        model = read_model(write_text(tmp_path, images_txt=lines))
        assert [pose.name for pose in model.images.values()] == [f"2024 01 {n}" for n in range(1, 5)]


def test_binary_with_observations_and_tracks_as_colmap_writes_it(tmp_path):
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, 640, 480, 500, 501, 320, 240))
    pose = struct.pack("<QI7dI", 1, 5, 1, 0, 0, 0, 1, 2, 3, 1)
    seen = struct.pack("<Qddqddq", 2, 1, 2, 9, 3, 4, -1)
    (tmp_path / "images.bin").write_bytes(pose + b"a.png\0" + seen)
    (tmp_path / "points3D.bin").write_bytes(struct.pack("<QQ3d3BdQii", 1, 9, 1, 2, 3, 4, 5, 6, 0.5, 1, 5, 0))
    model = read_model(tmp_path)
    assert model.images == {5: Pose("a.png", 1, (1, 0, 0, 0), (1, 2, 3))}
    np.testing.assert_array_equal(model.positions, [[1, 2, 3]])


@pytest.mark.parametrize(
    "changed, words",
    [
        ({"cameras_txt": "1 OPENCV 640 480 500 500 320 240 .1 0 0 0\n"}, "OPENCV camera; undistort first"),
        ({"cameras_txt": "1 WIDE_ANGLE 640 480 500\n"}, "WIDE_ANGLE camera; undistort first"),
        ({"cameras_txt": "1 PINHOLE 640 480 500 500 320\n"}, "PINHOLE with 3 parameters"),
        ({"cameras_txt": "1 PINHOLE 640 480 -5 500 320 240\n"}, "damaged"),
        ({"cameras_txt": "hello\n"}, "damaged"),
        ({"images_txt": "1 1 0 0 0 0 0 0 9 a.png\n\n"}, "refers to camera 9"),
        ({"images_txt": "1 1 0 0 0 0 0\n\n"}, "damaged"),
        ({"images_txt": "1 0 0 0 0 0 0 0 1 a.png\n\n"}, "no valid pose"),
        ({"images_txt": "1 nan 0 0 0 0 0 0 1 a.png\n\n"}, "no valid pose"),
        ({"images_txt": "1 1 0 0 0 0 0 0 1 a.png\n\n" * 2}, "the id 1 is there twice"),
        ({"points3D_txt": "1 0 0\n"}, "fewer than 8 values"),
        ({"points3D_txt": "1 0 nan 0 1 1 1 0\n"}, "NaN"),
        ({"points3D_txt": "1 0 0 0 1 1 256 0\n"}, "colour outside"),
    ],
)
def test_damaged_text_is_refused_with_the_file_and_the_reason(tmp_path, changed, words):
    with pytest.raises(InputError, match=words) as refused:
        read_model(write_text(tmp_path, **changed))
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_binary_files_cut_anywhere_are_refused(tmp_path_factory, name, data):
    folder = tmp_path_factory.mktemp("colmap")
    write_model(read_model(write_text(folder)), folder)
    whole = (folder / name).read_bytes()
    (folder / name).write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    with pytest.raises(InputError, match=name):
        read_model(folder)


def test_binary_with_more_bytes_or_absurd_counts_is_refused(tmp_path):
    write_model(read_model(write_text(tmp_path)), tmp_path)
    whole = (tmp_path / "points3D.bin").read_bytes()
    for damaged in (whole + b"\0", struct.pack("<Q", 2**63) + whole[8:], struct.pack("<Q", 2**64 - 1)):
        (tmp_path / "points3D.bin").write_bytes(damaged)
        with pytest.raises(InputError, match="points3D.bin is damaged"):
            read_model(tmp_path)
    for number, name in ((4, "OPENCV"), (13, "a number 13")):  # 13: a model newer than this package
        (tmp_path / "cameras.bin").write_bytes(struct.pack("<QiiQQ8d", 1, 1, number, 640, 480, *[1.0] * 8))
        with pytest.raises(InputError, match=f"{name} camera; undistort first"):
            read_model(tmp_path)


def test_sound_models_of_others(tmp_path):
    expected = read_model(write_text(tmp_path))
    lines = [line for line in TEXT["images.txt"].split("\n") if line and not line.startswith("10.5")]
    for name, content in {
        "images.txt": "\n".join(lines),  # one line per image
        "cameras.txt": TEXT["cameras.txt"].replace("640", "640.0").replace("2 SIMPLE", "2\tSIMPLE"),
        "points3D.txt": TEXT["points3D.txt"].replace("\n", "\r\n"),
    }.items():
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + content.encode())
        assert_equal(read_model(tmp_path), expected)
    bent = "1 OPENCV 640 480 500.5 501.5 320 240 0 0 0 0\n2 SIMPLE_RADIAL 64 48 50 32 24 0\n"
    assert_equal(read_model(write_text(tmp_path, cameras_txt=bent)), expected)
    write_model(expected, tmp_path / "binary")
    (tmp_path / "binary" / "images.bin").unlink()
    (tmp_path / "binary" / "points3D.bin").unlink()
    (tmp_path / "binary" / "images.txt").write_text(TEXT["images.txt"])
    head = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {c}\n" for c in "xyz")
    (tmp_path / "binary" / "points3D.ply").write_text(head + "end_header\n1.5 2.5 3.5\n")
    mixed = read_model(tmp_path / "binary")
    assert mixed.cameras == expected.cameras and mixed.images == expected.images
    np.testing.assert_array_equal(mixed.positions, [[1.5, 2.5, 3.5]])


def test_missing_files_are_named(tmp_path):
    with pytest.raises(InputError, match="no COLMAP file at .*cameras.bin or .txt"):
        read_model(tmp_path)
    write_text(tmp_path)
    (tmp_path / "points3D.txt").unlink()
    with pytest.raises(InputError, match="points3D.bin or .txt"):
        read_model(tmp_path)


def test_a_model_is_parsed_once_and_every_reader_has_a_copy(tmp_path, monkeypatch):
    first = read_model(write_text(tmp_path))
    places = first.positions.copy()
    first.positions[:], first.images[2] = np.nan, first.images[3]
    monkeypatch.setattr("paper_artifact.scene.colmap._points", None)  # parsing again would fail
    second = read_model(tmp_path)
    assert (second.positions == places).all() and sorted(second.images) == [3, 7]


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_a_rig_of_two_cameras_as_pycolmap_writes_it(tmp_path, kind):
    """Beside images lie rigs and frames then; the poses of images are the composed ones."""
    colmap = pytest.importorskip("pycolmap", reason="no wheel here")
    draws, model = np.random.default_rng(0), colmap.Reconstruction()

    def pose() -> object:
        quaternion = draws.normal(size=4)
        return colmap.Rigid3d(
            colmap.Rotation3d(quaternion / np.linalg.norm(quaternion)), draws.normal(size=3)
        )

    rig, sensors = colmap.Rig(rig_id=1), []
    for number in (1, 2):
        sizes = {"width": 40, "height": 30, "params": [50, 51, 20, 15]}
        camera = colmap.Camera(model="PINHOLE", camera_id=number, **sizes)
        model.add_camera(camera)
        sensors.append(camera.sensor_id)
    rig.add_ref_sensor(sensors[0])
    rig.add_sensor(sensors[1], pose())
    model.add_rig(rig)
    for number in (1, 2, 3):
        frame, images = colmap.Frame(frame_id=number, rig_id=1), []
        frame.rig_from_world = pose()
        for camera in (1, 2):
            name, identity = f"eye {camera}/{number}.png", 2 * number + camera
            images.append(colmap.Image(name=name, camera_id=camera, image_id=identity))
            images[-1].frame_id = number
            frame.add_data_id(images[-1].data_id)
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(number)
    (model.write_binary if kind == "binary" else model.write_text)(str(tmp_path))
    assert {path.stem for path in tmp_path.iterdir()} >= {"rigs", "frames", "images"}
    read = {each.name: each for each in read_model(tmp_path).images.values()}
    assert len(read) == 6
    for image in model.images.values():
        own, theirs = read[image.name], image.cam_from_world()
        x, y, z, w = theirs.rotation.quat
        assert own.quaternion == pytest.approx((w, x, y, z), abs=1e-15)
        assert own.translation == pytest.approx(tuple(theirs.translation), abs=1e-15)


def test_a_bent_camera_is_refused_where_an_image_names_it(tmp_path):
    bent = "2 OPENCV 40 30 50 50 20 15 .1 0 0 0\n"
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 40 30 50 50 20 15\n" + bent)
    (tmp_path / "points3D.txt").write_text("1 0 0 0 1 2 3 0\n")
    for camera, name in ((1, "a/0.png"), (2, "b.png")):
        (tmp_path / "images.txt").write_text(f"1 1 0 0 0 0 0 4 {camera} {name}\n")
        if camera == 1:
            model = read_model(tmp_path)
            assert [*model.cameras] == [1] and model.images[1].name == name
    with pytest.raises(InputError, match=r"cameras.txt: camera 2 is a OPENCV camera; undistort first"):
        read_model(tmp_path)
