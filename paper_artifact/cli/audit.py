"""`python -m paper_artifact audit MESH`: a mesh's topology, what of it is measurable, how to train on it."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from paper_artifact.audit.rule import DENSITIES, WORKING
from paper_artifact.files import RESULTS, renewed_folder, write_json, write_text

FILES = ("audit.json", "bundle.json", "audit.html")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "mesh",
        help="a mesh file (any that trimesh reads), the key of an external mesh, an analytic shape, or 'pot'",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for audit.html, audit.json and bundle.json (default: results/audits/NAME)",
    )
    parser.add_argument(
        "--seeds", type=int, default=1, help="sampling seeds of the staircase (default: %(default)s)"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="the first of them, which decides and which the bundle is built with (default: %(default)s)",
    )
    parser.add_argument(
        "--densities",
        type=int,
        nargs="+",
        metavar="M",
        default=DENSITIES,
        help=f"rungs of the staircase (default: {' '.join(map(str, DENSITIES))})",
    )
    parser.add_argument(
        "--working",
        type=int,
        nargs="+",
        metavar="M",
        default=WORKING,
        help=f"densities that the rule may choose (default: {' '.join(map(str, WORKING))})",
    )


def run(arguments: argparse.Namespace) -> int:
    """Audit, write the page, print a summary. Returns 0, also when nothing is measurable."""
    import matplotlib
    from tqdm import tqdm

    matplotlib.use("Agg")
    from paper_artifact.audit.measure import audit_mesh
    from paper_artifact.audit.page import audit_page, headline, rung_text
    from paper_artifact.certify.certificate import verdict_text
    from paper_artifact.scene.find import find_mesh

    mesh = find_mesh(arguments.mesh, welded=False)
    folder = arguments.out or RESULTS / "audits" / (re.sub(r"[^\w.-]+", "_", mesh.name) or "mesh")
    with (
        renewed_folder(folder, "audit", FILES) as new,
        tqdm(disable=arguments.quiet or None, bar_format="{desc} ({elapsed})", leave=False) as bar,
    ):
        audit = audit_mesh(
            mesh,
            arguments.mesh,
            densities=arguments.densities,
            working=arguments.working,
            seeds=arguments.seeds,
            first_seed=arguments.seed,
            progress=bar.set_description_str,
        )
        page = audit_page(audit)
        write_json(new / "audit.json", audit.to_json())
        if audit.bundle is not None:
            audit.bundle.save(new / "bundle.json")
        write_text(new / "audit.html", page)
    certificate = audit.certificate
    print(
        f"{audit.name}: certificate {verdict_text(certificate)}"
        + (f" ({'; '.join(certificate.reasons)})" if certificate.reasons else "")
        + f", {certificate.kind}, β = {certificate.betti}"
    )
    for number in range(len(audit.rungs)):
        print(f"  {rung_text(audit, number)}")
    print("  (in brackets: the longest bar over the floor; above 1 it is measurable)")
    for reason in audit.decision.reasons:
        print(f"  {reason}")
    for warning in audit.decision.warnings:
        print(f"  warning: {warning}")
    print(headline(audit), *audit.commands, folder / "audit.html", sep="\n")
    return 0
