"""Exports read back by other readers: trimesh for PLY and GLB, Pillow for PNG, and the bytes inside the HTML
view.
"""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.export.flat import sheet, write_png
from paper_artifact.export.models import (
    Triangles,
    mesh_triangles,
    soup_triangles,
    srgb_to_linear,
    write_glb,
    write_ply,
)
from paper_artifact.export.viewer import framing, html_page, scene_viewpoint, up_of
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
from paper_artifact.scene.cameras import look_at, world_to_clip
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup, initial_mlp


def random_triangles(count: int = 40) -> Triangles:
    draws = stream(0, "test export")
    return Triangles(
        draws.normal(size=(count, 3, 3)).astype(np.float32),
        draws.random((count, 3, 3)).astype(np.float32),
        draws.random((count, 3)).astype(np.float32),
    )


def random_soup(blend: float = -30.0) -> Soup:
    draws = stream(1, "test export")
    features = draws.normal(size=(25, 3, 7)).astype(np.float32)
    features[:, :, 3] = blend
    return Soup(
        torch.from_numpy(draws.normal(size=(25, 3, 3)).astype(np.float32)),
        torch.from_numpy(features),
        torch.from_numpy(draws.normal(size=(25, 3)).astype(np.float32)),
        initial_mlp(0),
    )


def test_ply_reads_back(tmp_path):
    triangles = random_triangles()
    write_ply(tmp_path / "soup.ply", triangles)
    assert (tmp_path / "soup.ply").read_bytes().startswith(b"ply\nformat binary_little_endian")
    mesh = trimesh.load_mesh(tmp_path / "soup.ply", process=False)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], triangles.vertices)
    colours = np.asarray(mesh.visual.vertex_colors).reshape(-1, 3, 4) / 255
    np.testing.assert_allclose(colours[..., :3], triangles.colours, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(colours[..., 3], triangles.opacity, atol=0.5 / 255 + 1e-6)


def chunks_of(glb: bytes) -> tuple[dict, bytes]:
    """Return a GLB's JSON and its binary part."""
    begin = 20 + int.from_bytes(glb[12:16], "little")
    return json.loads(glb[20:begin]), glb[begin + 8 :]


def test_glb_reads_back_the_visible_triangles(tmp_path):
    triangles = random_triangles()
    write_glb(tmp_path / "soup.glb", triangles)
    shown = triangles.visible()
    assert 0 < len(shown) < len(triangles)
    scene = trimesh.load_scene(tmp_path / "soup.glb", process=False, maintain_order=True)
    (mesh,) = scene.geometry.values()
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], shown.vertices)
    tree, data = chunks_of((tmp_path / "soup.glb").read_bytes())
    assert tree["materials"][0]["doubleSided"] is True and "KHR_materials_unlit" in tree["extensionsUsed"]
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    stored = np.frombuffer(data, np.uint8, view["byteLength"], view["byteOffset"]).reshape(-1, 4)
    expected = srgb_to_linear(shown.colours).reshape(-1, 3)
    np.testing.assert_allclose(stored[:, :3] / 255, expected, atol=0.5 / 255 + 1e-6)


def test_srgb_curve_end_points():
    linear = srgb_to_linear(np.array([0.0, 0.04045, 0.5, 1.0]))
    np.testing.assert_allclose(linear, [0, 0.04045 / 12.92, 0.21404114, 1], atol=1e-7)


def test_baked_colour_is_the_base_without_blend_and_the_mlp_with_it():
    soup = random_soup(blend=-30.0)
    base = torch.sigmoid(soup.features[..., :3]).numpy()
    np.testing.assert_allclose(soup_triangles(soup).colours, base, atol=1e-6)
    constant = tuple(torch.zeros_like(tensor) for tensor in soup.mlp[:5]) + (torch.tensor([-1.0, 0.0, 2.0]),)
    baked = soup_triangles(replace(random_soup(blend=30.0), mlp=constant)).colours
    expected = np.broadcast_to(1 / (1 + np.exp([1.0, 0.0, -2.0])), baked.shape)
    np.testing.assert_allclose(baked, expected, atol=1e-6)


def test_baked_colour_survives_a_triangle_without_area():
    soup = random_soup(blend=0.0)
    soup.vertices[0] = soup.vertices[0, 0].clone()
    assert np.isfinite(soup_triangles(soup).colours).all()


def data_of(page: str) -> dict:
    """Return what a view holds."""
    return json.loads(re.search(r'type="application/json">(.*?)</script>', page, re.S)[1])


def test_html_holds_the_triangles_and_asks_nothing_of_the_network():
    triangles, truth = random_triangles(), mesh_triangles(Mesh(np.eye(3), np.array([[0, 1, 2]]), "one"))
    text = html_page({"</script> soup": triangles, "ground truth": truth}, "A <b>title</b>")
    assert not re.search(r"https?://|src=|@import|@DATA@|@TITLE@|@BACK@|<a ", text)
    assert "A &lt;b&gt;title" in text and text.count("</script>") == 2
    data = data_of(text)
    assert [part["name"] for part in data["parts"]] == ["</script> soup", "ground truth"]
    shown = triangles.visible()
    stored = np.frombuffer(base64.b64decode(data["parts"][0]["positions"]), "<f4").reshape(-1, 3, 3)
    np.testing.assert_array_equal(stored, shown.vertices)
    colours = np.frombuffer(base64.b64decode(data["parts"][0]["colours"]), np.uint8).reshape(-1, 3, 3)
    np.testing.assert_array_equal(colours, np.rint(shown.colours * 255))
    assert data["radius"] > 0
    linked = html_page({"soup": triangles}, "t", back=('../a"b.html', "← <back>"))
    assert '<a href="../a&#34;b.html">← &lt;back&gt;</a>' in linked


def test_empty_or_diverged_triangles_are_refused(tmp_path):
    triangles = random_triangles()
    clear = replace(triangles, opacity=np.zeros_like(triangles.opacity))
    with pytest.raises(InputError, match="opacity"):
        write_glb(tmp_path / "soup.glb", clear)
    with pytest.raises(InputError, match="not finite"):
        html_page({"soup": replace(triangles, vertices=triangles.vertices * np.nan)}, "t")
    with pytest.raises(InputError, match="at least one"):
        html_page({}, "t")


def test_png_round_trip_and_sheet(tmp_path):
    image = stream(2, "test export").random((5, 7, 3))
    write_png(tmp_path / "view.png", image)
    with Image.open(tmp_path / "view.png") as stored:
        np.testing.assert_allclose(np.asarray(stored) / 255, image, atol=0.5 / 255 + 1e-9)
    page = sheet([[image, image * 0], [image]], gap=2)
    assert page.shape == (12, 16, 3)
    np.testing.assert_allclose(page[7:, :7], image, atol=1e-6)
    assert (page[7:, 7:] == 1).all() and (page[:5, 9:] == 0).all()
    for bad in (image[..., 0], image * np.nan):
        with pytest.raises(InputError):
            write_png(tmp_path / "bad.png", bad)
    with pytest.raises(InputError, match="one shape"):
        sheet([[image, image[1:]]])


def made_scene(cameras, points) -> Scene:
    count = len(cameras)
    return Scene(
        path=Path(),
        names=tuple(map(str, range(count))),
        images=np.zeros((count, 3, 4, 4), dtype=np.uint8),
        world_to_clip=np.stack([world_to_clip(each, 0.01, 100) for each in cameras]).astype(np.float32),
        camera_centres=np.stack([camera.position for camera in cameras]).astype(np.float32),
        background=np.ones(3, dtype=np.float32),
        points=np.asarray(points, dtype=np.float32),
        train=np.arange(1, count),
        holdout=np.arange(1),
    )


def test_a_scene_is_seen_from_its_first_training_camera_upright():
    # Turned so that "down" is world +y, as COLMAP's scenes are: the cameras' own axes say what is up.
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # z up → y down
    cameras = [look_at(np.array(place), np.zeros(3), 40) for place in ((3, 0, 1), (0, 4, 1.0), (-3, 1, 1))]
    rotations = Rotation.from_matrix([each.rotation @ turn.T for each in cameras]).as_quat(scalar_first=True)
    turned = [replace(each, quaternion=tuple(q)) for each, q in zip(cameras, rotations, strict=True)]
    cloud = stream(3, "test export").normal(size=(200, 3)) * 0.1
    for views, up, first in ((cameras, [0, 0, 1], [0, 4, 1]), (turned, [0, -1, 0], [0, -1, 4])):
        seen = scene_viewpoint(made_scene(views, cloud))
        np.testing.assert_allclose(seen.up, up, atol=0.35)  # the mean of three tilted cameras
        np.testing.assert_allclose(seen.eye, first, atol=1e-5)
        np.testing.assert_allclose(seen.target, [0, 0, 0], atol=0.1)


def test_a_cloud_behind_the_camera_and_one_camera_looking_down_give_a_viewpoint_all_the_same():
    camera = look_at(np.array([0.0, 1e-6, 3.0]), np.zeros(3), 40)
    seen = scene_viewpoint(made_scene([camera, camera], np.full((4, 3), 9.0)))
    assert np.isfinite([*seen.eye, *seen.target, *seen.up]).all()
    assert np.linalg.norm(np.cross(seen.up, np.subtract(seen.target, seen.eye))) > 0.1


def test_the_view_opens_where_it_is_told():
    triangles, row = random_triangles(), shape_row("spot")
    given = framing(triangles.vertices.reshape(-1, 3), row.view, row.up)
    plain, shape = (data_of(html_page({"soup": triangles}, "t", each)) for each in (None, given))
    assert plain["up"] == [0, 0, 1] and shape["up"] == list(row.up)
    away = np.subtract(shape["eye"], shape["target"])
    np.testing.assert_allclose(away / np.linalg.norm(away), row.view / np.linalg.norm(row.view), atol=1e-6)
    assert '<input type="checkbox" id="light" checked>' in html_page({"soup": triangles}, "t")


def test_a_title_is_no_template_and_huge_soups_are_written(tmp_path):
    triangles = random_triangles()
    plain = html_page({"soup": triangles}, "x")
    for title in ("@DATA@ {{ data }} </title>", "</script><script>alert(1)</script>"):
        page = html_page({"soup": triangles}, title)
        assert page.count("<script") == 2 and abs(len(page) - len(plain)) < 300
    vertices, opaque = triangles.vertices * np.float32(1e37), np.ones_like(triangles.opacity)
    huge = replace(triangles, vertices=vertices, opacity=opaque)
    assert 1e36 < data_of(html_page({"soup": huge}, "x"))["radius"] < 1e39
    write_ply(tmp_path / "a.ply", huge)
    write_glb(tmp_path / "a.glb", huge)
    for name in ("a.ply", "a.glb"):
        read = trimesh.load(tmp_path / name, force="mesh", process=False)
        np.testing.assert_allclose(read.triangles.max(), huge.vertices.max(), rtol=1e-6)


@pytest.mark.parametrize("file", ["a.obj", "A.GLB", "spot", "a.obj-C0-s0-a16fef.npz", "a.ply", "torus", None])
def test_what_is_upwards(file):
    up = 2 if file in ("a.ply", "torus", None) else 1
    view = framing(np.array([[-1.0, -1, -1], [1, 1, 1]]), up=up_of(file))
    assert view.up[up] == 1 and view.eye[up] > 0.5 and view.target == (0, 0, 0)
