"""Differentiable alpha persistence: a package of its own, on numpy, numba and torch.

Of this project it imports `errors` and `kernel_cache` only.

    from paper_artifact.alpha import alpha_diagrams, alpha_persistence

`alpha_persistence(points)` gives the pairs of a point cloud, `alpha_diagrams(points)` the same diagrams as
tensors with gradients (paper §3.2). Three rooms, no way back: triangulation (`delaunay`, on exact
`predicates`), filtration, reduction. gudhi is loaded only when it is asked for as the oracle, or for a cloud
that spans no tetrahedron.
"""

from paper_artifact.alpha.circumradius import circumradius as circumradius
from paper_artifact.alpha.diagrams import DiagramTensor as DiagramTensor
from paper_artifact.alpha.diagrams import alpha_diagrams as alpha_diagrams
from paper_artifact.alpha.persistence import Pairs as Pairs
from paper_artifact.alpha.persistence import alpha_persistence as alpha_persistence
