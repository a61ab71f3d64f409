"""`python -m paper_artifact certify MESH`: exact homology, manifold checks, a verdict with reasons."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "mesh",
        nargs="?",
        help="a mesh file (OBJ, PLY, STL, OFF, glTF, GLB), the key of an external mesh, or an analytic shape",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the whole certificate as JSON")
    parser.add_argument(
        "--closed",
        action="store_true",
        help="fail a surface with boundary (disk, annulus …) for its open edges, not pass it as one",
    )
    parser.add_argument("--strict", action="store_true", help="exit code 1 unless the mesh passes")
    parser.add_argument(
        "--candidates",
        action="store_true",
        help="instead of one mesh: the paper's eleven candidates, ours beside its table",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the certificate. Returns 0, with --strict 1 when it fails."""
    from tqdm import tqdm

    from paper_artifact.certify.certificate import certificate_text, certify_mesh
    from paper_artifact.files import write_json
    from paper_artifact.scene.find import find_mesh
    from paper_artifact.study.dispositions import disposition_text, dispositions

    if arguments.candidates == (arguments.mesh is not None):
        raise InputError("name one mesh to certify, or give --candidates for the paper's table")
    if arguments.candidates:
        rows = dispositions()
        print(disposition_text(rows))
        if arguments.json:
            write_json(
                arguments.json,
                {row.key: row.certificate.to_json() if row.certificate else row.measured for row in rows},
            )
        return 1 if arguments.strict and any(row.agrees is False for row in rows) else 0
    with tqdm(disable=arguments.quiet or None, bar_format="{desc} ({elapsed})", leave=False) as bar:
        bar.set_description_str(f"{arguments.mesh}: reading")
        certificate = certify_mesh(
            find_mesh(arguments.mesh, welded=False),
            with_boundary=False if arguments.closed else None,
            progress=lambda stage: bar.set_description_str(f"{arguments.mesh}: {stage}"),
        )
    if arguments.json:
        write_json(arguments.json, certificate.to_json())
    print(certificate_text(certificate))
    return 1 if arguments.strict and not certificate.passed else 0
