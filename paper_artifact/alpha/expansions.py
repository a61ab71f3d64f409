"""Exact arithmetic for the geometric predicates: double-double numbers and floating-point expansions.

A formula is written once, as a `Formula` of sums and products of coordinate differences, and evaluated in
either arithmetic by a small interpreter: the rare path stays short to compile.

An expansion is a sum of doubles, smallest first, that do not overlap: it holds a real number exactly
(Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates", 1997). A
double-double is the rounded sum of two. Exact as long as nothing over- or underflows: the caller scales
coordinates to about 1 and keeps them multiples of 2^-120 (ordering.normalised).

Expansions live in a workspace `ws` (float64); register r of a formula is `loc[r] = (offset, length)`, a zero
has length 0.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, reduce

import numpy as np

from paper_artifact.kernel_cache import njit

# Doubles of a workspace; the longest expansion (a Gabriel sign with nothing cancelling) needs half of it.
WORKSPACE = 1 << 21
SPLITTER = 134217729.0  # 2^27 + 1: splits a double into two halves (Dekker)


@njit(cache=True, nogil=True)
def two_sum(a: float, b: float) -> tuple[float, float]:
    """Return (s, e) with s = fl(a + b) and s + e = a + b exactly."""
    s = a + b
    bb = s - a
    return s, (a - (s - bb)) + (b - bb)


@njit(cache=True, nogil=True)
def two_product(a: float, b: float) -> tuple[float, float]:
    """Return (p, e) with p = fl(a b) and p + e = a b exactly (Dekker)."""
    p = a * b
    t = SPLITTER * a
    ah = t - (t - a)
    al = a - ah
    t = SPLITTER * b
    bh = t - (t - b)
    bl = b - bh
    return p, al * bl - (((p - ah * bh) - al * bh) - ah * bl)


@njit(cache=True, nogil=True)
def dd_add(x: tuple[float, float], y: tuple[float, float]) -> tuple[float, float]:
    """Return the sum of two double-doubles; relative error below 2^-103."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    e += t
    h = s + e
    e = e - (h - s) + f
    s = h + e
    return s, e - (s - h)


@njit(cache=True, nogil=True)
def dd_mul(x: tuple[float, float], y: tuple[float, float]) -> tuple[float, float]:
    """Return the product of two double-doubles; relative error below 2^-102."""
    p, e = two_product(x[0], y[0])
    e += x[0] * y[1] + x[1] * y[0]
    s = p + e
    return s, e - (s - p)


@njit(cache=True, nogil=True, forceinline=True)
def _append(ws: np.ndarray, place: int, value: float) -> int:
    """Write a value that is not 0 to ws[place]; return the place of the next."""
    if value == 0.0:
        return place
    ws[place] = value
    return place + 1


@njit(cache=True, nogil=True)
def _sum(ws: np.ndarray, e: int, ne: int, f: int, nf: int, h: int) -> int:
    """Write the sum of two expansions to ws[h:], zeros left out; return its length (Shewchuk, fast sum)."""
    i = j = 0
    place = h
    q = 0.0
    for _ in range(ne + nf):
        if j >= nf or (i < ne and abs(ws[e + i]) < abs(ws[f + j])):
            term = ws[e + i]
            i += 1
        else:
            term = ws[f + j]
            j += 1
        q, low = two_sum(q, term)
        place = _append(ws, place, low)
    return _append(ws, place, q) - h


@njit(cache=True, nogil=True)
def _scale(ws: np.ndarray, e: int, ne: int, b: float, h: int) -> int:
    """Write b times an expansion to ws[h:], zeros left out; return its length."""
    if ne == 0 or b == 0.0:
        return 0
    q, low = two_product(ws[e], b)
    place = _append(ws, h, low)
    for i in range(1, ne):
        p, p_low = two_product(ws[e + i], b)
        q, low = two_sum(q, p_low)
        place = _append(ws, place, low)
        q, low = two_sum(p, q)
        place = _append(ws, place, low)
    return _append(ws, place, q) - h


ADD, SUBTRACT, MULTIPLY = 0, 1, 2


class Formula:
    """A polynomial of difference vectors, recorded as steps (operation, register, register, result)."""

    def __init__(self, vectors: int) -> None:
        """Begin with `vectors` difference vectors as inputs; vector i has the registers 3i, 3i+1, 3i+2."""
        self.inputs = [(3 * i, 3 * i + 1, 3 * i + 2) for i in range(vectors)]
        self.rows: list[tuple[int, int, int, int]] = []

    def step(self, operation: int, i: int, j: int) -> int:
        """Record `i operation j` and return its register."""
        self.rows.append((operation, i, j, 3 * len(self.inputs) + len(self.rows)))
        return self.rows[-1][3]

    def minor(self, a: int, b: int, c: int, d: int) -> int:
        """Record a b - c d and return its register."""
        return self.step(SUBTRACT, self.step(MULTIPLY, a, b), self.step(MULTIPLY, c, d))

    def cross(self, u: tuple, v: tuple) -> tuple[int, int, int]:
        """Record the cross product of two vectors and return its registers."""
        return (
            self.minor(u[1], v[2], u[2], v[1]),
            self.minor(u[2], v[0], u[0], v[2]),
            self.minor(u[0], v[1], u[1], v[0]),
        )

    def total(self, *terms: int) -> int:
        """Record the sum of registers and return its register."""
        return reduce(partial(self.step, ADD), terms)

    def dot(self, u: tuple, v: tuple) -> int:
        """Record the dot product of two vectors and return its register."""
        return self.total(*(self.step(MULTIPLY, a, b) for a, b in zip(u, v, strict=True)))


def recorded(vectors: int, write: Callable) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps (s, 4) int64 that write(formula, *inputs) records and the registers int64 it returns.

    The value of the formula is the result of the last step.
    """
    formula = Formula(vectors)
    registers = write(formula, *formula.inputs)
    return np.array(formula.rows, dtype=np.int64), np.array(registers, dtype=np.int64)


@njit(cache=True, nogil=True)
def _multiply(ws: np.ndarray, loc: np.ndarray, i: int, j: int, top: int) -> int:
    """Write register i times register j to ws[top:]; return its length."""
    e, ne, f, nf = loc[i, 0], loc[i, 1], loc[j, 0], loc[j, 1]
    if ne < nf:
        e, ne, f, nf = f, nf, e, ne
    room = 2 * ne * nf
    here, other, scaled = top, top + room, top + 2 * room
    n = np.int64(0)  # a plain 0 is a type of its own, for which _sum would be compiled again
    for k in range(nf):
        m = _scale(ws, e, ne, ws[f + k], scaled)
        n = _sum(ws, here, n, scaled, m, other)
        here, other = other, here
    if here != top:
        for k in range(n):
            ws[top + k] = ws[here + k]
    return int(n)


@njit(cache=True, nogil=True)
def exact(
    points: np.ndarray, rows: np.ndarray, steps: np.ndarray, ws: np.ndarray, values: np.ndarray
) -> float:
    """Return a formula of the vectors points[rows[i]] - points[rows[-1]], exact and then rounded.

    The sign is right, the relative error below 2^-51. values: (registers, 2) float64, filled with every
    step's rounded value (and 0).
    """
    vectors = len(rows) - 1
    loc = np.empty((3 * vectors + len(steps), 2), dtype=np.int64)
    top = np.int64(0)
    for i in range(vectors):
        for k in range(3):
            high, low = two_sum(points[rows[i], k], -points[rows[vectors], k])
            loc[3 * i + k, 0] = top
            top = _append(ws, _append(ws, top, low), high)
            loc[3 * i + k, 1] = top - loc[3 * i + k, 0]
    out = 0
    for s in range(len(steps)):
        operation, i, j, out = steps[s, 0], steps[s, 1], steps[s, 2], steps[s, 3]
        if operation == MULTIPLY:
            n = _multiply(ws, loc, i, j, top)
        else:
            f = loc[j, 0]
            if operation == SUBTRACT:
                f = top
                top += loc[j, 1]
                for k in range(loc[j, 1]):
                    ws[f + k] = -ws[loc[j, 0] + k]
            n = _sum(ws, loc[i, 0], loc[i, 1], f, loc[j, 1], top)
        loc[out, 0], loc[out, 1] = top, n
        top += n
        total = 0.0
        for k in range(max(0, n - 4), n):  # components do not overlap: the last ones are the number
            total += ws[top - n + k]
        values[out, 0], values[out, 1] = total, 0.0
    return values[out, 0]


@njit(cache=True, nogil=True)
def evaluate(points: np.ndarray, rows: np.ndarray, steps: np.ndarray, values: np.ndarray) -> float:
    """Return a formula of the vectors points[rows[i]] - points[rows[-1]] in double-doubles, rounded.

    values: (registers, 2) float64, filled with every register's value. The vectors themselves are exact.
    """
    vectors = len(rows) - 1
    for i in range(vectors):
        for k in range(3):
            value = two_sum(points[rows[i], k], -points[rows[vectors], k])
            values[3 * i + k, 0], values[3 * i + k, 1] = value
    out = 0
    for s in range(len(steps)):
        operation, i, j, out = steps[s, 0], steps[s, 1], steps[s, 2], steps[s, 3]
        x, y = (values[i, 0], values[i, 1]), (values[j, 0], values[j, 1])
        if operation == SUBTRACT:
            y = -y[0], -y[1]
        values[out, 0], values[out, 1] = dd_mul(x, y) if operation == MULTIPLY else dd_add(x, y)
    return values[out, 0]
