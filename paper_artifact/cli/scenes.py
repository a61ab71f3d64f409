"""Where a run's input comes from: fetched meshes, registered photographs, scenes of shapes and of images."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from paper_artifact.cli.options import Options, Positional, Source, WrongUsage, usage_checked
from paper_artifact.cli.output import next_command, to_string
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.mesh import load_mesh
from paper_artifact.photos.pictures import FRAMES  # noqa: F401, for the help
from paper_artifact.photos.register import Registered
from paper_artifact.photos.scene import PhotosConfig, photographs_scene
from paper_artifact.scene import fetch as downloads
from paper_artifact.scene.build import TEXTURE, SceneConfig, build_scene
from paper_artifact.scene.colmap import read_model
from paper_artifact.scene.fetch import photo_sets, source, sources
from paper_artifact.scene.folder import model_folder
from paper_artifact.scene.ground_truth import BACKGROUNDS
from paper_artifact.scene.load import EVERY
from paper_artifact.scene.shapes import SHAPES, make_shape
from paper_artifact.scene.transforms import CLOUDS, TransformsConfig, transforms_scene

SURFACE, IMAGES = SceneConfig(), TransformsConfig()
SETS, NAMES = [*photo_sets()], [*SHAPES]


@dataclass(frozen=True, kw_only=True)
class Fetch(Options):
    """Options of `fetch`.

    key: meshes to fetch (default: all that the paper uses, sets aside or rejects), or sets of photographs:
        {SETS}
    all: also the other copies that were compared with these
    mirror DIR: read from this folder (layout {downloads.MIRROR_LAYOUT}) instead of the network; the
        environment variable {downloads.MIRROR_VARIABLE} does the same
    out DIR: where to put them
    listing/list: print key, role, source and licence of every mesh and fetch nothing
    """

    key: Positional[tuple[str, ...]] = ()
    all: bool = False
    mirror: Path | None = None
    out: Path = downloads.DOWNLOADS
    listing: bool = False


def fetch(options: Fetch) -> int:
    """Fetch, with a line per mesh; one that fails is named, the others go on. Returns 1 if one failed."""
    if options.listing:
        if options.key:
            raise WrongUsage(f"--list lists all there is; leave {options.key[0]} out")
        print(to_string(("key", "role", "source", "licence"), _listed()))
        return 0
    keys = options.key or [
        entry.key
        for entry in sources().values()
        if entry.obtainable and (options.all or entry.role != "comparison")
    ]
    with usage_checked():
        for key in keys:
            if key not in photo_sets():
                source(key)  # a mistyped key stops before any download
    failed = 0
    for key in keys:
        try:
            fetched = downloads.fetch(key, mirror=options.mirror, downloads=options.out, quiet=options.quiet)
        except downloads.Unreachable:
            raise
        except InputError as error:
            failed += 1
            print(f"{key}: {error}", file=sys.stderr)
        else:
            path = fetched.path
            files = [each.bytes for each in photo_sets()[key].files] if key in photo_sets() else None
            size = (sum(files) if files else path.stat().st_size) / 1e6
            shown = path.relative_to(REPOSITORY) if path.is_relative_to(REPOSITORY) else path
            print(f"{key:<17}{size:6.2f} MB  {shown}  ({fetched.origin})")
    if failed:
        print(f"paper_artifact: {failed} of {len(keys)} meshes could not be fetched", file=sys.stderr)
    elif not options.key:
        print(next_command("run-all", "--only", "10_group_wave"))
    elif len(keys) == 1 and files:
        print(next_command("photos", path, "--out", f"results/scenes/{keys[0]}"))
    elif len(keys) == 1:
        print(next_command("certify", keys[0] if options.out == downloads.DOWNLOADS else path))
    return 1 if failed else 0


def _listed() -> list[tuple[str, str, str, str]]:
    """Return key, role, source and licence of every mesh and of every set of photographs."""
    rows = []
    for entry in sources().values():
        place = f"{entry.repository}@{entry.commit[:8]}:{entry.path}" if entry.obtainable else entry.notes
        rows.append((entry.key, entry.role, place, entry.licence or "-"))
    for each in photo_sets().values():
        first, size = each.files[0], sum(file.bytes for file in each.files) / 1e6
        place = f"{first.repository}@{first.commit[:8]}:{Path(first.path).parent}"
        files = f"({len(each.files)} files, {size:.0f} MB)"
        rows.append((each.name, "photographs", f"{place} {files}", each.licence))
    return rows


@dataclass(frozen=True, kw_only=True)
class Photos(Options):
    """Options of `photos`.

    photographs DIR|VIDEO: the folder that holds the photographs, or a video file
    out SCENE: the scene's folder
    every K: of a video, the sharpest of every K frames (default: about {FRAMES} frames of all)
    size: longest side of the scene's images, pixels
    features: longest side of the pictures that features are found on, pixels: more finds more points and
        takes longer
    keep_exposure: leave each photograph as bright as it is, without one exposure for all
    """

    photographs: Positional[Source]
    out: Path
    every: Annotated[int | None, 1] = None
    size: Annotated[int, 64, 16384] = PhotosConfig.size
    features: Annotated[int, 64, 16384] = PhotosConfig.features
    keep_exposure: bool = False


def photos(options: Photos) -> int:
    """Make the scene and print what was registered. Returns 0."""
    before = written(options.out)
    found = photographs_scene(
        Path(options.photographs),
        options.out,
        PhotosConfig(options.size, options.features, not options.keep_exposure, options.every),
        progress=not options.quiet,
        tell=lambda text: print(f"warning: {text}", file=sys.stderr),
    )
    if before is not None and before == written(options.out):
        print("nothing ran: the scene of these photographs is there already")
    print(f"{found.folder}: {registered_text(found)}")
    if not options.keep_exposure:
        spread = max(found.exposures.values()) / min(found.exposures.values())
        print(f"exposures: the longest is {spread:.2f} times the shortest; all are made equal")
    print(next_command("train", "--scene", found.folder, "--set", "budget=5000"))
    return 0


def registered_text(found: Registered) -> str:
    """Return what structure from motion found, in one line."""
    return (
        f"{len(found.names)} photographs registered, {found.points} points, "
        f"mean reprojection error {found.error:.2f} pixels, {found.track:.1f} photographs a point"
    )


@dataclass(frozen=True, kw_only=True)
class Scene(Options):
    """Options of `scene`.

    shape NAME: an analytic shape: {NAMES}
    mesh FILE: any mesh file that trimesh reads (OBJ, PLY, OFF, STL, GLB …)
    transforms FILE.json: NeRF-style cameras, with the images that the file names (RGBA: transparent is
        background)
    out DIR: the scene's folder; the same scene is not built twice
    views: cameras, every {EVERY}th is held out (default: {SURFACE.views}; of --transforms all)
    size: image side in pixels (default: {SURFACE.size}; of --transforms the longest, {IMAGES.size}, never
        larger than the images are)
    background: behind the object
    supersample: samples per pixel and axis, of a surface (default: {SURFACE.supersample})
    points: points of the cloud (default: {SURFACE.points}; of --transforms {IMAGES.points})
    cloud: of --transforms: on the visual hull of what is not transparent, or anywhere (default: hull)
    seed: of the SfM cloud
    """

    shape: str | None = None
    mesh: Source | None = None
    transforms: Source | None = None
    out: Path
    views: int | None = None
    size: int | None = None
    background: Annotated[str, (*BACKGROUNDS, TEXTURE)] = SURFACE.background
    supersample: int | None = None
    points: int | None = None
    cloud: Annotated[str, CLOUDS] | None = None
    seed: int = SURFACE.seed


def scene(options: Scene) -> int:
    """Build the scene and print where it is and what it holds. Returns 0."""
    if sum(each is not None for each in (options.shape, options.mesh, options.transforms)) != 1:
        raise WrongUsage("give one of --shape NAME, --mesh FILE and --transforms FILE.json")
    given = {
        name: getattr(options, name)
        for name in ("views", "size", "background", "points", "supersample", "cloud", "seed")
        if getattr(options, name) is not None
    }
    wrong = "supersample" if options.transforms is not None else "cloud"
    if wrong in given:
        raise WrongUsage(f"--{wrong} has no meaning for {'images' if options.transforms else 'a surface'}")
    with usage_checked():
        config = SceneConfig(**given) if options.transforms is None else TransformsConfig(**given)
    before = written(options.out)
    if isinstance(config, TransformsConfig):
        folder = transforms_scene(
            Path(options.transforms or ""), options.out, config, progress=not options.quiet
        )
        views = len(list((folder / "images").iterdir()))
        what = f"{views} views of at most {config.size} pixels"
        points = f"{len(read_model(model_folder(folder)).positions)} points"
    else:
        mesh = make_shape(options.shape or "") if options.mesh is None else load_mesh(Path(options.mesh))
        folder = build_scene(mesh, config, options.out, progress=not options.quiet)
        views = config.views
        what = (
            f"{mesh.name} ({len(mesh.faces)} triangles, diagonal {mesh.diagonal:.4g}), {views} views of "
            f"{config.size}×{config.size} pixels"
        )
        points = f"{config.points} SfM points"
    if before is not None and before == written(folder):
        print("nothing ran: this scene is there already")
    print(f"{folder}: {what} ({len(range(0, views, EVERY))} held out), {points}")
    print(next_command("train", "--scene", folder))
    return 0


def written(folder: Path | str) -> int | None:
    """Return when a scene's description was written (ns), None where there is none."""
    file = Path(folder) / "scene.json"
    return file.stat().st_mtime_ns if file.is_file() else None
