"""Solids of the study's final soups: which offset gives a sound one, and how far it lies from the truth.

One row per run and offset tried: topology, triangles, whether it meets what is wanted; of the offset taken
also Chamfer, Hausdorff95 (over the ground truth's diagonal), the share of the way moved back, triangles that
meet others and the run's CPU seconds. Offsets are fractions of the soup's diagonal. Notebook 19 reads it.

The script goes on from the rows that are stored and writes after every run. --soups: a folder of final soups,
named like records; runs that it lacks are left out. Without it, missing soups are trained into
results/retrained (half a minute each; 75 runs). A soup takes 5 to 40 seconds of CPU.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from common import Clock, kept, options, write

import pandas as pd

from paper_artifact.catalogue import SHAPES, study_config
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.export.models import soup_triangles
from paper_artifact.export.solid import distances_to, opaque_mesh, solidify_soup
from paper_artifact.ingest.solidify import CELLS, OFFSETS, Rung, Wanted, outer_surface, wanted_of
from paper_artifact.pipeline import run
from paper_artifact.record.store import record_path
from paper_artifact.results import RETRAINED
from paper_artifact.scene.shapes import find_mesh, surface
from paper_artifact.soup.state import load_soup

ARMS, SEED = ("C0", "C1", "C2", "T1", "T2"), 0
NAMES = tuple(row.name for row in SHAPES if row.group != "allocation")
RUN = ["shape", "condition", "seed"]
HOPELESS = 20  # handles beyond the wanted ones: finer offsets only have more


@cache
def betti_of(shape: str) -> tuple[int, int, int]:
    """Return the certified Betti numbers of a shape's ground truth; an open one is certified as open."""
    return certify_mesh(surface(shape), with_boundary=True).betti


def soups_of(folder: Path | None) -> Iterator[tuple[str, str, Path]]:
    """Yield (shape, condition, path of its final soup in `folder`); the path may be missing."""
    place = RETRAINED / "soups" if folder is None else folder
    for shape in NAMES:
        for arm in ARMS:
            yield shape, arm, place / f"{record_path(study_config(shape, arm, SEED)).stem}.npz"


def rows_of(shape: str, file: Path) -> pd.DataFrame:
    """Return one row per offset tried on a soup."""
    soup, wanted = load_soup(file), wanted_of(betti_of(shape))
    opaque, rungs = opaque_mesh(soup_triangles(soup), shape), list[Rung]()
    for offset in OFFSETS[::-1]:
        rungs.append(outer_surface(opaque, offset, CELLS)[0])
        if enough(rungs, wanted):
            break
    with Clock() as clock:
        solid = solidify_soup(soup, betti_of(shape), [rung.offset for rung in rungs])
    rows = []
    for rung in rungs[::-1]:
        names = dict(zip(("b0", "b1", "b2"), rung.betti, strict=True))
        row = {"offset": rung.offset, **names, "genus": rung.genus, "inside": rung.inside}
        row |= {"triangles": rung.triangles, "meets": rung.meets(wanted), "taken": rung == solid.rung}
        if rung == solid.rung and solid.mesh is not None and solid.moved is not None:
            found = distances_to(solid.mesh, surface(shape))
            row |= {name: found[name] for name in ("chamfer", "hausdorff95")}
            row |= {"moved": solid.moved.mean(), "crossings": solid.crossings, "seconds": clock.cpu}
        rows.append(row)
    return pd.DataFrame(rows)


def enough(rungs: Sequence[Rung], wanted: Wanted) -> bool:
    """Return whether finer offsets are not worth trying: the first miss after a hit, or HOPELESS."""
    hits = [rung.meets(wanted) for rung in rungs]
    many = rungs[-1].genus > wanted.betti[1] // 2 + HOPELESS
    return many or (any(hits) and not hits[-1])


def main() -> None:
    """Measure what is missing in the CSV."""
    given = options(__doc__, soups={"type": Path, "help": "folder of final soups"})
    path = given.out / "solids.csv"
    table = kept(path, RUN)
    known = set(table[RUN].itertuples(index=False, name=None))
    if given.soups is not None and not any(file.is_file() for _, _, file in soups_of(given.soups)):
        raise SystemExit(f"{given.soups} has none of the final soups; name another folder")
    for shape, arm, file in soups_of(given.soups):
        if (shape, arm, SEED) in known or not (given.soups is None or file.is_file()):
            continue
        if not file.is_file():
            run(study_config(shape, arm, SEED), mesh=find_mesh(shape), results=RETRAINED)
        own = rows_of(shape, file).assign(shape=shape, condition=arm, seed=SEED)
        table = pd.concat([table, own], ignore_index=True) if len(table) else own
        write(table[[*RUN, *table.columns.difference(RUN, sort=False)]], path)


if __name__ == "__main__":
    main()
