"""A trained soup as a closed, certified, coloured mesh, by the smallest offset of the wanted topology."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.evaluate.geometry import point_distances
from paper_artifact.export.models import Triangles, glb_bytes, ply_bytes, soup_triangles, srgb_to_linear
from paper_artifact.frame import SAME, Frame, frame_for
from paper_artifact.ingest.crossings import retract
from paper_artifact.ingest.solidify import (
    CELLS,
    OFFSETS,
    Rung,
    Wanted,
    check_ladder,
    outer_surface,
    plateau,
    wanted_of,
    write_certified,
)
from paper_artifact.ingest.surgery import without_holes
from paper_artifact.mesh import Mesh, check_scale, checked_mesh
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.soup.state import Soup

FORMATS = (".ply", ".glb")
GREY = 0.7  # sRGB of a solid of a mesh
WIDEST = 1 / 4  # of the diagonal; a wider hole of a mesh is taken for an opening, and stays
LASTING = 1 / 3  # share of the ladder that Betti numbers must last over, unless they were stated
SAMPLES = 20_000  # per surface, as an evaluation has


@dataclass(frozen=True, eq=False)
class SoupSolid:
    """What came of a soup: the rungs that were tried, and the solid where one of them is as wanted."""

    rungs: tuple[Rung, ...]  # smallest offset first
    wanted: Wanted
    # share of the ladder, in log ε, that `wanted` lasts over; None: it was stated
    lasting: float | None
    diagonal: float  # D of the opaque soup, the frame's units; offsets are fractions of it
    rung: Rung | None = None  # the one taken; None: no offset gives the wanted topology
    mesh: Mesh | None = None  # the solid, the frame's units, wound outwards
    colours: np.ndarray | None = None  # (V,3) float32 sRGB in [0,1]
    moved: np.ndarray | None = None  # (V,) float64 share of the way back to the soup
    # triangles that may meet another; 0: none does; None: not looked for
    crossings: int | None = None
    certificate: Certificate | None = None  # of `mesh`
    frame: Frame = SAME  # of the soup's coordinates; what is written and `to_json` have the user's
    holes: tuple[float, ...] = ()  # of a mesh, how far across / diagonal; up to WIDEST were closed

    @property
    def hollow(self) -> tuple[Rung, ...]:
        """The rungs with the wanted Betti numbers that have neither an inside nor walls."""
        return tuple(
            rung for rung in self.rungs if rung.betti == self.wanted.betti and not rung.meets(self.wanted)
        )

    def to_json(self) -> dict:
        """Return a JSON-able dict: wanted, every rung, and of the solid ε, certificate and checks."""
        found = {}
        if self.rung is not None and self.certificate is not None and self.moved is not None:
            found = {
                "offset": self.rung.offset,
                "epsilon": math.ldexp(self.rung.offset * self.diagonal, self.frame.exponent),
                "crossing_triangles": self.crossings,
                "moved_back": float(self.moved.mean()),
                "certificate": self.certificate.to_json(),
            }
        return {
            "wanted": list(self.wanted.betti),
            "body": self.wanted.body,
            "stated": self.lasting is None,
            "diagonal": math.ldexp(self.diagonal, self.frame.exponent),
            "holes": list(self.holes),
            "offsets": [asdict(rung) for rung in self.rungs],
            "solid": found or None,
        }


def opaque_mesh(triangles: Triangles, name: str = "soup") -> Mesh:
    """Return the visible triangles as an unwelded Mesh, corners in their order; raises InputError as
    `Triangles.visible` and `checked_mesh` do."""
    corners = triangles.visible().vertices.astype(np.float64).reshape(-1, 3)
    return checked_mesh(corners, np.arange(len(corners)).reshape(-1, 3), name, welded=False)


def solidify_soup(
    soup: Soup,
    betti: Sequence[int] | None = None,
    offsets: Iterable[float] = OFFSETS,
    cells: float = CELLS,
    name: str = "soup",
    progress: Callable[[Rung], None] = lambda rung: None,
    frame: Frame = SAME,
) -> SoupSolid:
    """Return the SoupSolid of a trained soup.

    betti: of the surface, see `wanted_of`; None takes the plateau, if it lasts over a third of the ladder.
    offsets: fractions of the opaque soup's diagonal; cells: grid cells per offset. Where betti is stated the
    smallest offset is tried first and the first that meets it is the last. progress is called with each rung.
    frame: of the soup's coordinates.
    Raises InputError for what cannot be wanted, bad offsets, and as `opaque_mesh` does.
    """
    shown = soup_triangles(soup).visible()
    return _solid_of(opaque_mesh(shown, name), shown.colours, betti, offsets, cells, progress, frame)


def solidify_mesh(
    mesh: Mesh,
    betti: Sequence[int] | None,
    offsets: Iterable[float],
    cells: float,
    progress: Callable[[Rung], None],
) -> SoupSolid:
    """Return the SoupSolid of a mesh, grey: of double sheets, scans with holes, shells that intersect.

    The arguments are those of `solidify_soup`, which it raises as.
    """
    frame, across = frame_for(mesh.centre, mesh.radius), list[float]()
    raw = mesh.framed(frame)
    if betti is None or wanted_of(betti).body:
        raw, across = without_holes(raw, WIDEST * raw.diagonal)
    colours = np.full((len(raw.faces), 3, 3), GREY, dtype=np.float32)
    solid = _solid_of(raw, colours, betti, offsets, cells, progress, frame)
    return replace(solid, holes=tuple(each / raw.diagonal for each in across))


def _solid_of(
    raw: Mesh,
    colours: np.ndarray,
    betti: Sequence[int] | None,
    offsets: Iterable[float],
    cells: float,
    progress: Callable[[Rung], None],
    frame: Frame,
) -> SoupSolid:
    """Return the SoupSolid of a raw mesh (F triangles) with the colours (F,3,3) of its corners."""
    wanted = None if betti is None else wanted_of(betti)
    ladder, lasting = check_ladder(offsets, cells), None
    rungs: list[Rung] = []
    kept: dict[float, Mesh] = {}  # the first surface that meets it, by its offset
    for offset in ladder:
        rung, surface = outer_surface(raw, offset, cells)
        rungs.append(rung)
        progress(rung)
        if wanted is not None and rung.meets(wanted):
            kept = kept or {offset: surface}
        if kept and wanted is not None and rung.sure(wanted):
            break
    if wanted is None:
        longest, lasting = plateau(rungs)
        wanted = Wanted(longest, any(rung.meets(Wanted(longest, True)) for rung in rungs))
    result = SoupSolid(tuple(rungs), wanted, lasting, raw.diagonal, frame=frame)
    if lasting is not None and lasting < LASTING:
        return result
    for rung in sorted(rungs, key=lambda rung: not rung.sure(wanted)):
        if not rung.meets(wanted):
            continue
        epsilon = rung.offset * raw.diagonal
        surface = kept.get(rung.offset) or outer_surface(raw, rung.offset, cells)[1]
        shell = checked_mesh(surface.vertices, surface.faces, surface.name)
        back = retract(shell, raw.vertices[raw.faces], epsilon + epsilon / cells)
        left = replace(back, mesh=shell, moved=np.zeros(len(shell.vertices)), crossings=None)
        for made in (back, left):
            certificate = certify_mesh(made.mesh)
            if certificate.passed and certificate.betti == rung.betti:
                blended = np.einsum("ij,ijk->ik", made.nearest.weights, colours[made.nearest.triangle])
                return replace(
                    result,
                    rung=rung,
                    mesh=replace(made.mesh, name=f"{raw.name} solid", betti=certificate.betti),
                    colours=blended.astype(np.float32),
                    moved=made.moved,
                    crossings=made.crossings,
                    certificate=certificate,
                )
    return result


def check_format(path: Path | str) -> None:
    """Raise InputError unless the path ends in .ply or .glb."""
    if Path(path).suffix.lower() not in FORMATS:
        raise InputError(f"cannot write a solid as {path}: its name must end in {' or '.join(FORMATS)}")


def write_solid(path: Path | str, solid: SoupSolid) -> Certificate:
    """Write the solid as binary PLY (sRGB bytes per vertex) or binary glTF 2.0 (unlit, COLOR_0 linear);
    return the certificate of what was written, in the user's coordinates. Raises InputError as
    `write_certified` does, and when there is no solid."""
    check_format(path)
    if solid.mesh is None or solid.colours is None:
        raise InputError(f"no offset gave the wanted topology, so there is no solid to write as {path}")
    glb = Path(path).suffix.lower() == ".glb"
    colours = srgb_to_linear(solid.colours) if glb else solid.colours
    mesh = trimesh.Trimesh(
        solid.mesh.vertices,
        solid.mesh.faces,
        vertex_colors=np.rint(np.clip(colours, 0, 1) * 255).astype(np.uint8),
        process=False,
    )
    outer = placed(solid.mesh, solid.frame)
    check_scale(outer.vertices, f"the solid for {path}")
    if solid.frame != SAME and len(np.unique(outer.vertices, axis=0)) < len(
        np.unique(solid.mesh.vertices, axis=0)
    ):
        raise InputError(
            f"points of the solid coincide at coordinates of up to {np.abs(outer.vertices).max():.3g}, so "
            f"{path} was not written; move the mesh nearer to the origin, or scale it up"
        )
    data = glb_bytes(mesh, solid.frame) if glb else ply_bytes(mesh, solid.frame)
    return write_certified(path, outer, data)


def placed(mesh: Mesh, frame: Frame) -> Mesh:
    """Return a mesh of the frame's coordinates in the user's."""
    return replace(mesh, vertices=frame.outward(mesh.vertices))


def distances_to(solid: Mesh, target: Mesh, samples: int = SAMPLES) -> dict[str, float]:
    """Return chamfer, chamfer_sum and hausdorff95 (see `point_distances`) of area-weighted samples of both,
    divided by the target's diagonal."""
    clouds = [
        sample_surface(mesh.vertices, mesh.faces, samples, stream(0, f"solid: {purpose}"))[0]
        for mesh, purpose in ((solid, "solid"), (target, "target"))
    ]
    return point_distances(clouds[0], clouds[1], target.diagonal)
