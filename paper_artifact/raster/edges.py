"""Backward kernels on the CPU that belong to visibility: the edge gradient (vertices) and the opacity gradient.

Edge gradient (DRTK's EdgeGrad as DiffSoup extends it): for each pair of neighbouring pixels with adjoint
a = sum over channels of ½(g0 + g1)(c0 - c1), a pull g in NDC acts at a point m of a triangle. With mu_i = lambda_i / w_i (affine
in pixels) its effect on the clip-space corners is d xyz_i += g·mu_i(m), d w_i -= (g·m_ndc)·mu_i(m), whatever the kind of edge: so
each pull only adds to twelve moments of its triangle (sums of g and of s = g·m_ndc, times 1, column, row), and the corners are
served once per triangle at the end.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(inline="always")
def _pull(moments, rectangles, t, column, row, gx, gy, gz, z, sx, sy):
    x, y = column - rectangles[t, 2], row - rectangles[t, 0]
    s = gx * ((column + 0.5) * sx - 1.0) + gy * ((row + 0.5) * sy - 1.0) + gz * z
    moments[t, 0] += gx
    moments[t, 1] += gx * x
    moments[t, 2] += gx * y
    moments[t, 3] += gy
    moments[t, 4] += gy * x
    moments[t, 5] += gy * y
    moments[t, 6] += gz
    moments[t, 7] += gz * x
    moments[t, 8] += gz * y
    moments[t, 9] += s
    moments[t, 10] += s * x
    moments[t, 11] += s * y


@numba.njit(inline="always")
def _evaluate(coefficients, rectangles, t, first, column, row):
    return (
        coefficients[t, first]
        + coefficients[t, first + 1] * np.float32(column - rectangles[t, 2])
        + coefficients[t, first + 2] * np.float32(row - rectangles[t, 0])
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _edge_side(
    coefficients, rectangles, moments, t0, column0, row0, depth0, t1, column1, row1, depth1, gx, gy, sx, sy
):
    # One pixel's view of the pair: the triangle t0 visible at pixel 0, against whatever (t1, or nothing: -1) pixel 1 shows.
    q0 = _evaluate(coefficients, rectangles, t0, 0, column1, row1)
    q1 = _evaluate(coefficients, rectangles, t0, 3, column1, row1)
    q2 = _evaluate(coefficients, rectangles, t0, 6, column1, row1)
    in_front = t1 < 0 or depth0 < depth1
    if q0 >= 0 and q1 >= 0 and q2 >= 0:
        middle_column, middle_row = 0.5 * (column0 + column1), 0.5 * (row0 + row1)
        if t1 >= 0 and depth1 < _evaluate(coefficients, rectangles, t0, 9, column1, row1):
            inside = (
                _evaluate(coefficients, rectangles, t1, 0, column0, row0) >= 0
                and _evaluate(coefficients, rectangles, t1, 3, column0, row0) >= 0
                and _evaluate(coefficients, rectangles, t1, 6, column0, row0) >= 0
            )
            if inside and depth0 < _evaluate(coefficients, rectangles, t1, 9, column0, row0):
                # Intersection edge. The normals are (-slope, 1) of each depth plane in the x-z (or y-z) plane, NDC.
                axis = 10 if row0 == row1 else 11
                scale = 1.0 / sx if row0 == row1 else 1.0 / sy
                vary, fixed = coefficients[t0, axis] * scale, coefficients[t1, axis] * scale
                difference = vary - fixed
                if abs(difference) > 1e-12 * np.sqrt((1.0 + vary * vary) * (1.0 + fixed * fixed)):
                    pull = gx if row0 == row1 else gy
                    along, depth_pull = pull * vary / difference, -pull / difference
                    z = (
                        coefficients[t0, 9]
                        + coefficients[t0, 10] * (middle_column - rectangles[t0, 2])
                        + coefficients[t0, 11] * (middle_row - rectangles[t0, 0])
                    )
                    ax, ay = (along, 0.0) if row0 == row1 else (0.0, along)
                    _pull(moments, rectangles, t0, middle_column, middle_row, ax, ay, depth_pull, z, sx, sy)
        elif in_front:
            _pull(moments, rectangles, t0, middle_column, middle_row, gx, gy, 0.0, 0.0, sx, sy)
    elif in_front:
        # Geometric edge: where the segment between the pixel centres leaves the triangle.
        crossing = 1.0
        p = _evaluate(coefficients, rectangles, t0, 0, column0, row0)
        if q0 < 0:
            crossing = min(crossing, p / (p - q0))
        p = _evaluate(coefficients, rectangles, t0, 3, column0, row0)
        if q1 < 0:
            crossing = min(crossing, p / (p - q1))
        p = _evaluate(coefficients, rectangles, t0, 6, column0, row0)
        if q2 < 0:
            crossing = min(crossing, p / (p - q2))
        crossing = max(crossing, 0.0)
        column, row = column0 + crossing * (column1 - column0), row0 + crossing * (row1 - row0)
        _pull(moments, rectangles, t0, column, row, gx, gy, 0.0, 0.0, sx, sy)


@numba.njit(forceinline=True, error_model="numpy")
def _pair(
    triangle, depth, coefficients, rectangles, moments, p, column0, row0, q, column1, row1, gx, gy, sx, sy
):
    # Two neighbouring pixels p and q that show different triangles (or, one of them, nothing): both their views of the pair.
    tp, tq, zp, zq = triangle[p], triangle[q], depth[p], depth[q]
    if tp >= 0:
        _edge_side(
            coefficients, rectangles, moments, tp, column0, row0, zp, tq, column1, row1, zq, gx, gy, sx, sy
        )
    if tq >= 0:
        _edge_side(
            coefficients, rectangles, moments, tq, column1, row1, zq, tp, column0, row0, zp, gx, gy, sx, sy
        )


@numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _adjoints(c0, c1, c2, g0, g1, g2, start, offset, count, out):
    # out[k] = ½ sum over channels of (g[p] + g[q])(c[p] - c[q]) with p = start + k, q = p + offset.
    for k in range(count):
        p = start + k
        out[k] = np.float32(0.5) * (
            (g0[p] + g0[p + offset]) * (c0[p] - c0[p + offset])
            + (g1[p] + g1[p + offset]) * (c1[p] - c1[p + offset])
            + (g2[p] + g2[p + offset]) * (c2[p] - c2[p + offset])
        )


@numba.njit(inline="always")
def _flush(moments, rectangles, t, row, right0, right1, right2, down0, down1, sx, sy):
    # Add a run of pairs inside triangle t on one row: sums over the pairs of 2·g·(1, x, x²) to the right, of 2·g·(1, x) downward.
    y = float(row - rectangles[t, 0])
    shift = (rectangles[t, 2] + 0.5) * sx - 1.0  # ndc_x = shift + sx·x
    along, along_x = shift * right0 + sx * right1, shift * right1 + sx * right2
    ndc_y = (row + 1.0) * sy - 1.0
    moments[t, 0] += right0
    moments[t, 1] += right1
    moments[t, 2] += right0 * y
    moments[t, 3] += down0
    moments[t, 4] += down1
    moments[t, 5] += down0 * (y + 0.5)
    moments[t, 9] += along + ndc_y * down0
    moments[t, 10] += along_x + ndc_y * down1
    moments[t, 11] += along * y + ndc_y * down0 * (y + 0.5)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def edge_moments(surface, planes, colour, gradient, moments):
    """Add every pixel pair's pull to moments (T,12) float64 (zeroed by the caller).

    surface, planes: see `visibility`; colour and gradient (dL/dcolour) (3,H,W) float32. The same signed pull serves
    both pixels of a pair, since adjoint and direction change sign together; inside one triangle it therefore counts
    twice, and the pairs of a run along a row are summed before they are added.
    """
    height, width = colour.shape[1], colour.shape[2]
    triangle, depth = surface.triangle, surface.depth
    coefficients, rectangles = planes.coefficients, planes.rectangles
    c, g = colour.reshape(3, height * width), gradient.reshape(3, height * width)
    sx, sy = 2.0 / width, 2.0 / height
    to_right, downward = np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(height):
        start = row * width
        _adjoints(c[0], c[1], c[2], g[0], g[1], g[2], start, 1, width - 1, to_right)
        to_right[width - 1] = np.float32(0.0)
        if row + 1 < height:
            _adjoints(c[0], c[1], c[2], g[0], g[1], g[2], start, width, width, downward)
        else:
            downward[:] = np.float32(0.0)
        current = -1
        right0, right1, right2, down0, down1 = 0.0, 0.0, 0.0, 0.0, 0.0
        for column in range(width):
            p = start + column
            tp = triangle[p]
            if tp != current:
                if current >= 0:
                    _flush(moments, rectangles, current, row, right0, right1, right2, down0, down1, sx, sy)
                right0, right1, right2, down0, down1 = 0.0, 0.0, 0.0, 0.0, 0.0
                current = tp
            if to_right[column] != 0:
                gx = to_right[column] / sx
                if triangle[p + 1] == tp:
                    if tp >= 0:
                        x = column - rectangles[tp, 2] + 0.5
                        right0 += 2 * gx
                        right1 += 2 * gx * x
                        right2 += 2 * gx * x * x
                else:
                    _pair(
                        triangle,
                        depth,
                        coefficients,
                        rectangles,
                        moments,
                        p,
                        column,
                        row,
                        p + 1,
                        column + 1,
                        row,
                        gx,
                        0.0,
                        sx,
                        sy,
                    )
            if downward[column] != 0:
                gy = downward[column] / sy
                q = p + width
                if triangle[q] == tp:
                    if tp >= 0:
                        down0 += 2 * gy
                        down1 += 2 * gy * (column - rectangles[tp, 2])
                else:
                    _pair(
                        triangle,
                        depth,
                        coefficients,
                        rectangles,
                        moments,
                        p,
                        column,
                        row,
                        q,
                        column,
                        row + 1,
                        0.0,
                        gy,
                        sx,
                        sy,
                    )
        if current >= 0:
            _flush(moments, rectangles, current, row, right0, right1, right2, down0, down1, sx, sy)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def moments_to_vertices(moments, planes, matrix, vertex_gradient):
    """Turn moments (T,12) into world-space gradients, added to vertex_gradient (T,3,3) float32.

    matrix (4,4) float32 is world → clip.
    """
    coefficients, rectangles = planes.coefficients, planes.rectangles
    for t in range(moments.shape[0]):
        if rectangles[t, 0] < 0:
            continue
        for corner in range(3):
            a, b, c = (
                coefficients[t, 3 * corner],
                coefficients[t, 3 * corner + 1],
                coefficients[t, 3 * corner + 2],
            )
            gx = a * moments[t, 0] + b * moments[t, 1] + c * moments[t, 2]
            gy = a * moments[t, 3] + b * moments[t, 4] + c * moments[t, 5]
            gz = a * moments[t, 6] + b * moments[t, 7] + c * moments[t, 8]
            gw = -(a * moments[t, 9] + b * moments[t, 10] + c * moments[t, 11])
            for axis in range(3):
                vertex_gradient[t, corner, axis] += (
                    matrix[0, axis] * gx + matrix[1, axis] * gy + matrix[2, axis] * gz + matrix[3, axis] * gw
                )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def opacity_backward(count, fragments, surface, colour, target, weight, opacity_gradient):
    """Add the opacity gradient of one view to opacity_gradient (T,3) float32 (DiffSoup, path 2).

    count: how many fragments there are; colour and target (3,H,W) float32. With e = sum over channels of
    |colour - target| at the pixel: the visible fragment's alpha gets +e / max(alpha, 1e-5), every other fragment in
    front of it -e / max(1 - alpha, 1e-5), times `weight`; spread to the corners by the barycentrics.
    """
    fragment_index, fragment_value = fragments.index, fragments.value
    visible, depth = surface.visible, surface.depth
    size = colour.shape[1] * colour.shape[2]
    shown, wanted = colour.reshape(3, size), target.reshape(3, size)
    for number in range(count):
        pixel, t = fragment_index[number, 0], fragment_index[number, 1]
        if fragment_value[number, 2] > depth[pixel]:
            continue
        error = (
            abs(shown[0, pixel] - wanted[0, pixel])
            + abs(shown[1, pixel] - wanted[1, pixel])
            + abs(shown[2, pixel] - wanted[2, pixel])
        )
        if error == 0:
            continue
        alpha = fragment_value[number, 3]
        if visible[pixel] == number:
            value = error / max(alpha, np.float32(1e-5))
        else:
            value = -error / max(np.float32(1.0) - alpha, np.float32(1e-5))
        value *= weight
        b0, b1 = fragment_value[number, 0], fragment_value[number, 1]
        opacity_gradient[t, 0] += b0 * value
        opacity_gradient[t, 1] += b1 * value
        opacity_gradient[t, 2] += (np.float32(1.0) - b0 - b1) * value
