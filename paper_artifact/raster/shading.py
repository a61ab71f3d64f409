"""Shading kernels on the CPU: feature interpolation, view-direction harmonics, the small MLP, and their backward.

Covered pixels are processed in blocks of `BLOCK`, one array row per quantity, so that every inner loop runs over
consecutive pixels and vectorises. The forward keeps each block's activations; the backward walks them once.

Shading (DiffSoup `multires.py`): x = [7 interpolated features, 9 real spherical harmonics of the unit direction from the surface
to the camera]; y = sigmoid(w3·relu(w2·relu(w1·x + c1) + c2) + c3); colour = (1 - r)·x[0:3] + r·y with r = x[3].
"""

from __future__ import annotations

import numba
import numpy as np

from paper_artifact.raster.arrays import FEATURES, HIDDEN, INPUTS

BLOCK = 256
_H2, _Y = INPUTS + HIDDEN, INPUTS + 2 * HIDDEN
ROWS = _Y + 3  # kept per pixel: inputs x, hidden layers h1 and h2, outputs y
_FAST = {"contract", "reassoc", "arcp", "nsz", "afn"}  # keeps NaN and infinity, so that a broken run is seen


@numba.njit(inline="always")
def _sigmoid(x):
    # 0.5 + 0.5·tanh(x/2) with the clamped rational approximation of tanh that Eigen uses: within 4e-7, no call, vectorises.
    t = min(max(np.float32(0.5) * x, np.float32(-7.90531110763549805)), np.float32(7.90531110763549805))
    s = t * t
    p = np.float32(-2.76076847742355e-16)
    p = p * s + np.float32(2.00018790482477e-13)
    p = p * s + np.float32(-8.60467152213735e-11)
    p = p * s + np.float32(5.12229709037114e-08)
    p = p * s + np.float32(1.48572235717979e-05)
    p = p * s + np.float32(6.37261928875436e-04)
    p = p * s + np.float32(4.89352455891786e-03)
    q = np.float32(1.19825839466702e-06)
    q = q * s + np.float32(1.18534705686654e-04)
    q = q * s + np.float32(2.26843463243900e-03)
    q = q * s + np.float32(4.89352518554385e-03)
    return np.float32(0.5) + np.float32(0.5) * t * p / q


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _affine(weights, bias, x, out, count, relu):
    # out[o, :] = weights[o] · x + bias[o], four inputs a pass: one load and store of the accumulator per four products.
    for o in range(weights.shape[0]):
        row = out[o]
        b = bias[o]
        for p in range(count):
            row[p] = b
        for i in range(0, weights.shape[1], 4):
            v0, v1, v2, v3 = weights[o, i], weights[o, i + 1], weights[o, i + 2], weights[o, i + 3]
            x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
            for p in range(count):
                row[p] += v0 * x0[p] + v1 * x1[p] + v2 * x2[p] + v3 * x3[p]
        if relu:
            for p in range(count):
                row[p] = max(row[p], np.float32(0.0))


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _harmonics(pixels, start, count, width, height, rays, x, direction):
    # rays (3,3): unnormalised direction surface → camera = rays[0] + rays[1]·ndc_x + rays[2]·ndc_y, world frame; direction
    # (3,BLOCK) is scratch. Each loop writes one row: with more, LLVM gives up proving that they do not overlap and does not
    # vectorise.
    sx, sy = np.float32(2.0 / width), np.float32(2.0 / height)
    inverse_width = np.float32(1.0 / width)
    u, v, norm = x[7], x[8], x[9]
    for p in range(count):
        pixel = np.float32(pixels[start + p]) + np.float32(0.5)  # exact below 2**23 pixels
        v[p] = np.floor(pixel * inverse_width)
    for p in range(count):
        pixel = np.float32(pixels[start + p]) + np.float32(0.5)
        u[p] = (pixel - v[p] * np.float32(width)) * sx - np.float32(1.0)
    for p in range(count):
        v[p] = (v[p] + np.float32(0.5)) * sy - np.float32(1.0)
    for axis in range(3):
        d = direction[axis]
        r0, r1, r2 = rays[0, axis], rays[1, axis], rays[2, axis]
        for p in range(count):
            d[p] = r0 + r1 * u[p] + r2 * v[p]
    dx, dy, dz = direction[0], direction[1], direction[2]
    for p in range(count):
        norm[p] = np.float32(1.0) / np.sqrt(dx[p] * dx[p] + dy[p] * dy[p] + dz[p] * dz[p])
    for axis in range(3):
        d = direction[axis]
        for p in range(count):
            d[p] *= norm[p]
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = x[7], x[8], x[9], x[10], x[11], x[12], x[13], x[14], x[15]
    for p in range(count):
        h0[p] = np.float32(0.28209479177387814)
    for p in range(count):
        h1[p] = np.float32(-0.4886025119029199) * dy[p]
    for p in range(count):
        h2[p] = np.float32(0.4886025119029199) * dz[p]
    for p in range(count):
        h3[p] = np.float32(-0.4886025119029199) * dx[p]
    for p in range(count):
        h4[p] = np.float32(1.0925484305920792) * dx[p] * dy[p]
    for p in range(count):
        h5[p] = np.float32(-1.0925484305920792) * dy[p] * dz[p]
    for p in range(count):
        h6[p] = np.float32(0.31539156525252005) * (
            np.float32(2.0) * dz[p] * dz[p] - dx[p] * dx[p] - dy[p] * dy[p]
        )
    for p in range(count):
        h7[p] = np.float32(-1.0925484305920792) * dx[p] * dz[p]
    for p in range(count):
        h8[p] = np.float32(0.5462742152960396) * (dx[p] * dx[p] - dy[p] * dy[p])


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def shade_forward(pixels, visible, fragments, rays, features, mlp, activations, colour):
    """Shade the covered pixels of one view into colour (3,H,W) float32, which comes in filled with the background.

    pixels (covered,) int32, visible (H·W,) int32, fragments: see `visibility`; rays (3,3) float32 (see
    `_harmonics`); features (T,3,7) float32 in [0,1]; mlp: six arrays, see `arrays.MLP_SHAPES`. activations
    (blocks, ROWS, BLOCK) float32, with room for every covered pixel, is filled for the backward pass.
    """
    fragment_index, fragment_value = fragments.index, fragments.value
    w1, c1, w2, c2, w3, c3 = mlp
    height, width = colour.shape[1], colour.shape[2]
    image = colour.reshape(3, height * width)
    covered = len(pixels)
    direction = np.empty((3, BLOCK), np.float32)
    for block in range((covered + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        count = min(BLOCK, covered - start)
        kept = activations[block]
        x, h1, h2, y = kept[:INPUTS], kept[INPUTS:_H2], kept[_H2:_Y], kept[_Y:ROWS]
        for p in range(count):
            fragment = visible[pixels[start + p]]
            t = fragment_index[fragment, 1]
            b0, b1 = fragment_value[fragment, 0], fragment_value[fragment, 1]
            b2 = np.float32(1.0) - b0 - b1
            for f in range(FEATURES):
                x[f, p] = b0 * features[t, 0, f] + b1 * features[t, 1, f] + b2 * features[t, 2, f]
        _harmonics(pixels, start, count, width, height, rays, x, direction)
        _affine(w1, c1, x, h1, count, True)
        _affine(w2, c2, h1, h2, count, True)
        _affine(w3, c3, h2, y, count, False)
        for c in range(3):
            for p in range(count):
                y[c, p] = _sigmoid(y[c, p])
            for p in range(count):
                image[c, pixels[start + p]] = x[c, p] + x[3, p] * (y[c, p] - x[c, p])


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _accumulate_outer(delta, x, count, gradient, bias_gradient):
    # gradient[o, i] += sum over pixels of delta[o]·x[i]; bias_gradient[o] += sum of delta[o].
    for o in range(delta.shape[0]):
        row = delta[o]
        total = np.float32(0.0)
        for p in range(count):
            total += row[p]
        bias_gradient[o] += total
        for i in range(0, x.shape[0], 4):
            x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
            s0, s1, s2, s3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for p in range(count):
                d = row[p]
                s0 += d * x0[p]
                s1 += d * x1[p]
                s2 += d * x2[p]
                s3 += d * x3[p]
            gradient[o, i] += s0
            gradient[o, i + 1] += s1
            gradient[o, i + 2] += s2
            gradient[o, i + 3] += s3


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _transposed(weights, delta, out, count, rows):
    # out[i, :] = sum over o of weights[o, i]·delta[o, :] for the first `rows` inputs.
    outputs = weights.shape[0]
    for i in range(rows):
        row = out[i]
        for p in range(count):
            row[p] = weights[0, i] * delta[0, p]
        o = 1
        while o + 3 < outputs:
            v0, v1, v2, v3 = weights[o, i], weights[o + 1, i], weights[o + 2, i], weights[o + 3, i]
            d0, d1, d2, d3 = delta[o], delta[o + 1], delta[o + 2], delta[o + 3]
            for p in range(count):
                row[p] += v0 * d0[p] + v1 * d1[p] + v2 * d2[p] + v3 * d3[p]
            o += 4
        while o < outputs:
            v0 = weights[o, i]
            d0 = delta[o]
            for p in range(count):
                row[p] += v0 * d0[p]
            o += 1


@numba.njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def shade_backward(
    pixels, visible, fragments, mlp, activations, colour_gradient, feature_gradient, mlp_gradient
):
    """Add one view's dL/d(features, MLP) to feature_gradient (T,3,7) and to the six arrays of mlp_gradient, float32.

    colour_gradient (3,H,W) float32; activations as `shade_forward` left them; the rest as there.
    """
    fragment_index, fragment_value = fragments.index, fragments.value
    w1, w2, w3 = mlp[0], mlp[2], mlp[4]
    gw1, gc1, gw2, gc2, gw3, gc3 = mlp_gradient
    incoming = colour_gradient.reshape(3, colour_gradient.shape[1] * colour_gradient.shape[2])
    covered = len(pixels)
    d3 = np.empty((3, BLOCK), np.float32)
    d2 = np.empty((HIDDEN, BLOCK), np.float32)
    d1 = np.empty((HIDDEN, BLOCK), np.float32)
    dx = np.empty((FEATURES, BLOCK), np.float32)
    g = np.empty((3, BLOCK), np.float32)
    for block in range((covered + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        count = min(BLOCK, covered - start)
        kept = activations[block]
        x, h1, h2, y = kept[:INPUTS], kept[INPUTS:_H2], kept[_H2:_Y], kept[_Y:ROWS]
        for c in range(3):
            for p in range(count):
                g[c, p] = incoming[c, pixels[start + p]]
            for p in range(count):
                d3[c, p] = g[c, p] * x[3, p] * y[c, p] * (np.float32(1.0) - y[c, p])
        _accumulate_outer(d3, h2, count, gw3, gc3)
        _transposed(w3, d3, d2, count, HIDDEN)
        for i in range(HIDDEN):
            for p in range(count):
                d2[i, p] = d2[i, p] if h2[i, p] > 0 else np.float32(0.0)
        _accumulate_outer(d2, h1, count, gw2, gc2)
        _transposed(w2, d2, d1, count, HIDDEN)
        for i in range(HIDDEN):
            for p in range(count):
                d1[i, p] = d1[i, p] if h1[i, p] > 0 else np.float32(0.0)
        _accumulate_outer(d1, x, count, gw1, gc1)
        _transposed(w1, d1, dx, count, FEATURES)
        for c in range(3):
            for p in range(count):
                dx[c, p] += g[c, p] * (np.float32(1.0) - x[3, p])
                dx[3, p] += g[c, p] * (y[c, p] - x[c, p])
        for p in range(count):
            fragment = visible[pixels[start + p]]
            t = fragment_index[fragment, 1]
            b0, b1 = fragment_value[fragment, 0], fragment_value[fragment, 1]
            b2 = np.float32(1.0) - b0 - b1
            for f in range(FEATURES):
                value = dx[f, p]
                feature_gradient[t, 0, f] += b0 * value
                feature_gradient[t, 1, f] += b1 * value
                feature_gradient[t, 2, f] += b2 * value
