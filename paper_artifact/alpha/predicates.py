"""Exact signs of the three geometric tests of the alpha complex: orientation, in-sphere, Gabriel.

Each is evaluated in float64 first and accepted when it exceeds a proven error bound (Shewchuk 1997); the rest
goes to double-doubles with a bound, and what is still open to exact expansions, so every sign is right for
coplanar, cospherical and lattice-like input. `points` is (n, 3) float64, scaled as ordering.normalised does;
a..e are row indices; `ws` is a workspace of expansions.WORKSPACE.

NAME_filter returns the float64 value and its bound, and is compiled into its callers: most calls end there,
and several in a row overlap in the processor. NAME_exact is the rest, out of the way. orient3d and insphere
are both together.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.alpha.expansions import MULTIPLY, Formula, evaluate, exact, recorded
from paper_artifact.kernel_cache import njit

ORIENT_BOUND = 7.7715611723761027e-16  # (7 + 56 u) u, u = 2^-53
# In units of max|dx| max|dy| max|dz| max|d|²: the largest permanent, and a bound, (16 + 224 u) u of that.
INSPHERE_UNITS, INSPHERE_BOUND = 24.0, 4.5e-14
DOT_BOUND = 1e-15  # above (5 + small) u for a sum of three products of rounded differences
# Times |u||v|²|w|² max(|u|, |v|, |w|): six terms of at most 1 in this unit, each with at most 18 u.
GABRIEL_BOUND = 1.3e-14
DD_BOUND = 1e-29  # 800 times 2^-106: more than a thousand rounding errors of double-double operations


def _insphere(formula: Formula, a: tuple, b: tuple, c: tuple, d: tuple) -> int:
    ab, cd = formula.cross(a, b), formula.cross(c, d)
    dab, abc, bcd, cda = formula.dot(d, ab), formula.dot(c, ab), formula.dot(b, cd), formula.dot(a, cd)
    lift = [formula.dot(v, v) for v in formula.inputs]
    halves = formula.minor(lift[3], abc, lift[2], dab), formula.minor(lift[1], cda, lift[0], bcd)
    return formula.total(*halves)


def _triangle(formula: Formula, u: tuple, v: tuple, w: tuple) -> int:
    uu, vv, ww = formula.dot(u, u), formula.dot(v, v), formula.dot(w, w)
    uv, uw, vw = formula.dot(u, v), formula.dot(u, w), formula.dot(v, w)
    terms = (
        (uu, formula.minor(vv, ww, vw, vw)),
        (vv, formula.minor(vw, uw, ww, uv)),
        (ww, formula.minor(uv, vw, vv, uw)),
    )
    return formula.total(*(formula.step(MULTIPLY, length, minor) for length, minor in terms))


ORIENT, _ = recorded(3, lambda formula, a, b, c: formula.dot(c, formula.cross(a, b)))
INSPHERE, _ = recorded(4, _insphere)
EDGE, _ = recorded(2, Formula.dot)
TRIANGLE, _ = recorded(3, _triangle)


@njit(cache=True, nogil=True, forceinline=True)
def orient3d_filter(points: np.ndarray, a: int, b: int, c: int, d: int) -> tuple[float, float]:
    """Return det[a-d, b-d, c-d] in float64 and a bound of its error."""
    dx, dy, dz = points[d, 0], points[d, 1], points[d, 2]
    adx, ady, adz = points[a, 0] - dx, points[a, 1] - dy, points[a, 2] - dz
    bdx, bdy, bdz = points[b, 0] - dx, points[b, 1] - dy, points[b, 2] - dz
    cdx, cdy, cdz = points[c, 0] - dx, points[c, 1] - dy, points[c, 2] - dz
    bc, cb = bdx * cdy, cdx * bdy
    ca, ac = cdx * ady, adx * cdy
    ab, ba = adx * bdy, bdx * ady
    det = adz * (bc - cb) + bdz * (ca - ac) + cdz * (ab - ba)
    permanent = (
        (abs(bc) + abs(cb)) * abs(adz) + (abs(ca) + abs(ac)) * abs(bdz) + (abs(ab) + abs(ba)) * abs(cdz)
    )
    return det, ORIENT_BOUND * permanent


@njit("float64(float64[:,::1], int64, int64, int64, int64, float64[::1])", cache=True, nogil=True)
def orient3d_exact(points: np.ndarray, a: int, b: int, c: int, d: int, ws: np.ndarray) -> float:
    """Return what orient3d does, by expansions."""
    height = points[d, 2]
    if points[a, 2] == height and points[b, 2] == height and points[c, 2] == height:
        return 0.0
    return exact(points, np.array([a, b, c, d]), ORIENT, ws, np.empty((9 + len(ORIENT), 2)))


@njit(cache=True, nogil=True, forceinline=True)
def orient3d(points: np.ndarray, a: int, b: int, c: int, d: int, ws: np.ndarray) -> float:
    """Return a number with the sign of det[a-d, b-d, c-d], 0 exactly when coplanar.

    Positive when a, b, c turn clockwise seen from d.
    """
    det, bound = orient3d_filter(points, a, b, c, d)
    return det if abs(det) > bound else orient3d_exact(points, a, b, c, d, ws)


@njit(cache=True, nogil=True, forceinline=True)
def insphere_of(differences: tuple) -> tuple[float, float]:
    """Return insphere_filter's numbers for a-e, b-e, c-e and d-e: 12 floats, x, y, z of each in turn."""
    aex, aey, aez, bex, bey, bez, cex, cey, cez, dex, dey, dez = differences
    ab, bc, cd = aex * bey - bex * aey, bex * cey - cex * bey, cex * dey - dex * cey
    da, ac, bd = dex * aey - aex * dey, aex * cey - cex * aey, bex * dey - dex * bey
    abc = aez * bc - bez * ac + cez * ab
    bcd = bez * cd - cez * bd + dez * bc
    cda = cez * da + dez * ac + aez * cd
    dab = dez * ab + aez * bd + bez * da
    alift = aex * aex + aey * aey + aez * aez
    blift = bex * bex + bey * bey + bez * bez
    clift = cex * cex + cey * cey + cez * cez
    dlift = dex * dex + dey * dey + dez * dez
    det = (dlift * abc - clift * dab) + (blift * cda - alift * bcd)
    mx = max(max(abs(aex), abs(bex)), max(abs(cex), abs(dex)))
    my = max(max(abs(aey), abs(bey)), max(abs(cey), abs(dey)))
    mz = max(max(abs(aez), abs(bez)), max(abs(cez), abs(dez)))
    return det, INSPHERE_BOUND * mx * my * mz * max(max(alift, blift), max(clift, dlift))


@njit(cache=True, nogil=True, forceinline=True)
def insphere_filter(points: np.ndarray, a: int, b: int, c: int, d: int, e: int) -> tuple[float, float]:
    """Return the in-sphere determinant in float64 and a bound of its error."""
    x, y, z = points[e, 0], points[e, 1], points[e, 2]
    return insphere_of(
        (
            *(points[a, 0] - x, points[a, 1] - y, points[a, 2] - z),
            *(points[b, 0] - x, points[b, 1] - y, points[b, 2] - z),
            *(points[c, 0] - x, points[c, 1] - y, points[c, 2] - z),
            *(points[d, 0] - x, points[d, 1] - y, points[d, 2] - z),
        )
    )


@njit(cache=True, nogil=True)
def _resolved(points: np.ndarray, rows: np.ndarray, steps: np.ndarray, bound: float, ws: np.ndarray) -> float:
    """Return a formula's value in double-doubles if it exceeds `bound`, else by expansions."""
    values = np.empty((3 * len(rows) - 3 + len(steps), 2))
    value = evaluate(points, rows, steps, values)
    return value if abs(value) > bound else exact(points, rows, steps, ws, values)


@njit(cache=True, nogil=True)
def insphere_exact(points: np.ndarray, a: int, b: int, c: int, d: int, e: int, ws: np.ndarray) -> float:
    """Return what insphere does, by double-doubles or, where they leave it open, by expansions."""
    _, bound = insphere_filter(points, a, b, c, d, e)
    open_ = DD_BOUND * INSPHERE_UNITS / INSPHERE_BOUND * bound
    return _resolved(points, np.array([a, b, c, d, e]), INSPHERE, open_, ws)


@njit(cache=True, nogil=True, forceinline=True)
def insphere(points: np.ndarray, a: int, b: int, c: int, d: int, e: int, ws: np.ndarray) -> float:
    """Return a number with the sign of the in-sphere determinant, 0 exactly when cospherical.

    Positive when e lies inside the sphere through a, b, c, d, whose orient3d must be positive.
    """
    det, bound = insphere_filter(points, a, b, c, d, e)
    return det if abs(det) > bound else insphere_exact(points, a, b, c, d, e, ws)


@njit(cache=True, nogil=True, forceinline=True)
def edge_filter(points: np.ndarray, a: int, b: int, c: int) -> tuple[float, float]:
    """Return (a-c)·(b-c), negative for c in the edge's smallest sphere, in float64 and its error's bound."""
    x = (points[a, 0] - points[c, 0]) * (points[b, 0] - points[c, 0])
    y = (points[a, 1] - points[c, 1]) * (points[b, 1] - points[c, 1])
    z = (points[a, 2] - points[c, 2]) * (points[b, 2] - points[c, 2])
    return x + y + z, DOT_BOUND * (abs(x) + abs(y) + abs(z))


@njit(cache=True, nogil=True)
def edge_exact(points: np.ndarray, a: int, b: int, c: int, ws: np.ndarray) -> float:
    """Return (a-c)·(b-c) by expansions."""
    return exact(points, np.array([a, b, c]), EDGE, ws, np.empty((6 + len(EDGE), 2)))


@njit(cache=True, nogil=True, forceinline=True)
def triangle_filter(points: np.ndarray, b: int, c: int, d: int, a: int) -> tuple[float, float]:
    """Return the Gabriel value of a and the triangle (b, c, d) in float64 and a bound of its error.

    With u, v, w = a-b, c-b, d-b and N = |u|²(v x w) + |v|²(w x u) + |w|²(u x v), which points from b to the
    circumcentre of the tetrahedron (up to twice its determinant), the value is N·(v x w). It is negative for
    a inside the smallest circumsphere of the triangle: the circumcentre lies on the far side of the triangle.
    """
    ux, uy, uz = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    vx, vy, vz = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1], points[c, 2] - points[b, 2]
    wx, wy, wz = points[d, 0] - points[b, 0], points[d, 1] - points[b, 1], points[d, 2] - points[b, 2]
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    uv, uw, vw = ux * vx + uy * vy + uz * vz, ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    value = uu * (vv * ww - vw * vw) + vv * (vw * uw - ww * uv) + ww * (uv * vw - vv * uw)
    return value, GABRIEL_BOUND * (vv * ww * np.sqrt(uu * max(uu, max(vv, ww))))


@njit(cache=True, nogil=True)
def triangle_exact(points: np.ndarray, b: int, c: int, d: int, a: int, ws: np.ndarray) -> float:
    """Return a number with the sign of the Gabriel value, by double-doubles or, if open still, expansions."""
    _, bound = triangle_filter(points, b, c, d, a)
    return _resolved(points, np.array([a, c, d, b]), TRIANGLE, DD_BOUND / GABRIEL_BOUND * bound, ws)
