"""`python -m paper_artifact evaluate FILE --target SHAPE|MESH`: a soup or mesh against a ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.evaluate import scores
from paper_artifact.files import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument(
        "surface", type=Path, metavar="FILE", help="a trained soup (.npz) or any mesh file that trimesh reads"
    )
    parser.add_argument(
        "--target",
        required=True,
        metavar="SHAPE|MESH",
        help="the ground truth: an analytic shape, the key of a fetched mesh, or a mesh file",
    )
    parser.add_argument(
        "--scene",
        type=Path,
        metavar="DIR",
        help="a COLMAP scene: adds PSNR and SSIM on its held-out views (soups only)",
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
    truth = find_mesh(arguments.target)
    draws = stream(arguments.seed, "evaluation samples")
    images = None
    if is_soup:
        from paper_artifact.soup.state import load_soup

        soup = load_soup(arguments.surface)
        samples = scores.soup_samples(soup.vertices.numpy(), soup.corner_opacity(), arguments.samples, draws)
        images = None if arguments.scene is None else _holdout_scores(soup, arguments.scene)
    else:
        mesh = load_mesh(arguments.surface)
        samples = sample_surface(mesh.vertices, mesh.faces, arguments.samples, draws)[0]
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
        images = result["images"]
        lines.append(
            f"held-out views: PSNR {images['psnr']:.2f} dB, SSIM {images['ssim']:.4f} "
            f"({len(images['views'])} views)"
        )
    return "\n".join(lines)


def _holdout_scores(soup, folder: Path) -> dict:
    from paper_artifact.evaluate.image import image_scores
    from paper_artifact.scene.load import load_scene
    from paper_artifact.soup.render import render_views

    scene = load_scene(folder)
    return image_scores(np.asarray(render_views(soup, scene, scene.holdout)), scene.colours(scene.holdout))
