"""Photometric loss kernel on the CPU: .8·mean|target - colour| + .2·½(1 - SSIM), value and gradient in one pass.

SSIM: 11×11 Gaussian window, sigma 1.5 px, data range 1, valid windows only, mean over windows, channels and views (the
definition of pytorch-msssim, which DiffSoup trains with). The target's own blurred moments never change; they are computed once.
Windows that see nothing but equal pixels have SSIM 1 and no gradient: only the rectangle around the unequal ones is visited.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from paper_artifact.errors import InputError

TAPS, RADIUS = 11, 5
L1_WEIGHT, SSIM_WEIGHT = 0.8, 0.2
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_FAST = {"contract", "reassoc", "arcp", "nsz", "afn"}
_offsets = np.arange(TAPS) - RADIUS
WINDOW = (np.exp(-(_offsets**2) / (2 * 1.5**2)) / np.exp(-(_offsets**2) / (2 * 1.5**2)).sum()).astype(
    np.float32
)
_K0, _K1, _K2, _K3, _K4, _K5 = (np.float32(WINDOW[i]) for i in range(6))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _blur(source, out, scratch, rows, columns):
    # Valid separable blur of source[:rows, :columns] into out[:rows-10, :columns-10]; the window is symmetric.
    for r in range(rows):
        s, d = source[r], scratch[r]
        for c in range(columns - 10):
            d[c] = (
                _K5 * s[c + 5]
                + _K4 * (s[c + 4] + s[c + 6])
                + _K3 * (s[c + 3] + s[c + 7])
                + _K2 * (s[c + 2] + s[c + 8])
                + _K1 * (s[c + 1] + s[c + 9])
                + _K0 * (s[c] + s[c + 10])
            )
    for r in range(rows - 10):
        d = out[r]
        s0, s1, s2, s3, s4, s5 = (
            scratch[r],
            scratch[r + 1],
            scratch[r + 2],
            scratch[r + 3],
            scratch[r + 4],
            scratch[r + 5],
        )
        s6, s7, s8, s9, s10 = scratch[r + 6], scratch[r + 7], scratch[r + 8], scratch[r + 9], scratch[r + 10]
        for c in range(columns - 10):
            d[c] = (
                _K5 * s5[c]
                + _K4 * (s4[c] + s6[c])
                + _K3 * (s3[c] + s7[c])
                + _K2 * (s2[c] + s8[c])
                + _K1 * (s1[c] + s9[c])
                + _K0 * (s0[c] + s10[c])
            )


@numba.njit(cache=True, nogil=True)
def target_moments(target, mean, square):
    """Fill mean and square (3,H-10,W-10) float32: windowed mean of target (3,H,W) and of its square."""
    height, width = target.shape[1], target.shape[2]
    scratch = np.empty((height, width), np.float32)
    for channel in range(3):
        _blur(target[channel], mean[channel], scratch, height, width)
        _blur(target[channel] * target[channel], square[channel], scratch, height, width)


@numba.njit(cache=True, nogil=True)
def _active_rectangle(colour, target):
    height, width = colour.shape[1], colour.shape[2]
    row0, row1, column0, column1 = height, -1, width, -1
    for channel in range(3):
        for r in range(height):
            a, b = colour[channel, r], target[channel, r]
            first = 0
            while first < width and a[first] == b[first]:
                first += 1
            if first == width:
                continue
            last = width - 1
            while a[last] == b[last]:
                last -= 1
            row0, row1 = min(row0, r), max(row1, r)
            column0, column1 = min(column0, first), max(column1, last)
    return row0, row1, column0, column1


@numba.njit(inline="always")
def _ssim_terms(mx, my, xx, yy, xy):
    vx, vy, vxy = xx - mx * mx, yy - my * my, xy - mx * my
    l_top, l_bottom = np.float32(2.0) * mx * my + _C1, mx * mx + my * my + _C1
    s_top, s_bottom = np.float32(2.0) * vxy + _C2, vx + vy + _C2
    inverse = np.float32(1.0) / (l_bottom * s_bottom)
    structure = s_top * l_bottom * inverse
    value = l_top * s_bottom * inverse * structure
    # Partial derivatives of SSIM with respect to the windowed square and product of x; `over` is 1 / l_bottom.
    return (
        value,
        structure,
        -value * l_bottom * inverse,
        np.float32(2.0) * l_top * inverse,
        s_bottom * inverse,
    )


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _ssim_row(mean_x, mean_y, square_x, square_y, cross, by_mean, by_square, by_cross, count, scale):
    # One row of windows: sum of 1 - SSIM, and dL/d(windowed mean, square, product of x). One output a loop: LLVM vectorises
    # only loops whose arrays it can prove apart with few checks, and computing the terms three times is far cheaper than not.
    total = np.float32(0.0)
    for c in range(count):
        mx, my = mean_x[c], mean_y[c]
        value, structure, d_square, d_cross, over = _ssim_terms(mx, my, square_x[c], square_y[c], cross[c])
        total += np.float32(1.0) - value
        d_mean = np.float32(2.0) * (my * structure - mx * value) * over
        by_mean[c] = scale * (d_mean - np.float32(2.0) * mx * d_square - my * d_cross)
    for c in range(count):
        value, structure, d_square, d_cross, over = _ssim_terms(
            mean_x[c], mean_y[c], square_x[c], square_y[c], cross[c]
        )
        by_square[c] = scale * d_square
    for c in range(count):
        value, structure, d_square, d_cross, over = _ssim_terms(
            mean_x[c], mean_y[c], square_x[c], square_y[c], cross[c]
        )
        by_cross[c] = scale * d_cross
    return total


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def photometric_view(colour, target, mean, square, views, gradient):
    """Return one view's share of the loss (already divided by `views`) and write its gradient.

    colour, target (3,H,W) float32; mean, square: see `target_moments`; gradient (3,H,W) float32 is overwritten with dL/dcolour.
    """
    height, width = colour.shape[1], colour.shape[2]
    gradient[:] = np.float32(0.0)
    row0, row1, column0, column1 = _active_rectangle(colour, target)
    if row1 < 0:
        return 0.0
    # Input rectangle whose windows can hold an unequal pixel, clipped to the image; windows start at (top, left).
    top, left = max(0, row0 - 10), max(0, column0 - 10)
    rows, columns = min(height, row1 + 11) - top, min(width, column1 + 11) - left
    out_rows, out_columns = rows - 10, columns - 10
    l1_scale = np.float32(L1_WEIGHT / (3.0 * height * width * views))
    windows = 3.0 * (height - 10) * (width - 10) * views
    ssim_scale = np.float32(-0.5 * SSIM_WEIGHT / windows)
    scratch = np.empty((rows + 20, columns + 20), np.float32)
    product = np.empty((rows, columns), np.float32)
    mean_x = np.empty((out_rows, out_columns), np.float32)
    square_x = np.empty((out_rows, out_columns), np.float32)
    cross = np.empty((out_rows, out_columns), np.float32)
    padded = np.zeros((3, rows + 10, columns + 10), np.float32)
    spread = np.empty((3, rows, columns), np.float32)
    loss = 0.0
    for channel in range(3):
        x = colour[channel, top : top + rows, left : left + columns]
        y = target[channel, top : top + rows, left : left + columns]
        out = gradient[channel, top : top + rows, left : left + columns]
        _blur(x, mean_x, scratch, rows, columns)
        for r in range(rows):
            for c in range(columns):
                product[r, c] = x[r, c] * x[r, c]
        _blur(product, square_x, scratch, rows, columns)
        for r in range(rows):
            for c in range(columns):
                product[r, c] = x[r, c] * y[r, c]
        _blur(product, cross, scratch, rows, columns)
        missing = 0.0
        for r in range(out_rows):
            a, b, xx, xy = mean_x[r], mean[channel, top + r, left : left + out_columns], square_x[r], cross[r]
            yy = square[channel, top + r, left : left + out_columns]
            missing += _ssim_row(
                a,
                b,
                xx,
                yy,
                xy,
                padded[0, r + 10, 10:],
                padded[1, r + 10, 10:],
                padded[2, r + 10, 10:],
                out_columns,
                ssim_scale,
            )
        loss += 0.5 * SSIM_WEIGHT * missing / windows
        for k in range(3):
            _blur(padded[k], spread[k], scratch, rows + 10, columns + 10)
        absolute = 0.0
        for r in range(rows):
            s0, s1, s2, xr, yr, d = spread[0, r], spread[1, r], spread[2, r], x[r], y[r], out[r]
            total = np.float32(0.0)
            for c in range(columns):
                difference = xr[c] - yr[c]
                total += abs(difference)
                sign = l1_scale if difference > 0 else (-l1_scale if difference < 0 else np.float32(0.0))
                d[c] = s0[c] + np.float32(2.0) * xr[c] * s1[c] + yr[c] * s2[c] + sign
            absolute += total
        loss += L1_WEIGHT * absolute / (3.0 * height * width * views)
    return loss


class Target(NamedTuple):
    """The image that a view is compared with, and its windowed moments; see `make_target`."""

    image: np.ndarray  # (3,H,W) float32 in [0,1]
    mean: np.ndarray  # (3,H-10,W-10) float32: windowed mean of the image
    square: np.ndarray  # (3,H-10,W-10) float32: windowed mean of its square


def make_target(image: np.ndarray) -> Target:
    """Return the target of an image (3,H,W) float32 in [0,1]. Raises InputError below 11×11 pixels."""
    _, height, width = image.shape
    if min(height, width) < TAPS:
        raise InputError(
            f"an image needs at least {TAPS} × {TAPS} pixels, got {height} × {width}; render it larger"
        )
    shape = (3, height - TAPS + 1, width - TAPS + 1)
    target = Target(
        np.ascontiguousarray(image, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
    )
    target_moments(*target)
    return target
