"""The open-surface probe (App. F, Tables S9 and S10): two bowls, certified as disks, that samples read as voids.

Lifetimes and floors are radii divided by the bowl's bounding-box diagonal; a margin is lifetime / floor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.mesh import Mesh
from paper_artifact.report.figures import image_rows
from paper_artifact.report.published import published
from paper_artifact.report.render import CUT, render_flat
from paper_artifact.report.runs import Collected
from paper_artifact.report.staircase import counts, signature_table, staircase
from paper_artifact.scene.find import surface
from paper_artifact.scene.shapes import BOWL_RIMS
from paper_artifact.study.tables import counts_text, published_rows, tails_text
from paper_artifact.study.verdict import rows_of, verdict
from paper_artifact.topology.bundle import build_from_mesh

SHAPES = tuple(BOWL_RIMS)
DENSITIES = (2048, 4096, 8192, 20_000)
SEEDS = (0, 1, 2, 3, 4)
CONDITIONS = ("C0", "C1", "C2")


def opening(mesh: Mesh) -> np.ndarray:
    """Return the distances (n,) of the rim's vertices from the z axis, in units of the sphere's radius (the farthest vertex's
    distance from the origin); the rim are the vertices of edges with one face."""
    pairs = np.sort(
        np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1
    )
    edges, uses = np.unique(pairs, axis=0, return_counts=True)
    rim = mesh.vertices[np.unique(edges[uses == 1])]
    return np.linalg.norm(rim[:, :2], axis=1) / np.linalg.norm(mesh.vertices, axis=1).max()


def certificate_table() -> pd.DataFrame:
    """Return the bowls' certificates as surfaces with boundary, and their openings: nominal (the paper's measured value) and the
    rim's mean, least and largest radius."""
    rows = {}
    for shape, nominal in BOWL_RIMS.items():
        found, rim = certify_mesh(surface(shape), with_boundary=True), opening(surface(shape))
        rows[shape] = {
            "verdict": found.verdict,
            "surface": found.kind,
            "components": len(found.components),
            "boundary loops": found.boundary_loops,
            "non-manifold edges": found.nonmanifold_edges,
            "wound alike": "no edge" if found.reversed_edges == 0 else f"{found.reversed_edges} edges",
            "Euler characteristic": found.euler,
            "β over Z/2": str(found.betti),
            "opening / R, paper": f"{nominal:.2f}",
            "ours, mean": f"{rim.mean():.3f}",
            "least–largest": f"{rim.min():.3f}–{rim.max():.3f}",
            "vertices": found.vertices,
            "triangles": found.faces,
        }
    return pd.DataFrame(rows)


def bowl_figure(size: int = 220) -> Figure:
    """Return both bowls seen from above their opening; red: the inner side."""
    images = []
    for shape in SHAPES:
        mesh = surface(shape)
        images.append(render_flat(mesh.vertices, mesh.faces, size, direction=(0.3, -1.0, 1.1), inside=CUT))
    return image_rows([("", images)], size / 90)


def staircases(seeds: Iterable[int] = SEEDS) -> pd.DataFrame:
    """Return the bowls' staircases (see `staircase.staircase`); five seeds take about 5 s of CPU."""
    return pd.concat(
        [staircase(surface(shape), DENSITIES, tuple(seeds)) for shape in SHAPES], ignore_index=True
    )


def margin_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S9: top bar over the floor of H2 and H1 per bowl and density: the paper's (its seed 0), ours of seed 0 and
    the range over all seeds; significant (b0, b1, b2)."""
    paper = published("S9").set_index(["shape", "samples", "dimension"])["value"]
    signs, rows = signature_table(table), []
    for (shape, samples), own in table.groupby(["shape", "samples"], sort=False):
        row = {"shape": shape, "M": samples, "counts": signs.loc[shape, samples]}
        for dimension in (2, 1):
            values = own[f"h{dimension}_1"] / own["floor"]
            printed = paper.get((shape, samples, dimension))
            row |= {
                f"H{dimension}, paper": "—" if printed is None else f"{printed:.2f}",
                f"H{dimension}, seed 0": f"{values[own['seed'] == 0].iloc[0]:.2f}",
                f"H{dimension}, range": f"{values.min():.2f}–{values.max():.2f}",
            }
        rows.append(row)
    return pd.DataFrame(rows).set_index(["shape", "M"])


def bundle_table() -> pd.DataFrame:
    """Return the study's bundles: density, seed, dimensions, number of bars, birth and death, margin over the floor."""
    rows = []
    for shape in SHAPES:
        protocol, mesh = shape_row(shape), surface(shape)
        bundle = build_from_mesh(
            mesh.vertices,
            mesh.faces,
            protocol.samples,
            protocol.bundle_seed,
            shape=shape,
            dimensions=protocol.dimensions,
        ).to_json()
        (birth, death), *others = bundle["bars"][2]
        rows.append(
            {
                "bowl": shape,
                "M": bundle["samples"],
                "seed": bundle["seed"],
                "acts on": ", ".join(f"H{each}" for each in bundle["dimensions"]),
                "bars": sum(map(len, bundle["bars"])),
                "birth": round(birth, 4),
                "death": round(death, 4),
                "floor": round(bundle["floor"], 4),
                "margin": round((death - birth) / bundle["floor"], 2),
            }
        )
    return pd.DataFrame(rows).set_index("bowl")


def outcome_table(collected: Collected, table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S10 seed by seed: tails, counts and Chamfer / C0 per bowl and condition, ours beside the paper's, "not
    recorded" where no run is; and half the void's lifetime at 20,000 samples, the cost of leaving it unmatched."""
    paper, ratios = published("S10"), published("chamfer")
    judged = verdict(rows_of(collected.records))
    ratios = ratios[ratios["quantity"] == "chamfer_ratio_to_C0"].set_index(["shape", "condition"])["value"]
    rows = []
    for shape in SHAPES:
        void = table[(table["shape"] == shape) & (table["samples"] == 20_000)]["h2_1"] / 2
        arms = judged[shape].arms if shape in judged else {}
        for condition in CONDITIONS:
            arm, base = arms.get(condition), arms.get("C0")
            printed = paper[
                (paper["shape"] == shape) & (paper["condition"] == condition) & paper["seed"].notna()
            ]
            rows.append(
                {
                    "bowl": shape,
                    "condition": condition,
                    "our tails": tails_text(arm.tails) if arm else "not recorded",
                    "paper's tails": tails_text(printed.sort_values("seed")["value"]),
                    "our counts": counts_text(arm) if arm else "",
                    "Chamfer / C0": f"{arm.chamfer / base.chamfer:.2f}" if arm and base else "",
                    "paper's": f"{ratios[shape, condition]:g}" if (shape, condition) in ratios.index else "",
                    "half the void": f"{void.min():.4f}–{void.max():.4f}".replace("0.", "."),
                }
            )
    return pd.DataFrame(rows).set_index(["bowl", "condition"])


def verdict_table(collected: Collected, table: pd.DataFrame) -> pd.DataFrame:
    """Return per bowl the verdict of our tails and of the paper's by the study's rule, its reason, and the seeds of C1 and C2
    whose count is not the clean bowl's at 20,000 samples.

    The count is held against the staircase: a disk has no void of its own, so its Betti numbers are no expectation.
    """
    chosen = table[(table["samples"] == 20_000) & (table["seed"] == 0)]
    expected = dict(zip(chosen["shape"], counts(chosen, 2)))
    judged = verdict(rows_of(collected.records))
    theirs = verdict(published_rows(published("S10")))
    rows = []
    for shape, each in judged.items():
        row = {
            "bowl": shape,
            "verdict": each.outcome,
            "reason": each.reason,
            "paper's tails give": theirs[shape].outcome,
        }
        for condition in (name for name in ("C1", "C2") if name in each.arms):
            arm = each.arms[condition]
            wrong = [seed for seed, count in zip(arm.seeds, arm.counts) if count != expected[shape]]
            row[f"wrong count in {condition}, seeds"] = ", ".join(map(str, wrong)) or "none"
        rows.append(row)
    return pd.DataFrame(rows).set_index("bowl") if rows else pd.DataFrame()
