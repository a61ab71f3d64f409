"""OBJ, OFF, PLY and STL files, and their polygons as triangles.

Each reader takes a file's bytes and returns points (V,3) float64, in the file's order and units, and
triangles (F,3) int64. It raises ValueError for a damaged file (the counts that a file declares are compared
with what it holds) and InputError for a part of the format that is not read.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from struct import Struct

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.files import WIDE, decoded

Triangles = tuple[np.ndarray, np.ndarray]

NOT_POLYGONS = {"surf": "free-form surfaces", "bsp": "patches", "bzp": "patches", "cdp": "patches"}  # of OBJ
NOT_POLYGONS["call"] = "parts in other files"
PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
PLY_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
PLY_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
BENT = 1e-3  # of a polygon's length: farther from a plane it is too bent to be said to cross itself
FLAT = 1e-9  # of a polygon's area: what a triangle may be wound the wrong way by rounding


def read_obj(data: bytes) -> Triangles:
    """Return the faces of a Wavefront OBJ file; its points, lines, texture and normals are left out."""
    points: list[list[float]] = []
    corners: list[str] = []
    sizes: list[int] = []
    known: list[int] = []  # points before a face: negative indices count from there
    text = re.sub(r"#[^\n]*", "", decoded(data))  # before lines are joined: it may end in a backslash
    number = 0  # of the line
    for line in re.sub(r"\\[ \t]*\n", " \v", text).split("\n"):  # \v, a blank: here the file had another line
        number += 1 + line.count("\v")
        keyword, *words = line.lower().split() or ("",)
        if keyword == "v":
            if len(words) < 3:
                raise ValueError(f"cut off at line {number}, a vertex with {len(words)} of 3 coordinates")
            points.append(_reals(words[:3]))
        elif keyword in ("f", "fo"):
            if len(words) < 3:
                raise ValueError(f"line {number} is a face with {len(words)} corners, cut off or none")
            corners += words
            sizes.append(len(words))
            known.append(len(points))
        elif keyword in NOT_POLYGONS:
            raise InputError(
                f"it has {NOT_POLYGONS[keyword]} ({keyword}), which are not read; export all as polygons"
            )
        elif not keyword.isprintable():
            raise ValueError(f"line {number} begins with {keyword!r:.20}, which is no word")
    index = np.array([whole(word.partition("/")[0]) for word in corners], dtype=np.int64)
    if (index == 0).any():
        raise ValueError("a face refers to vertex 0, and OBJ counts from 1")
    count = np.repeat(known, sizes).astype(np.int64)
    index = np.where(index > 0, index - 1, count + index)
    if (index < 0).any():
        raise ValueError("a face counts back to before the first vertex")
    positions = np.array(points, dtype=np.float64).reshape(-1, 3)
    return positions, triangulated(positions, index, np.array(sizes, dtype=np.int64))


def read_off(data: bytes) -> Triangles:
    """Return the faces of an OFF file in text; normals, colours and edges are left out."""
    rows = [line.partition("#")[0].split() for line in decoded(data).split("\n")]
    rows = [row for row in rows if row]
    header = re.fullmatch(r"((?:ST)?C?N?)(4?n?)OFF(\d*)", rows[0][0]) if rows else None
    if header is None and not (rows and rows[0][0].isdigit()):
        raise ValueError("its first word is not OFF")
    if header is not None:
        if header[2] or "BINARY" in rows[0]:
            raise InputError(f"it is a {' '.join(rows[0])} file; only three-dimensional text is read")
        rows[0] = [header[3], *rows[0][1:]] if header[3] else rows[0][1:]
        rows = rows if rows[0] else rows[1:]
    if not rows or len(rows[0]) < 2:
        raise ValueError("it declares no numbers of vertices and faces")
    count, faces = (whole(word) for word in rows[0][:2])
    rows = rows[1:]
    if len(rows) != count + faces or min(count, faces) < 0:
        cut = "cut off: " if len(rows) < count + faces else ""
        raise ValueError(f"{cut}it declares {count} vertices and {faces} faces, and has {len(rows)} lines")
    if any(len(row) < 3 for row in rows[:count]):
        raise ValueError("a vertex has fewer than three coordinates")
    points = np.array([_reals(row[:3]) for row in rows[:count]]).reshape(-1, 3)
    sizes = np.array([whole(row[0]) for row in rows[count:]], dtype=np.int64)
    if (sizes < 0).any():
        raise ValueError(f"a face has {sizes.min()} corners")
    if any(len(row) <= size for row, size in zip(rows[count:], sizes.tolist(), strict=True)):
        raise ValueError("cut off: a face has fewer corners than it declares")
    named = zip(rows[count:], sizes.tolist(), strict=True)
    index = np.array([whole(word) for row, size in named for word in row[1 : 1 + size]], dtype=np.int64)
    return points, triangulated(points, index, sizes)


def read_stl(data: bytes) -> Triangles:
    """Return the triangles of an STL file, text or binary; each has its own three points."""
    count = int.from_bytes(data[80:84], "little")
    text = "" if len(data) == 84 + 50 * count else decoded(data).lower()
    if "\0" not in text and ("facet" in text or (len(data) < 84 and text.lstrip().startswith("solid"))):
        pattern = r"^[^\S\n]*(?:((?:end[ \t]*)?(?:solid|facet))\b|vertex\s+(\S+)\s+(\S+)\s+(\S+))"
        found = re.findall(pattern, text, re.MULTILINE)
        words = ["".join(word.split()) or "vertex" for word, *_ in found]
        facets, vertices = words.count("facet"), [each for word, *each in found if not word]
        if words.count("endsolid") < max(1, words.count("solid")) or words.count("endfacet") != facets:
            raise ValueError("cut off before its 'endsolid'")
        if [word for word in words if "solid" not in word] != ["facet", *["vertex"] * 3, "endfacet"] * facets:
            raise ValueError(f"it has {facets} facets with {len(vertices)} vertices, not three for each")
        points = np.array([_reals(each) for each in vertices]).reshape(-1, 3)
    else:
        if len(data) < 84 + 50 * count:
            held = max(0, len(data) - 84) // 50
            raise ValueError(f"cut off: it declares {count} triangles, and has bytes for {held}")
        if len(data) >= 84 + 50 * (count + 1):
            raise ValueError(f"it declares {count} triangles, and {len(data) - 84 - 50 * count} bytes follow")
        layout = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("colour", "<u2")])
        points = np.frombuffer(data, layout, count, 84)["points"].astype(np.float64).reshape(-1, 3)
    return points, np.arange(len(points)).reshape(-1, 3)


def read_ply(data: bytes) -> Triangles:
    """Return the faces and triangle strips of a PLY file, text or binary; all else is left out."""
    elements = read_ply_elements(data)
    if "vertex" not in elements or not {"x", "y", "z"} <= elements["vertex"].keys():
        raise ValueError("it has no vertices with x, y and z")
    points = np.stack([elements["vertex"][axis].astype(np.float64) for axis in "xyz"], axis=1)
    if "range_grid" in elements and "face" not in elements:
        raise InputError("it is a range scan (range_grid) without faces; export it as a mesh")
    parts = [np.zeros((0, 3), dtype=np.int64)]
    for element, columns in elements.items():
        lists = {name: column for name, column in columns.items() if isinstance(column, tuple)}
        chosen = [name for name in ("vertex_indices", "vertex_index") if name in lists]
        if element == "face" and columns and len(chosen) != 1:
            raise ValueError("its faces have no list vertex_indices, or two of it")
        for name in chosen:
            index, sizes = lists[name]
            if element == "face":
                parts.append(triangulated(points, index.astype(np.int64), sizes))
            elif element == "tristrips":
                runs = np.split(index.astype(np.int64), np.cumsum(sizes)[:-1])
                for run in runs:  # -1 divides a strip
                    pieces = np.split(run, np.flatnonzero(run < 0))
                    parts += [strip_triangles(piece[piece >= 0]) for piece in pieces]
    return points, np.concatenate(parts)


def with_doubles(ply: bytes, points: np.ndarray) -> bytes:
    """Return trimesh's binary PLY of floats and maybe colours with other positions (V,3), as doubles."""
    end = ply.index(b"end_header\n") + len(b"end_header\n")
    header, body = ply[:end], ply[end:]
    colours = [(name, "u1") for name in ("red", "green", "blue", "alpha") if name.encode() in header]
    old = np.frombuffer(body, np.dtype([("place", "<f4", 3), *colours]), len(points))
    new = np.empty(len(points), np.dtype([("place", "<f8", 3), *colours]))
    for name, _ in colours:
        new[name] = old[name]
    new["place"] = points
    return header.replace(b"property float ", b"property double ") + new.tobytes() + body[old.nbytes :]


def read_ply_elements(data: bytes) -> dict[str, dict]:
    """Return what a PLY file holds: element → property → (n,) array, or (values, (n,) sizes) of a list.
    Raises ValueError for a damaged file."""
    data = decoded(data).encode("utf-8", "surrogateescape") if data[:2] in WIDE else data
    end = rb"[\r\n][ \t]*end_header[ \t]*(?:\r\n|\n|\r)"
    header = re.match(rb"(?:\xef\xbb\xbf)?\s*ply\s.*?" + end, data, re.DOTALL)
    if header is None:
        raise ValueError("it has no PLY header")
    lines = [line.split() for line in decoded(header[0]).split("\n")]
    form = ""
    elements: list[tuple[str, int, list[tuple[str, str, str]]]] = []
    for words in lines:
        match words:
            case ["format", form, *_]:
                pass
            case ["element", name, number]:
                elements.append((name, whole(number), []))
            case ["property", "list", size, kind, name] if elements:
                elements[-1][2].append((name, _ply_type(size), _ply_type(kind)))
            case ["property", kind, name] if elements:
                elements[-1][2].append((name, "", _ply_type(kind)))
    if min((count for _, count, _ in elements), default=0) < 0:
        raise ValueError("it declares a negative number of elements")
    named = [[name for name, *_ in elements], *([name for name, *_ in columns] for *_, columns in elements)]
    if twice := [name for names in named for name in names if names.count(name) > 1]:
        raise ValueError(f"it declares {twice[0]!r} twice")
    if form == "ascii":  # as doubles, whatever their types
        rest, order = np.array(_reals(decoded(data[header.end() :]).split())).tobytes(), ""
    elif form in ("binary_little_endian", "binary_big_endian"):
        rest, order = data[header.end() :], "<" if form == "binary_little_endian" else ">"
    else:
        raise ValueError(f"its format is {form!r}")
    found, place = {}, 0
    for name, count, columns in elements:
        found[name], place = _rows(rest, place, order, count, columns)
    left = len(rest[place:].strip(b"\r\n")) if order else (len(rest) - place) // 8
    if left:
        raise ValueError(f"it holds {left} {'bytes' if order else 'numbers'} more than it declares")
    return found


def _ply_type(name: str) -> str:
    if name not in PLY_TYPES:
        raise ValueError(f"it declares values of the type {name}, which PLY does not have")
    return PLY_TYPES[name]


def _rows(
    data: bytes, place: int, order: str, count: int, columns: list[tuple[str, str, str]]
) -> tuple[dict, int]:
    """Return the columns of an element's rows, which begin at a byte of the data, and where they end.

    order: of bytes, "<" or ">"; "" for doubles that stand for numbers of any type. A list is the values of
    all rows and their numbers. Lengths are read row by row, unless all rows are as long as the first.
    """

    def stored(kind: str) -> np.dtype:
        return np.dtype(order + kind if order else "f8")

    heads = [Struct((order or "=") + stored(size).char) if size else None for _, size, _ in columns]
    limits = [np.iinfo(size).max if size else 1 for _, size, _ in columns]
    widths = [stored(kind).itemsize for *_, kind in columns]
    cut = ValueError(f"cut off: it holds fewer {'bytes' if order else 'numbers'} than it declares")

    def walked(rows: int) -> tuple[np.ndarray, np.ndarray, int]:
        """Return each column's first byte and number of values, both (rows, columns), and the end."""
        places, lengths, end = [], [], place
        for _ in range(rows):
            for (name, size, _), head, limit, width in zip(columns, heads, limits, widths, strict=True):
                length = 1
                if head is not None:
                    if end + head.size > len(data):
                        raise cut
                    (length,) = head.unpack_from(data, end)
                    if not (0 <= length <= limit and length % 1 == 0):
                        _of_type(np.array([length]), size)
                        raise ValueError(f"a list {name} with {length:g} values")
                    end += head.size
                places.append(end)
                lengths.append(length)
                end += int(length) * width
            if end > len(data):
                raise cut
        shape = rows, len(columns)
        return np.array(places, np.int64).reshape(shape), np.array(lengths).reshape(shape), end

    if not columns or not count:
        return {
            name: (np.zeros(0), np.zeros(0, np.int64)) if size else np.zeros(0) for name, size, _ in columns
        }, place
    begins, lengths, end = walked(1)
    alike = place + count * (end - place) <= len(data)
    rows = np.arange(count if alike else 0)[:, None] * (end - place)
    for head, begin, length in zip(heads, begins[0], lengths[0], strict=True):
        if alike and head is not None:
            found = _gathered(data, begin - head.size + rows, head.size).view(head.format)
            alike = bool((found == length).all())
    if alike:
        begins, lengths, end = begins + rows, np.repeat(lengths, count, axis=0), place + count * (end - place)
    else:
        begins, lengths, end = walked(count)
    result: dict = {}
    for (name, size, kind), begin, length, width in zip(columns, begins.T, lengths.T, widths, strict=True):
        number = _of_type(length, size or "i8").astype(np.int64)
        within = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
        values = _gathered(data, (np.repeat(begin, number) + width * within)[:, None], width)
        values = _of_type(values.view(stored(kind)).reshape(-1), kind)
        result[name] = (values, number) if size else values
    return result, end


def _gathered(data: bytes, begins: np.ndarray, width: int) -> np.ndarray:
    """Return the `width` bytes from each of begins (n,1) on, (n,width) uint8."""
    return np.frombuffer(data, np.uint8)[begins + np.arange(width)]


def _of_type(values: np.ndarray, kind: str) -> np.ndarray:
    """Return the numbers; raise ValueError for one that a whole type cannot hold."""
    if values.dtype.kind == "f" and kind[0] != "f":
        limits = np.iinfo(kind)
        wrong = values[(values != np.rint(values)) | (values < limits.min) | (values > limits.max)]
        if len(wrong):
            raise ValueError(f"{wrong[0]:g} is no whole number of the type {np.dtype(kind)}")
    return values


def whole(word: str) -> int:
    """Return the whole number that a word states, as 64, 64.0 or 6.4e1. Raises ValueError for any other."""
    if "_" not in word:  # Python reads 1_0 as 10
        with suppress(ValueError):
            return int(word)
        if (value := float(word)).is_integer():
            return int(value)
    raise ValueError(f"{word} is no whole number")


def _reals(words: Sequence[str]) -> list[float]:
    """Return the words as numbers; `1_0`, which Python reads as 10, is none."""
    if "_" in "".join(words):
        raise ValueError(f"{next(word for word in words if '_' in word)!r} is no number")
    return [float(word) for word in words]


def strip_triangles(index: np.ndarray) -> np.ndarray:
    """Return the triangles (n-2,3) of a strip (n,), wound alike, without those that name a point twice."""
    faces = np.stack([index[:-2], index[1:-1], index[2:]], axis=1)
    faces[1::2] = faces[1::2, ::-1]
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)]


def triangulated(points: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the triangles (F,3) int64 of polygons: `corners`, one polygon after another, `sizes` of each.

    Polygons are cut by the fan from their first corner where its triangles do not overlap, else by ears; what
    has fewer than three corners is left out. Raises ValueError for a corner beyond the points, InputError for
    a polygon that crosses itself.
    """
    if corners.size and (corners.min() < 0 or corners.max() >= len(points)):
        wrong = corners[(corners < 0) | (corners >= len(points))][0]
        raise ValueError(f"cut off or damaged: a face refers to vertex {wrong} of {len(points)}")
    first = np.cumsum(sizes) - sizes
    number = np.maximum(sizes - 2, 0)
    place = np.cumsum(number) - number
    faces = np.empty((int(number.sum()), 3), dtype=np.int64)
    for size in np.unique(sizes[sizes > 2]).tolist():
        rows = np.flatnonzero(sizes == size)
        polygons = corners[first[rows, None] + np.arange(size)]
        later = np.arange(1, size - 1)
        fan = np.stack(
            [
                np.broadcast_to(polygons[:, :1], (len(rows), size - 2)),
                polygons[:, later],
                polygons[:, later + 1],
            ],
            axis=2,
        )
        if size == 4:
            fan[:, 1] = polygons[:, [2, 3, 0]]
        if size > 3:
            for row in np.flatnonzero(_overlapping(points, polygons)).tolist():
                fan[row] = polygons[row][_ears(points[polygons[row]])]
        faces[place[rows, None] + np.arange(size - 2)] = fan
    return faces


def _overlapping(points: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Return of which polygons (n,k) the fan from the first corner has triangles wound the other way."""
    arms = points[polygons[:, 1:]] - points[polygons[:, :1]]
    areas = np.cross(arms[:, :-1], arms[:, 1:])  # (n,k-2,3), twice the vector area of each triangle
    normal = areas.sum(axis=1)
    signed, whole_area = np.einsum("nki,ni->nk", areas, normal), (normal * normal).sum(axis=1)
    crossed = whole_area <= FLAT**2 * (areas * areas).sum(axis=(1, 2))
    return (signed < -FLAT * whole_area[:, None]).any(axis=1) | (crossed & (areas != 0).any(axis=(1, 2)))


def _ears(corners: np.ndarray) -> np.ndarray:
    """Return triangles (k-2,3) of corner numbers that cut a polygon (k,3) without overlap, by its ears."""
    arms = corners[1:] - corners[0]
    normal = np.cross(arms[:-1], arms[1:]).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    flat = np.delete(corners - corners[0], axis, axis=1)  # seen along the axis that shows most of the area
    flat[:, 1] *= np.sign(normal[axis]) * (-1.0 if axis == 1 else 1.0)
    area = abs(float(normal[axis]))
    least, left, ears, last = FLAT * area, np.arange(len(flat)), [], 0

    def turn(a, b, c):
        return (flat[b, 0] - flat[a, 0]) * (flat[c, 1] - flat[a, 1]) - (flat[b, 1] - flat[a, 1]) * (
            flat[c, 0] - flat[a, 0]
        )

    def is_ear(a: int, b: int, c: int) -> bool:
        inside = (turn(a, b, left) >= 0) & (turn(b, c, left) >= 0) & (turn(c, a, left) >= 0)
        found = flat[left[inside]]
        return bool((found[:, None] == flat[[a, b, c]]).all(axis=2).any(axis=1).all())

    while len(left) > 2:
        before, after = np.roll(left, 1), np.roll(left, -1)
        turns = turn(before, left, after)
        # Flat ears last: their corner lies on a neighbour's edge and must stay a corner.
        order = [np.flatnonzero(turns > least), np.flatnonzero((turns > -least) & (turns <= least))]
        tried = np.concatenate([np.roll(each, -int(np.searchsorted(each, last))) for each in order])
        found = next((i for i in tried.tolist() if is_ear(before[i], left[i], after[i])), None)
        if found is None:
            break
        ears.append((int(before[found]), int(left[found]), int(after[found])))
        left, last = np.delete(left, found), found
    if len(left) > 2 or abs(sum(turn(*ear) for ear in ears) - area) > 1e-6 * area:
        spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
        if spread[2 if len(corners) > 2 else 0] > BENT * spread[0]:
            return np.array([(0, i, i + 1) for i in range(1, len(corners) - 1)])
        raise InputError(
            f"it has a face of {len(corners)} corners that crosses itself; triangulate it in the "
            "program that it comes from"
        )
    return np.array(ears)
