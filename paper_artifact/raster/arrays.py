"""What is drawn, as arrays: the soup's sizes, the record of arrays that values and gradients share, the
sigmoid."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.extending import intrinsic

from paper_artifact.arithmetic import LN2_HIGH, LN2_LOW, LOG2_E
from paper_artifact.kernel_cache import njit

FEATURES = 7  # per corner: base colour (3), blend, latent (3)
HARMONICS = 9  # real spherical harmonics of degrees 0–2
INPUTS = FEATURES + HARMONICS  # of the shading MLP
HIDDEN = 16  # width of its two hidden layers
MLP_SHAPES: tuple[tuple[int, ...], ...] = (
    (HIDDEN, INPUTS),
    (HIDDEN,),
    (HIDDEN, HIDDEN),
    (HIDDEN,),
    (3, HIDDEN),
    (3,),
)  # weights and biases of its three layers, as torch.nn.Linear has them


class SoupArrays(NamedTuple):
    """A soup as the rasterizer takes it, or a loss's gradient with respect to it: float32, contiguous."""

    vertices: np.ndarray  # (T,3,3) world; every triangle owns its corners
    features: np.ndarray  # (T,3,FEATURES) in [0,1], after the sigmoid
    opacity: np.ndarray  # (T,3) in [0,1], after the sigmoid
    mlp: tuple[np.ndarray, ...]  # see MLP_SHAPES

    @staticmethod
    def of(arrays: Iterable[np.ndarray]) -> SoupArrays:
        """Return the soup of nine arrays: vertices, features, opacity and the MLP's six."""
        vertices, features, opacity, *mlp = arrays
        return SoupArrays(vertices, features, opacity, tuple(mlp))

    def flat(self) -> tuple[np.ndarray, ...]:
        """Return the nine arrays, in the order that `of` takes."""
        return (self.vertices, self.features, self.opacity, *self.mlp)


_ROUND = 6755399441055744.0  # 1.5 · 2^52: a sum with it has no digits behind the point


@intrinsic
def _power_of_two(typing, rounded):
    # 2^n of n + _ROUND, whose last bits are n's.
    def code(context, builder, sig, arguments):
        word = ir.IntType(64)
        exponent = builder.add(builder.bitcast(arguments[0], word), word(1023))
        return builder.bitcast(builder.shl(exponent, word(52)), ir.DoubleType())

    return types.float64(types.float64), code


@njit(cache=True, nogil=True, error_model="numpy")
def _sigmoid(x, out):
    for i in range(len(x)):
        v = -float(x[i])
        v = -600.0 if v < -600.0 else (600.0 if v > 600.0 else v)
        rounded = v * LOG2_E + _ROUND
        n = rounded - _ROUND
        r = (v - n * LN2_HIGH) - n * LN2_LOW
        p = 2.7557319223985893e-06  # 1/9!: e^r to 1e-11, more than a float32 shows
        p = p * r + 2.48015873015873e-05
        p = p * r + 0.0001984126984126984
        p = p * r + 0.001388888888888889
        p = p * r + 0.008333333333333333
        p = p * r + 0.041666666666666664
        p = p * r + 0.16666666666666666
        p = p * r + 0.5
        p = p * r + 1.0
        p = p * r + 1.0
        out[i] = np.float32(1.0 / (1.0 + p * _power_of_two(rounded)))


def sigmoid(x: np.ndarray) -> np.ndarray:
    """Return 1 / (1 + e^-x), float32 of the shape of x float32, the nearest float32 but for one in 1e4.

    torch's depends on the processor. Nothing is fused here, so this one does not."""
    x = np.ascontiguousarray(x, np.float32)
    out = np.empty_like(x)
    _sigmoid(x.reshape(-1), out.reshape(-1))
    return out
