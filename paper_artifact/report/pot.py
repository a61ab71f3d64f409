"""The procedural hot pot in the role of the paper's pot, which is not public, and the Utah teapot (Tables S4, S5, Fig. S7).

Lifetimes and floors are radii divided by the certified shell's bounding-box diagonal; a margin is lifetime / floor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from trimesh.intersections import slice_faces_plane

from paper_artifact.audit.audit import Audit
from paper_artifact.catalogue import shape_row
from paper_artifact.certify.certificate import Certificate
from paper_artifact.evaluate.diagram import lifetimes
from paper_artifact.evaluate.staircase import measure
from paper_artifact.ingest import hot_pot
from paper_artifact.ingest.inventory import inventory, shells_as_indexed
from paper_artifact.ingest.solidify import Solid
from paper_artifact.mesh import Mesh
from paper_artifact.report.figures import image_rows
from paper_artifact.report.published import published
from paper_artifact.report.render import CUT, render_flat
from paper_artifact.report.runs import Collected
from paper_artifact.report.staircase import signature_table, staircase
from paper_artifact.study.tables import counts_text
from paper_artifact.study.verdict import Arm, rows_of, verdict

DENSITIES = (2048, 4096, 8192, 20_000)
SEEDS = (0, 1, 2, 3, 4)
WORKING = 8192  # M of the pot's bundle
RUNS = tuple(("pot", condition, seed) for condition in ("C0", "C1", "C2") for seed in range(3))
VIEW = (0.55, -1.0, 0.6)  # of Fig. S7, towards the camera


def staircases(mesh: Mesh, seeds: Iterable[int] = SEEDS) -> pd.DataFrame:
    """Return the shell's staircase at Table S5's densities (see `staircase.staircase`); five seeds take about 6 s of CPU."""
    return staircase(mesh, DENSITIES, tuple(seeds))


def margins(table: pd.DataFrame, samples: int, bar: str) -> pd.Series:
    """Return the margins (lifetime / floor) over the seeds of one bar ("h2_1": the longest void) at one density."""
    own = table[table["samples"] == samples]
    return own[bar] / own["floor"]


def challenge_table(
    pot: hot_pot.RawPot, solid: Solid, table: pd.DataFrame, collected: Collected
) -> pd.DataFrame:
    """Return Table S4's numbers: of the paper's pot, and of the stand-in (measured now, the outcomes from the records)."""
    raw, shell, void = solid.raw, solid.certificate, margins(table, WORKING, "h2_1")
    judged = verdict(rows_of(collected.records)).get("pot")
    arms = judged.arms if judged else {}
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
        "ratio_C0_over_C1": _outcome(arms, "C1", lambda base, arm: f"{base.mean / arm.mean:.1f}"),
        "chamfer_ratio_to_C0": _outcome(
            arms, "C2", lambda base, arm: f"{arm.chamfer / base.chamfer:.2f}, voids {counts_text(arm)}"
        ),
    }
    printed = published("S4").groupby("quantity", sort=False)["value"].agg(list)
    notes = published("S4").drop_duplicates("quantity").set_index("quantity")["note"]
    rows = []
    for quantity, values in printed.items():
        theirs = f"({', '.join(f'{value:.0f}' for value in values)})" if len(values) > 1 else f"{values[0]:g}"
        if quantity.startswith("margin"):
            theirs = f"{values[0]:.2f}"
        name = quantity.replace("_", " ")
        rows.append(
            {
                "what": name,
                "paper's pot": theirs,
                "paper's note": notes[quantity],
                "stand-in": str(ours[quantity]),
            }
        )
    return pd.DataFrame(rows).set_index("what")


def inventory_table(pot: hot_pot.RawPot, solid: Solid) -> pd.DataFrame:
    """Return the stand-in's challenge inventory: each difficulty and its measured consequence."""
    rows = [(what, consequence.split(", sha256")[0]) for what, consequence in inventory(pot, solid)]
    return pd.DataFrame(rows, columns=["challenge", "measured consequence"]).set_index("challenge")


def staircase_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S5: significant (b0, b1, b2) per density, the paper's pot and the stand-in over the seeds, with the ranges of
    the floor and of the margins of the longest loop, the longest and the second longest void."""
    paper = published("S5").sort_values("dimension").groupby("samples")["value"]
    paper = paper.agg(lambda values: "({:.0f},{:.0f},{:.0f})".format(*values))
    ours = signature_table(table).iloc[0]
    rows = []
    for samples, own in table.groupby("samples"):
        rows.append(
            {
                "M": samples,
                "paper's pot": paper[samples],
                "stand-in": ours[samples],
                "floor": f"{own['floor'].min():.4f}–{own['floor'].max():.4f}",
                "void / floor": _range(margins(table, samples, "h2_1")),
                "second void / floor": _range(margins(table, samples, "h2_2")),
                "longest loop / floor": _range(margins(table, samples, "h1_1")),
            }
        )
    return pd.DataFrame(rows).set_index("M")


def void_table(mesh: Mesh, samples: int = WORKING, seeds: Sequence[int] = SEEDS) -> pd.DataFrame:
    """Return birth, death, lifetime of the longest void per seed, its margin, and how far birth and death are from their means:
    how stable the bar is to re-sampling (the paper: about 1e-5)."""
    rows = []
    for seed in seeds:
        diagram, floor = measure(mesh, samples, seed)
        birth, death = diagram[2][np.argmax(lifetimes(diagram[2]))]
        rows.append(
            {
                "seed": seed,
                "birth": birth,
                "death": death,
                "lifetime": death - birth,
                "margin": (death - birth) / floor,
            }
        )
    table = pd.DataFrame(rows).set_index("seed")
    spread = table.std(ddof=1).rename("standard deviation")
    return pd.concat([table, spread.to_frame().T]).rename_axis("seed").round({"margin": 2}).round(5)


def decision_text(audit: Audit) -> str:
    """Return the audit's decision as lines: class, density, dimensions of the loss, the rule's steps, and whether the study's
    protocol of the pot is the same."""
    decision, protocol = audit.decision, shape_row("pot")
    same = (decision.samples, decision.dimensions) == (protocol.samples, protocol.dimensions)
    bars = audit.bundle.to_json()["bars"] if audit.bundle else []
    head = f"class H{decision.dimension}, M = {decision.samples}, the loss acts on {decision.dimensions}"
    counted = f"bars in the bundle: {sum(map(len, bars))}; the study's protocol is this decision: {same}"
    return "\n".join([head, *(f"  {reason}" for reason in (*decision.reasons, *decision.warnings)), counted])


def flue_table(solid: Solid, table: pd.DataFrame) -> pd.DataFrame:
    """Return the flue's geometry as built beside the void that is measured: the radius at which the mouth closes and birth, the
    radius that fits into the chamber and death (8192 samples, mean over seeds 0–4), and half the lifetime at 20,000 samples."""
    apothem = np.cos(np.pi / hot_pot.SIDES)  # inscribed / circumscribed radius of the flue's cross-section
    inner = [
        (radius * apothem - solid.offset) / solid.shell.diagonal
        for radius in (hot_pot.MOUTH_RADIUS, hot_pot.FLUE_RADIUS)
    ]
    void = void_table(solid.shell).iloc[:-1].mean()
    pinned = published("2").set_index(["shape", "condition"])["value"]["pot", "C2"]
    half = table[table["samples"] == 20_000]["h2_1"] / 2
    rows = {
        "mouth": {"built, radius / D": f"{inner[0]:.4f}", "bar": f"birth {void['birth']:.4f}", "paper": ""},
        "chamber": {"built, radius / D": f"{inner[1]:.4f}", "bar": f"death {void['death']:.4f}", "paper": ""},
        "half the lifetime at 20,000": {
            "built, radius / D": "",
            "bar": f"{half.min():.4f}–{half.max():.4f}",
            "paper": f"{pinned:.4f} (C2's tail)",
        },
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def cut_open(mesh: Mesh, axis: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V,3), world units, and faces (F,3) of the mesh's half beyond its middle along the axis, cut exactly."""
    normal = np.eye(3)[axis]
    vertices, faces, _ = slice_faces_plane(mesh.vertices, mesh.faces, normal, mesh.centre)
    return vertices, faces


def pot_figure(solid: Solid, size: int = 300) -> Figure:
    """Return Fig. S7 of the stand-in: the certified shell, from the side and from above, and cut open through the flue (red: the
    wall where it is cut)."""
    shell, frame = solid.shell, solid.shell.vertices
    half = cut_open(shell)
    images = [
        render_flat(shell.vertices, shell.faces, size, direction=VIEW, frame=frame),
        render_flat(shell.vertices, shell.faces, size, direction=(0.2, -0.5, 1.0), frame=frame),
        render_flat(*half, size, direction=(0.15, -1.0, 0.25), frame=frame, inside=CUT),
    ]
    return image_rows([("", images)], size / 90)


def ingest_table(solid: Solid) -> pd.DataFrame:
    """Return the certificate of a raw mesh beside that of the shell that the ingest makes of it."""
    columns = {"raw": _certificate_column(solid.raw), "after ingest": _certificate_column(solid.certificate)}
    columns["raw"]["enclosed pockets filled"] = ""
    columns["after ingest"]["enclosed pockets filled"] = str(solid.pockets)
    return pd.DataFrame(columns)


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


def _outcome(arms: Mapping[str, Arm], condition: str, text: Callable[[Arm, Arm], str]) -> str:
    """The text of (C0, condition) with how many seeds it rests on; what is missing where there is no run."""
    if "C0" not in arms or condition not in arms:
        return "no run recorded"
    seeds = min(len(arms["C0"].seeds), len(arms[condition].seeds))
    return text(arms["C0"], arms[condition]) + ("" if seeds == 3 else f" ({seeds} of 3 seeds)")


def _range(values: pd.Series) -> str:
    return f"{values.min():.2f}–{values.max():.2f}"
