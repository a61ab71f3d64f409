"""`python -m paper_artifact export SOUP.npz --out DIR`: a trained soup as PLY, GLB, PNG and an HTML view."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from paper_artifact.cli._scene_options import add_reading_arguments, reading_of_run
from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS

if TYPE_CHECKING:
    from paper_artifact.export.triangles import Triangles
    from paper_artifact.export.viewpoint import Viewpoint

FORMATS = ("ply", "glb", "png", "html")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options on `parser`."""
    parser.add_argument("soup", type=Path, metavar="SOUP", help="a trained soup, results/soups/<run>.npz")
    parser.add_argument(
        "--out",
        type=Path,
        default=RESULTS / "exports",
        metavar="DIR",
        help="the folder for the files (default: results/exports); they are named after the soup",
    )
    parser.add_argument(
        "--formats",
        nargs="+",
        choices=FORMATS,
        default=list(FORMATS),
        metavar="FORMAT",
        help=f"which of {', '.join(FORMATS)} (default: all)",
    )
    parser.add_argument(
        "--target",
        metavar="SHAPE|MESH",
        help="a ground truth (shape, key of a fetched mesh, or file) to show beside it in the HTML view",
    )
    parser.add_argument(
        "--scene",
        type=Path,
        metavar="DIR",
        help="render the held-out views of this COLMAP scene, photographs above, and open the HTML view at "
        "its first camera (default: views around the soup); it is read as the run's record beside "
        "the soup (../runs) has it, unless the next options are given",
    )
    add_reading_arguments(parser)
    parser.add_argument("--views", type=int, default=4, help="renders without --scene (default: %(default)s)")
    parser.add_argument("--size", type=int, default=400, help="their side in pixels (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print their paths. Returns 0; InputError goes to the caller."""
    if arguments.views < 1 or not 16 <= arguments.size <= 4096:
        raise InputError(
            f"--views must be at least 1 and --size in 16…4096, got {arguments.views} and {arguments.size}"
        )
    from paper_artifact.export.models import write_glb, write_ply
    from paper_artifact.export.triangles import mesh_triangles, soup_triangles
    from paper_artifact.export.viewer import write_html
    from paper_artifact.soup.state import load_frame, load_soup

    settings = reading_of_run(arguments, arguments.soup)
    soup = load_soup(arguments.soup)
    frame = load_frame(arguments.soup)
    triangles = soup_triangles(soup)
    stem = arguments.out / arguments.soup.stem
    written = []

    def path_of(kind: str) -> Path:
        written.append(stem.with_name(f"{stem.name}.{kind}"))
        return written[-1]

    if "ply" in arguments.formats:
        write_ply(path_of("ply"), triangles, frame)
    if "glb" in arguments.formats:
        write_glb(path_of("glb"), triangles, frame)
    if "html" in arguments.formats:
        parts = {"soup": triangles}
        if arguments.target is not None:
            from paper_artifact.scene.find import find_mesh

            parts["ground truth"] = mesh_triangles(find_mesh(arguments.target).framed(frame))
        write_html(path_of("html"), parts, arguments.soup.stem, _viewpoint(arguments, triangles, settings))
    if "png" in arguments.formats:
        from paper_artifact.export.images import sheet, write_png
        from paper_artifact.export.renders import orbit_renders, scene_renders
        from paper_artifact.scene.load import load_scene

        if arguments.scene is None:
            rows = [orbit_renders(soup, arguments.views, arguments.size)]
        else:
            rows = scene_renders(soup, load_scene(arguments.scene, **settings), frame)
        for index, image in enumerate(rows[-1]):
            write_png(path_of(f"view{index}.png"), image)
        write_png(path_of("views.png"), sheet(rows))
    for path in written:
        print(path)
    return 0


def _viewpoint(
    arguments: argparse.Namespace, triangles: Triangles, settings: dict[str, Any]
) -> Viewpoint | None:
    """Where the HTML view opens: at the scene's first camera, as the study shows that shape, or anywhere."""
    from paper_artifact.catalogue import SHAPES
    from paper_artifact.export.viewpoint import scene_viewpoint, shape_viewpoint
    from paper_artifact.scene.load import load_scene

    if arguments.scene is not None:
        return scene_viewpoint(load_scene(arguments.scene, **settings))
    row = next((each for each in SHAPES if each.name == arguments.target), None)
    return row and shape_viewpoint(row, triangles.visible().vertices.reshape(-1, 3))
