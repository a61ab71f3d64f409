"""Notebook 10: the group wave (App. G, Tables S11, S12): staircases, quoted margins, pins, candidates.

Units as in `report.kit.staircase`.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from paper_artifact.catalogue import shape_row, shapes_of
from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS, load_json
from paper_artifact.report.kit.frames import paper
from paper_artifact.report.kit.published import published
from paper_artifact.scene.fetch import mesh_path
from paper_artifact.scene.sources import sources
from paper_artifact.staircase import (
    DENSITIES,
    SEEDS,
    bar_name,
    bars,
    beside_published,
    published_counts,
    signature_table,
    signatures,
    staircases,
)
from paper_artifact.study.dispositions import Disposition

PLAN, CERTIFICATES = RESULTS / "plan" / "group_wave.json", RESULTS / "certificates"
SEEDS_AT_2048 = range(40)  # where eight's count depends on the seed
BAR = ["shape", "samples", "bar"]
KINDS = {  # what the paper's quantities are of a bar
    "lifetime": "lifetime",
    "floor": "floor",
    "top_bar_over_floor": "margin",
    "tightest_in_over_floor": "margin",
    "largest_out_over_floor": "margin",
}


def external_shapes() -> list[str]:
    """Return the external meshes whose staircases are measured: the candidates that pass in Table S12, then
    Table 2's others."""
    table = published("S12")
    passed = table.loc[table["certificate"] == "pass", "shape"]
    groups = [shape for shape in shapes_of("loop group", "void group") if shape in sources()]
    return list(dict.fromkeys([*passed, *groups]))


def measure_external_meshes(progress: Callable[[str], None] | None = None) -> pd.DataFrame:
    """Return the staircases of the external shapes: 40 seeds at M = 2048, five at each other density; two
    minutes of CPU.

    Raises InputError for a mesh that cannot be had.
    """
    tables = []
    for shape in external_shapes():
        tables.append(staircases([shape], DENSITIES[:1], SEEDS_AT_2048))
        tables.append(staircases([shape], DENSITIES[1:], SEEDS, progress))
    return pd.concat(tables, ignore_index=True)


def plan(path: Path = PLAN) -> dict:
    """Return the group wave's plan: pool, rule, members, runs, statistic. Raises InputError when it cannot be
    read."""
    return _json(path)


def _json(path: Path) -> dict:
    try:
        return load_json(path)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path.name} ({type(error).__name__}); restore it with git") from error


def plan_table() -> pd.DataFrame:
    """Return the plan as rows (part, item) of text; its members one row per group."""
    rows = {}
    for part, items in plan().items():
        for item, value in items.items() if isinstance(items, dict) else ((None, items),):
            if isinstance(value, dict):
                value = "; ".join(f"{name} (M = {each['samples']})" for name, each in value.items())
            elif isinstance(value, list):
                value = ", ".join(map(str, value))
            rows[part, item or ""] = {"": value}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["part", "item"])


def certificates(folder: Path = CERTIFICATES) -> dict[str, dict]:
    """Return the stored certificates by key: the candidates of Table S12 that could be had, and the earlier
    members. Raises InputError when the candidates' file cannot be read."""
    found = {path.stem: _json(path) for path in sorted(folder.glob("*.json")) if path.stem != "candidates"}
    candidates = _json(folder / "candidates.json")
    return {key: each for key, each in candidates.items() if isinstance(each, dict)} | found


def certificate_text(rows: Sequence[Disposition]) -> str:
    """Return how many certificates of the candidates, made now, are the stored ones."""
    stored, now = certificates(), [row for row in rows if row.certificate is not None]
    same = [same_certificate(row.certificate.to_json(), stored.get(row.key, {})) for row in now]
    return f"{sum(same)} of {len(now)} certificates are those in results/certificates/"


def same_certificate(left: dict, right: dict) -> bool:
    """Return whether two certificates (as JSON) agree, volumes to a relative 1e-9 (a machine's last bits)."""
    volumes = [[part.get("volume") for part in each.get("components", ())] for each in (left, right)]
    bare = [json.loads(json.dumps(each)) for each in (left, right)]
    for each in bare:
        for part in each.get("components", ()):
            part["volume"] = None
    if bare[0] != bare[1] or [each is None for each in volumes[0]] != [each is None for each in volumes[1]]:
        return False
    numbers = [np.array([each for each in own if each is not None]) for own in volumes]
    return bool(np.allclose(*numbers, rtol=1e-9, atol=0))


def table_s11(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S11: significant (b0, b1, b2) per shape and density, ours over seeds 0–4 above the paper's
    seed 0; shapes without a row there stand below."""
    ours = signature_table(table[table["seed"].isin(SEEDS)])
    return beside_published(ours, signatures(published_counts("S11")))


def noted_bar(note: str, dimension: int) -> str:
    """Return the bar that a published note names: "loop 4" is that one, "second H2 bar" the second, anything
    else the longest."""
    number = re.search(r"loop (\d)", note)
    return bar_name(dimension, int(number[1]) if number else 2 if "second" in note else 1)


def quoted_bars() -> pd.DataFrame:
    """Return what App. G's text and Table S13 print of single bars: shape, samples, bar, kind (lifetime,
    floor or margin), value, printed. Where the table names no dimension it is the judged one, where no
    density the study's; what the text has already is not repeated."""
    rows = []
    for row in pd.concat([published("S11"), published("S13")]).to_dict("records"):
        if row["quantity"] not in KINDS:
            continue
        shape = shape_row(row["shape"])
        known = {} if shape is None else {"dimension": shape.judged, "samples": shape.samples}
        known |= {name: value for name, value in row.items() if not pd.isna(value)}
        bar = noted_bar(row["note"], int(known["dimension"]))
        keys = {"samples": int(known["samples"]), "bar": bar, "kind": KINDS[row["quantity"]]}
        rows.append({name: row[name] for name in ("shape", "value", "printed")} | keys)
    return pd.DataFrame(rows).drop_duplicates([*BAR, "kind"])


def quoted_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return `quoted_bars` of the staircase's shapes beside ours: of seed 0, the least, the median and the
    largest over all seeds measured, and whether the paper's lies between them."""
    ours = bars(table).melt([*BAR, "seed"], ["lifetime", "floor", "margin"], "kind", "ours")
    first = ours[ours["seed"] == 0].set_index([*BAR, "kind"])["ours"].rename("seed 0")
    ours = ours.groupby([*BAR, "kind"])["ours"].agg(least="min", median="median", largest="max", seeds="size")
    rows = []
    for row in quoted_bars().join(ours.join(first), on=[*BAR, "kind"], how="inner").to_dict("records"):
        digits = 2 if row["kind"] == "margin" else 4
        low, high = round(row["least"], digits), round(row["largest"], digits)
        bar = "" if row["kind"] == "floor" else f", {row['bar']}"
        numbers = {name: f"{row[name]:.{digits}f}" for name in ("seed 0", "least", "median", "largest")}
        rows.append(
            {"shape": row["shape"], "M": row["samples"], "what": row["kind"] + bar, "paper": row["printed"]}
            | numbers
            | {"seeds": row["seeds"], "paper in range": "yes" if low <= row["value"] <= high else "no"}
        )
    return pd.DataFrame(rows).set_index(["shape", "M", "what"])


def seed_dependence(table: pd.DataFrame) -> pd.DataFrame:
    """Return for each shape and density where seeds disagree: the counts with how many seeds give each, and
    the margins of the bar about which they disagree most."""
    signs, margins = signature_table(table).stack(), bars(table).set_index(["shape", "samples"])
    rows = {}
    for key, text in signs[signs.str.contains("×")].items():
        over = margins.loc[[key]].groupby("bar")["margin"]
        undecided = over.agg(lambda each: abs((each > 1).mean() - 0.5)).idxmin()
        values = over.get_group(undecided)
        rows[key] = {
            "seeds": len(values),
            "counts": text,
            "bar at the floor": undecided,
            "least margin": round(values.min(), 2),
            "median": round(values.median(), 2),
            "largest": round(values.max(), 2),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["shape", "M"])


def pins() -> pd.DataFrame:
    """Return the bars whose loss pins a tail of Table 2: shape, condition, bar, printed (the tail). C0's are
    those of which App. G's text says so; C2's those that it destroys ("beta_1 2->1"), where C0 has no pin."""
    tails, rows = paper("tail_bottleneck", "2"), []
    for row in published("S11").to_dict("records"):
        if "the pin" in row["note"]:
            rows.append((row["shape"], "C0", noted_bar(row["note"], int(row["dimension"]))))
    for row in tails[tails["condition"] == "C2"].to_dict("records"):
        if lost := re.fullmatch(r"beta_(\d) \d->(\d)", row["note"]):
            rows.append((row["shape"], "C2", bar_name(int(lost[1]), int(lost[2]) + 1)))
    found = pd.DataFrame(rows, columns=["shape", "condition", "bar"]).drop_duplicates("shape")
    return found.merge(tails[["shape", "condition", "printed"]], on=["shape", "condition"])


def pin_table(table: pd.DataFrame, samples: int = DENSITIES[-1]) -> pd.DataFrame:
    """Return per pinned shape of the staircase half the lifetime of the bar that goes unmatched, at the
    evaluation density, mean and range over seeds, beside the pinned tail."""
    found = bars(table[table["samples"] == samples])
    half = (found["lifetime"] / 2).groupby([found["shape"], found["bar"]]).agg(["mean", "min", "max"])
    half = half.map("{:.4f}".format).set_axis(["half its lifetime", "least", "largest"], axis=1)
    rows = pins().join(half, on=["shape", "bar"], how="inner").set_index("shape")
    names = {"printed": "paper's pinned tail", "condition": "of condition"}
    return rows[["bar", *half, "printed", "condition"]].rename(columns=names)


def table_s12(rows: Sequence[Disposition]) -> pd.DataFrame:
    """Return Table S12: per candidate the paper's certificate and decision, ours and whether they agree."""
    origin = published("S12").set_index("shape")["origin"]
    cells = [
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
    return pd.DataFrame(cells).set_index("candidate")


def detail_table(rows: Sequence[Disposition]) -> pd.DataFrame:
    """Return per candidate that could be had what the certificate counts: open edges as indexed and after the
    exact weld, non-manifold edges, pinched vertices, Euler characteristic, components, how a closed component
    is wound, and what its polygons read before the fan split (OBJ files with larger polygons only)."""
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
    """Return (edges with one polygon, edges with more than two, vertices − edges + polygons) of an OBJ file's
    own polygons, indexed by position; None when it is no OBJ file or all its faces are triangles."""
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
    pairs = ((a, b) for polygon in polygons for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True))
    edges = Counter((min(pair), max(pair)) for pair in pairs)
    used = {index for polygon in polygons for index in polygon}
    uses = np.array(list(edges.values()))
    return int((uses == 1).sum()), int((uses > 2).sum()), len(used) - len(edges) + len(polygons)


def _winding(volume: float | None) -> str:
    return "—" if volume is None else "outwards" if volume > 0 else "inwards"
