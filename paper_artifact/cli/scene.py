"""`python -m paper_artifact scene (--shape NAME | --mesh FILE) --out DIR`: a COLMAP scene of a surface."""

from __future__ import annotations

import argparse
from pathlib import Path

from paper_artifact.mesh import load_mesh
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.ground_truth import BACKGROUNDS
from paper_artifact.scene.holdout import EVERY
from paper_artifact.scene.shapes import SHAPES, make_shape


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    default = SceneConfig()
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--shape", metavar="NAME", help=f"an analytic shape: {', '.join(SHAPES)}")
    source.add_argument(
        "--mesh",
        type=Path,
        metavar="FILE",
        help="any mesh file that trimesh reads (OBJ, PLY, OFF, STL, GLB …)",
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
        default=default.views,
        help=f"cameras, every {EVERY}th is held out (default: %(default)s)",
    )
    parser.add_argument(
        "--size", type=int, default=default.size, help="image side in pixels (default: %(default)s)"
    )
    parser.add_argument(
        "--background", choices=sorted(BACKGROUNDS), default=default.background, help="(default: %(default)s)"
    )
    parser.add_argument(
        "--supersample",
        type=int,
        default=default.supersample,
        help="samples per pixel and axis (default: %(default)s)",
    )
    parser.add_argument(
        "--points", type=int, default=default.points, help="points of the SfM cloud (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=default.seed, help="of the SfM cloud (default: %(default)s)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Build the scene and print where it is and what it holds. Returns 0; InputError goes to the caller."""
    config = SceneConfig(
        views=arguments.views,
        size=arguments.size,
        background=arguments.background,
        supersample=arguments.supersample,
        points=arguments.points,
        seed=arguments.seed,
    )
    mesh = make_shape(arguments.shape) if arguments.shape is not None else load_mesh(arguments.mesh)
    folder = build_scene(mesh, config, arguments.out, progress=not arguments.quiet)
    held_out = len(range(0, config.views, EVERY))
    print(
        f"{folder}: {mesh.name} ({len(mesh.faces)} triangles, diagonal {mesh.diagonal:.4g}), "
        f"{config.views} views of {config.size}×{config.size} pixels ({held_out} held out), "
        f"{config.points} SfM points"
    )
    return 0
