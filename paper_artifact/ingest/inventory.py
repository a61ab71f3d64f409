"""The challenge inventory of a raw mesh (paper, Table S4): what makes it hard, and what follows, measured."""

from __future__ import annotations

from collections import Counter

import numpy as np

from paper_artifact.certify.simplices import labels_of_graph
from paper_artifact.ingest.hot_pot import RawPot
from paper_artifact.ingest.solidify import Solid


def shells_as_indexed(pot: RawPot) -> int:
    """Return the number of connected pieces of the polygons as indexed, before any weld."""
    left = np.array([p[0] for p in pot.polygons for _ in p[1:]])
    right = np.array([i for p in pot.polygons for i in p[1:]])
    return len(np.unique(labels_of_graph(left, right, len(pot.vertices))))


def inventory(pot: RawPot, solid: Solid) -> list[tuple[str, str]]:
    """Return (challenge, measured consequence) rows of the raw pot and of its ingested shell."""
    corners = sorted(Counter(len(polygon) for polygon in pot.polygons).items())
    raw, shell = solid.raw, solid.certificate
    grid = " × ".join(map(str, solid.grid))
    return [
        (
            f"raw export ({len(pot.vertices)} vertices): {shells_as_indexed(pot)} open shells; "
            f"faces by corners: {', '.join(f'{times} of {size}' for size, times in corners)}",
            f"{raw.open_edges_as_indexed} open edges as indexed; after the exact weld {raw.open_edges} open "
            f"edges and {raw.nonmanifold_edges} non-manifold junction edges: certificate {raw.verdict}, "
            f"no inside, β of the raw complex {raw.betti}",
        ),
        (
            f"offset solidification at ε = {solid.offset:.4g} (cell {solid.cell:.4g}, grid {grid})",
            f"{solid.pockets} enclosed pockets dropped; {len(shell.components)} closed body of "
            f"{shell.vertices} vertices and {shell.faces} triangles",
        ),
        (
            "topology known by certificate only",
            f"{shell.verdict}: genus {shell.genus}, β = {shell.betti}, Euler characteristic {shell.euler}, "
            f"sha256 {solid.sha256[:16]}…",
        ),
    ]
