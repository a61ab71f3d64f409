"""Per-fragment uniform draws for stochastic opacity masking: a hash of named counters, no generator's state.

A draw is a pure function of (seed, step, view, pixel, triangle), all non-negative integers: the order in
which fragments are visited, and the number of threads, cannot change it. The finalizer is the 32-bit
"lowbias32" of C. Wellons, "Prospecting for hash functions" (2018); numba, numpy and torch versions give the
same bits.

pixel is the row-major index row·width + column; triangle the index into the soup; view the index of the
scene's view.
"""

from __future__ import annotations

import numba
import numpy as np
import torch

from paper_artifact.raster.lanes import inlined, to_float

_MASK = 0xFFFFFFFF
_SEED, _STEP, _VIEW, _PIXEL, _TRIANGLE = 0x9E3779B9, 0x85EBCA6B, 0xC2B2AE35, 0x9E3779B1, 0x85EBCA77
_M1, _M2 = 0x7FEB352D, 0x846CA68B
_UNIT = 2.0**-24  # a draw keeps 24 of the 32 bits: every one of them is a float32


def _mix_int(x: int) -> int:
    x &= _MASK
    x = ((x ^ (x >> 16)) * _M1) & _MASK
    x = ((x ^ (x >> 15)) * _M2) & _MASK
    return x ^ (x >> 16)


def view_key(seed: int, step: int, view: int) -> int:
    """Return the 32-bit key shared by all fragments of one view of one step (a Python int below 2**32)."""
    key = _mix_int(seed * _SEED + 1)
    key = _mix_int(key ^ (step * _STEP & _MASK))
    return _mix_int(key ^ (view * _VIEW & _MASK))


@numba.njit(inline="always")
def draw(key: np.uint32, pixel: np.uint32, triangle: np.uint32) -> np.float32:
    """Return the uniform draw in [0, 1) (float32, 24 bits) of one fragment; all arguments uint32."""
    x = np.uint32(key + pixel * np.uint32(_PIXEL) + triangle * np.uint32(_TRIANGLE))
    x = np.uint32((x ^ (x >> np.uint32(16))) * np.uint32(_M1))
    x = np.uint32((x ^ (x >> np.uint32(15))) * np.uint32(_M2))
    x = np.uint32(x ^ (x >> np.uint32(16)))
    return np.float32(x >> np.uint32(8)) * np.float32(_UNIT)


@inlined
def draw_lanes(key, pixel, triangle):
    """Return `draw` of sixteen pixels (int32 lanes) of one triangle, in a kernel (float32 lanes); key
    uint32."""
    x = pixel * _PIXEL + (key + triangle * _TRIANGLE)
    x = (x ^ (x >> 16)) * _M1
    x = (x ^ (x >> 15)) * _M2
    x = x ^ (x >> 16)
    return to_float(x >> 8) * (1.0 / 16777216.0)


def draw_torch(key: int, pixel: torch.Tensor, triangle: torch.Tensor) -> torch.Tensor:
    """Return `draw` for int64 tensors of equal shape, as float64 of that shape (the same 24-bit values)."""
    x = (key + pixel * _PIXEL + triangle * _TRIANGLE) & _MASK
    x = ((x ^ (x >> 16)) * _M1) & _MASK
    x = ((x ^ (x >> 15)) * _M2) & _MASK
    x = x ^ (x >> 16)
    return (x >> 8).to(torch.float64) * _UNIT
