"""Exports read back by other readers: trimesh for PLY and GLB, Pillow for PNG, and the bytes inside the HTML
view.
"""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from paper_artifact.errors import InputError
from paper_artifact.export.images import sheet, write_png
from paper_artifact.export.models import srgb_to_linear, write_glb, write_ply
from paper_artifact.export.triangles import Triangles, mesh_triangles, soup_triangles
from paper_artifact.export.viewer import html_page, write_html
from paper_artifact.mesh import Mesh
from paper_artifact.randomness import stream
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


def test_glb_reads_back_the_visible_triangles(tmp_path):
    triangles = random_triangles()
    write_glb(tmp_path / "soup.glb", triangles)
    shown = triangles.visible()
    assert 0 < len(shown) < len(triangles)
    scene = trimesh.load_scene(tmp_path / "soup.glb", process=False, maintain_order=True)
    (mesh,) = scene.geometry.values()
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], shown.vertices)
    data = (tmp_path / "soup.glb").read_bytes()
    tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert tree["materials"][0]["doubleSided"] is True and "KHR_materials_unlit" in tree["extensionsUsed"]
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    begin = 28 + int.from_bytes(data[12:16], "little") + view["byteOffset"]
    stored = np.frombuffer(data[begin : begin + view["byteLength"]], np.uint8).reshape(-1, 4)
    np.testing.assert_allclose(
        stored[:, :3] / 255, srgb_to_linear(shown.colours).reshape(-1, 3), atol=0.5 / 255 + 1e-6
    )


def test_srgb_curve_end_points():
    np.testing.assert_allclose(
        srgb_to_linear(np.array([0.0, 0.04045, 0.5, 1.0])), [0, 0.04045 / 12.92, 0.21404114, 1], atol=1e-7
    )


def test_baked_colour_is_the_base_without_blend_and_the_mlp_with_it():
    soup = random_soup(blend=-30.0)
    np.testing.assert_allclose(
        soup_triangles(soup).colours, torch.sigmoid(soup.features[..., :3]).numpy(), atol=1e-6
    )
    constant = tuple(torch.zeros_like(tensor) for tensor in soup.mlp[:5]) + (torch.tensor([-1.0, 0.0, 2.0]),)
    baked = soup_triangles(replace(random_soup(blend=30.0), mlp=constant)).colours
    expected = np.broadcast_to(1 / (1 + np.exp([1.0, 0.0, -2.0])), baked.shape)
    np.testing.assert_allclose(baked, expected, atol=1e-6)


def test_baked_colour_survives_a_triangle_without_area():
    soup = random_soup(blend=0.0)
    soup.vertices[0] = soup.vertices[0, 0].clone()
    assert np.isfinite(soup_triangles(soup).colours).all()


def test_html_holds_the_triangles_and_asks_nothing_of_the_network(tmp_path):
    triangles = random_triangles()
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), "one")
    write_html(
        tmp_path / "view.html",
        {"</script> soup": triangles, "ground truth": mesh_triangles(mesh)},
        "A <b>title</b>",
    )
    text = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|src=|@import|@DATA@|@TITLE@", text)
    assert "A &lt;b&gt;title" in text and text.count("</script>") == 2
    data = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.S).group(1))
    assert [part["name"] for part in data["parts"]] == ["</script> soup", "ground truth"]
    shown = triangles.visible()
    stored = np.frombuffer(base64.b64decode(data["parts"][0]["positions"]), "<f4").reshape(-1, 3, 3)
    np.testing.assert_array_equal(stored, shown.vertices)
    colours = np.frombuffer(base64.b64decode(data["parts"][0]["colours"]), np.uint8).reshape(-1, 3, 3)
    np.testing.assert_array_equal(colours, np.rint(shown.colours * 255))
    assert data["radius"] > 0


def test_empty_or_diverged_triangles_are_refused(tmp_path):
    triangles = random_triangles()
    clear = replace(triangles, opacity=np.zeros_like(triangles.opacity))
    with pytest.raises(InputError, match="opacity"):
        write_glb(tmp_path / "soup.glb", clear)
    with pytest.raises(InputError, match="not finite"):
        html_page({"soup": replace(triangles, vertices=triangles.vertices * np.nan)}, "t")
    with pytest.raises(InputError, match="at least one"):
        html_page({}, "t")
    with pytest.raises(InputError, match="cannot write"):
        write_ply("/proc/no/soup.ply", triangles)


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
