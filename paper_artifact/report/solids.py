"""Notebook 19: solids of the study's final soups: which offset makes a sound one; does the loss pay?

`results/measured/solids.csv` has one row per run and offset tried (`measure_solids`), `solid_peers.csv` what
the usual ways give on the same soups. Offsets are fractions of the soup's diagonal, Chamfer of the target's.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path

import pandas as pd

from paper_artifact.catalogue import SHAPES, study_config
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.export.solid import distances_to, solidify_soup
from paper_artifact.files import RESULTS, write_text
from paper_artifact.ingest.offsets import Rung, Wanted, wanted_of
from paper_artifact.pipeline import run
from paper_artifact.record.store import record_path
from paper_artifact.report.kit.records import RETRAINED
from paper_artifact.scene.find import find_mesh, surface
from paper_artifact.soup.state import load_soup

ARMS = ("C0", "C1", "C2")
CSV = RESULTS / "measured" / "solids.csv"
HOPELESS = 20  # handles beyond the wanted ones: finer offsets only have more
RUN = ["shape", "condition", "seed"]


def shapes_of_solids() -> tuple[str, ...]:
    """Return the shapes whose soups are made solids: those of the catalogue but the allocation study's."""
    return tuple(row.name for row in SHAPES if row.group != "allocation")


@cache
def wanted_for(shape: str) -> Wanted:
    """Return what the certificate of a shape's ground truth asks of a solid; of an open one a thick shell."""
    return wanted_of(certify_mesh(surface(shape), with_boundary=True).betti)


def soups_of(
    shapes: Iterable[str], arms: Iterable[str], seeds: Iterable[int], folder: Path | None
) -> list[tuple[str, str, int, Path]]:
    """Return (shape, condition, seed, path of its final soup in `folder`) of every run wanted; the path may
    be missing. folder None: results/retrained/soups."""
    seeds, arms = tuple(seeds), tuple(arms)
    place = RETRAINED / "soups" if folder is None else folder
    return [
        (shape, arm, seed, place / f"{record_path(study_config(shape, arm, seed)).stem}.npz")
        for seed in seeds
        for shape in shapes
        for arm in arms
    ]


def measure_solids(
    progress: Callable[[str], None] | None = None,
    soups: Path | None = None,
    arms: Iterable[str] = ARMS,
    seeds: Iterable[int] = (0,),
    path: Path = CSV,
) -> pd.DataFrame:
    """Return one row per run and offset tried: shape, condition, seed, offset, b0, b1, b2, genus, inside,
    triangles, and of the offset taken also chamfer, hausdorff95, moved, crossings and the run's CPU seconds.

    soups: the folder of final soups, runs that it lacks are left out; None: those of results/retrained, and
    what is not there is trained (half a minute a run). What `path` holds already is kept, and it is written
    after every run. From the coarsest offset on, none finer is tried once two have missed after a hit, or
    there are HOPELESS handles too many.
    """
    stored = pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=RUN)
    rows = [stored]
    known = set(stored[RUN].itertuples(index=False, name=None))
    for shape, arm, seed, file in soups_of(shapes_of_solids(), arms, seeds, soups):
        if (shape, arm, seed) not in known and (soups is None or file.is_file()):
            if not file.is_file():
                run(study_config(shape, arm, seed), mesh=find_mesh(shape), results=RETRAINED)
            rows.append(_rows(shape, file).assign(shape=shape, condition=arm, seed=seed))
            write_text(path, _together(rows).to_csv(index=False, float_format="%.6g", lineterminator="\n"))
        if progress is not None:
            progress(f"{shape} {arm} {seed}")
    return _together(rows)


def _together(rows: list[pd.DataFrame]) -> pd.DataFrame:
    table = pd.concat([each for each in rows if len(each)], ignore_index=True)
    return table[[*RUN, *(column for column in table.columns if column not in RUN)]]


def _rows(shape: str, file: Path) -> pd.DataFrame:
    wanted, start = wanted_for(shape), time.process_time()
    # Of an open target the Betti numbers as they are; `wanted_of` makes the shell's of them again.
    betti = certify_mesh(surface(shape), with_boundary=True).betti
    solid = solidify_soup(load_soup(file), betti, enough=lambda rungs: _enough(rungs, wanted))
    seconds = time.process_time() - start
    rows = []
    for rung in solid.rungs:
        names = dict(zip(("b0", "b1", "b2"), rung.betti, strict=True))
        row = {"offset": rung.offset, **names, "genus": rung.genus, "inside": rung.inside}
        row |= {"triangles": rung.triangles, "meets": rung.meets(wanted), "taken": rung is solid.rung}
        if rung is solid.rung and solid.mesh is not None and solid.moved is not None:
            found = distances_to(solid.mesh, surface(shape))
            row |= {name: found[name] for name in ("chamfer", "hausdorff95")}
            row |= {"moved": solid.moved.mean(), "crossings": solid.crossings, "seconds": seconds}
        rows.append(row)
    return pd.DataFrame(rows)


def _enough(rungs: Sequence[Rung], wanted: Wanted) -> bool:
    hits = [rung.meets(wanted) for rung in rungs]
    many = rungs[-1].genus > wanted.betti[1] // 2 + HOPELESS
    return many or (any(hits) and not any(hits[-2:]) and len(hits) > 1)
