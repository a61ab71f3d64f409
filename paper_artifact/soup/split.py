"""Splitting triangles whose edges are long on screen (DiffSoup `remesh_clip`).

Lengths are in NDC with x scaled by width/height, so an image is 2 units high: "1/5 of the image height" is
0.4.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.arithmetic import norm, product
from paper_artifact.kernel_cache import njit


@njit(inline="always")
def _project(matrix, point, out):
    for row in range(4):
        out[row] = (
            matrix[row, 0] * point[0] + matrix[row, 1] * point[1] + matrix[row, 2] * point[2] + matrix[row, 3]
        )


@njit(cache=True, nogil=True, error_model="numpy")
def _squared_length(a, b, aspect):
    # Squared screen length of a clip-space edge; 0 when an end lies outside the clip cube, so that the edge
    # is never split.
    for end in (a, b):
        if not end[3] > 0:
            return 0.0
        for axis in range(3):
            if abs(end[axis]) > end[3]:
                return 0.0
    dx, dy = (a[0] / a[3] - b[0] / b[3]) * aspect, a[1] / a[3] - b[1] / b[3]
    return dx * dx + dy * dy


@njit(cache=True, nogil=True, error_model="numpy")
def split_long_edges(corners, origins, wanted, matrix, aspect, limit):
    """Bisect the longest screen-space edge of each wanted triangle, and of its halves, until none exceeds
    `limit` (NDC).

    corners (T,3,3) float32 world, origins (T,) int64, wanted (T,) bool, matrix (4,4) world → clip. Returns
    (corners (T',3,3), origins (T',)): halves stay in place of the parent and at the end, both with the
    parent's origin and corner order (a, m, c) and (m, b, c). The split point is the perspective-correct image
    midpoint.
    """
    count = len(corners)
    room = count + 64
    out = np.empty((room, 3, 3), corners.dtype)
    out[:count] = corners
    source = np.empty(room, np.int64)
    source[:count] = origins
    clip = np.empty((3, 4))
    t = 0
    while t < count:
        if t < len(wanted) and not wanted[t]:
            t += 1
            continue
        for corner in range(3):
            _project(matrix, out[t, corner], clip[corner])
        longest, length = 0, -1.0
        for edge in range(3):
            squared = _squared_length(clip[edge], clip[(edge + 1) % 3], aspect)
            if squared > length:
                longest, length = edge, squared
        if not length > limit * limit:
            t += 1
            continue
        ia, ib, ic = longest, (longest + 1) % 3, (longest + 2) % 3
        a, b = clip[ia], clip[ib]
        # The image midpoint in homogeneous terms: weights 1/w of the *other* end.
        weight = a[3] / (a[3] + b[3])
        if count == room:
            room = 2 * room
            larger = np.empty((room, 3, 3), corners.dtype)
            larger[:count] = out[:count]
            out = larger
            more = np.empty(room, np.int64)
            more[:count] = source[:count]
            source = more
        for axis in range(3):
            pa, pb, pc = out[t, ia, axis], out[t, ib, axis], out[t, ic, axis]
            middle = (1.0 - weight) * pa + weight * pb
            out[t, 0, axis], out[t, 1, axis], out[t, 2, axis] = pa, middle, pc
            out[count, 0, axis], out[count, 1, axis], out[count, 2, axis] = middle, pb, pc
        source[count] = source[t]
        count += 1
    return out[:count].copy(), source[:count].copy()


def least_pieces(
    corners: np.ndarray, wanted: np.ndarray, matrix: np.ndarray, aspect: float, limit: float
) -> float:
    """Return a lower bound of the number of triangles that `split_long_edges` makes, arguments as there: a
    triangle whose edges are at most `limit` long has at most √3/4 limit² of screen area."""
    points = corners[wanted].astype(np.float64)
    clip = product(points, matrix[:, :3].T) + matrix[:, 3]
    clip = clip[((clip[..., 3] > 0) & (np.abs(clip[..., :3]).max(axis=2) <= clip[..., 3])).all(axis=1)]
    screen = clip[..., :2] / clip[..., 3:] * [aspect, 1.0]
    (ax, ay), (bx, by) = (screen[:, 1] - screen[:, 0]).T, (screen[:, 2] - screen[:, 0]).T
    return float(np.abs(ax * by - ay * bx).sum() / 2 / (3**0.5 / 4 * limit**2))


def bisected(corners: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (T+k,3,3) with the k `chosen` (indices) halved at their longest edge, and their
    origins (T+k,).

    corners (T,3,3) float32, world units. One half stays in the parent's place, the other goes to the end,
    both in the parent's orientation.
    """
    picked = corners[chosen]
    lengths = norm(picked - np.roll(picked, -1, axis=1))
    first = lengths.argmax(axis=1)
    rows = np.arange(len(picked))
    a, b, c = (picked[rows, (first + turn) % 3] for turn in (0, 1, 2))
    middle = (a + b) / 2
    halves = corners.copy()
    halves[chosen] = np.stack([a, middle, c], axis=1)
    added = np.stack([middle, b, c], axis=1)
    return np.concatenate([halves, added]), np.concatenate([np.arange(len(corners)), chosen])
