"""Mesh files of every feature and dialect: what is read, what is refused. `python -m tests.file_features`
prints the table of docs/files.md.

The features of glTF are those of Khronos' sample assets, built small here: each file holds the unit cube, or
as many as `cubes` says, side by side along x. Nothing is copied.
"""

from __future__ import annotations

import base64
import json
import struct
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.mesh import load_mesh

POINTS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))])
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


@dataclass(frozen=True)
class Feature:
    """A file with one feature, and what becomes of it."""

    kind: str  # of the file
    name: str  # of the feature
    write: Callable[[Path], Path]  # into a folder; returns the file
    refused: str = ""  # words of the sentence that refuses it; none: it is read
    cubes: int = 1  # that it holds; 0: the prism over an L


class Gltf:
    """A glTF document under construction."""

    def __init__(self, **top) -> None:
        self.data, self.top = b"", {"asset": {"version": "2.0"}, **top}
        self.views: list[dict] = []
        self.accessors: list[dict] = []

    def view(self, data: bytes, **more) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)} | more)
        self.data += data
        return len(self.views) - 1

    def add(self, values, kind: str = "f4", **more) -> int:
        array = np.asarray(values, dtype="<" + kind)
        width = array.shape[1] if array.ndim > 1 else 1
        entry = {"bufferView": self.view(array.tobytes()), "componentType": CODES[kind]}
        self.accessors.append(entry | {"count": len(array), "type": KINDS[width]} | more)
        return len(self.accessors) - 1

    def cube(self, position: int | None = None, index: str = "u2", **more) -> dict:
        """Return a primitive that is the cube, its points in an accessor of its own or in `position`."""
        position = self.add(POINTS) if position is None else position
        return {"attributes": {"POSITION": position}, "indices": self.add(FACES.ravel(), index)} | more

    def document(self, primitives=None, nodes=None, **more) -> dict:
        scene = {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes or [{"mesh": 0}]}
        shapes = {"meshes": [{"primitives": primitives or [self.cube()]}], "accessors": self.accessors}
        data = {"bufferViews": self.views, "buffers": [{"byteLength": len(self.data)}]}
        return self.top | scene | shapes | data | more

    def glb(self, folder: Path, document: dict, name: str = "cube.glb") -> Path:
        document["buffers"][0]["byteLength"] = len(self.data)
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        rest = self.data + b"\0" * (-len(self.data) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(rest), 0x4E4942) + rest
        (folder / name).write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        return folder / name


def gltf(name: str, change=None, refused: str = "", cubes: int = 1, **top) -> Feature:
    """A GLB whose document `change(gltf)` returns, or that of the plain cube."""

    def write(folder: Path) -> Path:
        made = Gltf(**top)
        primitive = change(made) if change else made.cube()
        return made.glb(folder, primitive if "asset" in primitive else made.document([primitive]))

    return Feature("glTF, GLB", name, write, refused, cubes)


def quantized(made: Gltf) -> dict:
    primitive = made.cube(made.add(POINTS * 65535, "u2", normalized=True), "u1")
    return made.document([primitive], extensionsRequired=["KHR_mesh_quantization"])


def integers(made: Gltf) -> dict:
    nodes = [{"mesh": 0, "scale": [0.01] * 3}]
    primitive = made.cube(made.add(POINTS * 100, "i2"), "u4")
    return made.document([primitive], nodes, extensionsRequired=["KHR_mesh_quantization"])


def replaced(made: Gltf, which, values) -> dict:
    """Return the entry `sparse` of an accessor whose values `which` are replaced."""
    where, new = (made.accessors[each]["bufferView"] for each in (made.add(which, "u1"), made.add(values)))
    indices = {"bufferView": where, "componentType": 5121}
    return {"count": len(which), "indices": indices, "values": {"bufferView": new}}


def sparse(made: Gltf) -> dict:
    wrong = POINTS.copy()
    wrong[[1, 6]] = 9
    return made.cube(made.add(wrong, sparse=replaced(made, [1, 6], POINTS[[1, 6]])))


def sparse_alone(made: Gltf) -> dict:
    position = made.add(POINTS, sparse=replaced(made, range(1, 8), POINTS[1:]))
    del made.accessors[position]["bufferView"]
    return made.cube(position)


def interleaved(made: Gltf) -> dict:
    rows = np.concatenate([POINTS, POINTS * 7], axis=1).astype("<f4")
    return made.cube(made.add(POINTS, bufferView=made.view(rows.tobytes(), byteStride=24)))


def mode(number: int, runs, indexed: bool = True) -> Callable[[Gltf], dict]:
    def change(made: Gltf) -> dict:
        primitives = []
        for run in runs:
            points = POINTS if indexed else POINTS[list(run)]
            primitives.append({"attributes": {"POSITION": made.add(points)}, "mode": number})
            if indexed:
                primitives[-1]["indices"] = made.add(list(run), "u1")
        return made.document(primitives)

    return change


def beside(number: int) -> Callable[[Gltf], dict]:
    other = {"mode": number}
    return lambda made: made.document([made.cube(), {"attributes": {"POSITION": made.add(POINTS)}} | other])


def placed(*nodes: dict, **more) -> Callable[[Gltf], dict]:
    return lambda made: made.document(None, list(nodes), **more)


def instanced(made: Gltf) -> dict:
    turn = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    attributes = {
        "TRANSLATION": made.add([[0, 0, 0], [4, 0, 0], [7, 0, 0]]),
        "ROTATION": made.add([[0, 0, 0, 1], turn, [0, 0, 0, 1]]),
        "SCALE": made.add([[1, 1, 1]] * 3),
    }
    node = {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}
    return made.document(None, [node], extensionsRequired=["EXT_mesh_gpu_instancing"])


def morphed(made: Gltf) -> dict:
    primitive = made.cube(targets=[{"POSITION": made.add(-POINTS)}, {"POSITION": made.add(POINTS)}])
    return made.document([primitive], meshes=[{"primitives": [primitive], "weights": [0.5, 0.5]}])


def skinned(made: Gltf) -> dict:
    moved = {"JOINTS_0": made.add([[0, 1, 0, 0]] * 8, "u1"), "WEIGHTS_0": made.add([[0.5, 0.5, 0, 0]] * 8)}
    primitive = made.cube()
    primitive["attributes"] |= moved
    bind = np.eye(4)
    bind[:3, 3] = -3
    joint = {"translation": [3, 3, 3]}
    nodes = [{"children": [1, 2, 3]}, {"mesh": 0, "skin": 0, "translation": [50, 0, 0]}, joint, joint]
    skin = {"joints": [2, 3], "inverseBindMatrices": made.add([bind.T.ravel()] * 2)}
    return made.document([primitive], nodes, skins=[skin])


def draco(made: Gltf) -> dict:
    import DracoPy

    packed = DracoPy.encode(POINTS, FACES.astype(np.uint32), quantization_bits=14, preserve_order=True)
    extension = {"bufferView": made.view(packed), "attributes": {"POSITION": 0}}
    primitive = made.cube(extensions={"KHR_draco_mesh_compression": extension})
    for accessor in made.accessors:
        del accessor["bufferView"]
    return made.document([primitive], extensionsRequired=["KHR_draco_mesh_compression"])


def meshopt(made: Gltf) -> dict:
    primitive = made.cube()
    made.views[0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0, "byteLength": 96}}}
    buffers = [{"byteLength": 0}, {"byteLength": 96}]
    return made.document([primitive], extensionsRequired=["EXT_meshopt_compression"], buffers=buffers)


def separate(name: str, uri: str, there: bool = True) -> Feature:
    """A .gltf with its buffer in a file, or in a data URI."""

    def write(folder: Path) -> Path:
        made = Gltf()
        document = made.document()
        if there:
            (folder / "my cube.bin").write_bytes(made.data)
        inline = "data:application/octet-stream;base64," + base64.b64encode(made.data).decode()
        document["buffers"] = [{"byteLength": len(made.data), "uri": inline if uri == "data" else uri}]
        (folder / "cube.gltf").write_text(json.dumps(document))
        return folder / "cube.gltf"

    return Feature("glTF, GLB", name, write, "" if there else "its buffer gone.bin is not in the folder")


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
OFF = "8 12 0\n" + lines(POINTS) + lines(FACES, "3 ")


def zipped(*names: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        with zipfile.ZipFile(folder / "cube.zip", "w") as archive:
            for name in names:
                archive.writestr(name, OBJ)
        return folder / "cube.zip"

    return write


def written(content: str | bytes, file: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / file

    return write


AWAY, SCENES = {"mesh": 0, "translation": [4, 0, 0]}, [{"nodes": [1]}, {"nodes": [0]}]
TURNED = {"mesh": 0, "scale": [0.5, 1, 0.25], "rotation": [0, 0, 0, 1]}
MIRROR = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1]
INVISIBLE = {"KHR_node_visibility": {"visible": False}}
SLASHES = OBJ.replace("\nf", "\nvt 0 0\nvn 0 0 1\nf", 1).replace("f 1 ", "f 1/1/1 ")
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
        "other files taken in (call)": (OBJ + "call more.obj\n", "takes in other files (call)"),
        "cut off within a face": (OBJ + "f 1 2", "cut off at line 21"),
        "index 0": (OBJ + "f 0 1 2\n", "refers to vertex 0"),
        "decimal commas": (OBJ.replace("v 1 ", "v 1,0 "), "1,0"),
    },
    "PLY": {
        "text": ply(),
        "text, blank lines, tabs, Windows line ends": (
            ply().replace(b" 0", b"\t0 ").replace(b"\n", b"\r\n\r\n"),
        ),
        "text, old Mac line ends": ply().replace(b"\n", b"\r"),
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
        "more numbers than declared": (ply(end="3 0 1 2\n"), "4 numbers more than it declares"),
    },
    "STL": {
        "binary": stl(),
        "binary whose header begins with solid": stl(head=b"solid but binary"),
        "binary with bytes after the triangles": stl(end=b"made by a slicer"),
        "binary cut off": (stl(count=9), "it declares 12 triangles, and has bytes for 9"),
        "binary that declares 0 triangles": (stl(named=0), "declares 0 triangles, and more bytes follow"),
        "text": STL_TEXT,
        "text, capitals, tabs, Windows line ends": STL_TEXT.upper().replace(" ", "\t").replace("\n", "\r\n"),
        "text, several solids": STL_TEXT.replace("endfacet\n", "endfacet\nendsolid\nsolid b\n", 1),
        "text cut off": (STL_TEXT[:-60], "cut off before its 'endsolid'"),
    },
    "OFF": {
        "triangles": "OFF\n" + OFF,
        "counts on the first line, comments, blank lines": "# a cube\nOFF " + OFF.replace("\n", " # x\n\n"),
        "counts that touch the word OFF": "OFF" + OFF,
        "no word OFF": OFF,
        "COFF, colours of points and faces": "COFF\n" + OFF.replace("\n", " 255 0 0 255\n"),
        "fewer lines than declared": ("OFF\n" + OFF[:-9], "cut off"),
        "more lines than declared": ("OFF\n" + OFF + "3 0 1 2\n", "has 21 lines"),
        "binary": ("OFF BINARY\n" + OFF, "only three-dimensional text is read"),
        "four dimensions": ("4OFF\n" + OFF, "only three-dimensional text is read"),
    },
}
FEATURES: list[Feature] = [
    gltf("triangles, indices of 8, 16, 32 bit"),
    gltf("triangles without indices", mode(4, [FACES.ravel()], indexed=False)),
    gltf("triangle strips", mode(5, STRIPS)),
    gltf("triangle fans", mode(6, [(a, b, c, d) for a, b, c, d in QUADS])),
    *(
        gltf(f"{what} beside triangles: left out", beside(n))
        for n, what in enumerate(("points", "lines", "line loops", "line strips"))
    ),
    gltf("points alone", mode(0, [range(8)]), "has no triangles"),
    gltf("strided (interleaved) vertices", interleaved),
    gltf("sparse accessor over a buffer", sparse),
    gltf("sparse accessor alone", sparse_alone),
    gltf("normalized integers (KHR_mesh_quantization)", quantized),
    gltf("integers and a scale (KHR_mesh_quantization)", integers),
    gltf("nodes in nodes, one mesh twice", placed({"children": [1, 2]}, {"mesh": 0}, AWAY), cubes=2),
    gltf("rotation and scale", placed({"scale": [2, 1, 4], "children": [1]}, TURNED)),
    gltf("matrix that mirrors: winding kept outward", placed({"mesh": 0, "matrix": MIRROR})),
    gltf("several scenes: the one that is shown", placed({"mesh": 0}, AWAY, scenes=SCENES, scene=1)),
    gltf(
        "no scene: all nodes",
        lambda made: {key: value for key, value in made.document().items() if key not in ("scene", "scenes")},
    ),
    gltf(
        "invisible nodes (KHR_node_visibility): left out",
        placed({"children": [1, 2]}, {"mesh": 0}, AWAY | {"extensions": INVISIBLE}),
    ),
    gltf("instances (EXT_mesh_gpu_instancing)", instanced, cubes=3),
    gltf("morph targets, at their default weights", morphed),
    gltf("skins, in the pose of their joints", skinned),
    gltf("Draco (KHR_draco_mesh_compression), with DracoPy", draco),
    gltf("meshopt (EXT_meshopt_compression)", meshopt, "decompress it: npx gltfpack"),
    gltf(
        "another required extension",
        lambda made: made.document(extensionsRequired=["ACME_voxels"]),
        "requires the glTF extension ACME_voxels",
    ),
    gltf(
        "required extension of materials, textures, lights",
        lambda made: made.document(extensionsRequired=["KHR_materials_unlit", "KHR_texture_transform"]),
    ),
    gltf("Unicode names", lambda made: made.document(meshes=[{"name": "❤♻", "primitives": [made.cube()]}])),
    gltf("glTF 1.0", lambda made: made.document() | {"asset": {"version": "1.0"}}, "only 2.0 is read"),
    gltf("a node below itself", placed({"mesh": 0, "children": [0]}), "two parents"),
    gltf(
        "accessor beyond its buffer view",
        lambda made: made.cube() | {"indices": made.add(FACES.ravel(), "u2", count=99)},
        "do not fit",
    ),
    gltf(
        "index beyond the vertices",
        lambda made: made.cube() | {"indices": made.add([0, 1, 8], "u2")},
        "vertex 8 of 8",
    ),
    separate("buffer in a file, %20 in its name", "my%20cube.bin"),
    separate("buffer in a data URI", "data"),
    separate("missing buffer", "gone.bin", there=False),
    *(
        Feature(kind, name, written(each[0], f"cube.{kind.lower()}"), *each[1:])
        for kind, files in FILES.items()
        for name, content in files.items()
        for each in [content if isinstance(content, tuple) else (content,)]
    ),
    Feature("zip", "one mesh", zipped("a/cube.obj", "readme.txt", "__MACOSX/a/cube.obj")),
    Feature("zip", "several meshes", zipped("a.obj", "b.obj"), "holds 2 meshes"),
    Feature("other", "3MF, DAE, FBX, STEP, USD …", written(b"PK", "cube.3mf"), "no mesh format that is read"),
]


def outcome(feature: Feature, folder: Path) -> str:
    """Return "read" when the file is read as its cubes, "refused: …" for one sentence with the words that are
    due; raises AssertionError for all else."""
    path = feature.write(folder)
    try:
        mesh = load_mesh(path)
    except InputError as error:
        sentence = str(error)
        assert feature.refused and feature.refused in sentence, f"{feature.name}: {sentence}"
        assert path.name in sentence and "\n" not in sentence
        return "refused: “" + feature.refused + "”"
    assert not feature.refused, f"{feature.name}: read as {len(mesh.faces)} triangles"
    certificate = certify_mesh(mesh)
    cubes = feature.cubes or 1
    assert certificate.passed and certificate.betti == (cubes, 0, cubes), (
        f"{feature.name}: {certificate.reasons}"
    )
    volumes = [each.volume for each in certificate.components]
    assert np.allclose(volumes, 1 if feature.cubes else 0.75, atol=1e-3), f"{feature.name}: volumes {volumes}"
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert np.allclose(low[1:], 0, atol=1e-3) and np.allclose(high[1:], 1, atol=1e-3), (
        f"{feature.name}: {low} {high}"
    )
    return "read"


def table() -> str:
    """Return the table as Markdown."""
    rows = []
    for kind, features in groupby(FEATURES, key=lambda feature: feature.kind):
        rows += [f"\n| {kind} | |", "|---|---|"]
        for feature in features:
            with tempfile.TemporaryDirectory() as folder:
                rows.append(f"| {feature.name} | {outcome(feature, Path(folder))} |")
    return "\n".join(rows).strip()


if __name__ == "__main__":
    print(table())
