"""What a loss term on the vertices must offer to the training loop, and the term that adds nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from torch import Tensor


class LossTerm(Protocol):
    """An additive loss on the soup's vertices (T,3,3), world units; steps count from 1."""

    log: list[dict]  # what happened, JSON-able, for the record

    def refresh_if_due(self, step: int, vertices: Tensor, opacity: Tensor, resampled: bool) -> bool:
        """Make the term's plan when it is due and return whether it was; opacity (T,3) in [0,1]; resampled:
        the soup is new."""

    def value(self, step: int, vertices: Tensor, photo_gradient_norm: Callable[..., float]) -> Tensor | None:
        """Return the weighted loss (scalar), differentiable by the vertices, or None while the term is
        inactive.

        photo_gradient_norm(batches=1): norm of the photometric gradient by the vertices, the mean over this
        step's batch and those of the next batches - 1 steps.
        """

    def state(self) -> dict:
        """Return what a resumed run needs."""

    def load_state(self, state: dict) -> None:
        """Take over what `state` returned."""


class NoTerm:
    """The term of condition C0: it adds nothing, and no code of the topology package is imported for it."""

    log: list[dict] = []

    def refresh_if_due(self, step: int, vertices: Tensor, opacity: Tensor, resampled: bool) -> bool:
        """Return False: there is nothing to refresh."""
        return False

    def value(self, step: int, vertices: Tensor, photo_gradient_norm: Callable[..., float]) -> None:
        """Return None: nothing is added."""

    def state(self) -> dict:
        """Return an empty state."""
        return {}

    def load_state(self, state: dict) -> None:
        """Take over nothing."""
