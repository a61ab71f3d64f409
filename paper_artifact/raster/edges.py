"""The edge gradient on the CPU: what moving a triangle's corners does to the image (DRTK's EdgeGrad as
DiffSoup extends it).

For each pair of neighbouring pixels p, q (q right of p or below) with adjoint a = sum over channels of ½(g_p
+ g_q)(c_p - c_q), the pull a·W/2 (or a·H/2) in NDC acts on each of the two visible triangles at a point m
between the pixels. The same signed pull serves both, since adjoint and direction change sign together; inside
one triangle it counts twice, as in DiffSoup. With mu_i = lambda_i / w_i (affine in pixels, see `visibility`)
a pull g = (gx, gy, gz) moves clip-space corner i by mu_i(m)·(gx, gy, gz, -g·m), whatever the kind of edge.

Pairs wait in a queue, those inside a triangle in one of their own, and are served sixteen at a time without a
branch: a lane is a pair, and `load_rows` brings its triangle's planes. So it does not matter whether a border
or an intersection lies between two triangles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from paper_artifact.kernel_cache import njit
from paper_artifact.raster.lanes import (
    WIDTH,
    add_to_rows,
    bits,
    first,
    fma,
    inlined,
    load,
    load_part,
    load_rows,
    lowest,
    maximum,
    minimum,
    select,
    splat,
    store,
)

_COLUMN, _ROW = 12, 13  # places in a row of planes, after the twelve coefficients


class Pairs(NamedTuple):
    """A queue of up to 16 pairs of pixels p, q that await service; row r, place k is at r·16 + k."""

    value: np.ndarray  # (6,16) float32: p's column, row, 1 where q is below (else right), adjoint, depths
    triangle: np.ndarray  # (2,16) int32: visible triangle's index + 1 at p and q, 0 where there is none


@inlined
def _values(plane, x, y):
    # mu_0, mu_1, mu_2 and depth of sixteen triangles, each at its pixel (column x, row y).
    x, y = x - plane[_COLUMN], y - plane[_ROW]
    return (
        fma(plane[2], y, fma(plane[1], x, plane[0])),
        fma(plane[5], y, fma(plane[4], x, plane[3])),
        fma(plane[8], y, fma(plane[7], x, plane[6])),
        fma(plane[11], y, fma(plane[10], x, plane[9])),
    )


@inlined
def _inside(values):
    return (values[0] >= 0.0) & (values[1] >= 0.0) & (values[2] >= 0.0)


@inlined
def _pull_one(here, there, other_here, depth, other_depth, alone, pull, crossing):
    # One pixel's view of the pairs. here, there, other_here: `_values` of its triangle at its own pixel and
    # at the other, and of the other's triangle here; alone: nothing is visible at the other pixel; crossing:
    # the pull along the pair's direction and in depth where the two triangles pass through each other.
    # Returns how far from here to there the pull acts (0 to 1), and its two parts.
    (p0, p1, p2, _), (q0, q1, q2, depth_there) = here, there
    goes_on, in_front = _inside(there), alone | (depth < other_depth)
    hidden = goes_on & ~alone & (other_depth < depth_there)
    meets = hidden & _inside(other_here) & (depth < other_here[3])
    # Geometric edge: where the segment between the pixel centres leaves the triangle. Else the middle.
    border = select(q0 < 0.0, minimum(p0 / (p0 - q0), 1.0), 1.0)
    border = select(q1 < 0.0, minimum(p1 / (p1 - q1), border), border)
    border = select(q2 < 0.0, minimum(p2 / (p2 - q2), border), border)
    fraction = select(goes_on, 0.5, maximum(border, 0.0))
    along = select(meets, crossing[0], select(in_front & ~hidden, pull, 0.0))
    return fraction, along, select(meets, crossing[1], 0.0)


@inlined
def _corners(here, there, fraction, along, deep, below, where):
    # What the pulls do to the clip-space corners: x, y, z, w of the first, second, third. where: NDC of the
    # point along its axis.
    gx, gy = select(below, 0.0, along), select(below, along, 0.0)
    gw = -fma(along, where, deep * (0.5 * (here[3] + there[3])))
    m0 = fma(fraction, there[0] - here[0], here[0])
    m1 = fma(fraction, there[1] - here[1], here[1])
    m2 = fma(fraction, there[2] - here[2], here[2])
    first_two = m0 * gx, m0 * gy, m0 * deep, m0 * gw, m1 * gx, m1 * gy, m1 * deep, m1 * gw
    zero = splat(0.0)
    return (*first_two, m2 * gx, m2 * gy, m2 * deep, m2 * gw, zero, zero, zero, zero)


@inlined
def _geometry(pairs, size):
    # Of the first sixteen pairs: column and row of p and of q, whether q is below, pixels per unit of NDC and
    # back, coordinate of p along the pair's direction (pixels from the image's border), pull.
    x, y, below = load(pairs.value, 0), load(pairs.value, WIDTH), load(pairs.value, 2 * WIDTH) != 0.0
    x_q, y_q = select(below, x, x + 1.0), select(below, y + 1.0, y)
    half = select(below, splat(0.5 * size[0]), splat(0.5 * size[1]))
    scale = select(below, splat(2.0 / size[0]), splat(2.0 / size[1]))
    return x, y, x_q, y_q, below, half, scale, select(below, y, x) + 0.5, load(pairs.value, 3 * WIDTH) * half


@njit(_nrt=False, error_model="numpy")
def _serve_inside(pairs, count, planes, size, corners):
    # Add what the first `count` <= 16 pairs of the queue pull, in the middle and twice since from both
    # pixels, to corners.
    x, y, x_q, y_q, below, _, scale, at, pull = _geometry(pairs, size)
    t = select(first(count), load(pairs.triangle, 0), 0)
    plane, middle, where = load_rows(planes, t), splat(0.5), (at + 0.5) * scale - 1.0
    here, there = _values(plane, x, y), _values(plane, x_q, y_q)
    add_to_rows(corners, t, _corners(here, there, middle, 2.0 * pull, splat(0.0), below, where))


@njit(_nrt=False, error_model="numpy")
def _serve_edges(pairs, count, planes, size, corners):
    # Add what the first `count` <= 16 pairs of the queue pull, two triangles each, to corners.
    x, y, x_q, y_q, below, half, scale, at, pull = _geometry(pairs, size)
    depth_p, depth_q = load(pairs.value, 4 * WIDTH), load(pairs.value, 5 * WIDTH)
    t_p = select(first(count), load(pairs.triangle, 0), 0)
    t_q = select(first(count), load(pairs.triangle, WIDTH), 0)
    plane_p, plane_q = load_rows(planes, t_p), load_rows(planes, t_q)
    p_at_p, p_at_q = _values(plane_p, x, y), _values(plane_p, x_q, y_q)
    q_at_p, q_at_q = _values(plane_q, x, y), _values(plane_q, x_q, y_q)
    # Intersection edge. The normals are (-slope, 1) of each depth plane in the x-z (or y-z) plane, NDC.
    slope_p = select(below, plane_p[11], plane_p[10]) * half
    slope_q = select(below, plane_q[11], plane_q[10]) * half
    difference = slope_p - slope_q
    steep = difference * difference > 1e-24 * (1.0 + slope_p * slope_p) * (1.0 + slope_q * slope_q)
    ratio = select(steep, pull / difference, 0.0)  # none for (nearly) parallel planes

    crossing = slope_p * ratio, -ratio
    fraction, along, deep = _pull_one(p_at_p, p_at_q, q_at_p, depth_p, depth_q, t_q == 0, pull, crossing)
    where = (at + fraction) * scale - 1.0
    add_to_rows(corners, t_p, _corners(p_at_p, p_at_q, fraction, along, deep, below, where))

    crossing = -slope_q * ratio, ratio
    fraction, along, deep = _pull_one(q_at_q, q_at_p, p_at_q, depth_q, depth_p, t_p == 0, pull, crossing)
    where = (at + (1.0 - fraction)) * scale - 1.0
    add_to_rows(corners, t_q, _corners(q_at_q, q_at_p, fraction, along, deep, below, where))


@inlined
def _adjoints(colour, gradient, size, p, q, count):
    # ½ sum over channels of (g_p + g_q)(c_p - c_q) of the first `count` of sixteen pairs, 0 in the other
    # lanes.
    out = splat(0.0)
    for c in range(0, 3 * size, size):
        g = load_part(gradient, c + p, count) + load_part(gradient, c + q, count)
        out = fma(g, load_part(colour, c + p, count) - load_part(colour, c + q, count), out)
    return 0.5 * out


@inlined
def _put(pairs, place, block, k, column, row, below):
    # Pair k of a block of sixteen waits at `place`.
    pairs.value[0, place] = column + k
    pairs.value[1, place] = row
    pairs.value[2, place] = below
    for j in range(3):
        pairs.value[3 + j, place] = block.value[3 + j, k]
    for j in range(2):
        pairs.triangle[j, place] = block.triangle[j, k]
    return place + 1


@njit(cache=True, nogil=True, error_model="numpy")
def edge_backward(surface, planes, colour, gradient, matrix, vertex_gradient):
    """Add the edge gradient of one view to vertex_gradient (T,3,3) float32, world.

    surface, planes: see `visibility`; colour and gradient (dL/dcolour) (3,H,W) float32; matrix (4,4) float32
    is world → clip.
    """
    height, width = image = colour.shape[1:]
    triangles = len(vertex_gradient)
    # One row per triangle, row 0 for where none is visible: planes as `load_rows` takes them, and dL/d of the
    # corners' clip space.
    rows, corners = np.zeros((1 + triangles, WIDTH), np.float32), np.zeros((1 + triangles, WIDTH))
    for t in range(triangles):
        for k in range(12):
            rows[1 + t, k] = planes.coefficients[t, k]
        rows[1 + t, _COLUMN], rows[1 + t, _ROW] = planes.rectangles[t, 2], planes.rectangles[t, 0]
    inside = Pairs(np.empty((6, WIDTH), np.float32), np.empty((2, WIDTH), np.int32))
    edges = Pairs(np.empty((6, WIDTH), np.float32), np.empty((2, WIDTH), np.int32))
    block = Pairs(np.empty((6, WIDTH), np.float32), np.empty((2, WIDTH), np.int32))
    waiting_inside, waiting_edges = 0, 0
    for row in range(height):
        for column in range(0, width, WIDTH):
            p = row * width + column
            for below in range(2):
                q, count = p + 1, width - 1 - column
                if below:
                    q, count = p + width, (width - column if row + 1 < height else 0)
                t_p = load_part(surface.triangle, p, count) + 1
                t_q = load_part(surface.triangle, q, count) + 1
                seen = (t_p | t_q) != 0
                if bits(seen) == 0:
                    continue
                adjoint = _adjoints(colour, gradient, height * width, p, q, count)
                active, same = seen & (adjoint != 0.0), t_p == t_q
                store(block.value, 3 * WIDTH, adjoint)
                store(block.value, 4 * WIDTH, load_part(surface.depth, p, count))
                store(block.value, 5 * WIDTH, load_part(surface.depth, q, count))
                store(block.triangle, 0, t_p)
                store(block.triangle, WIDTH, t_q)
                left = bits(active & same)
                while left:
                    waiting_inside = _put(inside, waiting_inside, block, lowest(left), column, row, below)
                    left &= left - 1
                    if waiting_inside == WIDTH:
                        _serve_inside(inside, WIDTH, rows, image, corners)
                        waiting_inside = 0
                left = bits(active & ~same)
                while left:
                    waiting_edges = _put(edges, waiting_edges, block, lowest(left), column, row, below)
                    left &= left - 1
                    if waiting_edges == WIDTH:
                        _serve_edges(edges, WIDTH, rows, image, corners)
                        waiting_edges = 0
    _serve_inside(inside, waiting_inside, rows, image, corners)
    _serve_edges(edges, waiting_edges, rows, image, corners)
    for t in range(triangles):
        for i in range(3):
            for axis in range(3):
                total = 0.0
                for k in range(4):
                    total += matrix[k, axis] * corners[1 + t, 4 * i + k]
                vertex_gradient[t, i, axis] += total
