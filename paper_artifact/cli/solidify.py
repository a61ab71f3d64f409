"""`python -m paper_artifact solidify SOUP --out MESH`: a soup → a closed, certified, coloured mesh."""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from paper_artifact.errors import InputError
from paper_artifact.scene.subject import GROUND, RADIUS, subject_of_scene

if TYPE_CHECKING:
    from paper_artifact.export.solid import SoupSolid
    from paper_artifact.frame import Frame
    from paper_artifact.soup.state import Soup


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument("soup", type=Path, metavar="SOUP", help="a trained soup, results/soups/<run>.npz")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="MESH", help="the solid: .ply or .glb, colours per vertex"
    )
    parser.add_argument(
        "--betti",
        metavar="B0,B1,B2",
        help="wanted Betti numbers: 1,2,1 for a torus, 1,0,0 for an open bowl (its solid is a thick shell); "
        "default: the target's, without one the numbers that last over most offsets",
    )
    parser.add_argument(
        "--offsets",
        metavar="ε,ε…",
        help="offsets to try, as fractions of the soup's diagonal (default: .004 to .02 in eight steps)",
    )
    parser.add_argument("--cells", type=float, help="grid cells per offset (default: 2)")
    parser.add_argument(
        "--target",
        metavar="SHAPE|MESH",
        help="a ground truth (shape, key of a fetched mesh, or file): its certificate "
        "says what is wanted, and the distance to it is printed",
    )
    group = parser.add_argument_group("of a soup of photographs, only what they are of")
    group.add_argument(
        "--scene",
        type=Path,
        metavar="DIR",
        help="the scene the soup was trained on: keeps what lies in the ball that all cameras look at, above "
        "the plane that most of the cloud lies on",
    )
    group.add_argument(
        "--radius",
        type=float,
        metavar="R",
        help=f"of the ball, in half widths of the picture there (default: {RADIUS:g})",
    )
    group.add_argument(
        "--ground",
        type=float,
        metavar="H",
        help="what lies lower than this above the plane is taken away, in the same unit; 0 keeps the ground "
        f"(default: {GROUND:g})",
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="also write offsets, checks, certificate, distance as JSON"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the solid and print what every offset gives. Returns 0, or 1 when no offset gives what is wanted;
    InputError goes to the caller."""
    from tqdm import tqdm

    from paper_artifact.certify.certificate import certify_mesh
    from paper_artifact.export.solid import check_format, distances_to, placed, solidify_soup, write_solid
    from paper_artifact.files import write_json
    from paper_artifact.ingest.solidify import CELLS, OFFSETS, check_ladder, wanted_of
    from paper_artifact.scene.find import find_mesh
    from paper_artifact.soup.state import load_frame, load_soup

    check_format(arguments.out)
    cells = CELLS if arguments.cells is None else arguments.cells
    offsets = check_ladder(
        OFFSETS if arguments.offsets is None else _numbers(arguments.offsets, float, "--offsets"), cells
    )
    betti = None if arguments.betti is None else _numbers(arguments.betti, int, "--betti")
    if betti is not None:
        wanted_of(betti)
    soup, frame = load_soup(arguments.soup), load_frame(arguments.soup)
    if arguments.scene is not None:
        soup = _of_the_subject(soup, frame, arguments)
    elif arguments.radius is not None or arguments.ground is not None:
        raise InputError("--radius and --ground belong to --scene DIR, whose cameras they are told from")
    target = None if arguments.target is None else find_mesh(arguments.target)
    if target is not None and betti is None:
        betti = certify_mesh(target, with_boundary=True).betti
    with tqdm(total=len(offsets), unit="ε", desc="offsets", disable=arguments.quiet) as bar:
        solid = solidify_soup(
            soup, betti, offsets, cells, arguments.soup.stem, lambda rung: bar.update() and None, frame=frame
        )
    report = solid.to_json()
    print(offset_table(solid))
    if solid.mesh is not None:
        certificate = write_solid(arguments.out, solid)
        print(
            f"{certificate.verdict}: {certificate.kind}, β = {certificate.betti}, "
            f"{certificate.vertices} vertices, {certificate.faces} triangles; "
            + {0: "no triangle meets another", None: "whether triangles meet is unknown"}.get(
                solid.crossings, f"{solid.crossings} triangles may meet"
            )
        )
        if target is not None:
            report["distance"] = distances_to(placed(solid.mesh, frame), target)
            print(
                f"to {target.name}: Chamfer {100 * report['distance']['chamfer']:.3f} %, "
                f"Hausdorff95 {100 * report['distance']['hausdorff95']:.3f} % of its diagonal"
            )
    if arguments.json:
        write_json(arguments.json, report)
    if solid.mesh is None:
        return 1
    print(arguments.out)
    return 0


def _of_the_subject(soup: Soup, frame: Frame, arguments: argparse.Namespace) -> Soup:
    """Return the triangles whose middle belongs to what the scene's cameras look at, and say how many."""
    import torch

    subject = subject_of_scene(
        arguments.scene,
        RADIUS if arguments.radius is None else arguments.radius,
        GROUND if arguments.ground is None else arguments.ground,
    )
    kept = subject.holds(frame.outward(soup.vertices.numpy()).mean(1))
    ground = "with the ground" if subject.lowest == float("-inf") else "without the ground"
    print(f"{kept.sum()} of {len(kept)} triangles are of what the cameras look at, {ground}")
    if not kept.any():
        raise InputError(
            f"no triangle of {arguments.soup} lies where the cameras of {arguments.scene} look: is it the "
            "scene it was trained on? --radius widens the ball, --ground 0 keeps the ground"
        )
    return soup.select(torch.from_numpy(kept.nonzero()[0]))


def offset_table(solid: SoupSolid) -> str:
    """Return what every offset gives, a line each, and the choice in a sentence."""
    lines = [f"{'ε / D':>8}  {'β':<16}{'genus':>6}{'inside':>8}{'triangles':>11}"]
    for rung in solid.rungs:
        mark = "  ← taken" if rung is solid.rung else ""
        lines.append(
            f"{rung.offset:>8g}  {str(rung.betti):<16}{rung.genus:>6}{rung.inside:>8.2f}"
            f"{rung.triangles:>11}{mark}"
        )
    kind = "a body" if solid.wanted.body else "a thick shell around an open surface"
    text = f"β = {solid.wanted.betti}, {kind}"
    if solid.rung is None:
        lines.append(
            f"no offset gives {text}: no mesh is written; try --offsets "
            f"{','.join(f'{offset:.3g}' for offset in _others(solid))}, or train further"
        )
    elif solid.stated:
        lines.append(f"ε = {solid.rung.offset:g} D is the smallest that gives {text}")
    elif sum(rung.betti == solid.wanted.betti for rung in solid.rungs) == 1:
        lines.append(
            f"nothing was wanted, and no Betti numbers last over two offsets: ε = {solid.rung.offset:g} D is "
            f"taken; {text}, says nothing of what was photographed"
        )
    else:
        lines.append(f"nothing was wanted; {text}, lasts longest, from ε = {solid.rung.offset:g} D on")
    return "\n".join(lines)


def _others(solid: SoupSolid) -> list[float]:
    """Return offsets to try next: between two that have more and fewer handles than wanted, else larger
    ones."""
    wanted = solid.wanted.betti[1] // 2
    for finer, coarser in pairwise(solid.rungs):
        if finer.genus > wanted > coarser.genus:
            step = (coarser.offset - finer.offset) / 5
            return [finer.offset + step * part for part in range(1, 5)]
    return [solid.rungs[-1].offset * factor for factor in (1.25, 1.5, 2, 2.5, 3)]


def _numbers(text: str, kind: type, option: str) -> tuple:
    try:
        return tuple(kind(word) for word in text.split(","))
    except ValueError:
        example = "1,2,1" if kind is int else "0.006,0.008,0.01"
        raise InputError(
            f"{option} takes numbers with commas between, such as {example}; got {text!r}"
        ) from None
