"""Alpha persistence with gradients, the topology loss, its plan, target bundle and conditions; usable without scene or trainer.

    from paper_artifact.topology import TopologyLoss, alpha_diagrams, alpha_persistence, build_bundle

Names load their module on first use, so importing the package costs nothing.
"""

from __future__ import annotations

import importlib

_HOME = {
    "alpha_persistence": "persistence",
    "Pairs": "persistence",
    "alpha_diagrams": "diagrams",
    "DiagramTensor": "diagrams",
    "median_spacing": "floor",
    "measurement_floor": "floor",
    "uniform_spacing": "floor",
    "significant": "floor",
    "Bundle": "bundle",
    "build_bundle": "bundle",
    "build_from_mesh": "bundle",
    "load_bundle": "bundle",
    "FrozenSamples": "samples",
    "draw_samples": "samples",
    "match_bars": "matching",
    "recruit": "matching",
    "Plan": "plan",
    "PlanOptions": "plan",
    "build_plan": "plan",
    "TopologyLoss": "loss",
    "TopologyTerm": "term",
    "make_term": "term",
    "Condition": "conditions",
    "CONDITIONS": "conditions",
    "get_condition": "conditions",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
