"""The group wave (App. G, Tables S11 and S12): staircases, quoted margins, pins and the disposition of the candidates.

Lifetimes and floors are radii divided by the mesh's bounding-box diagonal; a margin is lifetime / floor. Bars are known by
dimension and rank, the longest first.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from paper_artifact.report.published import published
from paper_artifact.report.staircase import counts, signature_table, staircase
from paper_artifact.scene.fetch import mesh_path
from paper_artifact.scene.find import surface
from paper_artifact.scene.sources import sources
from paper_artifact.study.dispositions import Disposition, dispositions

IN_TABLE = ("rocker-arm", "eight", "armadillo", "horse")  # the rows of Table S11
SHAPES = (*IN_TABLE, "bob", "fandisk", "spot", "cheburashka", "eight-dense")
DENSITIES = (2048, 4096, 8192, 20_000)
SEEDS = range(5)
SEEDS_AT_2048 = range(40)  # where eight's count depends on the seed
NAMES = ("component", "loop", "void")
# The bar that a pinned tail of Table 2 leaves unmatched: (condition, dimension, rank).
PINS = {
    "eight": ("C0", 1, 3),
    "armadillo": ("C0", 2, 1),
    "horse": ("C0", 2, 1),
    "bob": ("C2", 1, 2),
    "spot": ("C2", 2, 1),
    "fandisk": ("C2", 2, 1),
}


def measure_all(
    shapes: Sequence[str] = SHAPES, progress: Callable[[str], None] | None = None
) -> pd.DataFrame:
    """Return the staircases (see `staircase.staircase`) of the shapes: 40 seeds at M = 2048, five at each other density; about
    two minutes of CPU. progress is called with each shape done. Raises InputError for a mesh that cannot be had."""
    tables = []
    for shape in shapes:
        mesh = surface(shape)
        tables += [staircase(mesh, DENSITIES[:1], SEEDS_AT_2048), staircase(mesh, DENSITIES[1:], SEEDS)]
        if progress is not None:
            progress(shape)
    return pd.concat(tables, ignore_index=True)


def counts_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S11: significant (b0, b1, b2) per shape and density, ours over seeds 0–4 above the paper's seed 0; shapes
    without a row there stand below."""
    ours = signature_table(table[table["seed"].isin(SEEDS)])
    paper = published("S11")
    paper = paper[paper["quantity"] == "significant_count"]
    rows = {}
    for shape in ours.index:
        rows[shape, "ours"] = {f"M = {samples}": ours.loc[shape, samples] for samples in ours.columns}
        printed = paper[paper["shape"] == shape].sort_values("dimension").groupby("samples")["value"]
        if len(printed):
            signs = printed.agg(lambda values: "({:.0f},{:.0f},{:.0f})".format(*values))
            rows[shape, "paper"] = {f"M = {samples}": signs[samples] for samples in ours.columns}
    return pd.DataFrame.from_dict(rows, orient="index")


def rank_of(note: str) -> int:
    """Return the rank of the bar that a published note names: "loop 4" is 4, "second H2 bar" 2, anything else 1."""
    number = re.search(r"loop (\d)", note)
    return int(number[1]) if number else 2 if "second" in note else 1


def quoted_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return every lifetime, floor and margin that App. G's text and Table S13 print of these shapes: the paper's, ours of seed
    0, the least, the median and the largest over all seeds measured, and whether the paper's lies between them."""
    paper = pd.concat([published("S11"), published("S13").assign(samples=np.nan)])
    kinds = {"lifetime": "lifetime", "floor": "floor", "top_bar_over_floor": "margin"}
    kinds |= {"tightest_in_over_floor": "margin", "largest_out_over_floor": "margin"}
    rows = []
    for row in paper[paper["quantity"].isin(kinds) & paper["shape"].isin(table["shape"])].itertuples():
        if row.source.startswith("Table S13") and (row.shape == "eight" or row.shape in IN_TABLE[2:]):
            continue  # App. G's text has the same number
        dimension = (
            int(row.dimension) if row.dimension == row.dimension else 1 if row.shape == "rocker-arm" else 2
        )
        samples, rank, kind = (
            (2048 if np.isnan(row.samples) else int(row.samples)),
            rank_of(row.note),
            kinds[row.quantity],
        )
        own = table[(table["shape"] == row.shape) & (table["samples"] == samples)]
        length = own[f"h{dimension}_{rank}"]
        values = {"lifetime": length, "floor": own["floor"], "margin": length / own["floor"]}[kind]
        digits = 2 if kind == "margin" else 4
        low, high = round(values.min(), digits), round(values.max(), digits)
        ours = {
            "seed 0": values[own["seed"] == 0].iloc[0],
            "least": low,
            "median": values.median(),
            "largest": high,
        }
        rows.append(
            {
                "shape": row.shape,
                "M": samples,
                "what": kind if kind == "floor" else f"{kind}, {NAMES[dimension]} {rank}",
            }
            | {name: f"{value:.{digits}f}" for name, value in ({"paper": row.value} | ours).items()}
            | {"seeds": len(own), "paper in range": "yes" if low <= row.value <= high else "no"}
        )
    return pd.DataFrame(rows).set_index(["shape", "M", "what"])


def seed_dependence(table: pd.DataFrame) -> pd.DataFrame:
    """Return for each shape and density where seeds disagree: the counts with how many seeds give each, and the margins of the
    bar about which they disagree most."""
    rows = []
    for (shape, samples), own in table.groupby(["shape", "samples"], sort=False):
        signs = Counter(
            f"({1 + a},{b},{c})" for a, b, c in zip(*(counts(own, dimension) for dimension in range(3)))
        )
        if len(signs) == 1:
            continue
        margins = own[[f"h{d}_{rank}" for d in range(3) for rank in range(1, 5)]].div(own["floor"], axis=0)
        column = (margins > 1).mean().sub(0.5).abs().idxmin()
        values = margins[column]
        rows.append(
            {
                "shape": shape,
                "M": samples,
                "seeds": len(own),
                "counts": ", ".join(f"{sign} {number}×" for sign, number in signs.most_common()),
                "bar at the floor": f"{NAMES[int(column[1])]} {column[3]}",
                "least margin": round(values.min(), 2),
                "median": round(values.median(), 2),
                "largest": round(values.max(), 2),
            }
        )
    return pd.DataFrame(rows).set_index(["shape", "M"])


def pin_table(table: pd.DataFrame, samples: int = 20_000) -> pd.DataFrame:
    """Return per pinned shape half the lifetime of the bar that goes unmatched, at the evaluation density, mean and range over
    seeds, beside the pinned tail of Table 2."""
    paper = published("2").set_index(["shape", "condition"])["value"]
    rows = []
    for shape, (condition, dimension, rank) in PINS.items():
        own = table[(table["shape"] == shape) & (table["samples"] == samples)]
        half = own[f"h{dimension}_{rank}"] / 2
        rows.append(
            {
                "shape": shape,
                "bar": f"{NAMES[dimension]} {rank}",
                "half its lifetime": f"{half.mean():.4f}",
                "least": f"{half.min():.4f}",
                "largest": f"{half.max():.4f}",
                "paper's pinned tail": f"{paper[shape, condition]:.4f}",
                "of condition": condition,
            }
        )
    return pd.DataFrame(rows).set_index("shape")


def disposition_table(rows: Sequence[Disposition] | None = None) -> pd.DataFrame:
    """Return Table S12: per candidate the paper's certificate and decision, ours (certified now) and whether they agree."""
    rows = dispositions() if rows is None else rows
    origin = published("S12").set_index("shape")["origin"]
    return pd.DataFrame(
        [
            {
                "candidate": row.key,
                "paper's origin": origin[row.key],
                "paper": row.published,
                "ours": row.measured,
                "agrees": {True: "yes", False: "NO", None: "—"}[row.agrees],
                "paper's decision": row.decision,
                "β over Z/2": str(row.certificate.betti) if row.certificate else "—",
                "our copy": sources()[row.key].repository or "none",
            }
            for row in rows
        ]
    ).set_index("candidate")


def detail_table(rows: Sequence[Disposition]) -> pd.DataFrame:
    """Return per candidate that could be had what the certificate counts: open edges as indexed and after the exact weld,
    non-manifold edges, pinched vertices, Euler characteristic, components, how a closed component is wound, and what its polygons
    read before the fan split (OBJ files with larger polygons only)."""
    lines = []
    for row in (each for each in rows if each.certificate is not None):
        found, polygons = row.certificate, polygon_counts(mesh_path(row.key))
        lines.append(
            {
                "candidate": row.key,
                "open edges as indexed": found.open_edges_as_indexed,
                "after the weld": found.open_edges,
                "non-manifold edges": found.nonmanifold_edges,
                "pinched vertices": found.pinched_vertices,
                "χ": found.euler_as_given,
                "components": len(found.components),
                "wound": _winding(found.components[0].volume),
                "as polygons: open, non-manifold, χ": ""
                if polygons is None
                else "{}, {}, {}".format(*polygons),
            }
        )
    return pd.DataFrame(lines).set_index("candidate")


def polygon_counts(path: Path | str) -> tuple[int, int, int] | None:
    """Return (edges with one polygon, edges with more than two, vertices − edges + polygons) of an OBJ file's own polygons,
    indexed by position; None when it is no OBJ file or all its faces are triangles."""
    if Path(path).suffix != ".obj":
        return None
    polygons, points, number = [], {}, []
    for line in Path(path).read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            number.append(
                points.setdefault(tuple(map(float, words[1:4])), len(points))
            )  # equal points are one vertex
        elif words[:1] == ["f"]:
            indices = [int(word.split("/")[0]) for word in words[1:]]
            polygons.append([number[index - 1 if index > 0 else index] for index in indices])
    if all(len(polygon) == 3 for polygon in polygons):
        return None
    pairs = ((a, b) for polygon in polygons for a, b in zip(polygon, [*polygon[1:], polygon[0]]))
    edges = Counter((min(pair), max(pair)) for pair in pairs)
    used = {index for polygon in polygons for index in polygon}
    uses = np.array(list(edges.values()))
    return int((uses == 1).sum()), int((uses > 2).sum()), len(used) - len(edges) + len(polygons)


def _winding(volume: float | None) -> str:
    return "—" if volume is None else "outwards" if volume > 0 else "inwards"
