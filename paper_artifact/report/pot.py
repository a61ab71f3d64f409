"""Notebook 11: the procedural hot pot for the paper's pot, and the teapot (Tables S4, S5, Fig. S7).

Units as in `report.kit.staircase`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from trimesh.intersections import slice_faces_plane

from paper_artifact.audit.measure import Audit
from paper_artifact.catalogue import shape_row
from paper_artifact.certify.certificate import Certificate
from paper_artifact.evaluate.diagram import lifetimes
from paper_artifact.evaluate.staircase import measure
from paper_artifact.export.flat import CUT, render_flat
from paper_artifact.ingest import hot_pot
from paper_artifact.ingest.hot_pot import inventory, shells_as_indexed
from paper_artifact.ingest.solidify import Solid
from paper_artifact.mesh import Mesh
from paper_artifact.report.kit.figures import image_rows
from paper_artifact.report.kit.frames import arms
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected, collect
from paper_artifact.report.kit.text import counts_text, span
from paper_artifact.staircase import DENSITIES, SEEDS, bars, published_counts, signature_table, signatures
from paper_artifact.study.studies import study_configs

POT = shape_row("pot")
VIEW = (0.55, -1.0, 0.6)  # of Fig. S7, towards the camera


def collect_pot(profile: str = "recorded", **folders) -> Collected:
    """Return the records of the study's runs of the pot (see `kit.records.collect`)."""
    runs = study_configs("table2", shapes=["pot"])
    return collect([(each.shape, each.condition, each.seed) for each in runs], profile, **folders)


def bar_values(table: pd.DataFrame, samples: int, bar: str) -> pd.DataFrame:
    """Return the rows of `kit.staircase.bars` of one bar at one density, one per seed."""
    found = bars(table)
    return found[(found["samples"] == samples) & (found["bar"] == bar)]


def table_s4(pot: hot_pot.RawPot, solid: Solid, table: pd.DataFrame, collected: Collected) -> pd.DataFrame:
    """Return Table S4's numbers: of the paper's pot, and of the stand-in (measured now, the outcomes from the
    records)."""
    raw, shell = solid.raw, solid.certificate
    void = bar_values(table, POT.samples, "void 1")["margin"]
    outcomes = arms(collected).set_index("condition")
    ours = {
        "raw_vertices": len(pot.vertices),
        "open_shells": shells_as_indexed(pot),
        "boundary_edges_after_exact_weld": raw.open_edges,
        "non_manifold_junction_edges": raw.nonmanifold_edges,
        "dropped_enclosed_pocket_shells": solid.pockets,
        "components": len(shell.components),
        "genus": shell.genus,
        "betti": shell.betti,
        "certified_vertices": shell.vertices,
        "margin_low": f"{void.min():.2f}",
        "margin_high": f"{void.max():.2f}",
        "ratio_C0_over_C1": _outcome(outcomes, "C1", "{ratio:.1f}"),
        "chamfer_ratio_to_C0": _outcome(outcomes, "C2", "{chamfer ratio:.2f}, voids {counts}"),
    }
    rows = {}
    for quantity, printed in published("S4").groupby("quantity", sort=False):
        values = printed["printed"]
        rows[quantity.replace("_", " ")] = {
            "paper's pot": values.iloc[0] if len(values) == 1 else f"({', '.join(values)})",
            "paper's note": printed["note"].iloc[0],
            "stand-in": str(ours[quantity]),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("what")


def _outcome(outcomes: pd.DataFrame, condition: str, form: str) -> str:
    """The text of an arm with how many seeds it and C0 rest on; what is missing where there is no run."""
    both = outcomes.loc[["C0", condition]]
    seeds = min(map(len, both["seeds"]))
    if seeds == 0:
        return "no run recorded"
    arm = outcomes.loc[condition]
    text = form.format(**arm.to_dict() | {"counts": counts_text(arm["counts"])})
    return text + ("" if seeds == arm["wanted"] else f" ({seeds} of {arm['wanted']} seeds)")


def inventory_table(pot: hot_pot.RawPot, solid: Solid) -> pd.DataFrame:
    """Return the stand-in's challenge inventory: each difficulty and its measured consequence."""
    rows = [(what, consequence.split(", sha256")[0]) for what, consequence in inventory(pot, solid)]
    return pd.DataFrame(rows, columns=["challenge", "measured consequence"]).set_index("challenge")


def table_s5(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S5: significant (b0, b1, b2) per density, the paper's pot and the stand-in over the seeds,
    with the ranges of the floor and of the margins of the longest void, the second longest void and the
    longest loop."""
    columns = {
        "paper's pot": signatures(published_counts("S5")).loc["pot"],
        "stand-in": signature_table(table).iloc[0],
    }
    columns["floor"] = table.groupby("samples")["floor"].agg(span, 4)
    margins = bars(table).groupby(["bar", "samples"])["margin"].agg(span, 2)
    for name, bar in (("void", "void 1"), ("second void", "void 2"), ("longest loop", "loop 1")):
        columns[f"{name} / floor"] = margins[bar]
    return pd.DataFrame(columns).rename_axis("M")


def void_table(mesh: Mesh, samples: int = POT.samples, seeds: Iterable[int] = SEEDS) -> pd.DataFrame:
    """Return birth, death, lifetime of the longest void per seed, its margin, and how far birth and death are
    from their means: how stable the bar is to re-sampling (the paper: about 1e-5)."""
    rows = {}
    for seed in seeds:
        diagram, floor = measure(mesh, samples, seed)
        birth, death = diagram[2][np.argmax(lifetimes(diagram[2]))]
        rows[seed] = {
            "birth": birth,
            "death": death,
            "lifetime": death - birth,
            "margin": (death - birth) / floor,
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.loc["standard deviation"] = table.std(ddof=1)
    return table.rename_axis("seed").round({"margin": 2}).round(5)


def decision_text(audit: Audit) -> str:
    """Return the audit's decision as lines: class, density, dimensions of the loss, the rule's steps, and
    whether the study's row of the pot is the same."""
    decision = audit.decision
    same = (decision.samples, decision.dimensions) == (POT.samples, POT.dimensions)
    found = audit.bundle.to_json()["bars"] if audit.bundle else []
    head = f"class H{decision.dimension}, M = {decision.samples}, the loss acts on {decision.dimensions}"
    counted = f"bars in the bundle: {sum(map(len, found))}; the study's protocol is this decision: {same}"
    return "\n".join([head, *(f"  {reason}" for reason in (*decision.reasons, *decision.warnings)), counted])


def flue_table(solid: Solid, table: pd.DataFrame) -> pd.DataFrame:
    """Return the flue's geometry as built beside the void that is measured: the radius at which the mouth
    closes and birth, the radius that fits into the chamber and death (mean over seeds 0–4), and half the
    lifetime at the evaluation density."""
    apothem = np.cos(np.pi / hot_pot.SIDES)  # inscribed / circumscribed radius of the flue's cross-section
    void = void_table(solid.shell).iloc[:-1].mean()
    half = bar_values(table, DENSITIES[-1], "void 1")["lifetime"] / 2
    tail = published("2").set_index(["shape", "condition"])["printed"]["pot", "C2"]
    rows = {}
    for name, radius, end in (
        ("mouth", hot_pot.MOUTH_RADIUS, "birth"),
        ("chamber", hot_pot.FLUE_RADIUS, "death"),
    ):
        built = (radius * apothem - solid.offset) / solid.shell.diagonal
        rows[name] = {"built, radius / D": f"{built:.4f}", "bar": f"{end} {void[end]:.4f}"}
    rows["half the lifetime at 20,000"] = {"bar": span(half, 4), "paper": f"{tail} (C2's tail)"}
    return pd.DataFrame.from_dict(rows, orient="index").fillna("")


def cut_open(mesh: Mesh, axis: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V,3), world units, and faces (F,3) of the mesh's half beyond its middle along the
    axis, cut exactly."""
    normal = np.eye(3)[axis]
    vertices, faces, _ = slice_faces_plane(mesh.vertices, mesh.faces, normal, mesh.centre)
    return vertices, faces


def pot_figure(solid: Solid, size: int = 300) -> Figure:
    """Return Fig. S7 of the stand-in: the certified shell, from the side and from above, and cut open through
    the flue (red: the wall where it is cut)."""
    shell, frame = solid.shell, solid.shell.vertices
    half = cut_open(shell)
    images = [
        render_flat(shell.vertices, shell.faces, size, direction=VIEW, frame=frame),
        render_flat(shell.vertices, shell.faces, size, direction=(0.2, -0.5, 1.0), frame=frame),
        render_flat(*half, size, direction=(0.15, -1.0, 0.25), frame=frame, inside=CUT),
    ]
    return image_rows([("", images)])


def ingest_table(solid: Solid) -> pd.DataFrame:
    """Return the certificate of a raw mesh beside that of the shell that the ingest makes of it."""
    shell = _certificate_column(solid.certificate) | {"enclosed pockets filled": str(solid.pockets)}
    return pd.DataFrame({"raw": _certificate_column(solid.raw), "after ingest": shell}).fillna("")


def _certificate_column(found: Certificate) -> dict[str, str]:
    return {
        "vertices": str(found.vertices),
        "triangles": str(found.faces),
        "open edges as indexed": str(found.open_edges_as_indexed),
        "open edges after the weld": str(found.open_edges),
        "non-manifold edges": str(found.nonmanifold_edges),
        "pinched vertices": str(found.pinched_vertices),
        "components": str(len(found.components)),
        "Euler characteristic": str(found.euler),
        "β over Z/2": str(found.betti),
        "verdict": found.verdict + (f", genus {found.genus}" if found.passed else ""),
    }
