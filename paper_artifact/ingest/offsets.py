"""Which offset makes a solid of the wanted topology out of a soup: a ladder of offsets, and the choice.

The outer surface of everything within ε of the soup is closed, orientable and a manifold at every ε: b0 = b2,
b1 = 2 × genus. What changes with ε is how often it is pierced: below half the width of a gap of the soup the
surface passes through it to the soup's inner side. One gap in a sphere leaves a double wall whose Betti
numbers are those of the sphere, so a body is also asked to have had an inside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from paper_artifact.errors import InputError
from paper_artifact.ingest.solidify import check_offset, outer_surface
from paper_artifact.mesh import Mesh

OFFSETS = (0.004, 0.005, 0.006, 0.008, 0.01, 0.0125, 0.016, 0.02)  # ε / diagonal, a factor of 1.25 apart
# Grid cells per ε. With 1.5, which takes half the time, bob's C0 passes at an ε where 2 shows two handles.
CELLS = 2.0
# A body's inside is at least this share of its volume; a tube of radius 2ε has .11, a double wall 0.
INSIDE = 0.1

Betti = tuple[int, int, int]


@dataclass(frozen=True)
class Wanted:
    """The homology that a solid must have."""

    betti: Betti  # of the solid's surface
    body: bool  # whether it has an inside; False: a thick shell around an open surface


@dataclass(frozen=True)
class Rung:
    """What one offset gives."""

    offset: float  # ε / diagonal of the soup
    betti: Betti  # of the outer surface
    genus: int  # summed over its components
    inside: float  # share of a body's volume that the soup enclosed, least of all bodies; 0: open or double
    pockets: int  # enclosed cavities, filled
    triangles: int  # of the surface
    grid: tuple[int, int, int]  # points per axis

    def meets(self, wanted: Wanted) -> bool:
        """Whether Betti numbers and, for a body, the inside are as wanted."""
        return self.betti == wanted.betti and (self.inside >= INSIDE or not wanted.body)

    def to_json(self) -> dict:
        """Return the fields as a JSON-able dict."""
        return asdict(self)


def wanted_of(betti: Sequence[int]) -> Wanted:
    """Return what a solid of a surface with Betti numbers (b0, b1, b2) must have.

    A closed surface (b2 = b0, b1 even) is wanted itself. An open one (b2 = 0) has no inside: its solid is a
    thick shell around it, whose surface is (b0, 2·b1, b0). Raises InputError for what no surface in space
    has.
    """
    text = ",".join(map(str, betti))
    if len(betti) != 3 or min(betti) < 0 or betti[0] == 0:
        raise InputError(
            f"Betti numbers are b0,b1,b2 with b0 ≥ 1 and none negative, such as 1,2,1; got {text}"
        )
    b0, b1, b2 = (int(each) for each in betti)
    if b2 == 0:
        return Wanted((b0, 2 * b1, b0), body=False)
    if b2 != b0:
        raise InputError(
            f"no solid has the Betti numbers {text}: each of its components is one closed surface, so "
            f"b2 = b0 (or 0 for a thick shell around open surfaces); give {b0},{b1},{b0}"
        )
    if b1 % 2:
        raise InputError(
            f"no closed surface in space has b1 = {b1}: it is twice the number of handles; "
            f"give {b0},{b1 - 1},{b2} or {b0},{b1 + 1},{b2}"
        )
    return Wanted((b0, b1, b2), body=True)


def check_ladder(offsets: Iterable[float], cells: float = CELLS) -> tuple[float, ...]:
    """Return the offsets in rising order, each once. InputError for none, or as `check_offset` does."""
    rungs = tuple(sorted(set(offsets)))
    if not rungs:
        raise InputError("no offset to try; give at least one, as a fraction of the diagonal such as 0.008")
    for offset in rungs:
        check_offset(offset, cells)
    return rungs


def climb(
    soup: Mesh,
    offsets: Iterable[float] = OFFSETS,
    cells: float = CELLS,
    progress: Callable[[Rung], None] | None = None,
    enough: Callable[[Sequence[Rung]], bool] | None = None,
) -> tuple[Rung, ...]:
    """Return a Rung per offset (fractions of the soup's diagonal, cells per offset), the smallest first.

    progress is called with each rung, the coarsest first; enough with all so far, and no finer one is tried
    once it is true. Raises InputError as `check_ladder` and
    `outer_surface` do.
    """
    rungs = []
    for offset in reversed(check_ladder(offsets, cells)):
        surface = outer_surface(soup, offset * soup.diagonal, offset * soup.diagonal / cells)
        betti = surface.betti
        rungs.append(
            Rung(
                offset,
                betti,
                betti[1] // 2,
                surface.inside,
                surface.pockets,
                len(surface.faces),
                surface.grid,
            )
        )
        if progress is not None:
            progress(rungs[-1])
        if enough is not None and enough(rungs):
            break
    return tuple(reversed(rungs))


def plateau(rungs: Sequence[Rung]) -> Betti:
    """Return the Betti numbers that last longest, in log ε, on consecutive rungs with an inside (on any,
    where none has one); of equally long ones those at the smaller offsets."""
    enclosed = [rung.inside >= INSIDE for rung in rungs]
    edges = np.log([rung.offset for rung in rungs])
    best, longest, start = rungs[0].betti, -1.0, 0
    for i, rung in enumerate(rungs):
        if i and (rung.betti, enclosed[i]) != (rungs[i - 1].betti, enclosed[i - 1]):
            start = i
        if edges[i] - edges[start] > longest and (enclosed[i] or not any(enclosed)):
            best, longest = rung.betti, edges[i] - edges[start]
    return best


def shells(
    soup: Mesh, rungs: Sequence[Rung], wanted: Wanted, cells: float = CELLS
) -> Iterator[tuple[Rung, Mesh]]:
    """Yield the rungs that meet `wanted`, the smallest first, each with its outer surface, made again."""
    for rung in rungs:
        if rung.meets(wanted):
            epsilon = rung.offset * soup.diagonal
            yield rung, outer_surface(soup, epsilon, epsilon / cells).shell()
