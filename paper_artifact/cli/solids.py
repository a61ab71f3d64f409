"""One closed, certified surface: `ingest` makes it of raw polygons, `solidify` of a soup or a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import torch

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.cli.bars import bar, stage_bar
from paper_artifact.cli.options import Options, Positional, Source, WrongUsage, usage_checked
from paper_artifact.cli.output import next_command, to_string
from paper_artifact.errors import InputError
from paper_artifact.export.solid import (
    WIDEST,
    SoupSolid,
    check_format,
    distances_to,
    placed,
    solidify_mesh,
    solidify_soup,
    write_solid,
)
from paper_artifact.files import check_writable
from paper_artifact.frame import Frame
from paper_artifact.ingest import hot_pot
from paper_artifact.ingest import solidify as shells
from paper_artifact.ingest.solidify import (
    BACKED,
    CELLS,
    INSIDE,
    LARGEST_OFFSET,
    OFFSETS,
    Rung,
    check_ladder,
    wanted_of,
    write_shell,
)
from paper_artifact.ingest.solidify import check_format as check_shell_format
from paper_artifact.mesh import betti_text
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.scene.subject import GROUND, RADIUS, subject_of_scene
from paper_artifact.soup.state import Soup, load_frame, load_soup


@dataclass(frozen=True, kw_only=True)
class Ingest(Options):
    """Options of `ingest`.

    raw: a mesh file, the key of an external mesh, or 'pot' for the procedural hot pot with a flue
    out SHELL: the shell: .ply, .obj or .stl
    offset: ε as a fraction of the bounding-box diagonal; gaps below 2ε close (default: {shells.OFFSET:g};
        pot: its own)
    cells: grid cells per ε (default: {shells.CELLS:g}; pot: its own)
    json FILE: also write both certificates and the numbers as JSON (-: to stdout)
    """

    raw: Positional[Source]
    out: Path
    offset: float | None = None
    cells: float | None = None
    json: Path | None = None


def ingest(options: Ingest) -> tuple[int, dict]:
    """Ingest, certify, write and print. Returns 0 and what --json writes."""
    pot = hot_pot.raw_pot() if options.raw == hot_pot.NAME else None
    offset, cells = (shells.OFFSET, shells.CELLS) if pot is None else (hot_pot.OFFSET, hot_pot.CELLS)
    offset = offset if options.offset is None else options.offset
    cells = cells if options.cells is None else options.cells
    with usage_checked():
        check_shell_format(options.out)
        check_ladder([offset], cells)
    check_writable(options.out)
    mesh = find_mesh(options.raw, welded=False) if pot is None else pot.mesh()
    with stage_bar(options.raw, options.quiet) as stage:
        stage("distances and shell")
        solid = shells.solidify(mesh, offset, cells)
    certificate = write_shell(options.out, solid.shell)
    raw = solid.raw
    reasons = f" ({'; '.join(raw.reasons)})" if raw.reasons else ""
    print(
        f"{mesh.name}: raw {raw.verdict}{reasons}, {len(raw.components)} components after the weld\n"
        f"  offset   ε = {solid.offset:.6g}, cell {solid.cell:.6g}, grid {' × '.join(map(str, solid.grid))}\n"
        f"  pockets  {solid.pockets} enclosed, dropped\n"
        f"  shell    {certificate.verdict}: {certificate.kind}, {betti_text(certificate.betti)}, "
        f"{certificate.vertices} vertices, {certificate.faces} triangles\n"
        f"  sha256   {solid.sha256} (points and triangles)\n"
        f"{options.out}"
    )
    print(next_command("audit", options.out))
    return 0, solid.to_json()


@dataclass(frozen=True, kw_only=True)
class Solidify(Options):
    """Options of `solidify`.

    soup SOUP|MESH: a trained soup, results/soups/<run>.npz, or a mesh: a double sheet, a scan with holes …
    out MESH: the solid: .ply or .glb, colours per vertex
    betti B0,B1,B2: wanted components, loops, voids: 1,2,1 for a torus, 1,0,0 for an open bowl (its solid is
        a thick shell); default: the target's, without one the numbers that last over most offsets, at least
        over a third of their range
    offsets ε,ε…: offsets to try, as fractions of the soup's diagonal, the smallest first, until one gives
        what --betti or --target states (default: .004 to .02 in eight steps)
    cells: grid cells per offset
    target SHAPE|MESH: a ground truth (shape, key of a fetched mesh, or file): its certificate says what is
        wanted, and the distance to it is printed
    scene DIR: the scene the soup was trained on: keeps what lies in the ball that all cameras look at,
        above the ground (a plane under it that holds a tenth of the cloud there), where there is one
    radius R: of the ball, in half widths of the picture there (default: {RADIUS:g})
    ground H: what lies lower than this above the plane is taken away, in the same unit; 0 keeps the ground
        (default: {GROUND:g})
    json FILE: also write offsets, checks, certificate, distance as JSON (-: to stdout)
    """

    soup: Positional[Source]
    out: Path
    betti: str | None = None
    offsets: str | None = None
    cells: float = CELLS
    target: Source | None = None
    scene: Source | None = None
    radius: float | None = None
    ground: float | None = None
    json: Path | None = None


def solidify(options: Solidify) -> tuple[int, dict]:
    """Write the solid and print what every offset gives. Returns 0, or 1 when no offset gives what is wanted,
    and what --json writes."""
    with usage_checked():
        check_format(options.out)
        asked = OFFSETS if options.offsets is None else numbers(options.offsets, float, "--offsets")
        offsets = check_ladder(asked, options.cells)
        betti = None if options.betti is None else numbers(options.betti, int, "--betti")
        if betti is not None:
            wanted_of(betti)
        if options.scene is None and (options.radius is not None or options.ground is not None):
            raise WrongUsage("--radius and --ground belong to --scene DIR, whose cameras give their unit")
        if options.scene is not None and Path(options.soup).suffix.lower() != ".npz":
            raise WrongUsage("--scene belongs to a trained soup (.npz); a mesh is taken whole")
    check_writable(options.out)
    target = None if options.target is None else find_mesh(options.target)
    if target is not None and betti is None:
        betti = certify_mesh(target, with_boundary=True).betti
    solid = solid_of(options, betti, offsets)
    report = solid.to_json()
    print(offset_table(solid))
    if solid.mesh is None:
        return 1, report
    certificate = write_solid(options.out, solid)
    print(written_text(solid, certificate))
    if target is not None:
        report["distance"] = distances_to(placed(solid.mesh, solid.frame), target)
        print(
            f"to {target.name}: Chamfer {100 * report['distance']['chamfer']:.3f} %, "
            f"Hausdorff95 {100 * report['distance']['hausdorff95']:.3f} % of its diagonal"
        )
    print(options.out)
    print(next_command("certify", options.out, "--closed"))
    return 0, report


def written_text(solid: SoupSolid, certificate: Certificate) -> str:
    """Return what a written solid is, in one line."""
    meeting = {0: "no triangle meets another", None: "whether triangles meet is unknown"}
    return (
        f"{certificate.verdict}: {certificate.kind}, {betti_text(certificate.betti)}, "
        f"{certificate.vertices} vertices, {certificate.faces} triangles; "
        + meeting.get(solid.crossings, f"{solid.crossings} triangles may meet")
    )


def solid_of(options: Solidify, betti: tuple | None, offsets: tuple[float, ...]) -> SoupSolid:
    """Return what the ladder of offsets gives of the soup or the mesh."""
    file = Path(options.soup)
    if file.suffix.lower() == ".npz":
        soup, frame = load_soup(file), load_frame(file)
        if options.scene is not None:
            soup = _of_the_subject(soup, frame, options)
    else:
        raw = find_mesh(options.soup, welded=False)
    with bar(total=len(offsets), unit="ε", desc="offsets", disable=options.quiet) as line:

        def count(rung: Rung) -> None:
            line.update()

        if file.suffix.lower() != ".npz":
            return solidify_mesh(raw, betti, offsets, options.cells, count)
        return solidify_soup(soup, betti, offsets, options.cells, file.stem, count, frame=frame)


def _of_the_subject(soup: Soup, frame: Frame, options: Solidify) -> Soup:
    """Return the triangles whose middle belongs to what the scene's cameras look at, and say how many."""
    subject = subject_of_scene(
        options.scene or "",
        RADIUS if options.radius is None else options.radius,
        GROUND if options.ground is None else options.ground,
    )
    kept = subject.holds(frame.outward(soup.vertices.numpy()).mean(1))
    ground = "without the ground"
    if subject.lowest == float("-inf"):
        ground = (
            "with the ground" if options.ground == 0 else "and there is no ground: no plane lies under it"
        )
    print(f"{kept.sum()} of {len(kept)} triangles are of what the cameras look at, {ground}")
    if not kept.any():
        raise InputError(
            f"no triangle of {options.soup} lies where the cameras of {options.scene} look: is it the scene "
            "it was trained on? --radius widens the ball, --ground 0 keeps the ground"
        )
    return soup.select(torch.from_numpy(kept.nonzero()[0]))


def offset_table(solid: SoupSolid) -> str:
    """Return what every offset gives, a line each, and the choice in a sentence."""
    rows = [
        (
            f"{rung.offset:g}",
            *rung.betti,
            rung.genus,
            f"{rung.inside:.2f}",
            f"{rung.backed:.2f}",
            rung.triangles,
            "← taken" if rung is solid.rung else "",
        )
        for rung in solid.rungs
    ]
    heads = ("ε / D", "components", "loops", "voids", "genus", "inside", "walls", "triangles", "")
    kind = "a body" if solid.wanted.body else "a thick shell around an open surface"
    text = f"{betti_text(solid.wanted.betti)}, {kind}"
    if solid.rung is None and solid.lasting is not None:
        said = (
            f"no Betti numbers were stated, and none last over a third of the ladder (at most {text}, over "
            f"{100 * solid.lasting:.0f} %): no mesh is written, since its topology would be chance; state "
            "--betti B0,B1,B2 (1,0,1 for a ball, 1,2,1 for a ring), or train with a larger budget"
        )
    elif solid.rung is None:
        tried = ",".join(f"{offset:.3g}" for offset in _others(solid))
        said = f"no offset gives {text}: no mesh is written; "
        said += f"try --offsets {tried}, or train " if tried else "train "
        said += "further; from a mesh remove what lies far from the body: it makes ε large"
        if solid.hollow:
            most = max(solid.hollow, key=lambda rung: rung.backed)
            b0, b1, _ = solid.wanted.betti
            said = (
                f"ε = {most.offset:g} D gives {betti_text(solid.wanted.betti)}, but encloses "
                f"{most.inside:.2f} of its volume (a body {INSIDE:g}), and {most.backed:.2f} of its surface "
                f"has a wall thicker than ε behind (a body {BACKED:g}): it goes around an open sheet, or in "
                "through a gap wider than 2ε, or its walls are thinner than ε. No mesh is written; for a gap "
                f"try --offsets {tried}, for thin walls {most.offset / 4:.3g},{most.offset / 2:.3g}, or take "
                f"the same surface as a thick shell: --betti {b0},{b1 // 2},0"
            )
    elif solid.lasting is None:
        said = f"ε = {solid.rung.offset:g} D is the smallest that gives {text}" + (
            "" if solid.rung.sure(solid.wanted) else ", by its thin walls"
        )
    elif len(solid.rungs) == 1:
        said = f"no Betti numbers were stated and one offset was tried: {text}, says nothing of the subject"
    else:
        said = (
            f"no Betti numbers were stated; {text}, lasts over {100 * solid.lasting:.0f} % of the ladder, "
            f"from ε = {solid.rung.offset:g} D on. Its topology is a guess: good to look at and to measure "
            "roughly; state --betti where holes and handles matter"
        )
    return f"{to_string(heads, rows)}\n{holes_text(solid.holes)}{said}"


def holes_text(holes: Sequence[float]) -> str:
    """Return what became of a mesh's holes, each so far across / diagonal, the widest first; ends with a
    space, or is empty where there are none."""
    wide = sum(each > WIDEST for each in holes)
    closed, text = len(holes) - wide, ""
    if closed:
        size = f"up to {100 * holes[wide]:.0f} % of D across"
        text = f"Closed by discs: {closed} hole{'s' * (closed > 1)} {size}. "
    if wide:
        size = f"up to {100 * holes[0]:.0f} % of D across"
        text += f"Too wide for a disc: {wide} opening{'s' * (wide > 1)} {size}. "
    return text


def _others(solid: SoupSolid) -> list[float]:
    """Return offsets to try next: between two that have more and fewer handles than wanted, else larger
    ones."""
    wanted = solid.wanted.betti[1] // 2
    for finer, coarser in pairwise(solid.rungs):
        if finer.genus > wanted > coarser.genus:
            step = (coarser.offset - finer.offset) / 5
            return [finer.offset + step * part for part in range(1, 5)]
    larger = (solid.rungs[-1].offset * factor for factor in (1.25, 1.5, 2, 2.5, 3))
    return [offset for offset in larger if offset <= LARGEST_OFFSET]


def numbers(text: str, kind: type, name: str) -> tuple:
    try:
        return tuple(kind(word) for word in text.split(","))
    except ValueError:
        example = "1,2,1" if kind is int else "0.006,0.008,0.01"
        raise WrongUsage(
            f"{name} takes numbers with commas between, such as {example}; got {text!r}"
        ) from None
