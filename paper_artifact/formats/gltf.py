"""glTF 2.0 (.gltf, .glb): the triangles of the scene that is shown, in world coordinates.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html. Accessors of every kind (sparse, normalized,
strided), triangles, strips and fans, nodes, instances (EXT_mesh_gpu_instancing), morph targets at their
default weights and skins in the pose of their joints are read. Materials, cameras, animations, points and
lines are left out. A required extension that changes geometry and is not read is refused by name.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote_to_bytes

import numpy as np
from scipy.spatial.transform import Rotation

from paper_artifact.errors import InputError
from paper_artifact.files import decoded
from paper_artifact.formats.named import find_file
from paper_artifact.formats.polygons import Triangles, strip_triangles

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
ROUNDED = 0.02  # the most that a point's skin weights, often bytes, may miss 1 by
MOST_FACES = 20_000_000  # of a file, its instances counted each time
DRACO, INSTANCES, VISIBILITY = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing", "KHR_node_visibility"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
READ = (DRACO, INSTANCES, VISIBILITY, "KHR_mesh_quantization")
# What extensions with these beginnings add leaves positions and triangles as they are.
HARMLESS = re.compile(
    "KHR_(materials_|texture_|lights_|xmp|animation_|node_|physics|interactivity|audio)|MSFT_(texture_|lod)|"
    "EXT_(texture_|lights_|mesh_features|mesh_manifold|instance_features|structural_metadata)|"
    "ADOBE_materials_|AGI_|CESIUM_primitive_outline|FB_|MPEG_(media|texture_|audio_)|VRM|GODOT_"
)


def read_gltf(path: Path, data: bytes) -> list[Triangles]:
    """Return a part per primitive and instance: points (V,3) float64, world units, triangles (F,3) int64.

    path: of the file, whose folder holds its buffers. Raises ValueError for a damaged file, InputError for
    what is not read.
    """
    document, chunk = _chunks(data)
    version = str(document.get("asset", {}).get("version", "none"))
    if version.split(".")[0] != "2":
        raise InputError(
            f"it is glTF {version}, and only 2.0 is read; convert it: npx gltf-pipeline -i "
            "OLD.gltf -o NEW.gltf"
        )
    for name in document.get("extensionsRequired", ()):
        if name not in READ + MESHOPT and not HARMLESS.match(str(name)):
            raise InputError(
                f"it requires the glTF extension {name}, which is not read; export it without it"
            )
    return list(_Reader(path, document, chunk).parts())


def _chunks(data: bytes) -> tuple[dict, bytes | None]:
    """Return the JSON and the binary chunk of a GLB, or the JSON of a .gltf."""
    text, chunk = data, None
    if data[:4] == b"glTF":
        version, length = (int.from_bytes(data[i : i + 4], "little") for i in (4, 8))
        if version != 2:
            raise InputError(f"it is GLB version {version}, and only 2 is read; export it again as glTF 2.0")
        if length > len(data):
            raise ValueError(f"cut off: it declares {length} bytes and has {len(data)}")
        found: dict[bytes, bytes] = {}
        place = 12
        while place + 8 <= length:
            size, kind = int.from_bytes(data[place : place + 4], "little"), data[place + 4 : place + 8]
            if place + 8 + size > length:
                raise ValueError("cut off: a chunk is longer than the file")
            found.setdefault(kind, data[place + 8 : place + 8 + size])
            place += 8 + size
        text, chunk = found.get(b"JSON", b""), found.get(b"BIN\0")
    try:
        document = json.loads(decoded(text))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"its JSON is damaged: {error}") from error
    if not isinstance(document, dict):
        raise ValueError("its JSON is no object")
    return document, chunk


class _Reader:
    """One document and its buffers."""

    def __init__(self, path: Path, document: dict, chunk: bytes | None) -> None:
        self.path, self.document, self.chunk = path, document, chunk
        self.empty = 0  # numbers of accessors that have no bytes in the file
        self.buffer, self.accessor = cache(self._buffer), cache(self._accessor)

    def listed(self, kind: str, index: int) -> dict:
        """Return an entry of one of the document's lists."""
        entries = self.document.get(kind, [])
        if not isinstance(index, int) or not 0 <= index < len(entries):
            raise ValueError(f"it refers to number {index} of {len(entries)} {kind}")
        return entries[index]

    def parts(self) -> Iterator[Triangles]:
        """Yield the points and triangles of every primitive of every node of the scene, placed."""
        count = 0
        self.world = dict(self.placed())
        for number, matrix in self.world.items():
            node = self.document["nodes"][number]
            if "mesh" not in node:
                continue
            mesh = self.listed("meshes", node["mesh"])
            places = self.instances(node, matrix)
            for primitive in mesh["primitives"]:
                faces, points = self.primitive(primitive, node.get("weights", mesh.get("weights", ())))
                count += len(faces) * len(places)
                if count > MOST_FACES:
                    raise ValueError(f"it has more than {MOST_FACES} triangles")
                if not len(faces):
                    continue
                if "skin" in node:
                    yield self.skinned(points, primitive, self.listed("skins", node["skin"])), faces
                    continue
                for place in places:
                    turned = faces[:, ::-1] if np.linalg.det(place[:3, :3]) < 0 else faces
                    same = np.array_equal(place, np.eye(4))
                    yield points if same else points @ place[:3, :3].T + place[:3, 3], turned

    def placed(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the scene's visible nodes and their world matrices (4,4)."""
        nodes = self.document.get("nodes", [])
        if "scenes" in self.document:
            roots = self.listed("scenes", self.document.get("scene", 0)).get("nodes", [])
        else:
            roots = sorted(
                set(range(len(nodes))) - {each for node in nodes for each in node.get("children", ())}
            )
        waiting, seen = [(root, np.eye(4)) for root in reversed(roots)], set()
        while waiting:
            number, above = waiting.pop()
            node = self.listed("nodes", number)
            if number in seen:
                raise ValueError(f"node {number} has two parents")
            seen.add(number)
            if not node.get("extensions", {}).get(VISIBILITY, {}).get("visible", True):
                continue
            matrix = above @ _local(node)
            yield number, matrix
            waiting += [(child, matrix) for child in reversed(node.get("children", []))]

    def instances(self, node: dict, matrix: np.ndarray) -> list[np.ndarray]:
        """Return the world matrices of a node's instances, its own where it has none."""
        named = node.get("extensions", {}).get(INSTANCES, {}).get("attributes")
        if named is None:
            return [matrix]
        values = {
            key: self.accessor(index)
            for key, index in named.items()
            if key in ("TRANSLATION", "ROTATION", "SCALE")
        }
        number = max((len(each) for each in values.values()), default=0)
        if number * 16 > MOST_FACES or any(len(each) != number for each in values.values()):
            raise ValueError("its instances have attributes of different lengths, or are too many")
        return [
            matrix @ _local({key.lower(): each[i] for key, each in values.items()}) for i in range(number)
        ]

    def primitive(self, primitive: dict, weights: list[float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the triangles and the points of a primitive, in the coordinates of its mesh."""
        named, mode = primitive["attributes"], primitive.get("mode", 4)
        if mode not in range(7):
            raise ValueError(f"a primitive has mode {mode}")
        if mode < 4 or "POSITION" not in named:  # points and lines
            return np.zeros((0, 3), np.int64), np.zeros((0, 3))
        packed = primitive.get("extensions", {}).get(DRACO)
        if packed is not None and DRACO in self.document.get("extensionsRequired", ()):
            points, index = self.unpacked(packed, self.listed("accessors", named["POSITION"]))
        else:
            points = self.accessor(named["POSITION"]).astype(np.float64)
            index = np.arange(len(points))
            if "indices" in primitive:
                index = _whole(self.accessor(primitive["indices"])).reshape(-1)
        for weight, target in zip(weights, primitive.get("targets", ()), strict=False):
            if weight and "POSITION" in target:
                points = points + weight * self.accessor(target["POSITION"])
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"its positions come as {points.shape}")
        if mode == 4:
            if len(index) % 3:
                raise ValueError(f"a primitive of triangles has {len(index)} corners")
            return index.reshape(-1, 3), points
        if mode == 5:
            return strip_triangles(index), points
        middle = np.full(max(len(index) - 2, 0), index[0] if len(index) else 0)
        return np.stack([middle, index[1:-1], index[2:]], axis=1), points

    def skinned(self, points: np.ndarray, primitive: dict, skin: dict) -> np.ndarray:
        """Return the points moved by the joints' present pose; a skinned node's own place does not count."""
        joints = []
        for i, number in enumerate(skin["joints"]):
            if number not in self.world:
                raise ValueError(f"joint {number} of a skin is not in its scene")
            bind = (
                self.accessor(skin["inverseBindMatrices"])[i].reshape(4, 4).T
                if ("inverseBindMatrices" in skin)
                else np.eye(4)
            )
            joints.append(self.world[number] @ bind)
        moved, named, turn = np.zeros_like(points), primitive["attributes"], 0
        shares = np.zeros((len(points), 1))
        while f"JOINTS_{turn}" in named:
            of, share = self.accessor(named[f"JOINTS_{turn}"]), self.accessor(named[f"WEIGHTS_{turn}"])
            if of.max(initial=0) >= len(joints):
                raise ValueError(f"it refers to joint {of.max()} of {len(joints)}")
            for corner in range(of.shape[1]):
                matrix = np.stack(joints)[of[:, corner].astype(np.int64)]
                one = np.einsum("nij,nj->ni", matrix[:, :3, :3], points) + matrix[:, :3, 3]
                moved += share[:, corner, None] * one
                shares += share[:, corner, None]
            turn += 1
        if turn and not np.abs(shares - 1).max(initial=0) <= ROUNDED:
            worst = shares.flat[np.abs(shares - 1).argmax()]
            raise ValueError(f"the skin's weights of a point add up to {worst:g}, not 1")
        return moved / shares if turn else points

    def unpacked(self, packed: dict, accessor: dict) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (V,3) float64 and indices of what Draco compressed."""
        try:
            import DracoPy
        except ImportError as error:
            raise InputError(
                "it is compressed with Draco (KHR_draco_mesh_compression): pip install DracoPy, or "
                "decompress it: npx @gltf-transform/cli cp IN.glb OUT.glb"
            ) from error
        view = self.listed("bufferViews", packed["bufferView"])
        try:
            mesh = DracoPy.decode(self.view_bytes(view))
        except Exception as error:  # the decoder raises FileTypeException, which is no ValueError
            raise InputError(
                "it is compressed with Draco (KHR_draco_mesh_compression), which DracoPy cannot decode "
                f"({error}); decompress it: npx @gltf-transform/cli cp IN.glb OUT.glb, or export it again"
            ) from error
        points = _normalized(np.asarray(mesh.points), accessor).astype(np.float64)
        if len(points) != accessor["count"]:
            raise ValueError(f"it declares {accessor['count']} points and its Draco data have {len(points)}")
        return points, np.asarray(mesh.faces).astype(np.int64).reshape(-1)

    def _accessor(self, index: int) -> np.ndarray:
        """Return an accessor's values (count, width), as float64 where they are normalized integers."""
        entry = self.listed("accessors", index)
        count, width, kind = (
            int(entry["count"]),
            WIDTHS[entry["type"]],
            np.dtype(TYPES[entry["componentType"]]),
        )
        if count < 1:
            raise ValueError(f"an accessor has {count} values")
        if "bufferView" in entry:
            values = self.values(entry["bufferView"], entry.get("byteOffset", 0), count, width, kind)
        else:
            self.empty += count * width
            if self.empty > 3 * MOST_FACES:
                raise ValueError(f"it names {self.empty} values that it does not hold")
            values = np.zeros((count, width), kind)
        if "sparse" in entry:
            sparse, values = entry["sparse"], values.copy()
            number, at, new = int(sparse["count"]), sparse["indices"], sparse["values"]
            kind_at = np.dtype(TYPES[at["componentType"]])
            where = _whole(self.values(at["bufferView"], at.get("byteOffset", 0), number, 1, kind_at)).ravel()
            if where.max(initial=0) >= count:
                raise ValueError(f"a sparse accessor of {count} values replaces value {where.max()}")
            values[where] = self.values(new["bufferView"], new.get("byteOffset", 0), number, width, kind)
        return _normalized(values, entry)

    def values(self, view: int, offset: int, count: int, width: int, kind: np.dtype) -> np.ndarray:
        """Return (count, width) numbers of a buffer view."""
        entry = self.listed("bufferViews", view)
        data = self.view_bytes(entry)
        stride = entry.get("byteStride") or width * kind.itemsize
        if (
            offset < 0
            or stride < 1
            or count < 0
            or (count and offset + stride * (count - 1) + width * kind.itemsize > len(data))
        ):
            raise ValueError(f"{count} values do not fit into the {len(data)} bytes of buffer view {view}")
        return np.ndarray((count, width), kind, data, offset, (stride, kind.itemsize))

    def view_bytes(self, view: dict) -> bytes:
        """Return a buffer view's bytes."""
        buffer = self.listed("buffers", view["buffer"])
        packed = any(name in view.get("extensions", {}) for name in MESHOPT)
        required = any(name in self.document.get("extensionsRequired", ()) for name in MESHOPT)
        if packed and (required or "uri" not in buffer and (view["buffer"] or self.chunk is None)):
            raise InputError(
                "it is compressed with meshopt (EXT_meshopt_compression); decompress it: npx "
                "gltfpack -i IN.glb -o OUT.glb -noq"
            )
        data, start, length = self.buffer(view["buffer"]), view.get("byteOffset", 0), view["byteLength"]
        if start < 0 or length < 0 or start + length > len(data):
            raise ValueError(f"a buffer view ends at byte {start + length} of {len(data)}")
        return data[start : start + length]

    def _buffer(self, index: int) -> bytes:
        entry = self.listed("buffers", index)
        uri = entry.get("uri")
        if uri is None:
            if index or self.chunk is None:
                raise ValueError(f"buffer {index} has no data")
            data = self.chunk
        elif uri[:5].lower() == "data:":
            head, _, body = uri.partition(",")
            data = unquote_to_bytes(body)
            if head.lower().endswith(";base64"):
                data = base64.b64decode(b"".join(data.split()), validate=True)
        else:
            file = find_file(self.path.parent, uri)
            if file is None:
                raise InputError(
                    f"its buffer {uri} is not in the folder {self.path.parent}; copy it there too"
                )
            data = file.read_bytes()
        if len(data) < entry["byteLength"]:
            raise ValueError(f"cut off: buffer {index} has {len(data)} of {entry['byteLength']} bytes")
        return data


def _whole(index: np.ndarray) -> np.ndarray:
    """Return indices as int64."""
    if index.dtype.kind != "u":
        raise ValueError("it has indices that are no unsigned whole numbers")
    return index.astype(np.int64)


def _normalized(values: np.ndarray, accessor: dict) -> np.ndarray:
    """Return normalized integers as float64 in [-1,1] or [0,1], all else as it is."""
    if not accessor.get("normalized") or values.dtype.kind == "f":
        return values
    return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)


def _local(node: dict) -> np.ndarray:
    """Return a node's own matrix (4,4): `matrix`, or translation · rotation · scale."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
        if matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            raise ValueError(f"a node's matrix has the last row {matrix[3].tolist()}, not 0, 0, 0, 1")
        return matrix
    parts = []
    for name, usual in (("rotation", (0, 0, 0, 1)), ("scale", (1, 1, 1)), ("translation", (0, 0, 0))):
        parts.append(np.array(node.get(name, usual), dtype=np.float64))
        if parts[-1].shape != (len(usual),):
            raise ValueError(f"a node's {name} is {node[name]}, not {len(usual)} numbers")
    result = np.eye(4)
    result[:3, :3] = Rotation.from_quat(parts[0]).as_matrix() * parts[1]
    result[:3, 3] = parts[2]
    return result
