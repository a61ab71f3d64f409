"""What is asked of a mesh before training: `certify` its topology, `audit` what is measurable of it."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from os.path import realpath, relpath
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from paper_artifact.audit.rule import DENSITIES, WORKING, counted
from paper_artifact.cli.bars import stage_bar
from paper_artifact.cli.options import Options, Positional, Source, WrongUsage, words_of
from paper_artifact.cli.output import free_name, next_command, next_mesh, to_string
from paper_artifact.errors import InputError, quoted
from paper_artifact.files import (
    RESULTS,
    check_writable,
    cut_name,
    load_json,
    renewed_folder,
    write_json,
    write_text,
)
from paper_artifact.mesh import FEATURES, Mesh, betti_text, checked_mesh
from paper_artifact.randomness import stream
from paper_artifact.scene.shapes import find_mesh

MESH = "a mesh file (any that trimesh reads), the key of an external mesh, or an analytic shape"
# Colours of the loops around handles and around holes, in turn, and of voids.
KINDS = {
    "handle": (("red", "#c0392b"), ("orange", "#e67e22"), ("pink", "#d6539a")),
    "hole": (("blue", "#1f5fbf"), ("violet", "#7d3c98"), ("cyan", "#00a5b8")),
}
GREEN = "#2e8b57"
MOST_TOLD = 12  # marks that a page's title lists
AUDIT_FILES = ("audit.json", "bundle.json", "audit.html")


@dataclass(frozen=True, kw_only=True)
class Certify(Options):
    """Options of `certify`.

    mesh: {MESH}
    json FILE: also write the whole certificate as JSON (-: to stdout)
    closed: fail a surface with boundary (disk, annulus …) for its open edges, not pass it as one
    where FILE: of a closed mesh: mark each handle, hole (tunnel) and void in this .html (3-D view) or .ply,
        with a shortest loop, and list them
    fill N: fill the N-th hole of that list, write --out and certify it
    cut N: cut the N-th handle of that list, write --out and certify it
    out MESH: where --fill or --cut writes, .ply, .obj or .stl (default: NAME_filled.ply or NAME_cut.ply)
    """

    mesh: Positional[Source]
    json: Path | None = None
    closed: bool = False
    where: Path | None = None
    fill: Annotated[int | None, 1] = None
    cut: Annotated[int | None, 1] = None
    out: Path | None = None


def certify(options: Certify) -> tuple[int, Any]:
    """Print the certificate. Returns 0, or 1 when it fails, and what --json writes."""
    from paper_artifact.certify.certificate import certificate_text, certify_mesh

    if options.where is not None and options.where.suffix not in (".html", ".ply"):
        raise WrongUsage(f"--where writes .html or .ply, got {options.where}")
    if options.fill is not None and options.cut is not None:
        raise WrongUsage("give --fill or --cut, one at a time: the other's numbers change with it")
    for file in (_mended(options) if options.fill or options.cut else None, options.where):
        if file is not None:
            check_writable(file)
    if options.out is not None and not (options.fill or options.cut):
        raise WrongUsage("--out has a meaning with --fill or --cut alone")
    with stage_bar(options.mesh, options.quiet) as stage:
        stage("reading")
        mesh = find_mesh(options.mesh, welded=False)
        certificate = certify_mesh(mesh, with_boundary=False if options.closed else None, progress=stage)
    print(certificate_text(certificate))
    found = certificate.to_json()
    shell = free_name(f"{cut_name(mesh.name)}_shell.ply")
    if options.where or options.fill or options.cut:
        if not (certificate.passed and certificate.closed):
            raise InputError(
                f"{mesh.name} is no closed certified surface, so it has no inside; make a shell of it first: "
                f"python -m paper_artifact ingest {quoted(options.mesh)} --out {quoted(shell)}"
            )
        found |= _where(options, mesh, certificate.genus or 0)
    if not certificate.passed:
        print(next_command("ingest", options.mesh, "--out", shell))
    elif not (options.fill or options.cut):  # then the next command is of what was written
        print(next_command("audit", options.mesh))
    return int(not certificate.passed), found


def _mended(options: Certify) -> Path:
    """Return where --fill or --cut writes. Raises InputError for an ending that is not written, and where the
    name was not given and there is such a file."""
    from paper_artifact.ingest.solidify import check_format

    name = cut_name(Path(options.mesh).stem)
    out = options.out or Path(f"{name}_{'filled' if options.fill else 'cut'}.ply")
    check_format(out)
    if options.out is None and out.exists():
        raise InputError(
            f"{out} is there already; --out {quoted(out)} replaces it, --out with another name keeps it"
        )
    if realpath(out) in [realpath(each) for each in (options.json, options.where) if each]:
        raise WrongUsage(f"the mended mesh is written to {out} too; give it another name with --out")
    return out


def _where(options: Certify, mesh: Mesh, genus: int) -> dict[str, Any]:
    """Print, mark and mend what a closed mesh has: handles, holes, voids. Returns them for --json."""
    from paper_artifact.audit.marks import Mark, light_mesh, view_parts
    from paper_artifact.certify.certificate import verdict_text
    from paper_artifact.export.models import write_ply
    from paper_artifact.export.viewer import framing, html_page, up_of
    from paper_artifact.frame import frame_for
    from paper_artifact.ingest.crossings import crossing_faces
    from paper_artifact.ingest.handles import HANDLE, HOLE, find_loops, find_voids
    from paper_artifact.ingest.solidify import write_shell
    from paper_artifact.ingest.surgery import cut_and_capped

    mesh = checked_mesh(mesh.vertices, mesh.faces, mesh.name)
    with stage_bar(mesh.name, options.quiet) as stage:
        loops, voids = find_loops(mesh, stage), find_voids(mesh)
        stage("triangles that cross others")
        crossed = int(crossing_faces(mesh.vertices, mesh.faces).sum())
    of_kind = {kind: [each for each in loops if each.kind == kind] for kind in (HANDLE, HOLE)}
    rows: list[tuple[str, int, str, float, float, str]] = []
    marks: list[Mark] = []
    colours: list[str] = []
    for kind, found in of_kind.items():
        for number, each in enumerate(found, start=1):
            line = mesh.vertices[np.append(each.vertices, each.vertices[0])]
            middle = line[:-1].mean(axis=0)
            word, colour = KINDS[kind][(number - 1) % len(KINDS[kind])]
            rows.append((kind, number, word, each.length, each.length / mesh.diagonal, _place(middle)))
            marks.append(Mark(1, np.inf, line, middle, 0.0))
            colours.append(colour)
    for number, void in enumerate(voids, start=1):
        ball = 2 * void.radius
        rows.append(("void", number, "green", ball, ball / mesh.diagonal, _place(void.centre)))
        marks.append(Mark(2, np.inf, np.zeros((0, 3)), void.centre, void.radius))
        colours.append(GREEN)
    heads = ("what", "N", "colour", "length", "/ diagonal", "about")
    shown = [(*row[:3], f"{row[3]:.4g}", f"{row[4]:.4f}", row[5]) for row in rows]
    print(to_string(heads, shown, "  "))
    print("  (a loop around each handle and each hole; of a void the diameter of a large ball in it)")
    for kind, found in of_kind.items():
        if len(found) < genus:
            lost = genus - len(found)
            print(f"  (no short loop was found around {lost} of {genus} {kind}s: they are knotted)")
    if crossed:
        print(f"  ({crossed} triangles cross or touch others; loops and voids there may be wrong)")
        print(next_mesh("ingest", options.mesh))
    if options.where is not None:
        frame = frame_for(mesh.centre, mesh.radius)
        parts = view_parts(light_mesh(mesh), marks, frame, colours)
        if options.where.suffix == ".html":
            told = ", ".join(f"{what} {number} ({colour})" for what, number, colour, *_ in rows[:MOST_TOLD])
            seen = framing(frame.inward(mesh.vertices), up=up_of(options.mesh))
            write_text(options.where, html_page(parts, f"{mesh.name}: {told}", seen))
        else:
            write_ply(options.where, parts["seen through" if marks else "mesh"], frame)
        print(options.where)
    asked = next(((kind, n) for kind, n in ((HOLE, options.fill), (HANDLE, options.cut)) if n), None)
    if asked is not None:
        kind, number = asked
        if number > len(of_kind[kind]):
            raise InputError(
                f"{len(of_kind[kind])} {kind}s of {mesh.name} were found, none of number {number}"
            )
        out = _mended(options)
        written = write_shell(out, cut_and_capped(mesh, of_kind[kind][number - 1]))
        print(f"{out}: {verdict_text(written)}, {written.kind}, {betti_text(written.betti)}")
        print(next_command("certify", out, "--where", free_name(f"{out.stem}.html")))
    return {"where": [dict(zip(("kind", "number", "colour", *heads[3:]), row, strict=True)) for row in rows]}


def _place(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"


@dataclass(frozen=True, kw_only=True)
class AuditOptions(Options):
    """Options of `audit`.

    mesh MESH|SOUP: {MESH}, or 'pot'; of a trained soup (.npz) the Betti numbers that it shows are proposed
    scene DIR: a COLMAP scene; without a mesh the Betti numbers that its SfM cloud shows are proposed, with a
        soup those of what the cameras look at and three pictures show
    out DIR: folder for audit.html, audit.json and bundle.json (default: results/audits/NAME)
    seeds: sampling seeds of the staircase
    seed: the first of them, which decides and which the bundle is built with
    densities M: rungs of the staircase
    working M: densities that the rule may choose
    """

    mesh: Positional[Source | None] = None
    scene: Source | None = None
    out: Path | None = None
    seeds: Annotated[int, 1] = 1
    seed: Annotated[int, 0] = 0
    densities: Annotated[tuple[int, ...], 16] = DENSITIES
    working: Annotated[tuple[int, ...], 16] = WORKING


def propose(soup: str | None, scene: Path | None) -> int:
    """Print which Betti numbers a trained soup or a scene's SfM cloud shows. Returns 0.

    Raises WrongUsage for neither, InputError for a damaged file or too few points.
    """
    from paper_artifact.evaluate.image import seen_samples
    from paper_artifact.sampling import sample_soup
    from paper_artifact.scene.load import load_scene
    from paper_artifact.scene.subject import subject_of_scene
    from paper_artifact.soup.state import load_frame, load_soup, reframed
    from paper_artifact.topology.statement import cleaned, densities_of, drawn, suggest

    if soup is not None:
        trained, frame = load_soup(soup), load_frame(Path(soup))
        corners, opacity = frame.outward(trained.vertices.numpy()), trained.corner_opacity()
        if scene is not None:
            shown = load_scene(scene)
            moved = reframed(trained, frame, shown.frame)
            if not shown.rendered:
                opacity = opacity * subject_of_scene(scene).holds(corners.mean(1))[:, None]

        def sample(count: int) -> np.ndarray:
            draws = stream(0, "propose", count)
            if scene is None:
                return sample_soup(corners, opacity, count, draws)[0]
            return seen_samples(moved, opacity, shown, count, draws)

        found = suggest(sample)
    elif scene is None:
        raise WrongUsage("give a mesh, a trained soup (.npz), or --scene DIR")
    else:
        given = load_scene(scene)
        points = given.points if given.rendered else given.points[subject_of_scene(scene).holds(given.points)]
        cloud = cleaned(points)
        found = suggest(lambda count: drawn(cloud, count), densities_of(cloud))
        print(f"{len(cloud)} points of the SfM cloud, cleaned; a gap in the cloud reads as a loop")
    print(*found.sentences, "lengths of bars in floors; what is below 1 hides", sep="\n")
    numbers = ",".join(map(str, found.betti))
    print(f"proposal, read at M = {found.samples}: --betti {numbers}; correct what you know better")
    if scene is not None:
        print(next_command("train", "--scene", scene, "--condition", "T3", "--betti", numbers))
    return 0


def _identity(mesh: str, folder: Path) -> str:
    """Return a mesh file's path from `folder`, which stays where both are moved; a name as it is."""
    return relpath(Path(mesh).resolve(), folder.resolve()) if Path(mesh).is_file() else mesh


def _check_other(folder: Path, mesh: str) -> None:
    """Raise InputError where the folder has the audit of another mesh, which has the same name."""
    other = None
    with suppress(OSError, ValueError, AttributeError):
        other = load_json(folder / "audit.json").get("mesh")
    if other not in (None, _identity(mesh, folder)):
        raise WrongUsage(f"{folder} has the audit of {other}; give another folder with --out")


def audit(options: AuditOptions) -> int:
    """Audit, write the page, print a summary. Returns 0, also when nothing is measurable."""
    if options.mesh is None or options.mesh.lower().endswith(".npz"):
        if unused := words_of(options, "mesh", "scene"):
            raise WrongUsage(
                f"{unused[0]} belongs to the audit of a mesh; a soup or a cloud takes --scene alone"
            )
        return propose(options.mesh, None if options.scene is None else Path(options.scene))
    if options.scene is not None:
        raise WrongUsage("--scene belongs to a soup (.npz) or stands alone; a mesh is audited whole")
    import matplotlib

    matplotlib.use("Agg")
    from paper_artifact.audit.measure import audit_mesh
    from paper_artifact.audit.page import audit_page, headline
    from paper_artifact.certify.certificate import verdict_text

    mesh = find_mesh(options.mesh, welded=False)
    folder = options.out or RESULTS / "audits" / (cut_name(re.sub(r"[^\w.-]+", "_", mesh.name)) or "mesh")
    _check_other(folder, options.mesh)
    part = f"audit of {_identity(options.mesh, folder)}"
    with renewed_folder(folder, part, AUDIT_FILES) as new, stage_bar(options.mesh, options.quiet) as stage:
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
        write_json(new / "audit.json", found.to_json() | {"mesh": _identity(options.mesh, folder)})
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
