"""What is asked of a mesh before training: `certify` its topology, `audit` what is measurable of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from paper_artifact.audit.rule import DENSITIES, WORKING, counted
from paper_artifact.cli.bars import stage_bar
from paper_artifact.cli.options import Options, Positional, Source, WrongUsage
from paper_artifact.cli.output import next_command, to_string
from paper_artifact.files import RESULTS, renewed_folder, write_json, write_text
from paper_artifact.mesh import FEATURES, betti_text
from paper_artifact.scene.fetch import sources
from paper_artifact.scene.shapes import SHAPES, find_mesh


def _named() -> list[str]:
    """Return the names that a mesh may be given by beside a file's."""
    return [*SHAPES, *sources()]


MESH = "a mesh file (any that trimesh reads), the key of an external mesh, or an analytic shape"
AUDIT_FILES = ("audit.json", "bundle.json", "audit.html")


@dataclass(frozen=True, kw_only=True)
class Certify(Options):
    """Options of `certify`.

    mesh: {MESH}
    json FILE: also write the whole certificate as JSON (-: to stdout)
    closed: fail a surface with boundary (disk, annulus …) for its open edges, not pass it as one
    strict: with --candidates: exit code 1 where one disagrees with the paper
    candidates: instead of one mesh: the paper's eleven candidates, ours beside its table
    """

    mesh: Positional[Source | None] = None
    json: Path | None = None
    closed: bool = False
    strict: bool = False
    candidates: bool = False


def certify(options: Certify) -> tuple[int, Any]:
    """Print the certificate. Returns 0, or 1 when it fails, and what --json writes."""
    from paper_artifact.certify.certificate import certificate_text, certify_mesh
    from paper_artifact.study.dispositions import dispositions

    if options.candidates == (options.mesh is not None):
        raise WrongUsage("name one mesh to certify, or give --candidates for the paper's table")
    if options.mesh is None:
        rows = dispositions()
        print(f"{'candidate':<13}{'paper':<23}{'decision':<12}{'Betti':<13}{'agrees':<8}measured")
        for row in rows:
            betti = str(row.certificate.betti) if row.certificate else "-"
            agrees = {True: "yes", False: "NO", None: "-"}[row.agrees]
            print(f"{row.key:<13}{row.published:<23}{row.decision:<12}{betti:<13}{agrees:<8}{row.measured}")
        found = {row.key: row.certificate.to_json() if row.certificate else row.measured for row in rows}
        return int(options.strict and any(row.agrees is False for row in rows)), found
    with stage_bar(options.mesh, options.quiet) as stage:
        stage("reading")
        mesh = find_mesh(options.mesh, welded=False)
        certificate = certify_mesh(mesh, with_boundary=False if options.closed else None, progress=stage)
    print(certificate_text(certificate))
    if certificate.passed:
        print(next_command("audit", options.mesh))
    else:
        print(next_command("ingest", options.mesh, "--out", f"{mesh.name}_shell.ply"))
    return int(not certificate.passed), certificate.to_json()


@dataclass(frozen=True, kw_only=True)
class AuditOptions(Options):
    """Options of `audit`.

    mesh: {MESH}, or 'pot'
    out DIR: folder for audit.html, audit.json and bundle.json (default: results/audits/NAME)
    seeds: sampling seeds of the staircase
    seed: the first of them, which decides and which the bundle is built with
    densities M: rungs of the staircase
    working M: densities that the rule may choose
    """

    mesh: Positional[Source]
    out: Path | None = None
    seeds: Annotated[int, 1] = 1
    seed: Annotated[int, 0] = 0
    densities: Annotated[tuple[int, ...], 16] = DENSITIES
    working: Annotated[tuple[int, ...], 16] = WORKING


def audit(options: AuditOptions) -> int:
    """Audit, write the page, print a summary. Returns 0, also when nothing is measurable."""
    import matplotlib

    matplotlib.use("Agg")
    from paper_artifact.audit.measure import audit_mesh
    from paper_artifact.audit.page import audit_page, headline
    from paper_artifact.certify.certificate import verdict_text

    mesh = find_mesh(options.mesh, welded=False)
    folder = options.out or RESULTS / "audits" / (re.sub(r"[^\w.-]+", "_", mesh.name) or "mesh")
    with renewed_folder(folder, "audit", AUDIT_FILES) as new, stage_bar(options.mesh, options.quiet) as stage:
        found = audit_mesh(
            mesh,
            options.mesh,
            densities=options.densities,
            working=options.working,
            seeds=options.seeds,
            first_seed=options.seed,
            progress=stage,
        )
        page = audit_page(found)
        write_json(new / "audit.json", found.to_json())
        if found.bundle is not None:
            found.bundle.save(new / "bundle.json")
        write_text(new / "audit.html", page)
    certificate = found.certificate
    reasons = f" ({'; '.join(certificate.reasons)})" if certificate.reasons else ""
    print(
        f"{found.name}: certificate {verdict_text(certificate)}{reasons}, {certificate.kind}, "
        f"{betti_text(certificate.betti)}"
    )
    rows = [
        (
            rung.samples,
            rung.seed,
            f"{rung.floor:.4f}",
            *(
                counted(d, rung.counts[d], found.decision.expected[d])
                + (f" ({margins[0]:.2f})" if margins else "")
                for d, margins in enumerate(rung.margins)
            ),
        )
        for rung in found.rungs
    ]
    print(to_string(("M", "seed", "floor", *(more for _, more in FEATURES)), rows, "  "))
    print("  (in brackets: the longest bar over the floor; above 1 it is measurable)")
    for reason in found.decision.reasons:
        print(f"  {reason}")
    for warning in found.decision.warnings:
        print(f"  warning: {warning}")
    print(headline(found), *(f"next: {each}" for each in found.commands), folder / "audit.html", sep="\n")
    return 0
