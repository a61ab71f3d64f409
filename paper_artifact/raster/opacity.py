"""The opacity gradient on the CPU: DiffSoup's estimate of what a triangle's opacity does to the error, by
stochastic masking."""

from __future__ import annotations

import numpy as np

from paper_artifact.kernel_cache import njit
from paper_artifact.raster.lanes import (
    WIDTH,
    bits,
    first,
    iota,
    load,
    maximum,
    select,
    splat,
    to_float,
    total,
)
from paper_artifact.raster.visibility import along, inside, line


@njit(cache=True, nogil=True, error_model="numpy")
def opacity_backward(planes, met, opacity, width, surface, error, weight, opacity_gradient):
    """Add the opacity gradient of one view to opacity_gradient (T,3) float32 (DiffSoup, path 2).

    planes, met, opacity, width, surface: as drawn (`visibility.draw`); error (H·W + 16,) float32: sum over
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
