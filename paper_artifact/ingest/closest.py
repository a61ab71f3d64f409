"""The nearest point of a triangle soup, exactly, for many points that are near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.ingest.boxes import Boxes, cells_of, file_boxes
from paper_artifact.ingest.distance import squared_distance
from paper_artifact.kernel_cache import njit


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
    boxes = file_boxes(soup, 2 * within)
    triangle = _nearest(points, soup, float(within), boxes)
    if (triangle < 0).any():
        raise InputError(f"{int((triangle < 0).sum())} points are farther than {within:.6g} from the soup")
    weights = _weights(points, soup, triangle)
    return Nearest(triangle, weights, np.einsum("ij,ijk->ik", weights, soup[triangle]))


@njit(cache=True)
def _nearest(points, soup, within, boxes: Boxes):
    result = np.full(len(points), -1)
    for n in range(len(points)):
        point, best = points[n], within * within
        first, last = cells_of(point - within, point + within, boxes.origin, boxes.cell, boxes.shape)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    place = (i * boxes.shape[1] + j) * boxes.shape[2] + k
                    for position in range(boxes.start[place], boxes.start[place + 1]):
                        item = boxes.items[position]
                        outside = 0.0
                        for axis in range(3):
                            gap = max(
                                boxes.low[item, axis] - point[axis], point[axis] - boxes.high[item, axis], 0.0
                            )
                            outside += gap * gap
                        if outside > best:
                            continue
                        squared = squared_distance(point, soup[item, 0], soup[item, 1], soup[item, 2])
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
        if determinant > 0 and v >= 0 and w >= 0 and v + w <= determinant:
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
