"""Shading kernels on the CPU: feature interpolation, view-direction harmonics, the small MLP, and their
backward.

Visible fragments are shaded sixteen at a time, a lane each, in the order of drawing: fragments of one
triangle are neighbours, so that its features stay at hand. Activations are one row of lanes per quantity and
never leave the cache: the backward makes them again, which costs less than reading 200 bytes a pixel back
from memory.

Shading (DiffSoup `multires.py`): x = [7 interpolated features, 9 real spherical harmonics of the unit
direction from the surface to the camera]; y = sigmoid(w3·relu(w2·relu(w1·x + c1) + c2) + c3); colour = (1 -
r)·x[0:3] + r·y with r = x[3].
"""

from __future__ import annotations

import numpy as np

from paper_artifact.kernel_cache import njit
from paper_artifact.raster.arrays import FEATURES, HIDDEN, INPUTS
from paper_artifact.raster.lanes import (
    WIDTH,
    aligned_zeros,
    evens,
    first,
    floor,
    fma,
    gather,
    inlined,
    join,
    load,
    load8,
    maximum,
    minimum,
    odds,
    scatter,
    select,
    splat,
    splat8,
    square_root,
    store,
    to_float,
    total,
    zip_high,
    zip_low,
)

_PADDED = 8  # places of a corner's features: one more than there are
_H1, _H2, _Y = INPUTS, INPUTS + HIDDEN, INPUTS + 2 * HIDDEN
ROWS = _Y + 3  # kept per sixteen fragments: inputs x, hidden layers h1 and h2, outputs y
_BLOCK = 8  # sixteens whose products the weight gradients take together


@inlined
def _sigmoid(x):
    # 0.5 + 0.5·tanh(x/2) with the clamped rational approximation of tanh that Eigen uses: within 4e-7.
    # The bounds stand first, here and in the ReLUs, so that NaN goes through: a broken MLP must stop the run.
    t = minimum(7.90531110763549805, maximum(-7.90531110763549805, 0.5 * x))
    s = t * t
    p = fma(s, -2.76076847742355e-16, 2.00018790482477e-13)
    p = fma(s, p, -8.60467152213735e-11)
    p = fma(s, p, 5.12229709037114e-08)
    p = fma(s, p, 1.48572235717979e-05)
    p = fma(s, p, 6.37261928875436e-04)
    p = fma(s, p, 4.89352455891786e-03)
    q = fma(s, 1.19825839466702e-06, 1.18534705686654e-04)
    q = fma(s, q, 2.26843463243900e-03)
    q = fma(s, q, 4.89352518554385e-03)
    return fma(0.5 * t, p / q, 0.5)


@njit(cache=True, nogil=True)
def _padded(features):
    out = np.zeros((len(features), 3, _PADDED), np.float32)
    for t in range(len(features)):
        for corner in range(3):
            for f in range(FEATURES):
                out[t, corner, f] = features[t, corner, f]
    return out


@inlined
def _one_pixel(t, b0, b1, features):
    at, b2 = t * 3 * _PADDED, np.float32(1.0) - b0 - b1
    return fma(b0, load8(features, at), fma(b1, load8(features, at + 8), b2 * load8(features, at + 16)))


@inlined
def _two_pixels(triangle, b0, b1, k, features):
    # The interpolated features of fragments k and k + 1, eight lanes each.
    return join(
        _one_pixel(triangle[k], b0[k], b1[k], features),
        _one_pixel(triangle[k + 1], b0[k + 1], b1[k + 1], features),
    )


@inlined
def _transposed(v):
    # Eight pairs of pixels' eight features → eight rows of sixteen pixels: three times even places before odd
    # ones.
    for _ in range(3):
        v0, v1, v2, v3, v4, v5, v6, v7 = v
        v = (
            evens(v0, v1),
            evens(v2, v3),
            evens(v4, v5),
            evens(v6, v7),
            odds(v0, v1),
            odds(v2, v3),
            odds(v4, v5),
            odds(v6, v7),
        )
    return v


@inlined
def _transposed_back(v):
    for _ in range(3):
        v0, v1, v2, v3, v4, v5, v6, v7 = v
        v = (
            zip_low(v0, v4),
            zip_high(v0, v4),
            zip_low(v1, v5),
            zip_high(v1, v5),
            zip_low(v2, v6),
            zip_high(v2, v6),
            zip_low(v3, v7),
            zip_high(v3, v7),
        )
    return v


@inlined
def _interpolate(triangle, b0, b1, k, features, kept, at):
    v = _transposed(
        (
            _two_pixels(triangle, b0, b1, k, features),
            _two_pixels(triangle, b0, b1, k + 2, features),
            _two_pixels(triangle, b0, b1, k + 4, features),
            _two_pixels(triangle, b0, b1, k + 6, features),
            _two_pixels(triangle, b0, b1, k + 8, features),
            _two_pixels(triangle, b0, b1, k + 10, features),
            _two_pixels(triangle, b0, b1, k + 12, features),
            _two_pixels(triangle, b0, b1, k + 14, features),
        )
    )
    for feature in range(FEATURES):
        store(kept, at + feature * WIDTH, v[feature])


@inlined
def _harmonics(pixel, width, height, rays, kept, at):
    # rays (3,3): unnormalised direction surface → camera = rays[0] + rays[1]·ndc_x + rays[2]·ndc_y, world
    # frame.
    centre = to_float(pixel) + 0.5  # exact below 2**23 pixels
    row = floor(centre * np.float32(1.0 / width))
    u = fma(fma(row, np.float32(-width), centre), np.float32(2.0 / width), -1.0)
    v = fma(row + 0.5, np.float32(2.0 / height), -1.0)
    x = fma(v, rays[2, 0], fma(u, rays[1, 0], rays[0, 0]))
    y = fma(v, rays[2, 1], fma(u, rays[1, 1], rays[0, 1]))
    z = fma(v, rays[2, 2], fma(u, rays[1, 2], rays[0, 2]))
    inverse = 1.0 / square_root(fma(x, x, fma(y, y, z * z)))
    x, y, z = x * inverse, y * inverse, z * inverse
    store(kept, at + 112, splat(0.28209479177387814))
    store(kept, at + 128, -0.4886025119029199 * y)
    store(kept, at + 144, 0.4886025119029199 * z)
    store(kept, at + 160, -0.4886025119029199 * x)
    store(kept, at + 176, 1.0925484305920792 * x * y)
    store(kept, at + 192, -1.0925484305920792 * y * z)
    store(kept, at + 208, 0.31539156525252005 * (2.0 * z * z - x * x - y * y))
    store(kept, at + 224, -1.0925484305920792 * x * z)
    store(kept, at + 240, 0.5462742152960396 * (x * x - y * y))


@inlined
def _hidden(weights, bias, kept, source, target):
    # relu(weights · x + bias) for sixteen fragments, four outputs at a time; weights (16,16).
    for o in range(0, HIDDEN, 4):
        y0, y1, y2, y3 = splat(bias[o]), splat(bias[o + 1]), splat(bias[o + 2]), splat(bias[o + 3])
        for i in range(HIDDEN):
            x = load(kept, source + i * WIDTH)
            y0 = fma(weights[o, i], x, y0)
            y1 = fma(weights[o + 1, i], x, y1)
            y2 = fma(weights[o + 2, i], x, y2)
            y3 = fma(weights[o + 3, i], x, y3)
        at = target + o * WIDTH
        store(kept, at, maximum(0.0, y0))
        store(kept, at + 16, maximum(0.0, y1))
        store(kept, at + 32, maximum(0.0, y2))
        store(kept, at + 48, maximum(0.0, y3))


@inlined
def _activate(pixel, triangle, b0, b1, k, width, height, rays, features, w1, c1, w2, c2, w3, c3, kept, at):
    # Fill rows `at` … of kept (flat index) with x, h1, h2 and y of sixteen fragments from k on.
    _interpolate(triangle, b0, b1, k, features, kept, at)
    _harmonics(load(pixel, k), width, height, rays, kept, at)
    _hidden(w1, c1, kept, at, at + _H1 * WIDTH)
    _hidden(w2, c2, kept, at + _H1 * WIDTH, at + _H2 * WIDTH)
    y0, y1, y2 = splat(c3[0]), splat(c3[1]), splat(c3[2])
    for i in range(HIDDEN):
        h = load(kept, at + (_H2 + i) * WIDTH)
        y0 = fma(w3[0, i], h, y0)
        y1 = fma(w3[1, i], h, y1)
        y2 = fma(w3[2, i], h, y2)
    store(kept, at + _Y * WIDTH, _sigmoid(y0))
    store(kept, at + (_Y + 1) * WIDTH, _sigmoid(y1))
    store(kept, at + (_Y + 2) * WIDTH, _sigmoid(y2))


@njit(cache=True, nogil=True)
def shade_forward(shown, covered, rays, features, mlp, colour):
    """Shade the visible fragments of one view into colour (3,H,W) float32, which comes in filled with the
    background.

    shown: the first `covered` of it (see `visibility.Shown`); rays (3,3) float32 (see `_harmonics`); features
    (T,3,7) float32 in [0,1]; mlp: six arrays as torch.nn.Linear has them.
    """
    pixel, triangle, b0, b1 = shown
    w1, c1, w2, c2, w3, c3 = mlp
    height, width = colour.shape[1], colour.shape[2]
    padded = _padded(features)
    kept = aligned_zeros(ROWS * WIDTH)
    for k in range(0, covered, WIDTH):
        _activate(pixel, triangle, b0, b1, k, width, height, rays, padded, w1, c1, w2, c2, w3, c3, kept, 0)
        where, lanes, blend = load(pixel, k), first(covered - k), load(kept, 3 * WIDTH)
        for c in range(3):
            y, base = load(kept, (_Y + c) * WIDTH), load(kept, c * WIDTH)
            scatter(colour, where + c * height * width, fma(blend, y - base, base), lanes)


@inlined
def _back(weights, deltas, source, kept, layer, target):
    # Through the weights (16,16) and the relu that made `layer`: (weights' · delta) where the unit was on.
    for i in range(0, HIDDEN, 4):
        d0, d1, d2, d3 = splat(0.0), splat(0.0), splat(0.0), splat(0.0)
        for o in range(weights.shape[0]):
            d = load(deltas, source + o * WIDTH)
            d0 = fma(weights[o, i], d, d0)
            d1 = fma(weights[o, i + 1], d, d1)
            d2 = fma(weights[o, i + 2], d, d2)
            d3 = fma(weights[o, i + 3], d, d3)
        at, unit = target + i * WIDTH, layer + i * WIDTH
        store(deltas, at, select(load(kept, unit) > 0.0, d0, 0.0))
        store(deltas, at + 16, select(load(kept, unit + 16) > 0.0, d1, 0.0))
        store(deltas, at + 32, select(load(kept, unit + 32) > 0.0, d2, 0.0))
        store(deltas, at + 48, select(load(kept, unit + 48) > 0.0, d3, 0.0))


@inlined
def _outer(sums, deltas, delta, outputs, kept, layer, sixteens):
    # sums[o, i] (lanes) += delta[o]·x[i] over some sixteens, two outputs by two inputs at a time: these stay
    # in the sixteen registers of AVX2.
    for o in range(0, outputs, 2):
        for i in range(0, HIDDEN, 2):
            s = (o * HIDDEN + i) * WIDTH
            z = s + HIDDEN * WIDTH
            s0, s1, z0, z1 = load(sums, s), load(sums, s + 16), load(sums, z), load(sums, z + 16)
            for n in range(sixteens):
                at, x = (n * _DELTAS + delta + o) * WIDTH, (n * ROWS + layer + i) * WIDTH
                d, e, x0, x1 = load(deltas, at), load(deltas, at + WIDTH), load(kept, x), load(kept, x + 16)
                s0, s1, z0, z1 = fma(d, x0, s0), fma(d, x1, s1), fma(e, x0, z0), fma(e, x1, z1)
            store(sums, s, s0)
            store(sums, s + 16, s1)
            store(sums, z, z0)
            store(sums, z + 16, z1)


_D3, _D2, _D1 = 0, 4, 4 + HIDDEN  # the fourth output is 0: the sums go by pairs
_DELTAS = (
    _D1 + HIDDEN
)  # rows of lanes: dL/d of the outputs and of both hidden layers, before their nonlinearity


@inlined
def _flush(gradient, t, g0, g1, g2):
    at = t * 3 * _PADDED
    _add8(gradient, at, g0)
    _add8(gradient, at + 8, g1)
    _add8(gradient, at + 16, g2)


@inlined
def _add8(array, at, value):
    store(array, at, load8(array, at) + value)


@inlined
def _feature_deltas(w1, deltas, delta, keep, g, by_blend):
    # dL/d of the seven features (and an eighth row of zeros): through the first layer, and by the blend with
    # the base colour.
    x0, x1, x2, x3 = keep * g[0], keep * g[1], keep * g[2], by_blend
    x4, x5, x6 = splat(0.0), splat(0.0), splat(0.0)
    for o in range(HIDDEN):
        d = load(deltas, delta + (_D1 + o) * WIDTH)
        x0 = fma(w1[o, 0], d, x0)
        x1 = fma(w1[o, 1], d, x1)
        x2 = fma(w1[o, 2], d, x2)
        x3 = fma(w1[o, 3], d, x3)
        x4 = fma(w1[o, 4], d, x4)
        x5 = fma(w1[o, 5], d, x5)
        x6 = fma(w1[o, 6], d, x6)
    return x0, x1, x2, x3, x4, x5, x6, splat(0.0)


@njit(cache=True, nogil=True)
def shade_backward(shown, covered, rays, features, mlp, colour_gradient, feature_gradient, mlp_gradient):
    """Add one view's dL/d(features, MLP) to feature_gradient (T,3,7) and to the six arrays of mlp_gradient,
    float32.

    colour_gradient (3,H,W) float32; the rest as in `shade_forward`.
    """
    pixel, triangle, b0, b1 = shown
    w1, c1, w2, c2, w3, c3 = mlp
    gw1, gc1, gw2, gc2, gw3, gc3 = mlp_gradient
    height, width = colour_gradient.shape[1], colour_gradient.shape[2]
    size = height * width
    padded, padded_gradient = _padded(features), np.zeros((len(features), 3, _PADDED), np.float32)
    kept = aligned_zeros(_BLOCK * ROWS * WIDTH)
    deltas = aligned_zeros(_BLOCK * _DELTAS * WIDTH)
    sums1 = aligned_zeros(HIDDEN * INPUTS * WIDTH)
    sums2 = aligned_zeros(HIDDEN * HIDDEN * WIDTH)
    sums3 = aligned_zeros(4 * HIDDEN * WIDTH)
    biases = aligned_zeros(_DELTAS * WIDTH)
    by_fragment = aligned_zeros(WIDTH * _PADDED)
    current, g0, g1, g2 = 0, splat8(0.0), splat8(0.0), splat8(0.0)
    for begin in range(0, covered, WIDTH * _BLOCK):
        some = min(_BLOCK, (covered - begin + WIDTH - 1) // WIDTH)
        for n in range(some):
            k, at, delta = begin + n * WIDTH, n * WIDTH * ROWS, n * _DELTAS * WIDTH
            _activate(
                pixel, triangle, b0, b1, k, width, height, rays, padded, w1, c1, w2, c2, w3, c3, kept, at
            )
            where, lanes, blend = load(pixel, k), first(covered - k), load(kept, at + 3 * WIDTH)
            g = (
                gather(colour_gradient, where, lanes),
                gather(colour_gradient, where + size, lanes),
                gather(colour_gradient, where + 2 * size, lanes),
            )
            by_blend = splat(0.0)
            for c in range(3):
                y = load(kept, at + (_Y + c) * WIDTH)
                store(deltas, delta + (_D3 + c) * WIDTH, g[c] * blend * y * (1.0 - y))
                by_blend = fma(g[c], y - load(kept, at + c * WIDTH), by_blend)
            _back(w3, deltas, delta + _D3 * WIDTH, kept, at + _H2 * WIDTH, delta + _D2 * WIDTH)
            _back(w2, deltas, delta + _D2 * WIDTH, kept, at + _H1 * WIDTH, delta + _D1 * WIDTH)
            v = _transposed_back(_feature_deltas(w1, deltas, delta, 1.0 - blend, g, by_blend))
            for pair in range(8):
                store(by_fragment, pair * WIDTH, v[pair])
            for p in range(min(WIDTH, covered - k)):
                t = triangle[k + p]
                if t != current:
                    _flush(padded_gradient, current, g0, g1, g2)
                    current, g0, g1, g2 = t, splat8(0.0), splat8(0.0), splat8(0.0)
                value = load8(by_fragment, p * _PADDED)
                g0 = fma(b0[k + p], value, g0)
                g1 = fma(b1[k + p], value, g1)
                g2 = fma(np.float32(1.0) - b0[k + p] - b1[k + p], value, g2)
        _outer(sums1, deltas, _D1, HIDDEN, kept, 0, some)
        _outer(sums2, deltas, _D2, HIDDEN, kept, _H1, some)
        _outer(sums3, deltas, _D3, 4, kept, _H2, some)
        for row in range(_DELTAS):
            s = load(biases, row * WIDTH)
            for n in range(some):
                s += load(deltas, (n * _DELTAS + row) * WIDTH)
            store(biases, row * WIDTH, s)
    if covered:
        _flush(padded_gradient, current, g0, g1, g2)
    for t in range(len(features)):
        for corner in range(3):
            for f in range(FEATURES):
                feature_gradient[t, corner, f] += padded_gradient[t, corner, f]
    for o in range(HIDDEN):
        gc1[o] += total(load(biases, (_D1 + o) * WIDTH))
        gc2[o] += total(load(biases, (_D2 + o) * WIDTH))
        for i in range(HIDDEN):
            gw1[o, i] += total(load(sums1, (o * INPUTS + i) * WIDTH))
            gw2[o, i] += total(load(sums2, (o * HIDDEN + i) * WIDTH))
    for o in range(3):
        gc3[o] += total(load(biases, (_D3 + o) * WIDTH))
        for i in range(HIDDEN):
            gw3[o, i] += total(load(sums3, (o * HIDDEN + i) * WIDTH))
