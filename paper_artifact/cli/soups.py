"""What is made of a trained soup: `evaluate` measures it, or a mesh; `export` writes PLY, GLB, PNG, HTML."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from os.path import realpath, relpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from paper_artifact.cli.options import Positional, Source, WrongUsage
from paper_artifact.cli.output import next_command, next_mesh, to_string
from paper_artifact.cli.reading import ReadingOptions
from paper_artifact.errors import InputError
from paper_artifact.evaluate import scores
from paper_artifact.files import RESULTS, renewed_folder, write_text
from paper_artifact.mesh import FEATURES

if TYPE_CHECKING:
    from paper_artifact.export.models import Triangles
    from paper_artifact.export.viewer import Viewpoint
    from paper_artifact.scene.load import Scene
    from paper_artifact.soup.state import Soup

ELSEWHERE = 0.5  # Chamfer over the target's diagonal
FORMATS = ("ply", "glb", "png", "html")


@dataclass(frozen=True, kw_only=True)
class Evaluate(ReadingOptions):
    """Options of `evaluate`.

    surface FILE: a trained soup (.npz) or any mesh file that trimesh reads
    target SHAPE|MESH: the ground truth: an analytic shape, the key of a fetched mesh, or a mesh file
        (without one, with --scene: what the soup shows by itself)
    supersample K: K × K rays a pixel in the renders that --scene scores: photographs average over a pixel,
        one ray does not (default: 1, as in records)
    samples: surface samples of either side (default: {scores.SAMPLES}, as the paper)
    dimension: the dimension to judge in: 0 components, 1 loops, 2 voids (default: the study's for the
        shape)
    seed: of the samples
    json OUT: also write everything to this file, with the longest bars (-: to stdout)
    """

    surface: Positional[Source]
    target: Source | None = None
    supersample: Annotated[int, 1, 8] = 1
    samples: Annotated[int, 4] = scores.SAMPLES
    dimension: Annotated[int, (0, 1, 2)] | None = None
    seed: Annotated[int, 0] = 0
    json: Path | None = None


def evaluate(options: Evaluate) -> tuple[int, dict]:
    """Evaluate and print a table. Returns 0 and what --json writes."""
    is_soup, file = options.surface.lower().endswith(".npz"), Path(options.surface)
    if options.scene is not None and not is_soup:
        raise WrongUsage(
            f"{options.surface} is a mesh without trained colours: leave out --scene, or give a soup (.npz)"
        )
    if options.target is None and (options.scene is None or not is_soup):
        raise WrongUsage("give --target SHAPE|MESH, or --scene DIR for a soup of photographs")
    settings = options.reading_of_run(file)
    if not file.is_file():
        raise InputError(f"no file at {options.surface}: give a trained soup (.npz) or a mesh")
    from paper_artifact.evaluate.diagram import require_memory_for
    from paper_artifact.mesh import load_mesh
    from paper_artifact.randomness import stream
    from paper_artifact.sampling import sample_surface
    from paper_artifact.scene.shapes import find_mesh

    require_memory_for(options.samples)
    truth = None if options.target is None else find_mesh(options.target)
    draws = stream(options.seed, "evaluation samples")
    asked = {"surface": options.surface, "samples": options.samples, "seed": options.seed}
    images = {}
    if is_soup:
        from paper_artifact.scene.load import load_scene
        from paper_artifact.soup.state import load_frame, load_soup, reframed
        from paper_artifact.topology.statement import frame_diagonal

        soup, frame = load_soup(file), load_frame(file)
        if options.scene is not None:
            scene = load_scene(options.scene, **settings)
            moved = reframed(soup, frame, scene.frame)
            images = {"images": _view_scores(moved, scene, options.supersample)}
        if truth is None:
            corners, unit = moved.vertices.numpy(), frame_diagonal(scene.points)
            result = scores.evaluate_alone(
                corners, moved.corner_opacity(), unit, options.samples, options.seed
            )
            result = {name: result[name] for name in result if name != "step"} | asked | images
            print(_table(result))
            print(next_mesh("solidify", options.surface, "--scene", options.scene))
            return 0, result
        corners = frame.outward(soup.vertices.numpy())
        samples = scores.soup_samples(corners, soup.corner_opacity(), options.samples, draws)
    else:
        mesh = load_mesh(file)
        samples = sample_surface(mesh.vertices, mesh.faces, options.samples, draws)[0]
    assert truth is not None
    target = scores.make_target(truth, options.samples, options.seed, options.dimension)
    about = {"target": target.name, "dimension": target.dimension, "target_counts": list(target.counts)}
    result = scores.evaluate_samples(samples, target) | asked | about | images
    print(_table(result))
    of = ["--target", options.target] if is_soup else []
    print(next_command("export" if is_soup else "certify", options.surface, *of))
    return 0, result


def _table(result: dict) -> str:
    """Return what the verb prints of a soup or mesh, beside its ground truth where there is one."""
    beside = f"against {result['target']}" if "target" in result else "no ground truth"
    unit = "target's diagonal" if "target" in result else "SfM cloud's diagonal"
    heads: tuple[str, ...] = ("class", "bottleneck", "counted", "in the target", "")
    rows: list[tuple] = []
    for dimension, (_, more) in enumerate(FEATURES):
        bars, first = result["counts"][dimension], int(dimension == 0)  # no bar tells of the first component
        if "target" in result:
            judged = "<- discriminating" if dimension == result["dimension"] else ""
            distance = f"{result['bottleneck'][dimension]:.5f}"
            rows.append((more, distance, bars + first, result["target_counts"][dimension] + first, judged))
        else:
            margins = result["margins"][dimension][: max(bars + 2, 3)]
            rows.append((more, bars + first, "  ".join(f"{margin:.2f}" for margin in margins)))
    if "target" not in result:
        heads = ("class", "counted", "the longest bars / floor (a bar counts above 1)")
    lines = [
        f"{result['surface']}, {beside}, {result['samples']} samples, seed {result['seed']}",
        to_string(heads, rows),
        f"floor {result['floor']:.5f} (6 r_med; lengths are radii / the {unit})",
    ]
    if "target" in result:
        lines.append(
            f"Chamfer {100 * result['chamfer']:.3f} % (mean of both directions; "
            f"sum {100 * result['chamfer_sum']:.3f} %), Hausdorff95 {100 * result['hausdorff95']:.3f} %"
        )
        if result["chamfer"] > ELSEWHERE:
            lines.append(
                "warning: that is far: does the target lie elsewhere, or has it another unit of length?"
            )
    if "images" in result:
        images, rays = result["images"], result["images"]["supersample"] ** 2
        lines.append(
            f"{images['of']} views: PSNR {images['psnr']:.2f} dB, SSIM {images['ssim']:.4f} "
            f"({len(images['views'])} views, {rays} ray{'s' if rays > 1 else ''} a pixel)"
        )
    return "\n".join(lines)


def _view_scores(soup: Soup, scene: Scene, supersample: int) -> dict:
    """Return `view_scores` of the held-out views, or of all where none is held out, of which ("of"), and of
    how many rays a pixel and side ("supersample"); the soup in the scene's frame."""
    from paper_artifact.evaluate.image import view_scores

    views, which = (scene.holdout, "held-out") if len(scene.holdout) else (scene.train, "training")
    return view_scores(soup, scene, views, supersample) | {"of": which, "supersample": supersample}


@dataclass(frozen=True, kw_only=True)
class Export(ReadingOptions):
    """Options of `export`.

    soup SOUP: a trained soup, results/soups/<run>.npz
    out DIR: the folder for the files, which are named after the soup; files of such a name that no `export`
        wrote are left alone, with an error
    formats FORMAT: which of {FORMATS} (default: all)
    target SHAPE|MESH: a ground truth (shape, key of a fetched mesh, or file) to show beside it in the HTML
        view
    views: renders around the soup; with --scene its held-out views are rendered instead, photographs above,
        and the HTML view opens at its first camera
    size: their side in pixels
    """

    soup: Positional[Source]
    out: Path = RESULTS / "exports"
    formats: Annotated[tuple[str, ...], FORMATS] = FORMATS
    target: Source | None = None
    views: Annotated[int, 1] = 4
    size: Annotated[int, 16, 4096] = 400


def export(options: Export) -> int:
    """Write the files and print their paths. Returns 0."""
    print(*exported(options), sep="\n")
    target = ["--target", options.target] if options.target else []
    of = ["--scene", options.scene] if options.scene else target
    print(next_mesh("solidify", options.soup, *of))
    return 0


def exported(options: Export) -> list[Path]:
    """Write the files and return their paths."""
    from paper_artifact.export.flat import orbit_renders, scene_renders, sheet, write_png
    from paper_artifact.export.models import mesh_triangles, soup_triangles, write_glb, write_ply
    from paper_artifact.export.viewer import html_page
    from paper_artifact.scene.load import load_scene
    from paper_artifact.scene.shapes import find_mesh
    from paper_artifact.soup.state import load_frame, load_soup

    file = Path(options.soup)
    settings = options.reading_of_run(file)
    soup, frame = load_soup(file), load_frame(file)
    triangles = soup_triangles(soup)
    for kind in options.formats:
        if options.target and realpath(options.target) == realpath(options.out / f"{file.stem}.{kind}"):
            raise WrongUsage(
                f"--target {options.target} would be lost: --out gets a file of this name; give another"
            )
    models = {"ply": write_ply, "glb": write_glb}
    files: dict[str, dict[str, Callable[[Path], None]]] = {  # of each kind, by what follows the soup's name
        kind: {kind: partial(write, triangles=triangles, frame=frame)}
        for kind, write in models.items()
        if kind in options.formats
    }
    if "html" in options.formats:
        parts = {"soup": triangles}
        if options.target is not None:
            parts["ground truth"] = mesh_triangles(find_mesh(options.target).framed(frame))
        viewpoint = _viewpoint(options, triangles, settings)
        files["html"] = {"html": lambda path: write_text(path, html_page(parts, file.stem, viewpoint))}
    if "png" in options.formats:
        if options.scene is None:
            rows = [orbit_renders(soup, options.views, options.size)]
        else:
            rows = scene_renders(soup, load_scene(options.scene, **settings), frame)
        images = {f"view{index}.png": image for index, image in enumerate(rows[-1])}
        images["views.png"] = sheet(rows)
        files["png"] = {name: partial(write_png, image=image) for name, image in images.items()}
    place = relpath(file.resolve(), realpath(options.out))  # stays where both are moved
    made: list[Path] = []
    for kind, writers in files.items():
        named = {f"{file.stem}.{name}": write for name, write in writers.items()}
        with renewed_folder(options.out, f"export of {file.stem}.{kind} from {place}", [*named]) as new:
            for name, write in named.items():
                write(new / name)
        made += [options.out / name for name in named]
    return made


def _viewpoint(options: Export, triangles: Triangles, settings: dict[str, Any]) -> Viewpoint:
    """Where the HTML view opens: at the first camera, as the study shows that shape, or from above."""
    from paper_artifact.catalogue import SHAPES
    from paper_artifact.export.viewer import framing, scene_viewpoint, up_of
    from paper_artifact.scene.load import load_scene

    if options.scene is not None:
        return scene_viewpoint(load_scene(options.scene, **settings))
    row = next((each for each in SHAPES if each.name == options.target), None)
    points = triangles.visible().vertices.reshape(-1, 3)
    return (
        framing(points, row.view, row.up)
        if row
        else framing(points, up=up_of(options.target or Path(options.soup).name))
    )
