"""paper_artifact: topology-aware differentiable triangle-soup reconstruction, piece by piece.

Data flows one way: scene → soup → train → evaluate → record → report → notebooks. Each
sub-package is importable alone; this file imports none of them.
"""

__version__ = "0.1.0"
