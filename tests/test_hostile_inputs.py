"""Files that somebody damaged or made with intent: every reader refuses them in one line that names the file.

The command for many more of the first kind: `python -m tests.fuzz_readers 2000`.
"""

import json
import os
import struct
import zipfile

import numpy as np
import pytest
import trimesh
from PIL import Image

from paper_artifact.archives import LARGEST, load_npz, write_npz
from paper_artifact.errors import InputError, require_disk
from paper_artifact.files import inside
from paper_artifact.mesh import load_mesh
from paper_artifact.photos.pictures import photographs_in, prepared, unread
from paper_artifact.record.store import unpack
from paper_artifact.scene.colmap import Intrinsics, Model, Pose, write_model
from paper_artifact.scene.folder import read_description
from paper_artifact.scene.images import MOST_PIXELS, read_pixels
from paper_artifact.scene.load import load_scene
from tests.file_features import Gltf
from tests.fuzz_readers import fuzz

pytestmark = pytest.mark.faults


def test_two_hundred_mutated_files_are_read_or_refused():
    found = fuzz(200, seed=7)
    assert len(found) == 200
    assert [each for each in found.values() if each[1] not in ("read", "refused")] == []
    assert {"read", "refused"} == {result for _, result in found.values()}


@pytest.mark.parametrize("kind, refused", [("jpg", True), ("png", True), ("webp", True), ("bmp", False)])
def test_pictures_whose_end_is_zeros_were_cut(tmp_path, kind, refused):
    """What a copy leaves that makes room first. Zeros, or a film and zeros, may follow a picture's end."""
    file = tmp_path / f"a.{kind}"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (60, 60, 3), dtype=np.uint8)).save(file)
    whole, data = read_pixels(file, 1.0).colours, file.read_bytes()
    for more in (bytes(4096), b"\xff\xda film" + bytes(4096)):
        file.write_bytes(data + more)
        assert (read_pixels(file, 1.0).colours == whole).all()
    file.write_bytes(data[: len(data) * 9 // 10] + bytes(len(data) - len(data) * 9 // 10))
    if refused:
        with pytest.raises(InputError, match=f"a.{kind} is damaged"):
            read_pixels(file, 1.0)


def test_a_disk_that_photographs_would_fill_is_said_before(tmp_path):
    with pytest.raises(InputError, match=r"MiB left, this may take 1.1e.12; free some space"):
        require_disk(2**60, tmp_path)


def test_photographs_that_are_nowhere_opaque_are_named(tmp_path):
    for name in ("a.png", "b.png"):
        Image.new("RGBA", (40, 30), (9, 90, 200, 200 if name == "a.png" else 255)).save(tmp_path / name)
    with pytest.raises(InputError, match="a.png is nowhere opaque, alpha is at most 200 of 255$"):
        prepared(
            {"a": tmp_path / "a.png", "b": tmp_path / "b.png"}, tmp_path / "p", tmp_path / "m", 64, False
        )


def test_photographs_behind_lost_links_are_told_and_long_names_refused(tmp_path):
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        (tmp_path / name).touch()
    (tmp_path / "d.jpg").symlink_to(tmp_path / "gone.jpg")
    assert set(photographs_in(tmp_path)) == {"a", "b", "c"}
    assert unread(tmp_path) == ["left out, as links that lead nowhere: d.jpg; see to them"]
    (tmp_path / "c.jpg").unlink()
    with pytest.raises(InputError, match="has 2 photographs .* lead nowhere: d.jpg"):
        photographs_in(tmp_path)
    (tmp_path / ("x" * 130)).mkdir()
    (tmp_path / ("x" * 130) / f"{'y' * 130}.jpg").touch()
    with pytest.raises(InputError, match="more than 240 bytes together"):
        photographs_in(tmp_path)


@pytest.fixture
def scene(tmp_path):
    """scene(names) writes a COLMAP scene with these image names; a.png and b.png are there."""

    def write(names=("a.png", "b.png"), size=4):
        poses = {i + 1: Pose(name, 1, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 3.0)) for i, name in enumerate(names)}
        camera = Intrinsics("SIMPLE_PINHOLE", size, size, (4.0, 2.0, 2.0))
        cloud = np.eye(5, 3)
        rgb = np.zeros((5, 3), np.uint8)
        folder = tmp_path / "scene"
        write_model(Model({1: camera}, poses, np.arange(5), cloud, rgb, np.zeros(5)), folder / "sparse" / "0")
        (folder / "images").mkdir()
        for name in ("a.png", "b.png"):
            Image.new("RGB", (4, 4)).save(folder / "images" / name)
        Image.new("RGB", (4, 4)).save(tmp_path / "x.png")
        return folder

    return write


@pytest.mark.parametrize(
    "name", ["../../x.png", "/../x.png", "..\\..\\x.png", "c/../../../x.png", "./a.png", "c//x.png"]
)
def test_image_names_that_lead_out_of_the_scene_are_refused(name, scene):
    with pytest.raises(InputError, match=r"images.bin: image .* lies outside of the scene; export"):
        load_scene(scene(("a.png", name)))


def test_absolute_names_of_another_machine_are_looked_for_by_their_last_parts(scene):
    assert len(load_scene(scene(("a.png", "/home/me/images/b.png"))).names) == 2


@pytest.mark.parametrize("link", ["images/b.png", "images", "sparse/0/points3D.bin", "sparse", "scene.json"])
def test_symbolic_links_out_of_the_scene_are_refused(link, scene, tmp_path):
    folder = scene()
    (folder / "scene.json").write_text(json.dumps({"background": [1, 1, 1], "radius": 1}))
    assert len(load_scene(folder).names) == 2
    (tmp_path / "elsewhere").mkdir()
    os.rename(folder / link, tmp_path / "elsewhere" / "file")
    os.symlink(tmp_path / "elsewhere" / "file", folder / link)
    with pytest.raises(InputError, match="lies outside of it; copy the file into the folder"):
        load_scene(folder)


def test_symbolic_links_that_stay_inside_are_followed_and_loops_are_refused(scene):
    folder = scene(("a.png", "b.png", "c.png"))
    os.symlink(folder / "images" / "a.png", folder / "images" / "c.png")
    assert len(load_scene(folder).names) == 3
    (folder / "images" / "c.png").unlink()
    os.symlink(folder / "images" / "c.png", folder / "images" / "c.png")
    with pytest.raises(InputError, match="c.png"):
        load_scene(folder)
    with pytest.raises(InputError, match="is no path"):
        inside(folder, "a\0b")


def png_of(width: int, height: int) -> bytes:
    """A PNG whose header alone tells its size."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zipfile.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


@pytest.mark.parametrize("side, words", [(20_000, "more than 134 million"), (12_000, "12000×12000 pixels")])
def test_pictures_that_unpack_to_more_than_a_photograph_are_refused(side, words, scene):
    folder = scene()
    assert side**2 > MOST_PIXELS
    (folder / "images" / "a.png").write_bytes(png_of(side, side))
    with pytest.raises(InputError, match=rf"a.png .*{words}"):
        load_scene(folder)


def test_pictures_of_a_kind_that_starts_other_programs_are_not_opened(scene):
    folder = scene()
    (folder / "images" / "a.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 4 4\n%%EOF\n")
    with pytest.raises(InputError, match=r"a.png is no image of the kinds PNG, JPEG"):
        load_scene(folder)


def test_an_archive_with_a_password_is_not_called_damaged(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.ply", "ply")
    data = bytearray(path.read_bytes())
    for head, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(head) + flags] |= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"cannot be unpacked here .*password.*; unpack it and name"):
        load_mesh(path)


def test_archives_that_unpack_without_end_are_refused(tmp_path):
    bomb = tmp_path / "bomb.npz"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("vertices.npy", bytes(1000))
    data = bytearray(bomb.read_bytes())
    place = data.rindex(b"PK\x01\x02") + 24  # the size that the directory gives
    data[place : place + 4] = (LARGEST + 1).to_bytes(4, "little")
    bomb.write_bytes(data)
    with pytest.raises(ValueError, match=f"unpacks to {LARGEST + 1} bytes"):
        load_npz(bomb)
    bomb.rename(tmp_path / "bomb.zip")
    with pytest.raises(InputError, match=r"bomb.zip .*unpacks to"):
        load_mesh(tmp_path / "bomb.zip")
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_LZMA) as archive:  # its reader has no bound
        archive.writestr("vertices.npy", bytes(1000))
    with pytest.raises(ValueError, match="a method that is not read"):
        load_npz(bomb)


def test_an_array_that_claims_more_than_its_file_holds_is_refused(tmp_path):
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 3), }"
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head) + 1) + head + b"\n" + bytes(48)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", array)
    with pytest.raises(ValueError, match="cannot reshape"):
        load_npz(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="pickled"):
        load_npz(tmp_path / "a.npz")


def test_arrays_come_back_as_they_were(tmp_path):
    columns = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    arrays = {"a": columns, "b": np.array("word"), "c": np.zeros((0, 2))}
    write_npz(tmp_path / "a.npz", arrays)
    back = load_npz(tmp_path / "a.npz")
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype and back[name].flags.writeable
        np.testing.assert_array_equal(back[name], array)


@pytest.mark.parametrize(
    "part, place, change, words",
    [
        ("accessors", 1, {"count": 10**10, "bufferView": None}, "names"),
        ("accessors", 1, {"count": 10**10}, "damaged"),
        ("bufferViews", 0, {"byteLength": 10**10}, "damaged"),
        ("buffers", 0, {"uri": "../../../../../../etc/passwd"}, "not in the folder"),
    ],
)
def test_models_that_declare_what_they_do_not_hold(part, place, change, words, tmp_path):
    made = Gltf()
    document = made.document()
    entry = document[part][place] | change
    document[part][place] = {name: value for name, value in entry.items() if value is not None}
    with pytest.raises(InputError, match=rf"cube.glb .*{words}"):
        load_mesh(made.glb(tmp_path, document))


def test_a_buffer_whose_name_is_too_long_is_told_shortly(tmp_path):
    made = Gltf()
    document = made.document()
    document["buffers"][0]["uri"] = "a" * 5000
    with pytest.raises(InputError, match=r"cube.glb") as told:
        load_mesh(made.glb(tmp_path, document))
    assert len(str(told.value)) < 400 + len(str(tmp_path))


def test_a_model_with_more_instances_than_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("paper_artifact.formats.gltf.MOST_FACES", 1000)
    made = Gltf()
    places = [{"mesh": 0, "translation": [2 * n, 0, 0]} for n in range(84)]  # of 12 triangles each
    file = made.glb(tmp_path, made.document(None, [{"children": [*range(1, 85)]}, *places]))
    with pytest.raises(InputError, match=r"cube.glb is damaged .*more than 1000 triangles"):
        load_mesh(file)


def test_a_model_that_is_cut_off_asks_for_no_memory(tmp_path):
    made = Gltf()
    file = made.glb(tmp_path, made.document())
    data = file.read_bytes()
    place = data.index(b"BIN\0") - 4
    file.write_bytes(data[:place] + b"\xff\xff\xff\xff" + data[place + 4 :])
    with pytest.raises(InputError, match=r"cube.glb is damaged .*a chunk is longer than the file"):
        load_mesh(file)


def test_records_that_unpack_without_end_are_refused(monkeypatch):
    monkeypatch.setattr("paper_artifact.record.store.MOST", 20_000)
    nested = {"#same": {"#same": {"#same": 0, "#count": 10**4}, "#count": 10**4}, "#count": 10**4}
    for value in ({"#same": 0, "#count": 10**12}, nested):
        with pytest.raises(ValueError, match="without end"):
            unpack(value)


def test_a_zip_opens_nothing_outside_of_it(tmp_path):
    trimesh.creation.box().export(tmp_path / "box.obj")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.obj")
    for name in (str(tmp_path / "ball.obj"), "../ball.obj"):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.writestr("parts.obj/", "")
            archive.writestr(name, (tmp_path / "box.obj").read_bytes())
        assert len(load_mesh(tmp_path / "a.zip").faces) == 12


def test_a_zip_with_changed_bytes_is_read_whole_or_refused(tmp_path):
    trimesh.creation.icosphere(1).export(tmp_path / "ball.obj")
    packed = tmp_path / "ball.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(tmp_path / "ball.obj", "ball.obj")
    data, whole = packed.read_bytes(), load_mesh(packed).vertices
    refused = 0
    for place in range(len(data)):
        packed.write_bytes(data[:place] + bytes([data[place] ^ 1 << place % 8]) + data[place + 1 :])
        try:
            assert np.array_equal(load_mesh(packed).vertices, whole)
        except InputError:
            refused += 1
    assert refused > len(data) / 2


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("nowhere")])
def test_a_description_of_a_scene_that_is_no_file_is_not_passed_over(tmp_path, make):
    make(tmp_path / "scene.json")
    with pytest.raises(InputError, match=r"cannot read .*scene.json"):
        read_description(tmp_path)
