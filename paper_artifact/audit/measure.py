"""One mesh through the audit: everything that is measured before a training run, as data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from paper_artifact.audit.marks import Mark, find_marks
from paper_artifact.audit.rule import DENSITIES, WORKING, Decision, Rung, decide
from paper_artifact.catalogue import shape_row
from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.config import LossConfig, RunConfig
from paper_artifact.errors import InputError, quoted
from paper_artifact.evaluate.diagram import Diagram, lifetimes, longest_bars, measure, require_memory_for
from paper_artifact.files import cut_name
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.topology.bundle import Bundle, build_from_mesh

BUDGET_BY_CLASS = (700, 700, 1200)  # triangles N of the component, loop and void class (paper §4)
FEWEST = 16  # points of a rung
MOST_SEEDS = 1000  # of a staircase: hours at most
KEPT_ABOVE = 0.2  # margins below this fraction of the floor are sampling noise and not kept


@dataclass(frozen=True, eq=False)
class Audit:
    """What was measured of a mesh, and what follows for training it."""

    name: str  # as the command line was given it
    mesh: Mesh  # welded
    certificate: Certificate
    rungs: tuple[Rung, ...]  # of the staircase, one per density and seed
    decision: Decision  # from the first seed's rungs
    bundle: Bundle | None  # of the first seed; None when nothing is measurable
    diagram: Diagram  # of the first seed at the chosen density, else at the largest; radius / diagonal
    marks: tuple[Mark, ...]  # where the longest bars of that diagram are on the mesh
    usual: bool  # densities and seed are those that `train` takes by itself

    @property
    def commands(self) -> tuple[str, ...]:
        """The shell commands that come next.

        Training of C0, C1 and C2 with this bundle, of C0 alone when nothing is measurable. Before them, where
        the certificate fails, the making of a closed surface and its audit.
        """
        python, name = "python -m paper_artifact", quoted(self.name)
        begin: tuple[str, ...] = ()
        usual = LossConfig()
        if not self.certificate.passed:
            shell = quoted(f"{cut_name(self.mesh.name)}_shell.ply")
            begin = (f"{python} ingest {name} --out {shell}", f"{python} audit {shell}")
        if self.decision.dimension is None or self.bundle is None:
            return (*begin, f"{python} train {name}")
        budget = BUDGET_BY_CLASS[self.decision.dimension]
        train = f"{python} train {name}"
        if budget != RunConfig(self.name).budget:
            train += f" --set budget={budget}"
        if self.usual and shape_row(self.name) is None:  # `train` takes the rule's M and dimensions by itself
            return (*begin, train, f"{train} --condition C1", f"{train} --condition C2")
        wanted = {
            "samples": (self.decision.samples, usual.samples),
            "dimensions": (",".join(map(str, self.decision.dimensions)), None),
            "bundle_seed": (self.bundle.seed, usual.bundle_seed),
        }
        loss = "".join(f" --loss {name}={value}" for name, (value, known) in wanted.items() if value != known)
        return (*begin, train, *(f"{train} --condition {condition}{loss}" for condition in ("C1", "C2")))

    def to_json(self) -> dict:
        """Return a JSON-able dict of all but the mesh and the diagram."""
        rungs = [asdict(rung) | {"signature": rung.signature} for rung in self.rungs]
        return {
            "name": self.name,
            "certificate": self.certificate.to_json(),
            "staircase": rungs,
            "decision": asdict(self.decision),
            "bundle": self.bundle.to_json() if self.bundle else None,
            "commands": list(self.commands),
        }


def audit_mesh(
    mesh: Mesh,
    name: str | None = None,
    *,
    densities: Sequence[int] = DENSITIES,
    working: Sequence[int] = WORKING,
    seeds: int = 1,
    first_seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Audit:
    """Return the Audit of `mesh` (with or without its weld): certificate, staircase, decision and bundle.

    densities: M of the staircase, the working ones are added; seeds: the staircase's sampling seeds, from
    `first_seed` on; the decision and the bundle are first_seed's; progress: called with a line before each
    measurement. Raises InputError for a mesh without area or densities below 16.
    """
    if not all(isinstance(each, Iterable) for each in (densities, working)):
        raise InputError(f"densities and working are lists of M, got {densities!r:.60} and {working!r:.60}")
    smallest = min((*densities, *working))
    if smallest < FEWEST or not 1 <= seeds <= MOST_SEEDS or first_seed < 0:
        raise InputError(
            f"an audit needs densities of at least {FEWEST} points, 1 to {MOST_SEEDS} seeds, none negative, "
            f"got {smallest}, {seeds} and {first_seed}"
        )
    require_memory_for(max(*densities, *working))
    certificate = certify_mesh(mesh, with_boundary=None, progress=progress)
    mesh = checked_mesh(mesh.vertices, mesh.faces, mesh.name, mesh.betti)
    rungs, diagrams, stage = [], {}, progress or (lambda line: None)
    for samples in sorted({*densities, *working}):
        for seed in range(first_seed, first_seed + seeds):
            stage(f"staircase M = {samples}, seed {seed}")
            diagram, floor = measure(mesh, samples, seed)
            rungs.append(Rung(samples, seed, floor, tuple(_margins(bars, floor) for bars in diagram)))
            if seed == first_seed:
                diagrams[samples] = diagram
    decision = decide([rung for rung in rungs if rung.seed == first_seed], certificate, working)
    bundle = None
    if decision.samples is not None:
        bundle = build_from_mesh(
            mesh.vertices,
            mesh.faces,
            decision.samples,
            first_seed,
            shape=mesh.name,
            dimensions=decision.dimensions,
        )
    shown = decision.samples if decision.samples is not None else max(diagrams)
    stage("where loops and voids are")
    points, _, _ = sample_surface(mesh.vertices, mesh.faces, shown, stream(first_seed, "bundle-samples"))
    floor = next(rung.floor for rung in rungs if (rung.samples, rung.seed) == (shown, first_seed))
    return Audit(
        name=name or mesh.name,
        mesh=mesh,
        certificate=certificate,
        rungs=tuple(rungs),
        decision=decision,
        bundle=bundle,
        diagram=diagrams[shown],
        marks=find_marks(points, floor * mesh.diagonal, decision.expected),
        usual=tuple(working) == WORKING and first_seed == LossConfig().bundle_seed,
    )


def _margins(bars: np.ndarray, floor: float) -> tuple[float, ...]:
    margins = lifetimes(longest_bars(bars, floor)) / floor
    return tuple(round(float(margin), 4) for margin in margins if margin > KEPT_ABOVE)
