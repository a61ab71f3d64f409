"""`reconstruct PHOTOS`: the one recipe from photographs to a picture, a 3-D view and a certified mesh."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from paper_artifact.cli.options import Options, Positional, Source, usage_checked, words_of
from paper_artifact.cli.output import next_command, next_mesh
from paper_artifact.cli.runs import Train, summary, trained
from paper_artifact.cli.scenes import registered_text, written
from paper_artifact.cli.solids import Solidify, numbers, offset_table, solid_of, written_text
from paper_artifact.cli.soups import Export, exported
from paper_artifact.config import STEPS_OF_THE_STUDY
from paper_artifact.errors import InputError
from paper_artifact.export.solid import check_format, write_solid
from paper_artifact.files import OWN, check_writable, cut_name
from paper_artifact.ingest.solidify import wanted_of
from paper_artifact.photos.pictures import FRAMES  # noqa: F401, for the help
from paper_artifact.photos.scene import PhotosConfig, photographs_scene

BUDGET = 5000  # triangles of a scene of photographs, as README and docs/photographs.md have it
OFFSETS = (0.008, 0.01, 0.0125, 0.016, 0.02, 0.025, 0.03, 0.035, 0.04, 0.05)  # of the subject's diagonal


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Options):
    """Options of `reconstruct`.

    photographs DIR|VIDEO: the folder that holds the photographs, or a video file
    out MESH: the closed mesh of what the cameras look at: .ply or .glb (default: no mesh, pictures alone)
    betti B0,B1,B2: its components, loops, voids: 1,0,1 for a ball, 1,2,1 for a ring, 1,1,0 for a cup with a
        handle (default: the numbers that last over a third of the offsets)
    every K: of a video, the sharpest of every K frames (default: about {FRAMES} frames of all)
    budget: triangles
    steps: of training
    work DIR: scene, record, soup and pictures; what is finished there is not done again (default:
        results/own/NAME, as the photographs are called)
    """

    photographs: Positional[Source]
    out: Path | None = None
    betti: str | None = None
    every: Annotated[int | None, 1] = None
    budget: Annotated[int, 1] = BUDGET
    steps: Annotated[int, 1] = STEPS_OF_THE_STUDY
    work: Path | None = None


def reconstruct(options: Reconstruct) -> int:
    """Make scene, soup, pictures and mesh, a line for each. Returns 0, or 1 when no mesh can be written."""
    with usage_checked():
        betti = None if options.betti is None else numbers(options.betti, int, "--betti")
        if betti is not None:
            wanted_of(betti)
            if options.out is None:
                raise InputError("--betti belongs to --out MESH; give the mesh's name too")
        if options.out is not None:
            check_format(options.out)
    if options.out is not None:
        check_writable(options.out)
    source = Path(options.photographs)
    work = options.work or OWN / cut_name(source.resolve().stem)
    if source.resolve() in (work.resolve(), *work.resolve().parents):
        raise InputError(
            f"--work {work} lies among the photographs, and its pictures would be taken for some; choose a "
            "folder elsewhere"
        )
    scene = Source(str(work / "scene"))
    before = written(scene)
    found = photographs_scene(
        source,
        scene,
        PhotosConfig(every=options.every),
        progress=not options.quiet,
        tell=lambda text: print(f"warning: {text}", file=sys.stderr),
    )
    held = ", as before" if before is not None and before == written(scene) else ""
    print(f"photographs  {registered_text(found)}{held}: {scene}")
    run = Train(
        scene=scene,
        changes=[f"budget={options.budget}"],
        steps=options.steps,
        results=work,
        quiet=options.quiet,
    )
    record, _, soup, ran = trained(run)
    print(f"training     {summary(record)}{'' if ran else ', as recorded'}: {soup}")
    pictures = exported(Export(soup=Source(str(soup)), scene=scene, out=work, formats=("png", "html")))
    print(f"pictures     3-D: {pictures[0]}; photographs held out above, renders below: {pictures[-1]}")
    if options.out is None:
        print(next_mesh("reconstruct", *words_of(options), "--betti", "1,1,0"))
        return 0
    cut = Solidify(soup=Source(str(soup)), out=options.out, scene=scene, quiet=options.quiet)
    solid = solid_of(cut, betti, OFFSETS)
    if solid.mesh is None:
        print(f"mesh         none is written\n{offset_table(solid)}")
        return 1
    certificate = write_solid(options.out, solid)
    print(
        f"mesh         {written_text(solid, certificate)}: {options.out}\n"
        f"             {offset_table(solid).splitlines()[-1]}"
    )
    print(next_command("certify", options.out, "--closed"))
    return 0
