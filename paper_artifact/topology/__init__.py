"""The topology loss on top of `paper_artifact.alpha`, usable without scene or trainer.

Modules: floor and bundle (the target), statement (stated Betti numbers in its place: frame, density, audit),
matching and plan (one refresh), loss (raw points), term (a run), importance (the allocation study's field).

    from paper_artifact.topology import TopologyLoss, build_bundle

    loss = TopologyLoss(build_bundle(target_points, diagonal))
    loss(points).backward()
    BettiLoss((1, 2, 1))(points).backward()  # no target: one component, two loops, one void
"""

from paper_artifact.topology.bundle import Bundle as Bundle
from paper_artifact.topology.bundle import build_bundle as build_bundle
from paper_artifact.topology.bundle import build_from_mesh as build_from_mesh
from paper_artifact.topology.bundle import load_bundle as load_bundle
from paper_artifact.topology.loss import BettiLoss as BettiLoss
from paper_artifact.topology.loss import TopologyLoss as TopologyLoss
from paper_artifact.topology.plan import Plan as Plan
from paper_artifact.topology.plan import build_plan as build_plan
from paper_artifact.topology.statement import cleaned as cleaned
