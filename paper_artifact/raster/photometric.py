"""Photometric loss kernel on the CPU: .8·mean|target - colour| + .2·½(1 - SSIM), value and gradient in one
pass.

SSIM: 11×11 Gaussian window, sigma 1.5 px, data range 1, valid windows only, mean over windows, channels and
views (the definition of pytorch-msssim, which DiffSoup trains with). Windows that see nothing but equal
pixels have SSIM 1 and no gradient: only the rectangle around the unequal ones is visited.

A pass makes two rows of windows and two rows of the gradient. Rows of pixels enter a ring of the last twelve;
the window runs down its columns first, then along the two rows of sums, which gives the five moments and
SSIM's derivatives by them; these run back the other way, along the rows first, then down a ring of their last
twelve rows. So everything stays in the cache, and the target's moments are made anew each time: keeping them
would cost eight bytes a pixel and channel for little time.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.kernel_cache import njit
from paper_artifact.raster.lanes import (
    WIDTH,
    absolute,
    aligned_zeros,
    bits,
    first,
    fma,
    inlined,
    load,
    load_part,
    load_unit_part,
    select,
    splat,
    store,
    store_part,
    total,
)
from paper_artifact.ssim import gaussian_window

TAPS, RADIUS = 11, 5
L1_WEIGHT, SSIM_WEIGHT = 0.8, 0.2
_C1, _C2 = 0.01**2, 0.03**2
WINDOW = np.array(gaussian_window(), np.float32)
_K0, _K1, _K2, _K3, _K4, _K5 = (float(WINDOW[i]) for i in range(6))
# A ring holds the last twelve rows (two rows of windows see twelve) and is read as twelve neighbours: row r
# is kept twice, in slots r % 12 and r % 12 + 12. Its layout is (blocks of 16 columns, slots, 16).
_ROWS = TAPS + 1
_SLOTS = 2 * _ROWS


@inlined
def _window(v0, v1, v2, v3, v4, v5, v6, v7, v8, v9, v10):
    # The window is symmetric.
    inner = fma(_K3, v3 + v7, fma(_K4, v4 + v6, _K5 * v5))
    return fma(_K0, v0 + v10, fma(_K1, v1 + v9, fma(_K2, v2 + v8, inner)))


@inlined
def _down(v):
    # The window at two neighbouring rows, of twelve rows v: from the middle out, so that few are at hand.
    v0, v1, v2, v3, v4, v5, v6, v7, v8, v9, v10, v11 = v
    upper, lower = fma(_K4, v4 + v6, _K5 * v5), fma(_K4, v5 + v7, _K5 * v6)
    upper, lower = fma(_K3, v3 + v7, upper), fma(_K3, v4 + v8, lower)
    upper, lower = fma(_K2, v2 + v8, upper), fma(_K2, v3 + v9, lower)
    upper, lower = fma(_K1, v1 + v9, upper), fma(_K1, v2 + v10, lower)
    return fma(_K0, v0 + v10, upper), fma(_K0, v1 + v11, lower)


@inlined
def _down_product(x, y, at):
    # `_down` of the products of twelve rows of two rings.
    return _down(
        (
            load(x, at) * load(y, at),
            load(x, at + 16) * load(y, at + 16),
            load(x, at + 32) * load(y, at + 32),
            load(x, at + 48) * load(y, at + 48),
            load(x, at + 64) * load(y, at + 64),
            load(x, at + 80) * load(y, at + 80),
            load(x, at + 96) * load(y, at + 96),
            load(x, at + 112) * load(y, at + 112),
            load(x, at + 128) * load(y, at + 128),
            load(x, at + 144) * load(y, at + 144),
            load(x, at + 160) * load(y, at + 160),
            load(x, at + 176) * load(y, at + 176),
        )
    )


@inlined
def _along(line, c):
    # The window over elements c … c + 10 and the fifteen places after it. Loads of any alignment are cheaper
    # than moving lanes: with AVX2 that takes two instructions for eight of them.
    return _window(
        load(line, c),
        load(line, c + 1),
        load(line, c + 2),
        load(line, c + 3),
        load(line, c + 4),
        load(line, c + 5),
        load(line, c + 6),
        load(line, c + 7),
        load(line, c + 8),
        load(line, c + 9),
        load(line, c + 10),
    )


@inlined
def _rows(ring, at):
    return (
        load(ring, at),
        load(ring, at + 16),
        load(ring, at + 32),
        load(ring, at + 48),
        load(ring, at + 64),
        load(ring, at + 80),
        load(ring, at + 96),
        load(ring, at + 112),
        load(ring, at + 128),
        load(ring, at + 144),
        load(ring, at + 160),
        load(ring, at + 176),
    )


@inlined
def _keep(ring, at, value):
    store(ring, at, value)
    store(ring, at + _ROWS * WIDTH, value)


@inlined
def _store_two(lines, c, values):
    store(lines[0], c, values[0])
    store(lines[1], c, values[1])


@inlined
def _ssim_terms(mx, my, xx, yy, xy):
    # SSIM of windows with means, mean squares and mean product, and its derivatives by mx, xx and xy.
    vx, vy, vxy = fma(-mx, mx, xx), fma(-my, my, yy), fma(-mx, my, xy)
    l_top, l_bottom = fma(2.0 * mx, my, splat(_C1)), fma(mx, mx, fma(my, my, _C1))
    s_top, s_bottom = fma(2.0, vxy, _C2), vx + vy + _C2
    inverse = 1.0 / (l_bottom * s_bottom)
    structure = s_top * l_bottom * inverse
    value = l_top * s_bottom * inverse * structure
    by_square, by_cross = -value * l_bottom * inverse, 2.0 * l_top * inverse
    by_mean = 2.0 * fma(my, structure, -mx * value) * s_bottom * inverse
    return value, by_mean - 2.0 * mx * by_square - my * by_cross, by_square, by_cross


@njit(cache=True, nogil=True)
def _active_rectangle(colour, target):
    # First and last row and column where the two differ; last row -1 where they do not.
    height, width = colour.shape[1], colour.shape[2]
    differ = np.zeros((width + WIDTH - 1) // WIDTH, np.int32)
    row0, row1 = height, -1
    for channel in range(3):
        for r in range(height):
            start = (channel * height + r) * width
            found = 0
            for c in range(0, width, WIDTH):
                unequal = load_part(colour, start + c, width - c) != load_unit_part(
                    target, start + c, width - c
                )
                differ[c // WIDTH] |= bits(unequal)
                found |= bits(unequal)
            if found:
                row0, row1 = min(row0, r), max(row1, r)
    column0, column1 = width, -1
    for block in range(len(differ)):
        for k in range(WIDTH):
            if differ[block] >> k & 1:
                column0, column1 = min(column0, WIDTH * block + k), WIDTH * block + k
    return row0, row1, column0, column1


@njit(cache=True, nogil=True)
def photometric_view(colour, target, views, gradient, error):
    """Return one view's share of the loss (already divided by `views`) and write its gradient and its error
    image.

    colour (3,H,W) float32, target (3,H,W) float32 or uint8 (255 is 1), H and W at least 11; overwritten are
    gradient (3,H,W) float32 with dL/dcolour and error (at least H·W,) float32 with the sum over channels of
    |colour - target|.
    """
    height, width = colour.shape[1], colour.shape[2]
    gradient[:] = np.float32(0.0)
    error[:] = np.float32(0.0)
    row0, row1, column0, column1 = _active_rectangle(colour, target)
    if row1 < 0:
        return 0.0
    # Input rectangle whose windows can hold an unequal pixel, clipped to the image; windows start at (top,
    # left).
    top, left = max(0, row0 - 10), max(0, column0 - 10)
    rows, columns = min(height, row1 + 11) - top, min(width, column1 + 11) - left
    out_rows, out_columns = rows - 10, columns - 10
    blocks = (columns + WIDTH - 1) // WIDTH
    l1_scale = L1_WEIGHT / (3.0 * height * width * views)
    windows = 3.0 * (height - 10) * (width - 10) * views
    ssim_scale = np.float32(-0.5 * SSIM_WEIGHT / windows)
    l1_step = np.float32(l1_scale)
    ring, line = blocks * _SLOTS * WIDTH, WIDTH * (blocks + 1)
    x_ring, y_ring = aligned_zeros(ring), aligned_zeros(ring)
    d_rings = aligned_zeros(3 * ring).reshape(3, ring)
    lines = aligned_zeros(10 * line).reshape(5, 2, line)
    d_lines = aligned_zeros(6 * line).reshape(3, 2, line)  # a block of zeros stands before the first window
    missing, distance = 0.0, 0.0
    for channel in range(3):
        corner = (channel * height + top) * width + left
        d_rings[:] = np.float32(0.0)
        for o in range(-10, rows, 2):
            # Two rows of pixels enter the ring.
            for r in range(o + 10, min(o + 12, rows)):
                for b in range(blocks):
                    start, count = corner + r * width + b * WIDTH, columns - b * WIDTH
                    at = (b * _SLOTS + r % _ROWS) * WIDTH
                    _keep(x_ring, at, load_part(colour, start, count))
                    _keep(y_ring, at, load_unit_part(target, start, count))
            if o < 0:
                continue
            # The windows of rows o and o + 1: down the columns, along the rows, derivatives, back along the
            # rows.
            phase = o % _ROWS
            if o < out_rows:
                for b in range(blocks):
                    at = (b * _SLOTS + phase) * WIDTH
                    x, y, c = _rows(x_ring, at), _rows(y_ring, at), b * WIDTH
                    _store_two(lines[0], c, _down(x))
                    _store_two(lines[1], c, _down(y))
                    _store_two(lines[2], c, _down_product(x_ring, x_ring, at))
                    _store_two(lines[3], c, _down_product(y_ring, y_ring, at))
                    _store_two(lines[4], c, _down_product(x_ring, y_ring, at))
            for k in range(2):
                if o + k < out_rows:
                    row_missing = splat(0.0)
                    for c in range(0, out_columns, WIDTH):
                        value, by_mean, by_square, by_cross = _ssim_terms(
                            _along(lines[0, k], c),
                            _along(lines[1, k], c),
                            _along(lines[2, k], c),
                            _along(lines[3, k], c),
                            _along(lines[4, k], c),
                        )
                        inside = first(out_columns - c)
                        row_missing += select(inside, 1.0 - value, 0.0)
                        store(d_lines[0, k], c + WIDTH, select(inside, ssim_scale * by_mean, 0.0))
                        store(d_lines[1, k], c + WIDTH, select(inside, ssim_scale * by_square, 0.0))
                        store(d_lines[2, k], c + WIDTH, select(inside, ssim_scale * by_cross, 0.0))
                    missing += total(row_missing)
                else:
                    d_lines[:, k] = np.float32(0.0)
                for q in range(3):
                    for b in range(blocks):
                        at = (b * _SLOTS + phase + k) * WIDTH
                        _keep(d_rings[q], at, _along(d_lines[q, k], b * WIDTH + 6))
            # Rows o and o + 1 of the gradient have met all their windows.
            pair_distance = splat(0.0)
            newest = (phase + 2) % _ROWS
            for b in range(blocks):
                at = (b * _SLOTS + newest) * WIDTH
                by_mean = _down(_rows(d_rings[0], at))
                by_square = _down(_rows(d_rings[1], at))
                by_cross = _down(_rows(d_rings[2], at))
                for k in range(min(2, rows - o)):
                    pixel = (b * _SLOTS + phase + k) * WIDTH
                    x, y = load(x_ring, pixel), load(y_ring, pixel)
                    sign = select(x > y, l1_step, select(x < y, -l1_step, splat(0.0)))
                    start, count = (o + k) * width + b * WIDTH, columns - b * WIDTH
                    slope = fma(y, by_cross[k], fma(2.0 * x, by_square[k], by_mean[k] + sign))
                    store_part(gradient, corner + start, slope, count)
                    apart = absolute(x - y)
                    pair_distance += apart
                    start += top * width + left
                    store_part(error, start, load_part(error, start, count) + apart, count)
            distance += total(pair_distance)
    return 0.5 * SSIM_WEIGHT * missing / windows + l1_scale * distance


def make_target(image: np.ndarray) -> np.ndarray:
    """Return the target of an image (3,H,W) as the kernel takes it: contiguous, uint8 (255 is 1) or float32
    in [0,1].

    Raises InputError below 11×11 pixels.
    """
    _, height, width = image.shape
    if min(height, width) < TAPS:
        raise InputError(
            f"an image needs at least {TAPS} × {TAPS} pixels, got {height} × {width}; render it larger"
        )
    return np.ascontiguousarray(image, np.uint8 if image.dtype == np.uint8 else np.float32)
