"""Boxes on a regular grid: which of them come near a place. For searches among triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from paper_artifact.kernel_cache import njit

MOST_CELLS = 4_000_000


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
def cells_of(low, high, origin, cell, shape):
    """Return the first and last cell (3,) int64 per axis that a box meets; first > last outside of all."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        first[axis] = max(0, int(np.floor((low[axis] - origin[axis]) / cell)))
        last[axis] = min(shape[axis] - 1, int(np.floor((high[axis] - origin[axis]) / cell)))
    return first, last


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
            first, last = cells_of(low[n], high[n], origin, cell, shape)
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
