"""Notebook 19: solids of the study's final soups: which offset makes a sound one; does the loss pay?

`results/measured/solids.csv` has one row per run and offset tried (`measure_solids`), `solid_peers.csv` what
the usual ways give on the same soups. Offsets are fractions of the soup's diagonal, Chamfer of the target's.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import binomtest

from paper_artifact.catalogue import LOSS, SHAPES, colour_of, study_config
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.export.solid import distances_to, solidify_soup
from paper_artifact.files import RESULTS, write_text
from paper_artifact.ingest.solidify import INSIDE, OFFSETS, Rung, Wanted, wanted_of
from paper_artifact.pipeline import run
from paper_artifact.record.store import record_path
from paper_artifact.report.kit.figures import new_figure
from paper_artifact.report.kit.records import RETRAINED
from paper_artifact.scene.find import find_mesh, surface
from paper_artifact.soup.state import load_soup

ARMS = ("C0", "C1", "C2", "T1", "T2")
CSV = RESULTS / "measured" / "solids.csv"
HOPELESS = 20  # handles beyond the wanted ones: finer offsets only have more
FIXED = 0.008  # the offset of a user who wants nothing, the default of `ingest`
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
    after every run. From the coarsest offset on, none finer is tried after the first miss that follows
    a hit, or once there are HOPELESS handles too many.
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
    return many or (any(hits) and not hits[-1])


def covered_text(solids: pd.DataFrame) -> str:
    """Return which runs were measured, and which of seed 0 were not."""
    known = set(solids[RUN].itertuples(index=False, name=None))
    missing = [
        f"{shape} {arm}" for shape in shapes_of_solids() for arm in ARMS if (shape, arm, 0) not in known
    ]
    text = f"{len(known)} runs measured"
    return text + (f"; NOT MEASURED, seed 0: {', '.join(missing)}" if missing else ", seed 0 of every shape")


def cost_table(solids: pd.DataFrame) -> pd.DataFrame:
    """Return per arm over the runs with a solid: CPU seconds (median, largest), triangles, share of the way
    moved back (mean of a run's vertices, least of the runs), runs in which triangles may meet."""
    taken = solids[solids["taken"].astype(bool)]
    rows = {
        arm: {
            "solids": len(own),
            "CPU s, median": f"{own['seconds'].median():.1f}",
            "CPU s, most": f"{own['seconds'].max():.1f}",
            "triangles, median": int(own["triangles"].median()),
            "moved back, least mean": f"{own['moved'].min():.3f}",
            "runs with meeting triangles": int((own["crossings"] > 0).sum()),
        }
        for arm, own in taken.groupby("condition", sort=False)
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("arm")


def smallest_offsets(solids: pd.DataFrame) -> pd.DataFrame:
    """Return the smallest sound offset per run, rows (shape, seed), columns conditions: infinite where none
    of those tried is, NaN where the run was not measured."""
    taken = solids["offset"].where(solids["taken"].astype(bool), np.inf)
    table = solids.assign(taken=taken).groupby(RUN, sort=False)["taken"].min()
    return table.unstack("condition")


def smallest_table(solids: pd.DataFrame) -> pd.DataFrame:
    """Return per shape what is wanted, and per arm the smallest sound offset (of several seeds all, "none"
    where no offset is) and the Chamfer of that solid (percent of D, mean)."""
    rows = {}
    for shape, own in solids.groupby("shape", sort=False):
        wanted = wanted_for(str(shape))
        row = {"wanted β": str(wanted.betti), "solid": "body" if wanted.body else "thick shell"}
        offsets = smallest_offsets(own)
        for arm in offsets.columns:
            values = offsets[arm].dropna()
            row[f"ε {arm}"] = ", ".join("none" if np.isinf(value) else f"{value:g}" for value in values)
        for arm, chamfer in own.groupby("condition", sort=False)["chamfer"].mean().items():
            row[f"Chamfer % {arm}"] = "" if pd.isna(chamfer) else f"{100 * chamfer:.2f}"
        rows[shape] = row
    return pd.DataFrame.from_dict(rows, orient="index").fillna("").rename_axis("shape")


def genus_table(solids: pd.DataFrame, seed: int = 0) -> pd.DataFrame:
    """Return the genus by offset, a row per shape and condition of one seed: the taken one in brackets;
    "open" where a body has no inside, "in n" where there are n bodies; empty where none was tried."""
    own = solids[solids["seed"] == seed]
    cells = own.apply(_genus_cell, axis=1)
    table = own.assign(cell=cells).pivot(index=["shape", "condition"], columns="offset", values="cell")
    order = list(dict.fromkeys(own[["shape", "condition"]].itertuples(index=False, name=None)))
    return table.reindex(pd.MultiIndex.from_tuples(order, names=["shape", "condition"])).fillna("")


def _genus_cell(row: pd.Series) -> str:
    text = str(row["genus"])
    text += f" in {row['b0']}" if row["b0"] != wanted_for(row["shape"]).betti[0] else ""
    text += " open" if row["inside"] < INSIDE and wanted_for(row["shape"]).body else ""
    return f"[{text}]" if row["taken"] else text


def pays_table(solids: pd.DataFrame) -> pd.DataFrame:
    """Return, for C1 against each other arm, in how many runs (same shape and seed) its smallest sound offset
    is smaller, equal, larger, and the two-sided p of the sign test without the ties; the same by Chamfer of
    the solids, where both have one."""
    offsets = smallest_offsets(solids)
    chamfers = solids[solids["taken"].astype(bool)].set_index(RUN)["chamfer"].unstack("condition")
    rows = {}
    for what, table in (("smallest sound ε", offsets), ("Chamfer of the solid", chamfers)):
        for arm in table.columns.drop(LOSS):
            both = table[[LOSS, arm]].dropna()
            less, more = int((both[LOSS] < both[arm]).sum()), int((both[LOSS] > both[arm]).sum())
            p = binomtest(less, less + more).pvalue if less + more else 1.0
            rows[f"{what}: {LOSS} against {arm}"] = {
                "smaller": less,
                "equal": len(both) - less - more,
                "larger": more,
                "sign test p": f"{p:.3f}",
            }
    return pd.DataFrame.from_dict(rows, orient="index")


def ways_table(solids: pd.DataFrame, peers: pd.DataFrame) -> pd.DataFrame:
    """Return per way and arm, over the runs that all ways have: how many solids have the wanted topology,
    the right genus, a certificate that passes, and the median Chamfer (percent of D) of all and of right
    ones. The genus is that of all pieces together.

    The offset is chosen by what is wanted; the same at one fixed offset, .008, and the other ways know
    nothing of it.
    """
    offset = solids.assign(passes=True)
    chosen = offset.sort_values("taken").groupby(RUN, as_index=False).last()
    chosen = chosen.assign(way="offset chosen", meets=chosen["taken"], passes=chosen["taken"])
    chosen["genus"] = chosen["genus"].where(chosen["taken"].astype(bool))
    # Where it was not tried, coarser ones had failed.
    fixed = offset[offset["offset"] == FIXED].set_index(RUN)[["meets", "genus"]]
    fixed = fixed.reindex(pd.MultiIndex.from_frame(chosen[RUN])).reset_index()
    fixed = fixed.assign(way=f"offset {FIXED:g}", passes=True, meets=fixed["meets"].eq(True))
    both = pd.concat([chosen, fixed, peers], ignore_index=True)
    ways = both["way"].nunique()
    both = both[both.groupby(RUN)["way"].transform("nunique") == ways]
    wanted = both["shape"].map(lambda shape: wanted_for(shape).betti[1] // 2)
    both = both.assign(genus_right=both["genus"] == wanted)
    rows = {}
    place = both["way"].map({way: i for i, way in enumerate(both["way"].unique())})
    for (_, arm), own in both.groupby([place, "condition"]):
        right = own["meets"].astype(bool)
        rows[own["way"].iloc[0], arm] = {
            "runs": len(own),
            "wanted topology": int(right.sum()),
            "right genus": int(own["genus_right"].sum()),
            "closed manifold": int(own["passes"].astype(bool).sum()),
            "Chamfer %": _percent(own["chamfer"]),
            "Chamfer % where wanted": _percent(own["chamfer"][right]),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["way", "arm"])


def _percent(values: pd.Series) -> str:
    return "" if values.dropna().empty else f"{100 * values.median():.2f}"


def offsets_figure(solids: pd.DataFrame) -> Figure:
    """Return the smallest sound offset of every run, a line per shape, a mark per arm; hollow at the right
    edge: no offset tried is."""
    figure, axes = new_figure(1, 1, 7.0, 4.2)
    axis, offsets = axes[0][0], smallest_offsets(solids)
    shapes = list(dict.fromkeys(offsets.index.get_level_values("shape")))
    edge = 1.3 * solids["offset"].max()
    for shift, arm in zip(np.linspace(-0.3, 0.3, offsets.columns.size), offsets.columns, strict=True):
        values = offsets[arm].dropna()
        places = [shapes.index(shape) + shift for shape in values.index.get_level_values("shape")]
        none = np.isinf(values.to_numpy())
        faces = ["none" if each else colour_of(arm) for each in none]
        axis.scatter(np.where(none, edge, values), places, c=faces, edgecolor=colour_of(arm), s=30)
        axis.scatter([], [], color=colour_of(arm), label=arm)
    axis.set_yticks(range(len(shapes)), shapes, fontsize=8)
    axis.invert_yaxis()
    axis.set(xscale="log", xlabel="smallest sound ε / D (hollow: none of those tried)")
    axis.set_xticks(OFFSETS, [f"{offset:g}" for offset in OFFSETS], fontsize=7)
    axis.minorticks_off()
    axis.grid(alpha=0.25)
    axis.legend(fontsize=8)
    return figure
