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

from dataclasses import dataclass, field

import numba
import numpy as np

from paper_artifact.raster.draws import draw

_BUCKETS = 512


@numba.njit(cache=True, nogil=True, error_model="numpy")
def set_up_triangles(clip, faces, height, width, coefficients, rectangles, order):
    """Fill per-triangle coefficients and rectangles; return how many triangles can cover a pixel.

    clip (V,4) float32, faces (T,3) int32 → coefficients (T,12) float32, rectangles (T,4) int32 (first row, last row,
    first column, last column, inclusive; first row -1 where the triangle is skipped), order (T,) int32: the
    kept triangles, nearest first (bucketed by their nearest NDC depth).
    A triangle is skipped unless all w > 0, when it lies outside one clip plane, or when it has no area in the image.
    """
    count = faces.shape[0]
    nearest = np.empty(count, np.float32)
    low, high = np.float32(1.0), np.float32(-1.0)
    kept = 0
    for t in range(count):
        rectangles[t, 0] = -1
        i0, i1, i2 = faces[t, 0], faces[t, 1], faces[t, 2]
        w0, w1, w2 = float(clip[i0, 3]), float(clip[i1, 3]), float(clip[i2, 3])
        if not (w0 > 0.0 and w1 > 0.0 and w2 > 0.0):
            continue
        outside = False
        for axis in range(3):
            a0, a1, a2 = float(clip[i0, axis]), float(clip[i1, axis]), float(clip[i2, axis])
            if (a0 > w0 and a1 > w1 and a2 > w2) or (a0 < -w0 and a1 < -w1 and a2 < -w2):
                outside = True
        if outside:
            continue
        x0 = 0.5 * width * (clip[i0, 0] / w0 + 1.0) - 0.5
        x1 = 0.5 * width * (clip[i1, 0] / w1 + 1.0) - 0.5
        x2 = 0.5 * width * (clip[i2, 0] / w2 + 1.0) - 0.5
        y0 = 0.5 * height * (clip[i0, 1] / w0 + 1.0) - 0.5
        y1 = 0.5 * height * (clip[i1, 1] / w1 + 1.0) - 0.5
        y2 = 0.5 * height * (clip[i2, 1] / w2 + 1.0) - 0.5
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
        z0, z1, z2 = clip[i0, 2] / w0, clip[i1, 2] / w1, clip[i2, 2] / w2
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
def raster_fragments(
    order,
    kept,
    coefficients,
    rectangles,
    opacity,
    width,
    key,
    stochastic,
    depth,
    visible,
    fragment_index,
    fragment_value,
):
    """Draw fragments front to back; return how many there were (more than the buffers hold: call again with larger ones).

    opacity (T,3) float32 in [0,1]. depth (H·W,) float32 must come in as +inf, visible (H·W,) int32 as -1; they go out as the
    nearest surviving fragment's NDC depth and fragment number. Recorded are the fragments not behind the survivors seen
    so far: fragment_index (capacity,2) int32 = pixel, triangle; fragment_value (capacity,4) float32 = b0, b1, NDC depth, alpha.
    A fragment survives iff alpha >= u, with u the hash draw of (key, pixel, triangle) when stochastic, else .5.
    """
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
def resolve_visibility(visible, fragment_index, triangle, pixels):
    """Write triangle (H·W,) int32 (index, -1 where nothing is visible) and the covered pixels; return their number."""
    covered = 0
    for pixel in range(visible.shape[0]):
        fragment = visible[pixel]
        triangle[pixel] = -1
        if fragment >= 0:
            triangle[pixel] = fragment_index[fragment, 1]
            pixels[covered] = pixel
            covered += 1
    return covered


def to_clip(corners: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return clip-space points (V,4) float32 of corners (V,3) float32 under matrix (4,4) float32.

    Summed in a fixed order: a BLAS product may choose another one on another machine.
    """
    clip = np.empty((len(corners), 4), np.float32)
    for row in range(4):
        clip[:, row] = (
            corners[:, 0] * matrix[row, 0]
            + corners[:, 1] * matrix[row, 1]
            + corners[:, 2] * matrix[row, 2]
            + matrix[row, 3]
        )
    return clip


@dataclass
class ViewRaster:
    """One view's raster and its reusable buffers (see the kernels for each array's meaning)."""

    height: int
    width: int
    coefficients: np.ndarray = field(default_factory=lambda: np.empty((0, 12), np.float32))
    rectangles: np.ndarray = field(default_factory=lambda: np.empty((0, 4), np.int32))
    order: np.ndarray = field(default_factory=lambda: np.empty(0, np.int32))
    fragments: int = 0
    covered: int = 0

    def __post_init__(self) -> None:
        size = self.height * self.width
        self.depth = np.empty(size, np.float32)
        self.visible = np.empty(size, np.int32)
        self.triangle = np.empty(size, np.int32)
        self.pixels = np.empty(size, np.int32)
        self._grow(3 * size)

    def _grow(self, capacity: int) -> None:
        self.fragment_index = np.empty((capacity, 2), np.int32)
        self.fragment_value = np.empty((capacity, 4), np.float32)

    def draw(self, clip: np.ndarray, faces: np.ndarray, opacity: np.ndarray, key: int | None) -> "ViewRaster":
        """Raster `faces` (T,3) int32 over `clip` (V,4) float32 with opacity (T,3) float32; key None: threshold .5. Returns
        self."""
        count = faces.shape[0]
        if self.order.shape[0] < count:
            room = count + count // 4
            self.coefficients = np.empty((room, 12), np.float32)
            self.rectangles = np.empty((room, 4), np.int32)
            self.order = np.empty(room, np.int32)
        kept = set_up_triangles(
            clip, faces, self.height, self.width, self.coefficients, self.rectangles, self.order
        )
        while True:
            self.depth.fill(np.inf)
            self.visible.fill(-1)
            self.fragments = raster_fragments(
                self.order,
                kept,
                self.coefficients,
                self.rectangles,
                opacity,
                self.width,
                np.uint32(key or 0),
                key is not None,
                self.depth,
                self.visible,
                self.fragment_index,
                self.fragment_value,
            )
            if self.fragments <= self.fragment_index.shape[0]:
                break
            self._grow(self.fragments + self.fragments // 4)
        self.covered = resolve_visibility(self.visible, self.fragment_index, self.triangle, self.pixels)
        return self


def rasterize_opaque(clip: np.ndarray, faces: np.ndarray, height: int, width: int):
    """Nearest-surface raster of an opaque mesh: (triangle, b0, b1, depth), each (height, width).

    clip (V,4) float32 clip-space vertices, faces (T,3) int32. triangle int32 is 0 where nothing is hit, else index + 1;
    b0, b1 float32 are perspective-correct barycentrics of corners 0 and 1 (0 where nothing is hit); depth float32 is NDC z
    (+inf where nothing is hit).
    """
    faces = np.ascontiguousarray(faces, np.int32)
    view = ViewRaster(height, width)
    view.draw(np.ascontiguousarray(clip, np.float32), faces, np.ones((len(faces), 3), np.float32), None)
    hit = view.visible >= 0
    values = np.zeros((height * width, 2), np.float32)
    values[hit] = view.fragment_value[view.visible[hit], :2]
    shape = (height, width)
    return (
        (view.triangle + 1).reshape(shape),
        values[:, 0].reshape(shape),
        values[:, 1].reshape(shape),
        view.depth.reshape(shape),
    )
