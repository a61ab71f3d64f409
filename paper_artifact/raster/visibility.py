"""Forward raster on the CPU: triangle set-up, fragments, stochastic opacity masking, depth test.

Frames. Clip space: (x, y, z, w) with w > 0 in front of the camera. NDC: xyz / w in [-1, 1], x right, y down.
Pixels: the centre of (row r, column c) has pixel coordinates (c, r) and NDC ((2c+1)/width - 1, (2r+1)/height - 1).

Per triangle the set-up stores twelve affine coefficients in pixel coordinates relative to the first pixel of its
bounding box: three mu_i = lambda_i / w_i (lambda: screen-space barycentrics), and the NDC depth. Perspective-correct
barycentrics are b_i = mu_i / (mu_0 + mu_1 + mu_2), and 1/w is that sum. Source: Olano & Greer, "Triangle scan conversion using 2D
homogeneous coordinates" (1997); fragment semantics: DiffSoup (Tojo et al. 2026).

Kernels are one view each, release the GIL, and share no state: the caller may run views on any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from paper_artifact.raster.draws import draw

_BUCKETS = 512


class Planes(NamedTuple):
    """What the set-up knows of each triangle; arrays may be longer than the soup."""

    coefficients: np.ndarray  # (T,12) float32: see above, 3 × mu (constant, per column, per row), then depth
    rectangles: (
        np.ndarray
    )  # (T,4) int32 pixels: first row, last row, first column, last column; first row -1: skipped
    order: np.ndarray  # (T,) int32: the kept triangles, nearest first (bucketed by their nearest NDC depth)

    @staticmethod
    def room(triangles: int) -> Planes:
        """Return uninitialised arrays for `triangles` triangles."""
        return Planes(
            np.empty((triangles, 12), np.float32),
            np.empty((triangles, 4), np.int32),
            np.empty(triangles, np.int32),
        )


class Fragments(NamedTuple):
    """The fragments not behind the survivors that were drawn before them, in the order of drawing."""

    index: np.ndarray  # (capacity,2) int32: pixel, triangle
    value: np.ndarray  # (capacity,4) float32: barycentrics b0 and b1, NDC depth, alpha

    @staticmethod
    def room(capacity: int) -> Fragments:
        """Return uninitialised arrays for `capacity` fragments."""
        return Fragments(np.empty((capacity, 2), np.int32), np.empty((capacity, 4), np.float32))


class Surface(NamedTuple):
    """What is visible at each pixel (row-major index)."""

    depth: np.ndarray  # (H·W,) float32 NDC, +inf where nothing is visible
    visible: np.ndarray  # (H·W,) int32: number of the visible fragment, -1 where there is none
    triangle: np.ndarray  # (H·W,) int32: its triangle, -1 where there is none
    pixels: np.ndarray  # (H·W,) int32: the covered pixels in ascending order, then rubbish

    @staticmethod
    def room(size: int) -> Surface:
        """Return uninitialised arrays for `size` pixels."""
        return Surface(np.empty(size, np.float32), *(np.empty(size, np.int32) for _ in range(3)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def set_up_triangles(clip, height, width, planes):
    """Fill planes from clip (T,3,4) float32, the clip-space corners; return how many triangles can cover a pixel.

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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def raster_fragments(planes, kept, opacity, width, key, stochastic, surface, fragments):
    """Draw the first `kept` triangles of planes.order front to back; return how many fragments there were.

    More than fragments hold: call again with larger arrays. opacity (T,3) float32 in [0,1]; width in pixels.
    surface.depth must come in as +inf and surface.visible as -1; they go out as the nearest survivor's.
    A fragment survives iff alpha >= u, with u the hash draw of (key, pixel, triangle) when stochastic, else .5.
    """
    order, coefficients, rectangles = planes.order, planes.coefficients, planes.rectangles
    depth, visible = surface.depth, surface.visible
    fragment_index, fragment_value = fragments.index, fragments.value
    capacity = fragment_index.shape[0]
    number = 0
    for k in range(kept):
        t = order[k]
        row0, row1, column0, column1 = rectangles[t, 0], rectangles[t, 1], rectangles[t, 2], rectangles[t, 3]
        a0, b0, c0 = coefficients[t, 0], coefficients[t, 1], coefficients[t, 2]
        a1, b1, c1 = coefficients[t, 3], coefficients[t, 4], coefficients[t, 5]
        a2, b2, c2 = coefficients[t, 6], coefficients[t, 7], coefficients[t, 8]
        az, bz, cz = coefficients[t, 9], coefficients[t, 10], coefficients[t, 11]
        o0, o1, o2 = opacity[t, 0], opacity[t, 1], opacity[t, 2]
        span = column1 - column0
        for row in range(row0, row1 + 1):
            y = np.float32(row - row0)
            e0, e1, e2, ez = a0 + c0 * y, a1 + c1 * y, a2 + c2 * y, az + cz * y
            # Columns where all three edge functions can be >= 0; one pixel of slack, the test below decides.
            first, last = np.float32(0.0), np.float32(span)
            if b0 > 0:
                first = max(first, -e0 / b0)
            elif b0 < 0:
                last = min(last, -e0 / b0)
            elif e0 < 0:
                continue
            if b1 > 0:
                first = max(first, -e1 / b1)
            elif b1 < 0:
                last = min(last, -e1 / b1)
            elif e1 < 0:
                continue
            if b2 > 0:
                first = max(first, -e2 / b2)
            elif b2 < 0:
                last = min(last, -e2 / b2)
            elif e2 < 0:
                continue
            if not last >= first - np.float32(1.0):
                continue
            for column in range(max(0, int(first)), min(span, int(last) + 1) + 1):
                x = np.float32(column)
                m0, m1, m2 = e0 + b0 * x, e1 + b1 * x, e2 + b2 * x
                if m0 < 0 or m1 < 0 or m2 < 0:
                    continue
                z = ez + bz * x
                pixel = row * width + column0 + column
                if not (z < depth[pixel] and z >= -1 and z <= 1):
                    continue
                inverse = np.float32(1.0) / (m0 + m1 + m2)
                w0, w1 = m0 * inverse, m1 * inverse
                alpha = w0 * o0 + w1 * o1 + (np.float32(1.0) - w0 - w1) * o2
                if number < capacity:
                    fragment_index[number, 0], fragment_index[number, 1] = pixel, t
                    fragment_value[number, 0], fragment_value[number, 1] = w0, w1
                    fragment_value[number, 2], fragment_value[number, 3] = z, alpha
                threshold = np.float32(0.5)
                if stochastic:
                    threshold = draw(key, np.uint32(pixel), np.uint32(t))
                if alpha >= threshold:
                    depth[pixel] = z
                    visible[pixel] = number
                number += 1
    return number


@numba.njit(cache=True, nogil=True)
def resolve_visibility(surface, fragments):
    """Write surface.triangle and the covered pixels to surface.pixels; return their number."""
    visible, triangle, pixels = surface.visible, surface.triangle, surface.pixels
    fragment_index = fragments.index
    covered = 0
    for pixel in range(visible.shape[0]):
        fragment = visible[pixel]
        triangle[pixel] = -1
        if fragment >= 0:
            triangle[pixel] = fragment_index[fragment, 1]
            pixels[covered] = pixel
            covered += 1
    return covered
