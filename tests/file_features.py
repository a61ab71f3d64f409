"""Mesh files of every feature and dialect: what is read, what is refused. `python -m tests.file_features`
prints the table of docs/files.md.

The features of glTF are those of Khronos' sample assets, built small here: each file holds the unit cube, or
as many as `cubes` says, side by side along x. Nothing is copied.
"""

import base64
import json
import struct
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from urllib.parse import quote

import numpy as np

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.mesh import load_mesh
from tests.file_dialects import FACES, FILES, OBJ, POINTS, QUADS, STRIPS

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


def skinned(made: Gltf, weight: float = 0.5) -> dict:
    moved = {"JOINTS_0": made.add([[0, 1, 0, 0]] * 8, "u1"), "WEIGHTS_0": made.add([[weight, 0.5, 0, 0]] * 8)}
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
        inline = "application/octet-stream;base64," + base64.b64encode(made.data).decode()
        uris = {"data": f"data:{inline}", "quoted": f"DATA:{quote(inline, safe=';,')}"}
        document["buffers"] = [{"byteLength": len(made.data), "uri": uris.get(uri, uri)}]
        (folder / "cube.gltf").write_text(json.dumps(document))
        return folder / "cube.gltf"

    return Feature("glTF, GLB", name, write, "" if there else "its buffer gone.bin is not in the folder")


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
    gltf("skins whose weights add up to .8", lambda made: skinned(made, 0.3), "add up to 0.8, not 1"),
    gltf("Draco (KHR_draco_mesh_compression), with DracoPy", draco),
    gltf("meshopt (EXT_meshopt_compression)", meshopt, "decompress it: npx gltfpack"),
    gltf(
        "another required extension",
        lambda made: made.document(extensionsRequired=["ACME_voxels"]),
        "requires the glTF extension ACME_voxels",
    ),
    gltf(
        "required extension of moving or compressed geometry (MPEG)",
        lambda made: made.document(extensionsRequired=["MPEG_accessor_timed"]),
        "requires the glTF extension MPEG_accessor_timed",
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
    gltf(
        "indices that are no whole numbers",
        lambda made: made.cube() | {"indices": made.add(FACES.ravel() + 0.6)},
        "no unsigned whole numbers",
    ),
    gltf("a scale of one number", placed({"mesh": 0, "scale": [2]}), "scale is [2], not 3 numbers"),
    gltf("a matrix with a perspective", placed({"mesh": 0, "matrix": [*MIRROR[:15], 2]}), "not 0, 0, 0, 1"),
    separate("buffer in a file, %20 in its name", "my%20cube.bin"),
    separate("buffer in a data URI", "data"),
    separate("buffer in a data URI with escapes", "quoted"),
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
    certificate, cubes = certify_mesh(mesh), feature.cubes or 1
    assert certificate.passed, f"{feature.name}: {certificate.reasons}"
    assert certificate.betti == (cubes, 0, cubes), feature.name
    volumes = [each.volume for each in certificate.components]
    assert np.allclose(volumes, 1 if feature.cubes else 0.75, atol=1e-3), f"{feature.name}: volumes {volumes}"
    box = mesh.vertices.min(axis=0)[1:], mesh.vertices.max(axis=0)[1:]
    assert np.allclose(box, [[0, 0], [1, 1]], atol=1e-3), f"{feature.name}: {box}"
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
