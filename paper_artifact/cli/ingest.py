"""`python -m paper_artifact ingest RAW --out SHELL`: raw open shells → one closed, certified surface."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.ingest import solidify


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "raw",
        help="a mesh file, the key of an external mesh, or 'pot' for the procedural hot pot with a flue",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="SHELL", help="the shell: .ply, .obj or .stl"
    )
    parser.add_argument(
        "--offset",
        type=float,
        help="ε as a fraction of the bounding-box diagonal; gaps below 2ε close "
        f"(default: {solidify.OFFSET}; pot: its own)",
    )
    parser.add_argument("--cells", type=float, help=f"grid cells per ε (default: {solidify.CELLS:g})")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="also write both certificates and the numbers as JSON"
    )
    parser.add_argument(
        "--raw-obj", type=Path, metavar="FILE", help="pot only: also write the raw polygons as OBJ"
    )


def run(arguments: argparse.Namespace) -> int:
    """Ingest, certify, write and print. Returns 0; InputError goes to the caller."""
    from paper_artifact.files import write_json, write_text
    from paper_artifact.ingest import hot_pot
    from paper_artifact.ingest.solidify import check_format, write_shell
    from paper_artifact.scene.find import find_mesh

    check_format(arguments.out)
    pot = hot_pot.raw_pot() if arguments.raw == hot_pot.NAME else None
    if arguments.raw_obj is not None and pot is None:
        raise InputError("--raw-obj writes the procedural pot's polygons; it goes with 'pot' alone")
    mesh = find_mesh(arguments.raw, welded=False) if pot is None else pot.mesh()
    offset, cells = (solidify.OFFSET, solidify.CELLS) if pot is None else (hot_pot.OFFSET, hot_pot.CELLS)
    solid = solidify.solidify(
        mesh,
        offset if arguments.offset is None else arguments.offset,
        cells if arguments.cells is None else arguments.cells,
    )
    certificate = write_shell(arguments.out, solid.shell)
    if arguments.json:
        write_json(arguments.json, solid.to_json())
    if arguments.raw_obj:
        write_text(arguments.raw_obj, pot.obj())
    raw = solid.raw
    reasons = f" ({'; '.join(raw.reasons)})" if raw.reasons else ""
    print(
        f"{mesh.name}: raw {raw.verdict}{reasons}, {len(raw.components)} components after the weld\n"
        f"  offset   ε = {solid.offset:.6g}, cell {solid.cell:.6g}, grid {' × '.join(map(str, solid.grid))}\n"
        f"  pockets  {solid.pockets} enclosed, dropped\n"
        f"  shell    {certificate.verdict}: {certificate.kind}, β = {certificate.betti}, "
        f"{certificate.vertices} vertices, {certificate.faces} triangles\n"
        f"  sha256   {solid.sha256} (points and triangles)\n"
        f"{arguments.out}"
    )
    return 0
