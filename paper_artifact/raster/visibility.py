"""Forward raster on the CPU: triangle set-up, stochastic opacity masking, depth test, the list of what is
visible.

Frames. Clip space: (x, y, z, w) with w > 0 in front of the camera. NDC: xyz / w in [-1, 1], x right, y down.
Pixels: the centre of (row r, column c) has pixel coordinates (c, r) and NDC ((2c+1)/width - 1, (2r+1)/height
- 1).

Per triangle the set-up stores twelve affine coefficients in pixel coordinates relative to the first pixel of
its bounding box: three mu_i = lambda_i / w_i (lambda: screen-space barycentrics), and the NDC depth.
Perspective-correct barycentrics are b_i = mu_i / (mu_0 + mu_1 + mu_2), and 1/w is that sum. Source: Olano &
Greer, "Triangle scan conversion using 2D homogeneous coordinates" (1997); fragment semantics: DiffSoup (Tojo
et al. 2026).

A triangle's pixels are visited along the rows of its bounding box, sixteen at a time. Fragments are not kept:
whoever needs them (the list of the visible ones, the opacity gradient) visits the triangles again, which
costs less than writing them down.

Kernels are one view each, release the GIL, and share no state: the caller may run views on any number of
threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from paper_artifact.kernel_cache import njit
from paper_artifact.raster.draws import draw_lanes
from paper_artifact.raster.lanes import (
    WIDTH,
    aligned_zeros,
    bits,
    first,
    inlined,
    iota,
    load,
    lowest,
    maximum,
    select,
    splat,
    splat_int,
    store,
    to_float,
    total,
)

_BUCKETS = 512


class Planes(NamedTuple):
    """What the set-up knows of each triangle; arrays may be longer than the soup."""

    coefficients: np.ndarray  # (T,12) float32: see above, 3 × mu (constant, per column, per row), then depth
    rectangles: (
        np.ndarray
    )  # (T,4) int32 pixels: first row, last row, first column, last column; first row -1: skipped
    order: (
        np.ndarray
    )  # (T,) int32: the kept triangles, nearest first (bucketed by their nearest NDC depth); see `draw`

    @staticmethod
    def room(triangles: int) -> Planes:
        """Return uninitialised arrays for `triangles` triangles."""
        return Planes(
            np.empty((triangles, 12), np.float32),
            np.empty((triangles, 4), np.int32),
            np.empty(triangles, np.int32),
        )


class Surface(NamedTuple):
    """What is visible at each pixel (row-major index); arrays are one vector longer than the image."""

    depth: np.ndarray  # (H·W + 16,) float32 NDC, +inf where nothing is visible
    triangle: np.ndarray  # (H·W + 16,) int32: the visible triangle, -1 where there is none

    @staticmethod
    def room(size: int) -> Surface:
        """Return uninitialised arrays for `size` pixels."""
        return Surface(np.empty(size + WIDTH, np.float32), np.empty(size + WIDTH, np.int32))


class Shown(NamedTuple):
    """The visible fragments in the order of drawing: a triangle's stand together, its pixels ascend.

    Arrays are longer than the list; the sixteen places after it hold zeros.
    """

    pixel: np.ndarray  # int32
    triangle: np.ndarray  # int32
    b0: np.ndarray  # float32 barycentrics of corners 0 and 1
    b1: np.ndarray

    @staticmethod
    def room(size: int) -> Shown:
        """Return uninitialised arrays for `size` pixels."""
        room = size + 2 * WIDTH
        return Shown(
            np.empty(room, np.int32),
            np.empty(room, np.int32),
            np.empty(room, np.float32),
            np.empty(room, np.float32),
        )


@njit(cache=True, nogil=True, error_model="numpy")
def set_up_triangles(clip, height, width, planes):
    """Fill planes from clip (T,3,4) float32, the clip-space corners; return how many triangles can cover a
    pixel.

    A triangle is skipped unless all w > 0, when it lies outside one clip plane, or when it has no area in the
    image.
    """
    coefficients, rectangles, order = planes.coefficients, planes.rectangles, planes.order
    count = clip.shape[0]
    nearest = np.empty(count, np.float32)
    low, high = np.float32(1.0), np.float32(-1.0)
    kept = 0
    for t in range(count):
        rectangles[t, 0] = -1
        w0, w1, w2 = float(clip[t, 0, 3]), float(clip[t, 1, 3]), float(clip[t, 2, 3])
        if not (w0 > 0.0 and w1 > 0.0 and w2 > 0.0):
            continue
        outside = False
        for axis in range(3):
            a0, a1, a2 = float(clip[t, 0, axis]), float(clip[t, 1, axis]), float(clip[t, 2, axis])
            if (a0 > w0 and a1 > w1 and a2 > w2) or (a0 < -w0 and a1 < -w1 and a2 < -w2):
                outside = True
        if outside:
            continue
        x0 = 0.5 * width * (clip[t, 0, 0] / w0 + 1.0) - 0.5
        x1 = 0.5 * width * (clip[t, 1, 0] / w1 + 1.0) - 0.5
        x2 = 0.5 * width * (clip[t, 2, 0] / w2 + 1.0) - 0.5
        y0 = 0.5 * height * (clip[t, 0, 1] / w0 + 1.0) - 0.5
        y1 = 0.5 * height * (clip[t, 1, 1] / w1 + 1.0) - 0.5
        y2 = 0.5 * height * (clip[t, 2, 1] / w2 + 1.0) - 0.5
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if not abs(area) > 0.0:
            continue
        column0 = max(0.0, np.ceil(min(x0, x1, x2)))
        column1 = min(width - 1.0, np.floor(max(x0, x1, x2)))
        row0 = max(0.0, np.ceil(min(y0, y1, y2)))
        row1 = min(height - 1.0, np.floor(max(y0, y1, y2)))
        if not (column1 >= column0 and row1 >= row0):
            continue
        x0 -= column0
        x1 -= column0
        x2 -= column0
        y0 -= row0
        y1 -= row0
        y2 -= row0
        inverse = 1.0 / area
        a0, b0, c0 = (x1 * y2 - x2 * y1) * inverse, (y1 - y2) * inverse, (x2 - x1) * inverse
        a1, b1, c1 = (x2 * y0 - x0 * y2) * inverse, (y2 - y0) * inverse, (x0 - x2) * inverse
        a2, b2, c2 = (x0 * y1 - x1 * y0) * inverse, (y0 - y1) * inverse, (x1 - x0) * inverse
        z0, z1, z2 = clip[t, 0, 2] / w0, clip[t, 1, 2] / w1, clip[t, 2, 2] / w2
        coefficients[t, 0], coefficients[t, 1], coefficients[t, 2] = a0 / w0, b0 / w0, c0 / w0
        coefficients[t, 3], coefficients[t, 4], coefficients[t, 5] = a1 / w1, b1 / w1, c1 / w1
        coefficients[t, 6], coefficients[t, 7], coefficients[t, 8] = a2 / w2, b2 / w2, c2 / w2
        coefficients[t, 9] = a0 * z0 + a1 * z1 + a2 * z2
        coefficients[t, 10] = b0 * z0 + b1 * z1 + b2 * z2
        coefficients[t, 11] = c0 * z0 + c1 * z1 + c2 * z2
        rectangles[t, 0], rectangles[t, 1] = int(row0), int(row1)
        rectangles[t, 2], rectangles[t, 3] = int(column0), int(column1)
        nearest[t] = min(z0, z1, z2)
        low, high = min(low, nearest[t]), max(high, nearest[t])
        kept += 1
    scale = np.float32((_BUCKETS - 1) / max(high - low, np.float32(1e-12)))
    starts = np.zeros(_BUCKETS + 1, np.int32)
    for t in range(count):
        if rectangles[t, 0] >= 0:
            starts[int((nearest[t] - low) * scale) + 1] += 1
    for bucket in range(_BUCKETS):
        starts[bucket + 1] += starts[bucket]
    for t in range(count):
        if rectangles[t, 0] >= 0:
            bucket = int((nearest[t] - low) * scale)
            order[starts[bucket]] = t
            starts[bucket] += 1
    return kept


@inlined
def line(coefficients, t, y):
    """Return the eight numbers of triangle t on the row y below its first one: mu_0, mu_1, mu_2, depth at
    column 0, and per column."""
    a0, b0, c0 = coefficients[t, 0], coefficients[t, 1], coefficients[t, 2]
    a1, b1, c1 = coefficients[t, 3], coefficients[t, 4], coefficients[t, 5]
    a2, b2, c2 = coefficients[t, 6], coefficients[t, 7], coefficients[t, 8]
    az, bz, cz = coefficients[t, 9], coefficients[t, 10], coefficients[t, 11]
    return a0 + c0 * y, a1 + c1 * y, a2 + c2 * y, az + cz * y, b0, b1, b2, bz


@inlined
def along(of_line, x):
    """Return mu_0, mu_1, mu_2 and depth of a `line` at columns x (float32 lanes, from the triangle's first
    column on)."""
    e0, e1, e2, ez, b0, b1, b2, bz = of_line
    return e0 + b0 * x, e1 + b1 * x, e2 + b2 * x, ez + bz * x


@inlined
def inside(values):
    """Return the mask of values (see `along`) inside the triangle and the depth range."""
    m0, m1, m2, z = values
    return (m0 >= 0.0) & (m1 >= 0.0) & (m2 >= 0.0) & (z >= -1.0) & (z <= 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def draw(planes, kept, opacity, width, key, stochastic, surface):
    """Draw the first `kept` triangles of planes.order front to back into surface; return how many of them met
    no nearer survivor.

    Those come first in planes.order afterwards, in the same order. opacity (T,3) float32 in [0,1]; width in
    pixels. A fragment survives iff alpha >= u, with u the hash draw of (key, pixel, triangle) when
    stochastic, else .5; the nearest survivor is visible.
    """
    order, coefficients, rectangles = planes.order, planes.coefficients, planes.rectangles
    depth, triangle = surface.depth, surface.triangle
    depth[:] = np.float32(np.inf)
    triangle[:] = -1
    met = 0
    for k in range(kept):
        t = order[k]
        row0, row1, column0 = rectangles[t, 0], rectangles[t, 1], rectangles[t, 2]
        columns = rectangles[t, 3] - column0 + 1
        o0, o1, o2 = opacity[t, 0], opacity[t, 1], opacity[t, 2]
        meets = False
        for row in range(row0, row1 + 1):
            of_line = line(coefficients, t, np.float32(row - row0))
            for column in range(0, columns, WIDTH):
                m0, m1, m2, z = values = along(of_line, to_float(iota() + column))
                pixel = row * width + column0 + column
                nearest = load(depth, pixel)
                in_front = inside(values) & first(columns - column) & (z < nearest)
                if bits(in_front) == 0:
                    continue
                meets = True
                inverse = 1.0 / (m0 + m1 + m2)
                w0, w1 = m0 * inverse, m1 * inverse
                alpha = w0 * o0 + w1 * o1 + (1.0 - w0 - w1) * o2
                threshold = splat(0.5)
                if stochastic:
                    threshold = draw_lanes(key, iota() + pixel, t)
                survives = in_front & (alpha >= threshold)
                store(depth, pixel, select(survives, z, nearest))
                store(triangle, pixel, select(survives, t, load(triangle, pixel)))
        if meets:
            order[met] = t
            met += 1
    return met


@njit(cache=True, nogil=True, error_model="numpy")
def list_visible(planes, met, width, surface, shown):
    """Fill shown from a drawn surface; return the number of visible fragments. met: what `draw` returned;
    width in pixels."""
    order, coefficients, rectangles = planes.order, planes.coefficients, planes.rectangles
    triangle = surface.triangle
    shown_pixel, shown_triangle, shown_b0, shown_b1 = shown
    weights, count = aligned_zeros(2 * WIDTH), 0
    for place in range(met):
        t = order[place]
        row0, row1, column0 = rectangles[t, 0], rectangles[t, 1], rectangles[t, 2]
        columns = rectangles[t, 3] - column0 + 1
        for row in range(row0, row1 + 1):
            for column in range(0, columns, WIDTH):
                pixel = row * width + column0 + column
                mine = (load(triangle, pixel) == t) & first(columns - column)
                if bits(mine) == 0:
                    continue
                of_line = line(coefficients, t, np.float32(row - row0))
                m0, m1, m2, _ = along(of_line, to_float(iota() + column))
                inverse = 1.0 / (m0 + m1 + m2)
                store(weights, 0, m0 * inverse)
                store(weights, WIDTH, m1 * inverse)
                left = bits(mine)
                while left:
                    k = lowest(left)
                    shown_pixel[count], shown_triangle[count] = pixel + k, t
                    shown_b0[count], shown_b1[count] = weights[k], weights[WIDTH + k]
                    left &= left - 1
                    count += 1
    store(shown_pixel, count, splat_int(0))
    store(shown_triangle, count, splat_int(0))
    store(shown_b0, count, splat(0.0))
    store(shown_b1, count, splat(0.0))
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def opacity_backward(planes, met, opacity, width, surface, error, weight, opacity_gradient):
    """Add the opacity gradient of one view to opacity_gradient (T,3) float32 (DiffSoup, path 2).

    planes, met, opacity, width, surface: as drawn (`draw`); error (H·W + 16,) float32: sum over
    channels of |colour - target|. The visible fragment's alpha gets +error / max(alpha, 1e-5), every other
    fragment in front of it -error / max(1 - alpha, 1e-5), times `weight`; spread to the corners by the
    barycentrics.
    """
    order, coefficients, rectangles = planes.order, planes.coefficients, planes.rectangles
    depth, triangle = surface.depth, surface.triangle
    for k in range(met):
        t = order[k]
        row0, row1, column0 = rectangles[t, 0], rectangles[t, 1], rectangles[t, 2]
        columns = rectangles[t, 3] - column0 + 1
        o0, o1, o2 = opacity[t, 0], opacity[t, 1], opacity[t, 2]
        g0, g1, g2 = splat(0.0), splat(0.0), splat(0.0)
        for row in range(row0, row1 + 1):
            of_line = line(coefficients, t, np.float32(row - row0))
            for column in range(0, columns, WIDTH):
                m0, m1, m2, z = values = along(of_line, to_float(iota() + column))
                pixel = row * width + column0 + column
                visible = load(triangle, pixel) == t
                reached = inside(values) & first(columns - column) & (visible | (z < load(depth, pixel)))
                if bits(reached) == 0:
                    continue
                inverse = select(reached, 1.0 / (m0 + m1 + m2), 0.0)  # elsewhere 1/w may be 0
                w0, w1 = m0 * inverse, m1 * inverse
                w2 = 1.0 - w0 - w1
                alpha = w0 * o0 + w1 * o1 + w2 * o2
                chance = select(visible, maximum(alpha, 1e-5), -maximum(1.0 - alpha, 1e-5))
                value = select(reached, load(error, pixel) / chance, 0.0)
                g0 += w0 * value
                g1 += w1 * value
                g2 += w2 * value
        opacity_gradient[t, 0] += weight * total(g0)
        opacity_gradient[t, 1] += weight * total(g1)
        opacity_gradient[t, 2] += weight * total(g2)
