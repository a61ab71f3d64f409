"""NeRF-style cameras become the same cameras, and a cloud that hugs the object."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from paper_artifact.cli import main
from paper_artifact.errors import InputError
from paper_artifact.scene.cameras import FAR, NEAR, fibonacci_cameras, world_to_clip
from paper_artifact.scene.ground_truth import render_ground_truth
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.scene.transforms import TransformsConfig, read_transforms, transforms_scene

VIEWS, SIZE = 14, 60


@pytest.fixture(scope="module")
def torus():
    return make_shape("torus")


@pytest.fixture(scope="module")
def cameras(torus):
    return fibonacci_cameras(torus, VIEWS, SIZE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, torus, cameras):
    """RGBA views of a torus with a transforms.json, as NeRF's synthetic scenes have them."""
    folder = tmp_path_factory.mktemp("nerf")
    (folder / "train").mkdir()
    frames = []
    for index, camera in enumerate(cameras):
        dark = render_ground_truth(torus, camera, np.zeros(3, np.float32))
        light = render_ground_truth(torus, camera, np.ones(3, np.float32))
        alpha = 1 - (light - dark).mean(2)
        colour = dark / np.maximum(alpha, 1e-6)[..., None]
        rgba = np.rint(255 * np.clip(np.dstack([colour, alpha]), 0, 1)).astype(np.uint8)
        Image.fromarray(rgba).save(folder / "train" / f"r_{index}.png")
        pose = np.eye(4)
        pose[:3, :3] = camera.rotation.T @ np.diag([1.0, -1.0, -1.0])
        pose[:3, 3] = camera.position
        frames.append({"file_path": f"./train/r_{index}", "transform_matrix": pose.tolist()})
    angle = 2 * np.arctan(SIZE / 2 / cameras[0].focal_x)
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    return folder


def changed(folder, **values):
    file = folder / "changed.json"
    file.write_text(json.dumps({**json.loads((folder / "transforms.json").read_text()), **values}))
    return file


def test_the_scene_has_the_cameras_the_images_and_a_cloud_on_the_object(folder, cameras, torus, tmp_path):
    config = TransformsConfig(points=3000)
    scene = load_scene(transforms_scene(folder / "transforms.json", tmp_path / "s", config))
    expected = [world_to_clip(each, NEAR * scene.radius, FAR * scene.radius) for each in cameras]
    assert np.allclose(scene.world_to_clip, expected, atol=2e-4)
    for view, camera in enumerate(cameras):
        truth = render_ground_truth(torus, camera, np.ones(3, np.float32))
        assert np.abs(scene.colours(view) - truth).max() < 0.02
    ring = np.hypot(np.hypot(scene.points[:, 0], scene.points[:, 1]) - 1.0, scene.points[:, 2])
    tube = np.hypot(np.hypot(*torus.vertices[:, :2].T) - 1.0, torus.vertices[:, 2]).max()
    assert len(scene.points) == 3000
    assert 0.7 * tube < np.median(ring) < 1.35 * tube  # few views: the hull is a little larger
    low, high = torus.vertices.min(0) - 0.2, torus.vertices.max(0) + 0.2
    assert ((scene.points > low) & (scene.points < high)).all()


def test_focal_lengths_centres_and_smaller_images(folder, cameras, tmp_path):
    c = cameras[0]
    file = changed(folder, fl_x=2 * c.focal_x, fl_y=2 * c.focal_y, cx=SIZE, cy=SIZE, w=2 * SIZE, h=2 * SIZE)
    camera = read_transforms(file)[0][1]
    assert np.allclose([camera.focal_x, camera.focal_y, camera.centre_x], [c.focal_x, c.focal_y, SIZE / 2])
    config = TransformsConfig(size=30, points=50, cloud="random", views=6)
    scene = load_scene(transforms_scene(file, tmp_path / "small", config))
    assert scene.images.shape == (6, 3, 30, 30) and len(scene.points) == 50
    assert np.allclose(scene.world_to_clip[0, 3], world_to_clip(c, 1, 2)[3], atol=1e-5)


def test_it_is_built_once_and_by_the_command_line(folder, tmp_path, capsys):
    words = ["scene", f"--transforms={folder / 'transforms.json'}", f"--out={tmp_path / 's'}", "--quiet"]
    assert main([*words, "--views", "7", "--points", "60"]) == 0
    told = capsys.readouterr().out
    assert "7 views of at most 400 pixels (1 held out), 60 points" in told
    assert "nothing ran" not in told
    written = (tmp_path / "s" / "images" / "00000.png").stat().st_mtime_ns
    assert main([*words, "--views", "7", "--points", "60"]) == 0
    assert (tmp_path / "s" / "images" / "00000.png").stat().st_mtime_ns == written
    assert "nothing ran: this scene is there already" in capsys.readouterr().out
    assert main([*words, "--views", "8"]) == 1 and "holds a scene of other images" in capsys.readouterr().err
    (tmp_path / "s" / "images" / "00003.png").unlink()
    assert (
        main([*words, "--views", "7", "--points", "60"]) == 1 and "has lost some" in capsys.readouterr().err
    )
    assert main([*words, "--supersample", "2"]) == 2 and "no meaning for images" in capsys.readouterr().err
    assert main(["scene", "--shape", "torus", "--cloud", "hull", "--out", str(tmp_path / "t")]) == 2


def frames(pose=None, *file_paths):
    matrix = np.eye(4) if pose is None else pose
    names = file_paths or ("train/r_0", "train/r_1")
    return {"frames": [{"file_path": name, "transform_matrix": matrix.tolist()} for name in names]}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"k1": -9}, "undistort"),
        ({"camera_angle_x": 0}, "no focal length above 0 of"),
        ({"camera_angle_x": 1e-320}, "are none of a camera of 60 pixels"),
        ({"w": "1e999", "h": "1e999"}, "w of ./train/r_0 is 1e999, which cannot be"),
        ({"w": -60, "h": -60}, "w of ./train/r_0 is -60, which cannot be"),
        ({"cy": True}, "cy of ./train/r_0 is True, which cannot be"),
        ({"frames": []}, "has 0 frames; at least 2 are needed, one of them is held out$"),
        (frames(None, "train/r_0", "./train/r_1", "train/r_1.png"), "r_1.png in 2 frames; keep one"),
        ({"frames": 3}, "damaged or no transforms.json"),
        (frames(None, "train/r_0", "gone"), "2 frames, 1 of them without an image .gone is not there"),
        (frames(None, "train/r_0", "9" * 5000), "cannot be"),
        (frames(np.zeros((4, 4))), "is no pose"),
        (frames(np.diag([1, 1, -1, 1])), "is no pose"),  # but a mirror
        (frames(np.eye(4) + np.eye(4, k=-3)), "if it lists columns, transpose it"),
        (frames(np.eye(4) + np.eye(4, k=1)), "is no pose"),  # but sheared
        (frames(np.eye(4) + np.diag([0.08, 0, 0], k=1)), "is no pose"),  # by five degrees
        ({"white_transparent": True}, "has white_transparent, which is not read"),
        ({"normal_mts_args": {}}, "has normal_mts_args, which is not read; turn its poses into OpenGL's"),
        ({"fix_premult": True}, "has fix_premult, which is not read; divide"),
        ({"ply_file_path": "."}, "names the cloud ., which is not there"),
        ({"cx": 0.5, "cy": 0.5}, "are 0.5, 0.5; give them in pixels"),
        ({"distortion_params": [0, 0, 0, 1, 0, 0]}, "k4 1, which is not read"),
        ({"distortion_params": [0.1, 0, 0.01, 0]}, "has 4 numbers, not the six k1, k2, k3, k4, p1, p2"),
        ({"fl_x": 1e300}, "are none of a camera of 60 pixels"),
        ({"w": 1e-300, "fl_x": 70.0}, "are none of a camera of 60 pixels"),
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model EQUIRECTANGULAR, which is not read"),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0}, "camera_model OPENCV_FISHEYE"),
        ({"is_fisheye": True}, "is_fisheye"),
        ({"camera_type": "ORTHO"}, "camera_type ORTHO, which is not read"),
        ({"skew": 2.5}, "skew 2.5, which is not read"),
        ({"w": 60, "h": 45}, "another aspect"),
        ({"cx": 640.0, "cy": 360.0}, "add w and h"),
        ({"ply_file_path": "gone.ply"}, "the cloud gone.ply, which is not there"),
        ({"ply_file_path": "transforms.json"}, "no PLY file"),
    ],
)
def test_bad_files(folder, tmp_path, values, message):
    with pytest.raises(InputError, match=message):
        transforms_scene(changed(folder, **values), tmp_path / "bad")
    assert not (tmp_path / "bad").exists()


def framed(folder, change):
    content = json.loads((folder / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        change(index, frame)
    return changed(folder, frames=content["frames"])


def test_a_frame_has_its_own_intrinsics(folder, cameras):
    focal = cameras[0].focal_x

    def wider(index, frame):
        frame.update({"fl_x": focal / 2, "fl_y": focal / 3, "cx": 31, "cy": 29} if index % 2 else {})

    views = read_transforms(framed(folder, wider))
    for index, (_, camera, _, _, _) in enumerate(views):
        expected = (focal / 2, focal / 3, 31, 29) if index % 2 else (focal, focal, SIZE / 2, SIZE / 2)
        assert np.allclose((camera.focal_x, camera.focal_y, camera.centre_x, camera.centre_y), expected)
    for values in (
        {"camera_angle_x": None, "camera_angle_y": 2 * np.arctan(SIZE / 2 / focal)},
        {"camera_angle_x": None, "fl_y": focal},
        {"fl_x": 3 * focal, "w": 3 * SIZE, "h": 3 * SIZE},
        {"fl_x": 3 * focal, "h": 3 * SIZE},
    ):
        camera = read_transforms(changed(folder, **values))[0].camera
        assert np.allclose((camera.focal_x, camera.focal_y), focal)


@pytest.mark.parametrize(
    ("root", "own"), [({"fl_y": 70.0}, {"fl_x": 80.0}), ({}, {"camera_angle_y": 0.7, "fl_x": None})]
)
def test_one_axis_of_a_frame_and_the_other_of_all_frames(folder, root, own):
    file = framed(folder, lambda index, frame: frame.update(own if index == 3 else {}))
    file.write_text(json.dumps(json.loads(file.read_text()) | root))
    with pytest.raises(InputError, match=r"r_3 has .* of its own, which leaves one axis"):
        read_transforms(file)


def test_nerfstudios_list_of_distortions_is_read(folder):
    view = read_transforms(changed(folder, distortion_params=[0.1, 0.02, 0.003, 0, 0.01, -0.005]))[0]
    assert view.distortion == (0.1, 0.02, 0.003, 0.01, -0.005)


@pytest.mark.parametrize("k1", [-0.2, 0.2])
def test_distortion_is_taken_out(k1, cameras, tmp_path):
    """A picture bent by pycolmap's OpenCV lens comes back as the pinhole's, but for two interpolations."""
    pycolmap = pytest.importorskip("pycolmap")
    lens, c = {"k1": k1, "k2": 0.05, "p1": 0.01, "p2": -0.005}, cameras[0]
    size = 300
    focal = c.focal_x * size / SIZE
    parameters = [focal, focal, size / 2, size / 2, *lens.values()]
    bent = pycolmap.Camera(model="OPENCV", width=size, height=size, params=parameters)
    u, v = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    rays = bent.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(size, size, 2)

    def pattern(x, y):
        waves = [np.sin(9 * x), np.cos(7 * y), np.sin(5 * (x + y))]
        return np.rint(127 + 120 * np.stack(waves, axis=2)).astype(np.uint8)

    (tmp_path / "images").mkdir()
    for name in ("a", "b"):
        Image.fromarray(pattern(rays[..., 0], rays[..., 1])).save(tmp_path / "images" / f"{name}.png")
    aside = np.linalg.inv([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 3], [0, 0, 0, 1]])
    poses = [frames(pose, f"images/{a}.png")["frames"][0] for pose, a in ((np.eye(4), "a"), (aside, "b"))]
    file = tmp_path / "transforms.json"
    content = {"fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2, "w": size, "h": size}
    file.write_text(json.dumps({**content, **lens, "camera_model": "OPENCV", "frames": poses}))
    config = TransformsConfig(cloud="random", points=20)
    scene = transforms_scene(file, tmp_path / "scene", config)
    camera = read_transforms(file)[0].camera
    zoom = camera.focal_x / focal
    assert zoom == 1 if k1 < 0 else 1 < zoom < 1.3, "a picture bent inwards fills its pinhole picture"
    with Image.open(scene / "images" / "00000.png") as image:
        straight = np.asarray(image).astype(float)
    x, y = (u - camera.centre_x) / camera.focal_x, (v - camera.centre_y) / camera.focal_y
    assert np.abs(straight - pattern(x, y)).max() < 3


def test_names_as_others_write_them_masks_and_a_given_cloud(folder, tmp_path, capsys):
    moved = tmp_path / "my images"
    moved.mkdir()
    for index in range(VIEWS):
        with Image.open(folder / "train" / f"r_{index}.png") as image:
            image.convert("RGB").save(moved / f"r_{index}.PNG")
            image.getchannel("A").point(lambda value: 255 * (value > 25)).save(moved / f"mask_{index}.png")
    spellings = [
        "my%20images/r_{}.png",
        "my images\\r_{}.png",
        "/home/someone/my images/r_{}.jpg",
        "./my images/R_{}",
        "../my images/r_{}.png",
        "my images/gone_{}.png",
    ]
    content = json.loads((folder / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        frame["file_path"] = spellings[index % len(spellings)].format(index)
        frame["mask_path"] = "" if index == 5 else f"my images/mask_{index}.png"
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    file = tmp_path / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + json.dumps(content).encode())
    expected = [f"r_{index}.PNG" for index in range(VIEWS) if index % 6 != 5]
    assert [view.image.name for view in read_transforms(file)] == expected
    assert "2 of 14 frames are left out" in capsys.readouterr().err
    scene = load_scene(transforms_scene(file, tmp_path / "scene", TransformsConfig(points=900)))
    assert np.linalg.norm(scene.points, axis=1).max() < 2, "the masks are the outlines"
    rows = "\n".join(f"{i} 1 2" for i in range(9))
    head = "ply\nformat ascii 1.0\nelement vertex 9\n" + "".join(f"property float {c}\n" for c in "xyz")
    (tmp_path / "cloud.ply").write_text(f"{head}end_header\n{rows}\n")
    file.write_text(json.dumps({**content, "ply_file_path": "./cloud.ply"}))
    scene = load_scene(transforms_scene(file, tmp_path / "with cloud"))
    assert scene.points.tolist() == [[i, 1, 2] for i in range(9)]


def test_images_of_several_sizes(folder, tmp_path):
    with Image.open(folder / "train" / "r_3.png") as image:
        image.crop((0, 0, 60, 40)).save(folder / "train" / "cut.png")

    def cut(index, frame):
        frame["file_path"] = "train/cut" if index == 3 else frame["file_path"]

    with pytest.raises(InputError, match=r"changed.json lists .* sizes, 60×60 \(13\), 60×40 \(1\); scale"):
        transforms_scene(framed(folder, cut), tmp_path / "bad")


def test_outlines_that_contradict_one_another_and_opaque_images(folder, tmp_path):
    Image.new("RGBA", (60, 60)).save(folder / "train" / "clear.png")

    def wrong_poses(index, frame):
        frame["transform_matrix"][2][3] += 4.0 * index

    def a_view_that_shows_nothing(index, frame):
        frame["file_path"] = "train/clear" if index == 3 else frame["file_path"]

    for change in (wrong_poses, a_view_that_shows_nothing):
        with pytest.raises(InputError, match="leave no room"):
            transforms_scene(framed(folder, change), tmp_path / "bad")
    (tmp_path / "train").mkdir()
    for index in range(VIEWS):
        with Image.open(folder / "train" / f"r_{index}.png") as image:
            image.convert("RGB").save(tmp_path / "train" / f"r_{index}.png")
    (tmp_path / "transforms.json").write_text((folder / "transforms.json").read_text())
    with pytest.raises(InputError, match="--cloud random"):
        transforms_scene(tmp_path / "transforms.json", tmp_path / "bad")


def test_a_texture_and_a_cloud_of_one_point_are_refused(folder, tmp_path):
    with pytest.raises(InputError, match="unknown background 'texture'"):
        TransformsConfig(background="texture")
    header = "ply\nformat ascii 1.0\nelement vertex 9\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (folder / "one.ply").write_text(header + "1 2 3\n" * 9)
    with pytest.raises(InputError, match="one.ply has 1 points that can be used; take --cloud random"):
        transforms_scene(changed(folder, ply_file_path="one.ply"), tmp_path / "s")


def test_a_mask_of_instant_ngps_is_refused(folder, tmp_path):
    copied = shutil.copytree(folder, tmp_path / "nerf")
    Image.new("L", (SIZE, SIZE)).save(copied / "train" / "dynamic_mask_r_3.png")
    with pytest.raises(InputError, match=r"dynamic_mask_r_3.png lies beside ./train/r_3 and is not read"):
        read_transforms(copied / "transforms.json")
