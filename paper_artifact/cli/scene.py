"""`python -m paper_artifact scene (--shape NAME | --mesh FILE | --transforms FILE.json) --out DIR`: a COLMAP
scene of a surface, or of images whose cameras are known."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.errors import InputError
from paper_artifact.mesh import load_mesh
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.ground_truth import BACKGROUNDS
from paper_artifact.scene.holdout import EVERY
from paper_artifact.scene.shapes import SHAPES, make_shape
from paper_artifact.scene.transforms import CLOUDS, TransformsConfig, transforms_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    default, images = SceneConfig(), TransformsConfig()
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--shape", metavar="NAME", help=f"an analytic shape: {', '.join(SHAPES)}")
    source.add_argument(
        "--mesh",
        type=Path,
        metavar="FILE",
        help="any mesh file that trimesh reads (OBJ, PLY, OFF, STL, GLB …)",
    )
    source.add_argument(
        "--transforms",
        type=Path,
        metavar="FILE.json",
        help="NeRF-style cameras, with the images that the file names (RGBA: transparent is background)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="the scene's folder; the same scene is not built twice",
    )
    parser.add_argument(
        "--views",
        type=int,
        help=f"cameras, every {EVERY}th is held out (default: {default.views}; of --transforms all)",
    )
    parser.add_argument(
        "--size",
        type=int,
        help=f"image side in pixels (default: {default.size}; of --transforms the longest, {images.size}, "
        "never larger than the images are)",
    )
    parser.add_argument(
        "--background", choices=sorted(BACKGROUNDS), default=default.background, help="(default: %(default)s)"
    )
    parser.add_argument(
        "--supersample",
        type=int,
        help=f"samples per pixel and axis, of a surface (default: {default.supersample})",
    )
    parser.add_argument(
        "--points",
        type=int,
        help=f"points of the cloud (default: {default.points}; of --transforms {images.points})",
    )
    parser.add_argument(
        "--cloud",
        choices=CLOUDS,
        help="of --transforms: on the visual hull of what is not transparent, or anywhere (default: hull)",
    )
    parser.add_argument(
        "--seed", type=int, default=default.seed, help="of the SfM cloud (default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Build the scene and print where it is and what it holds. Returns 0; InputError goes to the caller."""
    given = {
        name: getattr(arguments, name)
        for name in ("views", "size", "points", "supersample", "cloud")
        if getattr(arguments, name) is not None
    } | {"background": arguments.background, "seed": arguments.seed}
    wrong = "supersample" if arguments.transforms is not None else "cloud"
    if wrong in given:
        raise InputError(f"--{wrong} has no meaning for {'images' if arguments.transforms else 'a surface'}")
    if arguments.transforms is not None:
        return _from_images(arguments, TransformsConfig(**given))
    config = SceneConfig(**given)
    mesh = make_shape(arguments.shape) if arguments.shape is not None else load_mesh(arguments.mesh)
    folder = build_scene(mesh, config, arguments.out, progress=not arguments.quiet)
    held_out = len(range(0, config.views, EVERY))
    print(
        f"{folder}: {mesh.name} ({len(mesh.faces)} triangles, diagonal {mesh.diagonal:.4g}), "
        f"{config.views} views of {config.size}×{config.size} pixels ({held_out} held out), "
        f"{config.points} SfM points"
    )
    return 0


def _from_images(arguments: argparse.Namespace, config: TransformsConfig) -> int:
    """Build the scene of a transforms.json and print where it is and what it holds."""
    folder = transforms_scene(arguments.transforms, arguments.out, config, progress=not arguments.quiet)
    views = len(list((folder / "images").iterdir()))
    print(
        f"{folder}: {views} views of at most {config.size} pixels "
        f"({len(range(0, views, EVERY))} held out), {config.points} points ({config.cloud})"
    )
    return 0
