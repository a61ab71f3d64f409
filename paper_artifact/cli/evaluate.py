"""`python -m paper_artifact evaluate FILE --target SHAPE|MESH` or `--scene DIR`: a soup or mesh, measured."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from paper_artifact.cli._scene_options import add_reading_arguments, reading_of_run
from paper_artifact.errors import InputError
from paper_artifact.evaluate import scores
from paper_artifact.files import write_json

if TYPE_CHECKING:
    from paper_artifact.frame import Frame
    from paper_artifact.scene.load import Scene
    from paper_artifact.soup.state import Soup


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "surface", type=Path, metavar="FILE", help="a trained soup (.npz) or any mesh file that trimesh reads"
    )
    parser.add_argument(
        "--target",
        metavar="SHAPE|MESH",
        help="the ground truth: an analytic shape, the key of a fetched mesh, or a mesh file "
        "(without one, with --scene: what the soup shows by itself)",
    )
    parser.add_argument(
        "--scene",
        type=Path,
        metavar="DIR",
        help="a COLMAP scene: adds PSNR and SSIM on its held-out views (soups only); it is read as the run's "
        "record beside the soup (../runs) has it, unless the next options are given",
    )
    add_reading_arguments(parser)
    parser.add_argument(
        "--supersample",
        type=int,
        default=1,
        metavar="K",
        help="K × K rays a pixel in the renders that --scene scores: photographs average over a pixel, one "
        "ray does not (default: %(default)s, as in records)",
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=scores.SAMPLES,
        help="surface samples of either side (default: %(default)s, as the paper)",
    )
    parser.add_argument(
        "--dimension",
        type=int,
        choices=(0, 1, 2),
        help="the dimension to judge in (default: the study's for the shape)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the samples (default: %(default)s)")
    parser.add_argument(
        "--json", type=Path, metavar="OUT", help="also write everything to this file, with the longest bars"
    )


def run(arguments: argparse.Namespace) -> int:
    """Evaluate and print a table. Returns 0; InputError goes to the caller."""
    if arguments.samples < 4:
        raise InputError(f"--samples must be at least 4, got {arguments.samples}")
    if not 1 <= arguments.supersample <= 8:
        raise InputError(f"--supersample must be a whole number from 1 to 8, got {arguments.supersample}")
    if not arguments.surface.is_file():
        raise InputError(f"no file at {arguments.surface}: give a trained soup (.npz) or a mesh")
    from paper_artifact.mesh import load_mesh
    from paper_artifact.randomness import stream
    from paper_artifact.sampling import sample_surface
    from paper_artifact.scene.find import find_mesh

    is_soup = arguments.surface.suffix == ".npz"
    if arguments.scene is not None and not is_soup:
        raise InputError(
            f"{arguments.surface} is a mesh without trained colours: leave out --scene, or give a soup (.npz)"
        )
    if arguments.target is None and (arguments.scene is None or not is_soup):
        raise InputError("give --target SHAPE|MESH, or --scene DIR for a soup of photographs")
    truth = None if arguments.target is None else find_mesh(arguments.target)
    settings = reading_of_run(arguments, arguments.surface)
    draws = stream(arguments.seed, "evaluation samples")
    images = None
    if is_soup:
        from paper_artifact.soup.state import load_frame, load_soup

        soup, frame = load_soup(arguments.surface), load_frame(arguments.surface)
        if arguments.scene is not None:
            from paper_artifact.scene.load import load_scene

            scene = load_scene(arguments.scene, **settings)
            images = _view_scores(soup, frame, scene, arguments.supersample)
        if truth is None:
            result = _alone(soup, frame, scene, arguments) | {"images": images}
            print(table_alone(result))
            if arguments.json is not None:
                write_json(arguments.json, result)
            return 0
        corners = frame.outward(soup.vertices.numpy())
        samples = scores.soup_samples(corners, soup.corner_opacity(), arguments.samples, draws)
    else:
        mesh = load_mesh(arguments.surface)
        samples = sample_surface(mesh.vertices, mesh.faces, arguments.samples, draws)[0]
    assert truth is not None
    target = scores.make_target(truth, arguments.samples, arguments.seed, arguments.dimension)
    result = scores.evaluate_samples(samples, target) | {
        "surface": str(arguments.surface),
        "target": target.name,
        "dimension": target.dimension,
        "target_counts": list(target.counts),
        "samples": arguments.samples,
        "seed": arguments.seed,
    }
    if images is not None:
        result["images"] = images
    print(table(result))
    if arguments.json is not None:
        write_json(arguments.json, result)
    return 0


def table(result: dict) -> str:
    """Return the lines that the verb prints for its result."""
    lines = [
        f"{result['surface']} against {result['target']}, {result['samples']} samples a side, "
        f"seed {result['seed']}",
        "dimension   bottleneck   significant bars   of the target",
    ]
    for dimension in range(3):
        mark = "  <- discriminating" if dimension == result["dimension"] else ""
        lines.append(
            f"H{dimension}          {result['bottleneck'][dimension]:.5f}      "
            f"{result['counts'][dimension]:<18} {result['target_counts'][dimension]}{mark}"
        )
    lines.append(
        f"floor {result['floor']:.5f} (6 r_med; lengths are radii / the target's diagonal; finite bars only)"
    )
    lines.append(
        f"Chamfer {100 * result['chamfer']:.3f} % (mean of both directions; "
        f"sum {100 * result['chamfer_sum']:.3f} %), Hausdorff95 {100 * result['hausdorff95']:.3f} %"
    )
    if "images" in result:
        lines.append(images_line(result["images"]))
    return "\n".join(lines)


def table_alone(result: dict) -> str:
    """Return the lines that the verb prints of a soup without a ground truth."""
    lines = [
        f"{result['surface']}, no ground truth, {result['samples']} samples, seed {result['seed']}",
        "dimension   significant bars   the longest bars / floor (a bar counts above 1)",
    ]
    for dimension, (count, margins) in enumerate(zip(result["counts"], result["margins"], strict=True)):
        longest = "  ".join(f"{margin:.2f}" for margin in margins[: max(count + 2, 3)])
        lines.append(f"H{dimension}          {count:<18} {longest}")
    lines.append(
        f"floor {result['floor']:.5f} (6 r_med; lengths are radii / the SfM cloud's diagonal, finite bars "
        "only: one component more than H0 counts)"
    )
    return "\n".join([*lines, images_line(result["images"])])


def images_line(images: dict) -> str:
    """Return the line of an image score and of which views."""
    rays = images["supersample"] ** 2
    return (
        f"{images['of']} views: PSNR {images['psnr']:.2f} dB, SSIM {images['ssim']:.4f} "
        f"({len(images['views'])} views, {rays} ray{'s' if rays > 1 else ''} a pixel)"
    )


def _view_scores(soup: Soup, frame: Frame, scene: Scene, supersample: int) -> dict:
    """Return `view_scores` of the held-out views, or of all where none is held out, of which ("of"), and of
    how many rays a pixel and side ("supersample")."""
    from paper_artifact.evaluate.image import view_scores
    from paper_artifact.soup.state import reframed

    views, which = (scene.holdout, "held-out") if len(scene.holdout) else (scene.train, "training")
    found = view_scores(reframed(soup, frame, scene.frame), scene, views, supersample)
    return found | {"of": which, "supersample": supersample}


def _alone(soup: Soup, frame: Frame, scene: Scene, arguments: argparse.Namespace) -> dict:
    """Return what a soup shows by itself, in units of the scene's cloud."""
    from paper_artifact.soup.state import reframed
    from paper_artifact.topology.statement import frame_diagonal

    moved = reframed(soup, frame, scene.frame)
    shown = scores.evaluate_alone(
        moved.vertices.numpy(),
        moved.corner_opacity(),
        frame_diagonal(scene.points),
        arguments.samples,
        arguments.seed,
    )
    del shown["step"]
    named = {"surface": str(arguments.surface), "samples": arguments.samples, "seed": arguments.seed}
    return shown | named
