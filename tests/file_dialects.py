"""Mesh files as text and binary: the unit cube in dialects of OBJ, PLY, STL and OFF, sound or damaged."""

import re
import struct
from typing import Any

import numpy as np

POINTS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))])


def lines(rows, first: str = "") -> str:
    """Return numbers as lines of text."""
    return "".join(first + " ".join(f"{x:g}" for x in row) + "\n" for row in rows)


STRIPS = [(0, 1, 2, 3), (6, 7, 4, 5), (4, 5, 0, 1), (2, 3, 6, 7), (4, 0, 6, 2), (1, 5, 3, 7)]
VERTICES, POLYGONS = lines(POINTS, "v "), lines(np.array(QUADS) + 1, "f ")
OBJ = VERTICES + lines(FACES + 1, "f ")
PARTS = "".join(lines(POINTS + [2 * n, 0, 0], "v ") + lines(FACES - 8, "f ") for n in range(3))
# A prism over an L: two concave faces.
ELL = np.array([[0, 0], [1, 0], [1, 0.5], [0.5, 0.5], [0.5, 1], [0, 1]])
SIDES = [(i + 1, (i + 1) % 6 + 1, (i + 1) % 6 + 7, i + 7) for i in range(6)]
ELL_OBJ = "".join(lines(np.insert(ELL, 2, z, axis=1), "v ") for z in (0, 1)) + lines(SIDES, "f ")
STRIP = [each for run in STRIPS for each in (*run, -1)]
MIXED = [tuple(QUADS[0]), tuple(QUADS[1]), *map(tuple, FACES[4:])]


def ply(
    form: str = "ascii", faces=FACES, points: str = lines(POINTS), number: int = 8, element: str = "face",
    size: str = "uchar", head: str = "", end: str = "", data: bytes | None = None,
) -> bytes:  # fmt: skip
    header = f"ply\nformat {form} 1.0\ncomment unit cube\nelement vertex {number}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz") + head
    header += f"element {element} {len(faces)}\nproperty list {size} int vertex_indices\nend_header\n"
    rows = points + lines((len(face), *face) for face in faces) + end
    return header.encode() + (rows.encode() if data is None else data)


def binary(order: str, faces=FACES) -> bytes:
    rows = b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return POINTS.astype(order + "f4").tobytes() + rows


def stl(count: int = 12, head: bytes = b"unit cube", end: bytes = b"", named: int = 12) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *POINTS[face].ravel(), 0) for face in FACES[:count])
    return head.ljust(80) + struct.pack("<I", named) + rows + end


FACETS = "".join(
    f"facet normal 0 0 0\n outer loop\n{lines(POINTS[face], '  vertex ')} endloop\nendfacet\n"
    for face in FACES
)
STL_TEXT = f"solid unit cube\n{FACETS}endsolid unit cube\n".replace(" 1\n", " 1e+00\n")
UNEVEN = re.sub(r"( endloop\n.*\n.*\n.*\n)(  vertex.*\n)", r"\2\1", STL_TEXT, count=1)
OFF = "8 12 0\n" + lines(POINTS) + lines(FACES, "3 ")
SLASHES = OBJ.replace("\nf", "\nvt 0 0\nvn 0 0 1\nf", 1).replace("f 1 ", "f 1/1/1 ")
TWO_LISTS = ply(data=(lines(POINTS) + lines((3, *face, 3, *face) for face in FACES)).encode())
TWO_LISTS = TWO_LISTS.replace(b"end_header", b"property list uchar int vertex_index\nend_header")
COLOURED = ply(
    head="property uchar red\nelement edge 1\nproperty int a\nproperty int b\n",
    points=lines(POINTS).replace("\n", " 200\n") + "0 1\n",
)
# Of each file its content, words of the sentence that refuses it, and how many cubes it holds if not one.
FILES: dict[str, dict[str, Any]] = {
    "OBJ": {
        "triangles": OBJ,
        "byte-order mark": b"\xef\xbb\xbf" + OBJ.encode(),
        "UTF-16": OBJ.encode("utf-16"),
        "Windows line ends": OBJ.replace("\n", "\r\n"),
        "old Mac line ends": OBJ.replace("\n", "\r"),
        "tabs and blanks": OBJ.replace(" ", "\t  ").replace("\n", " \t\n\n"),
        "comments after values": OBJ.replace("\n", " # a comment\n"),
        "comments that end in a backslash": "# C:\\models\\\n" + OBJ.replace("\nf", "\n# here\\\nf", 1),
        "keywords in capitals": OBJ.upper(),
        "lines continued by a backslash": OBJ.replace("f 1 ", "f 1 \\\n "),
        "texture and normal indices": SLASHES.replace("f 2 ", "f 2//1 ").replace("f 3 ", "f 3/1 "),
        "colours after positions": OBJ.replace("\nf", " \nf").replace("\nv", " .1 .2 .3\nv"),
        "numbers such as 8.0 for 8": OBJ.replace("f 1 ", "f 1.0 "),
        "negative indices across parts": (PARTS, "", 3),
        "quads": VERTICES + POLYGONS,
        "concave polygons": (f"{ELL_OBJ}f 6 5 4 3 2 1\nf 7 8 9 10 11 12\n", "", 0),
        "polygon that crosses itself": (OBJ + "f 1 2 3 4\n", "crosses itself"),
        "points and lines beside faces: left out": OBJ + "p 1 2\nl 1 2 3\n",
        "unused vertices": OBJ.replace("\nf", "\nv nan 0 0\nf", 1),
        "free-form surfaces": (OBJ + "surf 0 1 0 1 1 2 3 4\n", "free-form surfaces (surf)"),
        "other files taken in (call)": (OBJ + "call more.obj\n", "has parts in other files (call)"),
        "a keyword with a zero byte": (
            OBJ.replace("f 1 ", "f\0 1 "),
            "begins with 'f\\x00', which is no word",
        ),
        "cut off within a face": (OBJ + "f 1 2", "line 21 is a face with 2 corners"),
        "index 0": (OBJ + "f 0 1 2\n", "refers to vertex 0"),
        "decimal commas": (OBJ.replace("v 1 ", "v 1,0 "), "1,0"),
        "digits with an underscore": (OBJ.replace("f 1 6", "f 1 0_6"), "0_6"),
    },
    "PLY": {
        "text": ply(),
        "text, blank lines, tabs, Windows line ends": (
            ply().replace(b" 0", b"\t0 ").replace(b"\n", b"\r\n\r\n"),
        ),
        "text, old Mac line ends": ply().replace(b"\n", b"\r"),
        "comments that name end_header": ply().replace(b"unit cube", b"before the end_header"),
        "text, UTF-16": ply().decode().encode("utf-16"),
        "text, 3.0 for 3": ply().replace(b"\n3 ", b"\n3.0 "),
        "binary, little endian": ply("binary_little_endian", data=binary("<")),
        "binary, big endian": ply("binary_big_endian", data=binary(">")),
        "binary, Windows line ends in the header": (
            ply("binary_little_endian", data=b"").replace(b"\n", b"\r\n") + binary("<")
        ),
        "triangles and quads, text": ply(faces=MIXED),
        "triangles and quads, binary": ply("binary_little_endian", MIXED, data=binary("<", MIXED)),
        "triangle strips with -1 between": ply(faces=[STRIP], element="tristrips", size="int"),
        "more properties and elements": COLOURED,
        "NaN in points that no face uses": ply(points=lines(POINTS) + "nan nan nan\n", number=9),
        "range scan without faces": (ply(element="range_grid"), "range scan (range_grid)"),
        "points alone": (ply(faces=[]), "has no triangles"),
        "text cut off": (ply()[:-30], "cut off"),
        "binary cut off": (ply("binary_little_endian", data=binary("<")[:-3]), "cut off"),
        "binary and a line end": ply("binary_little_endian", data=binary("<") + b"\r\n"),
        "binary with faces left over": (
            ply("binary_little_endian", FACES[:5], data=binary("<")),
            "it holds 91 bytes more than it declares",
        ),
        "text, 0.5 for an index": (ply().replace(b"\n3 0 ", b"\n3 0.5 ", 1), "0.5 is no whole number"),
        "text, 300 in a list's uchar": (
            ply().replace(b"\n3 0 ", b"\n300 0 ", 1),
            "300 is no whole number of the type uint8",
        ),
        "more numbers than declared": (ply(end="3 0 1 2\n"), "4 numbers more than it declares"),
        "a property twice": (ply(head="property float z\n"), "declares 'z' twice"),
        "an element twice": (ply(head="element vertex 0\nproperty float x\n"), "declares 'vertex' twice"),
        "two lists of corners": (TWO_LISTS, "vertex_indices, or two of it"),
    },
    "STL": {
        "binary": stl(),
        "binary whose header begins with solid": stl(head=b"solid but binary"),
        "binary with bytes after the triangles": stl(end=b"made by a slicer"),
        "binary cut off": (stl(count=9), "it declares 12 triangles, and has bytes for 9"),
        "binary with triangles left over": (stl(named=5), "declares 5 triangles, and 350 bytes follow"),
        "binary that declares 0 triangles": (stl(named=0), "declares 0 triangles, and 600 bytes follow"),
        "text": STL_TEXT,
        "text, capitals, tabs, Windows line ends": STL_TEXT.upper().replace(" ", "\t").replace("\n", "\r\n"),
        "text, UTF-16": STL_TEXT.encode("utf-16"),
        "text, 'end solid'": STL_TEXT.replace("end", "end "),
        "text after a comment": "# made by hand\n" + STL_TEXT,
        "text, several solids": STL_TEXT.replace("endfacet\n", "endfacet\nendsolid\nsolid b\n", 1),
        "text with 100,000 empty lines in a facet": STL_TEXT.replace("outer", "\n" * 100_000 + "outer", 1),
        "text cut off": (STL_TEXT[:-60], "cut off before its 'endsolid'"),
        "binary whose header names solids and facets": stl(head=b"solid of facets", end=b"\0\0"),
        "text, four vertices in one facet and two in the next": (UNEVEN, "not three for each"),
        "text cut off in its second solid": (f"{STL_TEXT}solid b\n{FACETS}", "cut off before its 'endsolid'"),
    },
    "OFF": {
        "triangles": "OFF\n" + OFF,
        "counts on the first line, comments, blank lines": "# a cube\nOFF " + OFF.replace("\n", " # x\n\n"),
        "counts that touch the word OFF": "OFF" + OFF,
        "no word OFF": OFF,
        "COFF, colours of points and faces": "COFF\n" + OFF.replace("\n", " 255 0 0 255\n"),
        "fewer lines than declared": ("OFF\n" + OFF[:-9], "cut off"),
        "more lines than declared": ("OFF\n" + OFF + "3 0 1 2\n", "has 21 lines"),
        "faces with a negative number of corners": ("OFF\n" + OFF.replace("\n3", "\n-3"), "-3 corners"),
        "binary": ("OFF BINARY\n" + OFF, "only three-dimensional text is read"),
        "four dimensions": ("4OFF\n" + OFF, "only three-dimensional text is read"),
    },
}
