"""A run's term of a loss in words: frame, and density where it is "auto", from the SfM cloud alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from paper_artifact.config import LossConfig
from paper_artifact.topology.clean import cleaned
from paper_artifact.topology.density import choose_density
from paper_artifact.topology.statement import Statement, frame_diagonal
from paper_artifact.topology.term import TopologyTerm


def words_term(
    loss: LossConfig,
    points: np.ndarray,
    steps: int,
    seed: int,
    *,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
) -> TopologyTerm:
    """Return the term of a loss of the kind "betti" in a run of `steps` steps.

    points (P,3): the SfM cloud, world units. A density that was asked of it, cleaned, is logged ("event":
    "density"). strict, tell: see `TopologyTerm`. Raises InputError as `frame_diagonal`, `cleaned` and
    `choose_density` do.
    """
    statement = Statement(loss.betti or (), frame_diagonal(points))
    log: list[dict] = []
    if loss.samples == 0:
        density = choose_density(cleaned(points), statement, loss)
        loss, log = replace(loss, samples=density.samples), [{"event": "density", **density.to_json()}]
        if tell is not None:
            for reason in density.reasons:
                tell(reason)
    term = TopologyTerm(loss, replace(statement, samples=loss.samples), steps, seed, strict=strict, tell=tell)
    term.log += log
    return term
