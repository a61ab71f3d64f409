"""Distances to a triangle soup: on a regular grid in a narrow band, and the nearest point of given points.

For every triangle the grid points that can lie within the band are visited (its bounding box, cut to the slab
around its plane) and the exact point–triangle distance (Ericson 2005, Real-Time Collision Detection, §5.1.5)
is minimised; beyond the band the field is the band. No sign, no ray, no winding: the soup may be open,
overlapping and non-manifold. `Boxes` lists which triangles come near a place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.kernel_cache import njit

MOST_CELLS = 4_000_000
FLAT = 1e-12  # squared sine of a triangle's angle below which rounding says where its inside is


class Boxes(NamedTuple):
    """Bounding boxes of n things, filed under every grid cell that they meet."""

    low: np.ndarray  # (n,3) float64 lower corners
    high: np.ndarray  # (n,3) float64 upper corners
    origin: np.ndarray  # (3,) float64 of the grid
    cell: float  # its spacing
    shape: np.ndarray  # (3,) int64 cells per axis
    start: np.ndarray  # (cells + 1,) int64: cell c, counted in C order, holds items[start[c]:start[c + 1]]
    items: np.ndarray  # (filed,) int64 indices of boxes


def file_boxes(corners: np.ndarray, cell: float) -> Boxes:
    """Return the Boxes of corners (n,k,3) float64; cell: the spacing wished for, same unit, raised where the
    grid would have more than MOST_CELLS cells."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    origin = low.min(axis=0)
    extent = high.max(axis=0) - origin
    cell = max(float(cell), float(extent.max()) * 1e-3, 1e-300)
    while np.prod(extent / cell + 1) > MOST_CELLS:
        cell *= 1.3
    shape = (extent / cell).astype(np.int64) + 1
    start, items = _file(low, high, origin, cell, shape)
    return Boxes(low, high, origin, cell, shape, start, items)


@njit(cache=True)
def _cells_of(low, high, origin, cell, shape):
    """Return the first and last cell (3,) int64 per axis that a box meets; first > last outside of all."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        first[axis] = max(0, int(np.floor((low[axis] - origin[axis]) / cell)))
        last[axis] = min(shape[axis] - 1, int(np.floor((high[axis] - origin[axis]) / cell)))
    return first, last


@njit(cache=True)
def items_near(boxes, low, high):
    """Return the boxes (n,) int64 filed in the cells that the box from `low` to `high` meets, some several
    times."""
    first, last = _cells_of(low, high, boxes.origin, boxes.cell, boxes.shape)
    found, count = np.empty(64, np.int64), 0
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                place = (i * boxes.shape[1] + j) * boxes.shape[2] + k
                begin, end = boxes.start[place], boxes.start[place + 1]
                if count + end - begin > len(found):
                    found = np.concatenate((found, np.empty(len(found) + end - begin, np.int64)))
                found[count : count + end - begin] = boxes.items[begin:end]
                count += end - begin
    return found[:count]


@njit(cache=True)
def _file(low, high, origin, cell, shape):
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.int64)
    items = np.empty(0, dtype=np.int64)
    for turn in range(2):  # count, then fill from the back
        if turn == 1:
            start = np.cumsum(start)
            items = np.empty(start[-1], dtype=np.int64)
        for back in range(len(low)):
            n = len(low) - 1 - back
            first, last = _cells_of(low[n], high[n], origin, cell, shape)
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    for k in range(first[2], last[2] + 1):
                        place = (i * shape[1] + j) * shape[2] + k
                        if turn == 0:
                            start[place] += 1
                        else:
                            start[place] -= 1
                            items[start[place]] = n
    return start, items


MOST_POINTS = 400_000_000  # grid points, 1.6 GB


def distance_grid(
    vertices: np.ndarray, faces: np.ndarray, cell: float, band: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (nx,ny,nz) float32, at most `band`, to vertices (V,3) float64 and faces (F,3) int64 on
    a grid, and its origin (3,) float64: point (i,j,k) lies at origin + cell·(i,j,k). All in world units.

    The grid exceeds the bounding box by the band and two cells. Raises InputError when it would be too large,
    or sizes are not positive.
    """
    if not (np.isfinite([cell, band]).all() and cell > 0 and band > 0):
        raise InputError(f"grid spacing and band must be positive lengths, got {cell} and {band}")
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    margin = band + 2 * cell
    shape = np.ceil((high - low + 2 * margin) / cell).astype(np.int64) + 1
    if float(np.prod(shape.astype(np.float64))) > MOST_POINTS:
        raise InputError(
            f"the grid would have {' × '.join(map(str, shape))} points; "
            "take a larger offset or fewer cells per offset"
        )
    # A fraction of a cell that no symmetric model repeats, so that faces rarely fall on grid planes.
    origin = low - margin - cell * np.array([0.137, 0.291, 0.419])
    values = np.full(tuple(shape + 1), band, dtype=np.float32)
    # Every 16th triangle first: the others then find most points nearer to one of these, and pass them over.
    order = np.concatenate([np.arange(first, len(faces), 16) for first in range(16)])
    _minimise(values, (vertices[faces[order]] - origin) / cell, band / cell, cell)
    return values, origin


@njit(cache=True)
def _minimise(values, corners, band, cell):
    """Lower `values` (world units) to the distance of each triangle of `corners` (F,3,3), in grid units."""
    shape, flat = values.shape, values.reshape(-1)
    steps = (shape[1] * shape[2], shape[2], 1)
    point = np.empty(3)
    for face in range(len(corners)):
        a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
        normal = np.cross(b - a, c - a)
        length = np.sqrt((normal * normal).sum())
        if length * length <= FLAT * ((b - a) ** 2).sum() * ((c - a) ** 2).sum():
            length = 0.0
        inner = 0  # the axis that the normal is closest to: along it the slab is thinnest
        for axis in (1, 2):
            if abs(normal[axis]) > abs(normal[inner]):
                inner = axis
        first, second = (inner + 1) % 3, (inner + 2) % 3
        middle = (a + b + c) / 3
        size = np.sqrt(max(((a - middle) ** 2).sum(), ((b - middle) ** 2).sum(), ((c - middle) ** 2).sum()))
        low, high = np.empty(3, np.int64), np.empty(3, np.int64)
        for axis in range(3):
            low[axis] = max(0, int(np.ceil(min(a[axis], b[axis], c[axis]) - band)))
            high[axis] = min(shape[axis] - 1, int(np.floor(max(a[axis], b[axis], c[axis]) + band)))
        for i in range(low[first], high[first] + 1):
            point[first] = i
            for j in range(low[second], high[second] + 1):
                point[second] = j
                start, stop = low[inner], high[inner]
                height, share = 0.0, 0.0
                if length > 0:
                    height = (
                        a[inner]
                        - ((i - a[first]) * normal[first] + (j - a[second]) * normal[second]) / normal[inner]
                    )
                    half = band * length / abs(normal[inner]) + 1e-9
                    share = normal[inner] / length
                    start = max(start, int(np.ceil(max(height - half, -1.0))))
                    stop = min(stop, int(np.floor(min(height + half, shape[inner] + 0.0))))
                column = (i - middle[first]) ** 2 + (j - middle[second]) ** 2
                for k in range(start, stop + 1):
                    place = i * steps[first] + j * steps[second] + k * steps[inner]
                    # Passed over where what is known is less than the distance to a disc around the triangle
                    # in its plane, by more than rounding.
                    known, above = flat[place] / cell, (k - height) * share
                    rest = known * known * (1 + 1e-6) + 1e-9 - above * above
                    if rest < 0:
                        continue
                    beside = column + (k - middle[inner]) ** 2 - above * above
                    reach = size + np.sqrt(rest) + 1e-6
                    if beside > reach * reach:
                        continue
                    point[inner] = k
                    distance = np.float32(np.sqrt(_squared_distance(point, a, b, c)) * cell)
                    if distance < flat[place]:
                        flat[place] = distance


@njit(cache=True)
def _squared_distance(p, a, b, c):
    """Return the squared distance of point p to triangle abc, (3,) float64 each, also for flat triangles."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    bb, cc, bc = (
        abx * abx + aby * aby + abz * abz,
        acx * acx + acy * acy + acz * acz,
        abx * acx + aby * acy + abz * acz,
    )
    bp, cp = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    determinant = bb * cc - bc * bc
    v, w = cc * bp - bc * cp, bb * cp - bc * bp
    if determinant > FLAT * bb * cc and v >= 0 and w >= 0 and v + w <= determinant:
        nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
        across = nx * apx + ny * apy + nz * apz
        return across * across / determinant
    return min(_squared_to_segment(p, a, b), min(_squared_to_segment(p, b, c), _squared_to_segment(p, c, a)))


@njit(cache=True)
def _squared_to_segment(p, a, b):
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    px, py, pz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    length = x * x + y * y + z * z
    t = 0.0 if length == 0 else min(1.0, max(0.0, (x * px + y * py + z * pz) / length))
    dx, dy, dz = px - t * x, py - t * y, pz - t * z
    return dx * dx + dy * dy + dz * dz


@dataclass(frozen=True, eq=False)
class Nearest:
    """Of n points, where on a soup of T triangles each one's nearest point lies."""

    triangle: np.ndarray  # (n,) int64
    weights: np.ndarray  # (n,3) float64 barycentric coordinates there
    points: np.ndarray  # (n,3) float64, world units


def nearest_on(soup: np.ndarray, points: np.ndarray, within: float) -> Nearest:
    """Return the Nearest of points (n,3) on the triangles soup (T,3,3), float64, all in world units.

    Of equally near triangles the first counts. Raises InputError where a point is farther than `within`.
    """
    soup, points = np.ascontiguousarray(soup), np.ascontiguousarray(points)
    boxes = file_boxes(soup, within)
    triangle = _nearest(points, soup, float(within), boxes)
    if (triangle < 0).any():
        raise InputError(f"{int((triangle < 0).sum())} points are farther than {within:.6g} from the soup")
    weights = _weights(points, soup, triangle)
    return Nearest(triangle, weights, np.einsum("ij,ijk->ik", weights, soup[triangle]))


@njit(cache=True)
def _nearest(points: np.ndarray, soup: np.ndarray, within: float, boxes: Boxes) -> np.ndarray:
    result = np.full(len(points), -1)
    for n in range(len(points)):
        point, best, reach = points[n], within * within, within
        if n > 0 and result[n - 1] >= 0:  # neighbours follow each other: a bound for most others
            corners = soup[result[n - 1]]
            squared = _squared_distance(point, corners[0], corners[1], corners[2])
            if squared < best:
                best, result[n] = squared, result[n - 1]
                reach = min(within, np.sqrt(squared) * (1 + 1e-9))
        for item in items_near(boxes, point - reach, point + reach):
            outside = 0.0
            for axis in range(3):
                gap = max(boxes.low[item, axis] - point[axis], point[axis] - boxes.high[item, axis], 0.0)
                outside += gap * gap
            if outside > best:
                continue
            squared = _squared_distance(point, soup[item, 0], soup[item, 1], soup[item, 2])
            if squared < best or (squared == best and (result[n] < 0 or item < result[n])):
                best = squared
                result[n] = item
    return result


@njit(cache=True)
def _weights(points, soup, triangle):
    """Return the barycentric coordinates (n,3) of the nearest point on the given triangle of each point."""
    result = np.zeros((len(points), 3))
    for n in range(len(points)):
        p, corners = points[n], soup[triangle[n]]
        ab, ac, ap = corners[1] - corners[0], corners[2] - corners[0], p - corners[0]
        bb, cc, bc = (ab * ab).sum(), (ac * ac).sum(), (ab * ac).sum()
        bp, cp = (ab * ap).sum(), (ac * ap).sum()
        determinant = bb * cc - bc * bc
        v, w = cc * bp - bc * cp, bb * cp - bc * bp
        if determinant > FLAT * bb * cc and v >= 0 and w >= 0 and v + w <= determinant:
            result[n, 1], result[n, 2] = v / determinant, w / determinant
            result[n, 0] = 1 - result[n, 1] - result[n, 2]
            continue
        best = np.inf
        for i in range(3):
            j = (i + 1) % 3
            side, to = corners[j] - corners[i], p - corners[i]
            length = (side * side).sum()
            t = 0.0 if length == 0 else min(1.0, max(0.0, (side * to).sum() / length))
            rest = to - t * side
            squared = (rest * rest).sum()
            if squared < best:
                best = squared
                result[n] = 0.0
                result[n, i], result[n, j] = 1 - t, t
    return result
