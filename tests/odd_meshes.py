"""Bad and odd mesh files, as bytes: what is refused, with a word of the sentence, and what is taken."""

import numpy as np
import trimesh

from tests import certify_shapes as shapes
from tests.file_dialects import ply

BALL = trimesh.creation.icosphere(1)
NOISE = np.random.default_rng(7).integers(0, 256, 4096, dtype=np.uint8).tobytes()
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
TETRAHEDRON = CORNERS + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def exported(kind: str) -> bytes:
    data = BALL.export(file_type=kind)
    return data if isinstance(data, bytes) else data.encode()


def obj(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(vertices, dtype=float).tolist()]
    lines += [f"f {' '.join(str(i + 1) for i in face)}\n" for face in np.asarray(faces).tolist()]
    return "".join(lines).encode()


BINARY_STL, BINARY_PLY, OFF, GLB = (exported(kind) for kind in ("stl", "ply", "off", "glb"))
OBJ = obj(BALL.vertices, BALL.faces)
NAN_STL = BINARY_STL[:96] + np.array([np.nan], "<f4").tobytes() + BINARY_STL[100:]

# file name: (content, a word of the sentence)
REFUSED: dict[str, tuple[bytes, str]] = {
    **{f"empty.{kind}": (b"", f"empty.{kind}") for kind in ("obj", "ply", "stl", "off", "glb")},
    **{f"noise.{kind}": (NOISE, f"noise.{kind}") for kind in ("obj", "ply", "stl", "off", "glb")},
    "cut_binary.ply": (BINARY_PLY[: len(BINARY_PLY) // 2], "cut_binary"),
    "cut.off": (OFF[: len(OFF) // 2], "cut off"),
    "cut.glb": (GLB[: len(GLB) // 2], "cut off: it declares"),
    "ply_named.obj": (BINARY_PLY, "ply_named"),
    "obj_named.ply": (OBJ, "PLY"),
    "obj_named.off": (OBJ, "obj_named"),
    "obj_named.stl": (OBJ, "obj_named"),
    "stl_named.glb": (BINARY_STL, "GLB"),
    "glb_named.stl": (GLB, "glb_named"),
    "off_named.obj": (OFF, "off_named"),
    "text.txt": (OBJ, "no mesh format"),
    "picture.png": (b"\x89PNG\r\n\x1a\n" + NOISE, "no mesh format"),
    "no_extension": (OBJ, "no_extension"),
    "points_only.obj": (CORNERS.encode(), "no triangles"),
    "words.obj": (b"these words are no mesh\n" * 9, "no triangles"),
    "flat.obj": (b"v 0 0\nv 1 0\nv 0 1\nv 1 1\nv 2 1\nv 2 2\nf 1 2 3\nf 2 3 4\n", "flat.obj"),
    "letters.obj": (b"v a b c\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "letters.obj"),
    "nan.obj": ((CORNERS + "v nan 0 0\nf 1 2 3\nf 1 2 5\n").encode(), "NaN"),
    "nan.stl": (NAN_STL, "NaN"),
    "infinite.obj": ((CORNERS + "v inf 0 0\nf 1 2 3\nf 1 2 5\n").encode(), "infinite.obj"),
    "far_back.obj": ((CORNERS + "f -1 -2 -9\n").encode(), "far_back.obj"),
    "beyond.ply": (ply(faces=[(0, 1, 9)]), "vertex 9 of 8"),
    "collinear.obj": (b"v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n", "zero area"),
    "stray.obj": (
        (CORNERS + "v 1e38 0 0\nf 1 2 3\nf 1 2 4\nf 1 1 5\nf 2 4 3\nf 1 2 5\n").encode(),
        "next to none",
    ),
    "same_corner.obj": ((CORNERS + "f 1 1 2\nf 2 2 2\n").encode(), "same_corner.obj"),
    "astronomic.obj": (b"v 0 0 0\nv 1e200 0 0\nv 0 1e200 0\nf 1 2 3\n", "too large"),
    "vanishing.obj": (b"v 0 0 0\nv 1e-200 0 0\nv 0 1e-200 0\nf 1 2 3\n", "vanishing.obj"),
}

_ball = shapes.ball()
_shifted = (_ball[0] + (0.7, 0.1, 0.2), _ball[1])

# file name: content
TAKEN: dict[str, bytes] = {
    "one_triangle.obj": obj(np.eye(3), [[0, 1, 2]]),
    "two_triangles.obj": obj(shapes.tetrahedron()[0], [[0, 1, 2], [0, 2, 3]]),
    "tetrahedron.obj": TETRAHEDRON.encode(),
    "UPPER.OBJ": TETRAHEDRON.encode(),
    "duplicate_faces.obj": (TETRAHEDRON + "f 2 3 4\nf 3 4 2\n").encode(),
    "flat_faces.obj": (
        CORNERS + "v 0.5 0 0\nf 1 3 2\nf 1 5 4\nf 5 2 4\nf 1 4 3\nf 2 3 4\nf 1 2 5\n"
    ).encode(),
    "repeated_corner.obj": (TETRAHEDRON + "f 1 1 2\n").encode(),
    "unused_points.obj": (CORNERS + "v 99 99 99\nv -7 0 0\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n").encode(),
    "twelve_sided.obj": obj(
        np.array([[np.cos(a), np.sin(a), 0] for a in np.arange(12) * np.pi / 6]), [list(range(12))]
    ),
    "huge.obj": obj(_ball[0] * 1e12, _ball[1]),
    "tiny.obj": obj(_ball[0] * 1e-12, _ball[1]),
    "far_away.obj": obj(_ball[0] + 1e6, _ball[1]),
    "needle.obj": obj(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1e-7, 0], [0.5, 0, 1e-3]]),
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    ),
    "identical_shells.obj": obj(*shapes.joined(_ball, _ball)),
    "intersecting_shells.obj": obj(*shapes.joined(_ball, _shifted)),
    "nested_shells.obj": obj(*shapes.joined(_ball, shapes.ball(0.5, inwards=True))),
    "inside_out.obj": obj(*shapes.ball(inwards=True)),
    "pinched.obj": obj(*shapes.joined(shapes.tetrahedron(), shapes.tetrahedron(sign=-1))),
    "moebius.obj": obj(*shapes.band(9, twist=True)),
    "klein.obj": obj(*shapes.band(9, twist=True, width=5, closed=True)),
    "many_pieces.obj": obj(*shapes.joined(*[shapes.tetrahedron(2.5 * i) for i in range(30)])),
    "random_soup.obj": obj(np.random.default_rng(2).normal(size=(90, 3)), np.arange(90).reshape(-1, 3)),
    "große Schüssel 鍋 🍲.obj": obj(*_ball),
    "with spaces and 'quotes'.stl": BINARY_STL,
    "ball.glb": GLB,
}

# Taken by the other verbs: float32 cannot hold a shell of size 1 at a distance of a million.
REFUSED_BY_INGEST = {"far_away.obj": "too small beside the coordinates"}
