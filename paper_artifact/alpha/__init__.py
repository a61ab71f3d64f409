"""Exact differentiable alpha persistence: a package of its own, on numpy and numba (docs/persistence.md).

Of this project it imports `errors` and `kernel_cache` only. torch, scipy, scikit-learn, matplotlib and gudhi
are loaded only by the names that need them: importing this package imports numpy and nothing else.

Three rooms, no way back: triangulation (`delaunay`, on exact `predicates`), filtration, reduction; `complex`
joins them. gudhi is the oracle of the tests.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from paper_artifact.alpha.persistence import Pairs, alpha_filtration, alpha_persistence
from paper_artifact.errors import InputError

if TYPE_CHECKING:
    from paper_artifact.alpha.diagrams import AlphaPersistence as AlphaPersistence
    from paper_artifact.alpha.diagrams import DiagramTensor as DiagramTensor
    from paper_artifact.alpha.diagrams import alpha_diagrams as alpha_diagrams
    from paper_artifact.alpha.diagrams import circumradius as circumradius
    from paper_artifact.alpha.distances import bottleneck as bottleneck
    from paper_artifact.alpha.distances import persistence_image as persistence_image
    from paper_artifact.alpha.distances import persistence_landscape as persistence_landscape
    from paper_artifact.alpha.distances import plot_diagram as plot_diagram
    from paper_artifact.alpha.distances import wasserstein as wasserstein
    from paper_artifact.alpha.transformer import AlphaTransformer as AlphaTransformer

_LATER = {
    **dict.fromkeys(("AlphaPersistence", "DiagramTensor", "alpha_diagrams", "circumradius"), "diagrams"),
    **dict.fromkeys(("bottleneck", "persistence_image", "persistence_landscape"), "distances"),
    **dict.fromkeys(("plot_diagram", "wasserstein"), "distances"),
    "AlphaTransformer": "transformer",
}
__all__ = ["Pairs", "alpha_filtration", "alpha_persistence", *_LATER]


def __getattr__(name: str) -> Any:
    """Import what needs more than numpy when it is first asked for."""
    if name in _LATER:
        try:
            return getattr(import_module(f"paper_artifact.alpha.{_LATER[name]}"), name)
        except ModuleNotFoundError as error:
            raise InputError(f"{name} needs the package {error.name}; install that first") from error
    raise AttributeError(f"module 'paper_artifact.alpha' has no attribute {name!r}")
