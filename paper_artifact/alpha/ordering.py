"""Scaling, insertion order and sorting for the alpha complex: all deterministic."""

from __future__ import annotations

import numpy as np

from paper_artifact.kernel_cache import njit

ROUNDS = 5  # biased randomised rounds: the last holds half of the points, the one before a quarter, ...
HILBERT_BITS = 16  # per axis
DIGIT, FIRST = 11, 3  # bits of a digit of a sort key, digits sorted by at first


def normalised(points: np.ndarray) -> tuple[np.ndarray, int]:
    """Return (scaled points, exponent) with points = 2^exponent * scaled.

    Scaled coordinates lie in [-1, 1] and are multiples of 2^-120. points: (n, 3) float64, finite. The
    products of the exact predicates then neither over- nor underflow. Scaling is exact; only coordinates
    below 2^-67 of the largest are rounded, by at most 2^-121 of it, which moves no bar by more: points closer
    than that may become one point, and the bars between them vanish.
    """
    exponent = int(np.frexp(np.abs(points).max(initial=0.0))[1])
    scaled = np.ldexp(points, -exponent)
    small = np.abs(scaled) < 2.0**-67
    scaled[small] = (scaled[small] + 2.0**-68) - 2.0**-68
    return scaled, exponent


@njit(cache=True, nogil=True)
def grown(array: np.ndarray, size: int) -> np.ndarray:
    """Return `array` (m,) int32 in a new array of `size` >= m, whose other values are not set."""
    larger = np.empty(size, dtype=np.int32)
    for i in range(len(array)):  # a slice assignment takes seconds to compile
        larger[i] = array[i]
    return larger


@njit("int32[::1](uint64[::1])", cache=True, nogil=True)
def sort_keys(keys: np.ndarray) -> np.ndarray:
    """Return the stable increasing order (n,) int32 of (n,) uint64 `keys`.

    A radix sort by the first FIRST digits of DIGIT bits in which keys differ, then insertions; by all digits
    where keys that differ further behind would take many of those.
    """
    n = len(keys)
    differ = np.uint64(0)
    for i in range(n):
        differ |= keys[i] ^ keys[0]
    top = 0  # bits up to the first that differs
    while top < 64 and differ >> np.uint64(top):
        top += 1
    order, other_order = np.arange(n).astype(np.int32), np.empty(n, dtype=np.int32)
    here, other = keys.copy(), np.empty(n, dtype=np.uint64)
    counts = np.empty(1 << DIGIT, dtype=np.int32)
    for first in (max(0, top - FIRST * DIGIT), 0):
        for low in range(first, top, DIGIT):
            shift, mask = np.uint64(low), np.uint64(len(counts) - 1)
            for value in range(len(counts)):
                counts[value] = 0
            for k in range(n):
                counts[(here[k] >> shift) & mask] += 1
            total = 0
            for value in range(len(counts)):
                size = counts[value]
                counts[value] = total
                total += size
            for k in range(n):
                value = (here[k] >> shift) & mask
                place = counts[value]
                counts[value] += 1
                other[place] = here[k]
                other_order[place] = order[k]
            here, other = other, here
            order, other_order = other_order, order
        moves = 0
        for k in range(1, n):
            key, name, place = here[k], order[k], k
            while place > 0 and here[place - 1] > key:
                here[place], order[place] = here[place - 1], order[place - 1]
                place -= 1
            here[place], order[place] = key, name
            moves += k - place
            if moves > 4 * n:
                break
        else:
            return order
    return order


@njit("uint64[::1](int64[:,::1])", cache=True, nogil=True)
def _hilbert(cells: np.ndarray) -> np.ndarray:
    """Return the Hilbert indices (n,) of cells (n, 3) with HILBERT_BITS bits per axis (Skilling 2004)."""
    indices = np.empty(len(cells), dtype=np.uint64)
    for i in range(len(cells)):
        x, y, z = cells[i, 0], cells[i, 1], cells[i, 2]
        for bit in range(HILBERT_BITS - 1, 0, -1):
            p = (1 << bit) - 1
            x ^= p if (x >> bit) & 1 else 0
            x, y = (x ^ p, y) if (y >> bit) & 1 else (x ^ ((x ^ y) & p), y ^ ((x ^ y) & p))
            x, z = (x ^ p, z) if (z >> bit) & 1 else (x ^ ((x ^ z) & p), z ^ ((x ^ z) & p))
        y ^= x
        z ^= y
        t = 0
        for bit in range(HILBERT_BITS - 1, 0, -1):
            t ^= (1 << bit) - 1 if (z >> bit) & 1 else 0
        x, y, z = x ^ t, y ^ t, z ^ t
        index = 0
        for bit in range(HILBERT_BITS - 1, -1, -1):
            index = (index << 3) | ((x >> bit) & 1) << 2 | ((y >> bit) & 1) << 1 | ((z >> bit) & 1)
        indices[i] = index
    return indices


def hilbert_indices(points: np.ndarray) -> np.ndarray:
    """Return the places (n,) uint64 of `points` (n, 3) float64, n > 0, on the Hilbert curve of their box."""
    low = points.min(axis=0)
    extent = float((points.max(axis=0) - low).max())
    scale = ((1 << HILBERT_BITS) - 1) / extent if extent > 0.0 else 0.0
    return _hilbert(((points - low) * scale).astype(np.int64))


@njit("int32[::1](uint64[::1])", cache=True, nogil=True)
def insertion_order(indices: np.ndarray) -> np.ndarray:
    """Return the order (n,) int32 in which to insert points at `indices` (n,) uint64 of the Hilbert curve.

    Biased randomised insertion order (Amenta, Choi & Rote 2003): a hash of the point's number spreads the
    points over rounds that double in size, and each round follows the curve, so the next point is close to
    the last.
    """
    n = len(indices)
    keys = np.empty(n, dtype=np.uint64)
    for i in range(n):
        bits = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)  # splitmix64
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits ^= bits >> np.uint64(31)
        level = 0
        while level < ROUNDS and (bits >> np.uint64(level)) & np.uint64(1):
            level += 1
        keys[i] = np.uint64(ROUNDS - level) << np.uint64(3 * HILBERT_BITS) | indices[i]
    return sort_keys(keys)
