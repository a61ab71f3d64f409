"""What is drawn, as arrays: the soup's sizes, and the record of arrays that values and gradients share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

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
