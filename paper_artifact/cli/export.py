"""`export SOUP`: a trained soup as PLY, GLB, PNG and an HTML view."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from paper_artifact.cli.options import Positional, Source
from paper_artifact.cli.reading import ReadingOptions
from paper_artifact.files import RESULTS

if TYPE_CHECKING:
    from paper_artifact.export.models import Triangles
    from paper_artifact.export.viewer import Viewpoint

FORMATS = ("ply", "glb", "png", "html")


@dataclass(frozen=True, kw_only=True)
class Export(ReadingOptions):
    """Options of `export`.

    soup SOUP: a trained soup, results/soups/<run>.npz
    out DIR: the folder for the files, which are named after the soup
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
    from paper_artifact.export.flat import orbit_renders, scene_renders, sheet, write_png
    from paper_artifact.export.models import mesh_triangles, soup_triangles, write_glb, write_ply
    from paper_artifact.export.viewer import write_html
    from paper_artifact.scene.load import load_scene
    from paper_artifact.scene.shapes import find_mesh
    from paper_artifact.soup.state import load_frame, load_soup

    file = Path(options.soup)
    settings = options.reading_of_run(file)
    soup, frame = load_soup(file), load_frame(file)
    triangles = soup_triangles(soup)
    written: list[Path] = []

    def path_of(kind: str) -> Path:
        written.append(options.out / f"{file.stem}.{kind}")
        return written[-1]

    if "ply" in options.formats:
        write_ply(path_of("ply"), triangles, frame)
    if "glb" in options.formats:
        write_glb(path_of("glb"), triangles, frame)
    if "html" in options.formats:
        parts = {"soup": triangles}
        if options.target is not None:
            parts["ground truth"] = mesh_triangles(find_mesh(options.target).framed(frame))
        write_html(path_of("html"), parts, file.stem, _viewpoint(options, triangles, settings))
    if "png" in options.formats:
        if options.scene is None:
            rows = [orbit_renders(soup, options.views, options.size)]
        else:
            rows = scene_renders(soup, load_scene(options.scene, **settings), frame)
        for index, image in enumerate(rows[-1]):
            write_png(path_of(f"view{index}.png"), image)
        write_png(path_of("views.png"), sheet(rows))
    print(*written, sep="\n")
    return 0


def _viewpoint(options: Export, triangles: Triangles, settings: dict[str, Any]) -> Viewpoint:
    """Where the HTML view opens: at the first camera, as the study shows that shape, or from above."""
    from paper_artifact.catalogue import SHAPES
    from paper_artifact.export.viewer import framing, scene_viewpoint, shape_viewpoint, up_of
    from paper_artifact.scene.load import load_scene

    if options.scene is not None:
        return scene_viewpoint(load_scene(options.scene, **settings))
    row = next((each for each in SHAPES if each.name == options.target), None)
    points = triangles.visible().vertices.reshape(-1, 3)
    return shape_viewpoint(row, points) if row else framing(points, up=up_of(options.target))
