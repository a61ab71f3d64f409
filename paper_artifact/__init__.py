"""paper_artifact: topology-aware differentiable triangle-soup reconstruction, piece by piece.

Data flows one way: scene → soup → train → evaluate → record → report → notebooks. Each
sub-package is importable alone; this file imports none of them. Rooms and rules: ARCHITECTURE.md.
"""

__version__ = "0.3.0"
