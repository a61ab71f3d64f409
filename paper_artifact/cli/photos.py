"""`python -m paper_artifact photos DIR --out SCENE`: photographs → registered, undistorted COLMAP scene."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from paper_artifact.photos.scene import PhotosConfig, photographs_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    default = PhotosConfig()
    parser.add_argument("photographs", type=Path, metavar="DIR", help="the folder that holds the photographs")
    parser.add_argument("--out", type=Path, required=True, metavar="SCENE", help="the scene's folder")
    parser.add_argument(
        "--size",
        type=int,
        default=default.size,
        help="longest side of the scene's images, pixels (default: %(default)s)",
    )
    parser.add_argument(
        "--features",
        type=int,
        default=default.features,
        help="longest side of the pictures that features are found on, pixels: more finds more points and "
        "takes longer (default: %(default)s)",
    )
    parser.add_argument(
        "--keep-exposure",
        action="store_true",
        help="leave each photograph as bright as it is, instead of bringing all to one exposure",
    )


def run(arguments: argparse.Namespace) -> int:
    """Make the scene and print what was registered. Returns 0; InputError goes to the caller."""
    config = PhotosConfig(arguments.size, arguments.features, not arguments.keep_exposure)
    found = photographs_scene(
        arguments.photographs,
        arguments.out,
        config,
        progress=not arguments.quiet,
        tell=lambda text: print(f"warning: {text}", file=sys.stderr),
    )
    print(
        f"{found.folder}: {len(found.names)} photographs registered, {found.points} points, "
        f"mean reprojection error {found.error:.2f} pixels, {found.track:.1f} photographs a point"
    )
    if not arguments.keep_exposure:
        spread = max(found.exposures.values()) / min(found.exposures.values())
        print(f"exposures: the longest is {spread:.2f} times the shortest; brought to one")
    print(f"next: python -m paper_artifact train --scene {found.folder} --set budget=5000")
    return 0
