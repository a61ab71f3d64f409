"""The edge gradient on the CPU: what moving a triangle's corners does to the image (DRTK's EdgeGrad as DiffSoup extends it).

For each visible pixel p and each of its four neighbours q, with adjoint a = sum over channels of ½(g_p + g_q)(c_p - c_q), a pull acts
on p's triangle at a point m between the two: in the middle where the triangle goes on to q, at its border where it ends before, and
not at all where another triangle is in front there. With mu_i = lambda_i / w_i (affine in pixels) a pull (gx, gy, gz) in NDC moves
the clip-space corner i by mu_i(m) · (gx, gy, gz, -g·m). The visible pixels of a triangle are served together, sixteen at a
time, and its sums stay in registers until it is done.

A pair inside one triangle is met from both its pixels and counts twice, as in DiffSoup.
"""

from __future__ import annotations

import numba
import numpy as np

from paper_artifact.raster.lanes import (
    WIDTH,
    bits,
    first,
    floor,
    fma,
    gather,
    inlined,
    load,
    load_part,
    maximum,
    popcount,
    select,
    splat,
    store,
    store_part,
    to_float,
    total,
    trailing_zeros,
)


@numba.njit(cache=True, nogil=True)
def edge_adjoints(colour, gradient, adjoints):
    """Fill adjoints (2,H+1,W) float32, which must have been zeros at first: for the pixel (row, column) stands at [0, row + 1, column]
    its adjoint with the right neighbour (in the last column: rubbish), at [1, row + 1, column] that with the lower one (in the last
    row: 0). colour and gradient (dL/dcolour) (3,H,W) float32."""
    height, width = colour.shape[1], colour.shape[2]
    size = height * width
    for axis in range(2):
        step, first_of = (width if axis else 1), (axis * (height + 1) + 1) * width
        for p in range(0, size - step, WIDTH):
            count, sum_of = size - step - p, splat(0.0)
            for c in range(3):
                at = c * size + p
                pull = load_part(gradient, at, count) + load_part(gradient, at + step, count)
                fall = load_part(colour, at, count) - load_part(colour, at + step, count)
                sum_of = fma(pull, fall, sum_of)
            store_part(adjoints, first_of + p, 0.5 * sum_of, count)


@inlined
def _border(p, q):
    # Where the segment from p (0, inside) to q (1) first leaves the triangle: the smallest p_i / (p_i - q_i) of those with q_i < 0.
    over, under = splat(1.0), splat(1.0)
    for i in range(3):
        fall = p[i] - q[i]
        earlier = (q[i] < 0.0) & (p[i] * under < over * fall)
        over, under = select(earlier, p[i], over), select(earlier, fall, under)
    return maximum(over / under, 0.0)


@inlined
def _meet(p, q, active, t, other, depth_q):
    # One pixel's view of the pairs with neighbours q. p, q: mu_0, mu_1, mu_2 and depth of the own triangle t there; other, depth_q: what
    # is visible at q. Returns where between p (0) and q (1) the pull acts, who is pulled, and who may meet an intersection.
    same = other == t
    continues = (q[0] >= 0.0) & (q[1] >= 0.0) & (q[2] >= 0.0)
    in_front = (other < 0) | (p[3] < depth_q)
    hidden = continues & ~same & (other >= 0) & (depth_q < q[3])
    # Only where it is asked for: in a lane without a pair it may be infinite, and its pull of 0 would not help.
    fraction = select(active & ~(same | continues), _border(p, q), 0.5)
    return fraction, active & (same | (in_front & ~hidden)), active & hidden


@inlined
def _add(sums, pull, p, q, fraction):
    # sums_i + pull · mu_i(m)
    s0, s1, s2 = sums
    return (
        fma(pull, fma(fraction, q[0] - p[0], p[0]), s0),
        fma(pull, fma(fraction, q[1] - p[1], p[1]), s1),
        fma(pull, fma(fraction, q[2] - p[2], p[2]), s2),
    )


@inlined
def _pull(sums, moments, p, q, fraction, pull, middle, step):
    # Add the pulls along an axis to sums (of mu_i·g), and to moments (of mu_i·g·m); m = middle + fraction·step on that axis, NDC.
    moment = pull * fma(fraction, step, middle)
    return _add(sums, pull, p, q, fraction), _add(moments, moment, p, q, fraction)


@inlined
def _value(coefficients, rectangles, t, which, column, row):
    # mu_0, mu_1, mu_2 or depth of triangle t at one pixel, or between two.
    x, y = np.float32(column - rectangles[t, 2]), np.float32(row - rectangles[t, 0])
    k = 3 * which
    return coefficients[t, k] + coefficients[t, k + 1] * x + coefficients[t, k + 2] * y


@inlined
def _serve(p, q, mine, t, triangle, depth, neighbour, adjoints, pair, scale):
    # Fraction and pull (0 where there is none) of the pairs with `neighbour`, and who may meet an intersection.
    adjoint = gather(adjoints, pair, mine)
    active = adjoint != 0.0
    other, depth_q = gather(triangle, neighbour, active), gather(depth, neighbour, active)
    fraction, pulled, hidden = _meet(p, q, active, t, other, depth_q)
    return fraction, select(pulled, scale * adjoint, 0.0), bits(hidden)


@inlined
def _intersect(coefficients, rectangles, t, other, column, row, axis, step, depth, pull, scale, corners):
    # Two triangles pass through each other between a pixel and its neighbour `step` further along axis (0: x, 1: y), unless the other
    # one is behind t at the pixel itself: the pull goes along t's normal, as far as that moves the crossing line. Adds to corners.
    if not depth < _value(coefficients, rectangles, other, 3, column, row):
        return
    for i in range(3):
        if not _value(coefficients, rectangles, other, i, column, row) >= 0:
            return
    # The normals are (-slope, 1) of each depth plane in the plane of the axis and z, NDC.
    vary, fixed = coefficients[t, 10 + axis] / scale, coefficients[other, 10 + axis] / scale
    difference = vary - fixed
    if not abs(difference) > 1e-12 * np.sqrt((1.0 + vary * vary) * (1.0 + fixed * fixed)):
        return
    x, y = (column, row + 0.5 * step) if axis else (column + 0.5 * step, row)
    across, deep = pull * vary / difference, -pull / difference
    where = ((y if axis else x) + 0.5) * scale - 1.0
    moment = across * where + deep * _value(coefficients, rectangles, t, 3, x, y)
    for i in range(3):
        mu = _value(coefficients, rectangles, t, i, x, y)
        corners[i, axis] += mu * across
        corners[i, 2] += mu * deep
        corners[i, 3] -= mu * moment


@numba.njit(cache=True, nogil=True, _nrt=False, error_model="numpy")
def _intersections(
    hidden,
    coefficients,
    rectangles,
    t,
    triangle,
    depth,
    pixels,
    k,
    width,
    adjoints,
    below_first,
    scales,
    corners,
):
    # hidden: four sets of lanes (right, left, below, above) of the pixels from number k on.
    for direction in range(4):
        axis, step = direction // 2, 1 - 2 * (direction % 2)
        apart, first_of = (step * width, below_first) if axis else (step, width)
        some = hidden[direction]
        while some:
            pixel = pixels[k + trailing_zeros(some)]
            some &= some - 1
            pull = adjoints[first_of + min(pixel, pixel + apart)] / scales[axis]
            _intersect(
                coefficients,
                rectangles,
                t,
                triangle[pixel + apart],
                pixel % width,
                pixel // width,
                axis,
                step,
                depth[pixel],
                pull,
                scales[axis],
                corners,
            )


@inlined
def _values(coefficients, t, x, y):
    # mu_0, mu_1, mu_2 and depth of triangle t, x and y from its first column and row on; the same bits as in `visibility`.
    return (
        (coefficients[t, 0] + coefficients[t, 2] * y) + coefficients[t, 1] * x,
        (coefficients[t, 3] + coefficients[t, 5] * y) + coefficients[t, 4] * x,
        (coefficients[t, 6] + coefficients[t, 8] * y) + coefficients[t, 7] * x,
        (coefficients[t, 9] + coefficients[t, 11] * y) + coefficients[t, 10] * x,
    )


@inlined
def _flush(gradient, t, by_x, by_y, by_w, corners, matrix):
    # Clip space to world.
    for i in range(3):
        gx, gy = corners[i, 0] + total(by_x[i]), corners[i, 1] + total(by_y[i])
        gz, gw = corners[i, 2], corners[i, 3] - total(by_w[i])
        for axis in range(3):
            gradient[t, i, axis] += (
                matrix[0, axis] * gx + matrix[1, axis] * gy + matrix[2, axis] * gz + matrix[3, axis] * gw
            )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def edge_backward(planes, surface, shown, covered, adjoints, matrix, vertex_gradient):
    """Add the edge gradient of one view to vertex_gradient (T,3,3) float32, world.

    planes, surface, the first `covered` of shown: as drawn (`visibility`); adjoints: see `edge_adjoints`; matrix (4,4) float32 is
    world → clip.
    """
    coefficients, rectangles = planes.coefficients, planes.rectangles
    depth, triangle = surface.depth, surface.triangle
    pixels, triangles = shown.pixel, shown.triangle
    height, width = adjoints.shape[1] - 1, adjoints.shape[2]
    flat, below_first = adjoints.reshape(adjoints.size), (height + 2) * width
    sx, sy = np.float32(2.0 / width), np.float32(2.0 / height)
    to_x, to_y = np.float32(0.5 * width), np.float32(0.5 * height)
    corners = np.zeros(
        (4, 4), np.float32
    )  # dL/d of the triangle's three clip-space corners, by intersections
    zero = splat(0.0)
    by_x, by_y, by_w = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    k = 0
    while k < covered:
        t = triangles[k]
        mine = (load(triangles, k) == t) & first(covered - k)
        pixel = load(pixels, k)
        row = floor((to_float(pixel) + 0.5) * np.float32(1.0 / width))  # exact below 2**23 pixels
        column = to_float(pixel) - row * np.float32(width)
        x, y = column - np.float32(rectangles[t, 2]), row - np.float32(rectangles[t, 0])
        ndc_x, ndc_y = fma(column + 0.5, sx, -1.0), fma(row + 0.5, sy, -1.0)
        p = _values(coefficients, t, x, y)
        q, pair = _values(coefficients, t, x + 1.0, y), pixel + width
        with_q = mine & (column < np.float32(width - 1))
        at, pull, right = _serve(p, q, with_q, t, triangle, depth, pixel + 1, adjoints, pair, to_x)
        by_x, by_w = _pull(by_x, by_w, p, q, at, pull, ndc_x, sx)
        q, pair = _values(coefficients, t, x - 1.0, y), pixel + (width - 1)
        with_q = mine & (column > 0.0)
        at, pull, left = _serve(p, q, with_q, t, triangle, depth, pixel - 1, adjoints, pair, to_x)
        by_x, by_w = _pull(by_x, by_w, p, q, at, pull, ndc_x, -sx)
        # Below the last row and above the first one adjoints are 0.
        q, pair = _values(coefficients, t, x, y + 1.0), pixel + below_first
        at, pull, below = _serve(p, q, mine, t, triangle, depth, pixel + width, adjoints, pair, to_y)
        by_y, by_w = _pull(by_y, by_w, p, q, at, pull, ndc_y, sy)
        q, pair = _values(coefficients, t, x, y - 1.0), pixel + (below_first - width)
        at, pull, above = _serve(p, q, mine, t, triangle, depth, pixel - width, adjoints, pair, to_y)
        by_y, by_w = _pull(by_y, by_w, p, q, at, pull, ndc_y, -sy)
        if right | left | below | above:
            _intersections(
                (right, left, below, above),
                coefficients,
                rectangles,
                t,
                triangle,
                depth,
                pixels,
                k,
                width,
                flat,
                below_first,
                (sx, sy),
                corners,
            )
        k += popcount(bits(mine))
        if k == covered or triangles[k] != t:
            _flush(vertex_gradient, t, by_x, by_y, by_w, corners, matrix)
            by_x, by_y, by_w = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
            store(corners, 0, zero)
