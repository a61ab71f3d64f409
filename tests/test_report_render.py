"""The flat renders: framing, shading on both sides, what hides what."""

import numpy as np
import pytest

from paper_artifact.errors import InputError
from paper_artifact.export.flat import AMBIENT, CUT, LIGHT, MARGIN, MATERIAL, render_flat
from paper_artifact.scene.shapes import make_shape

SQUARE = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], dtype=float)  # in the plane y = 0
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def inked(image):
    return np.flatnonzero((image < 1).any(axis=(1, 2))), np.flatnonzero((image < 1).any(axis=(0, 2)))


def test_a_sphere_fills_the_image_whatever_its_place_and_size():
    sphere = make_shape("sphere")
    places = sphere.vertices, 7 * sphere.vertices + (40, -3, 9)
    images = [render_flat(vertices, sphere.faces, 100) for vertices in places]
    for image in images:
        rows, columns = inked(image)
        assert len(rows) == pytest.approx(100 / MARGIN, abs=2)
        assert len(columns) == pytest.approx(100 / MARGIN, abs=2)
        assert rows[0] + rows[-1] == pytest.approx(99, abs=1)
        assert columns[0] + columns[-1] == pytest.approx(99, abs=1)
    assert abs(images[0] - images[1]).mean() < 1e-3


def test_the_colour_is_lambert_s_on_both_sides():
    light = -LIGHT[2] / np.linalg.norm(LIGHT)  # cosine to a face that looks straight at the camera
    wanted = np.array(MATERIAL) * (AMBIENT + (1 - AMBIENT) * light)
    for faces in (FACES, FACES[:, ::-1]):
        for direction in ((0, -1, 0), (0, 5, 0)):
            centre = render_flat(SQUARE, faces, 32, direction=direction)[16, 16]
            assert centre == pytest.approx(wanted, abs=1e-5)


def test_the_inside_has_its_own_colour():
    seen = [render_flat(SQUARE, FACES, 16, direction=(0, y, 0), inside=CUT)[8, 8] for y in (-1, 1)]
    assert seen[1] == pytest.approx(CUT, abs=1e-6) and abs(seen[0] - seen[1]).max() > 0.1


def test_the_nearer_triangle_hides_the_farther_and_keeps_its_own_material():
    both = np.concatenate([SQUARE, SQUARE * 0.3 - [0, 0.5, 0]])
    material = np.repeat([[1.0, 0, 0], [0, 1.0, 0]], 2, axis=0)
    faces = np.concatenate([FACES, FACES + 4])
    image = render_flat(both, faces, 64, direction=(0, -1, 0), material=material)
    assert image[32, 32, 0] == 0 and image[32, 32, 1] > 0.3, "the small green square is in front"
    assert image[6, 6, 1] == 0 and image[6, 6, 0] > 0.3


def test_up_and_the_frame():
    tall = SQUARE * [1, 1, 3]
    rows, columns = inked(render_flat(tall, FACES, 60, direction=(0, -1, 0)))
    assert len(rows) > 2.5 * len(columns)
    rows, columns = inked(render_flat(tall, FACES, 60, direction=(0, -1, 0), up=(1, 0, 0)))
    assert len(columns) > 2.5 * len(rows)
    rows, _ = inked(render_flat(SQUARE, FACES, 60, direction=(0, -1, 0), frame=tall))
    assert len(rows) == pytest.approx(60 / MARGIN / 3, abs=2)


def test_the_upper_end_is_up_and_the_right_end_right():
    corner = np.array([[0.8, 0, 0.8], [1, 0, 0.8], [1, 0, 1.0]])
    rows, columns = inked(render_flat(corner, np.array([[0, 1, 2]]), 60, direction=(0, -1, 0), frame=SQUARE))
    assert rows.max() < 15 and columns.min() > 45


@pytest.mark.parametrize(
    "change",
    [
        {"faces": np.zeros((0, 3), int)},
        {"vertices": np.zeros((4, 2))},
        {"vertices": SQUARE * np.nan},
        {"direction": (0, 0, 0)},
        {"direction": (0, 0, 1)},
        {"up": (0, 0, 0)},
        {"size": 0},
    ],
)
def test_what_cannot_be_drawn_is_said(change):
    with pytest.raises(InputError):
        render_flat(**({"vertices": SQUARE, "faces": FACES, "size": 8} | change))
