"""Notebook 12: the open-surface probe (App. F, Tables S9 and S10): two bowls, certified as disks, that
samples read as voids.

Lifetimes and floors are radii divided by the bowl's bounding-box diagonal; a margin is lifetime / floor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.catalogue import shape_row, shapes_of
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.export.flat import CUT, render_flat
from paper_artifact.mesh import Mesh
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import image_rows
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.tables import seed_table
from paper_artifact.scene.shapes import BOWL_RIMS, surface
from paper_artifact.staircase import signature_table, staircase
from paper_artifact.topology.bundle import build_from_mesh

DENSITIES = (2048, 4096, 8192, 20_000)
SEEDS = (0, 1, 2, 3, 4)


def opening(mesh: Mesh) -> np.ndarray:
    """Return the distances (n,) of the rim's vertices from the z axis, in units of the sphere's radius
    (the farthest vertex's distance from the origin); the rim are the vertices of edges with one face."""
    pairs = np.sort(
        np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1
    )
    edges, uses = np.unique(pairs, axis=0, return_counts=True)
    rim = mesh.vertices[np.unique(edges[uses == 1])]
    return np.linalg.norm(rim[:, :2], axis=1) / np.linalg.norm(mesh.vertices, axis=1).max()


def certificate_table() -> pd.DataFrame:
    """Return the bowls' certificates as surfaces with boundary, and their openings: nominal (the paper's
    measured value) and the rim's mean, least and largest radius."""
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
    shapes = shapes_of("bowls")
    images = []
    for shape in shapes:
        mesh = surface(shape)
        images.append(render_flat(mesh.vertices, mesh.faces, size, direction=(0.3, -1.0, 1.1), inside=CUT))
    figure = image_rows([("", images)])
    for axis, shape in zip(figure.axes, shapes, strict=True):
        axis.set_title(shape)
    return figure


def staircases(seeds: Iterable[int] = SEEDS) -> pd.DataFrame:
    """Return the bowls' staircases (see `staircase.staircase`); five seeds take about 5 s of CPU."""
    return pd.concat(
        [staircase(surface(shape), DENSITIES, tuple(seeds)) for shape in shapes_of("bowls")],
        ignore_index=True,
    )


def margin_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S9: top bar over the floor of H2 and H1 per bowl and density: the paper's (its seed 0),
    ours of seed 0 and the range over all seeds; significant (b0, b1, b2)."""
    paper = frames.paper("top_bar_over_floor", "S9").set_index(["shape", "samples", "dimension"])["printed"]
    signs, rows = signature_table(table), {}
    for (shape, samples), own in table.groupby(["shape", "samples"], sort=False):
        row = {"counts": signs.loc[shape, samples]}
        for dimension in (2, 1):
            values = own[f"h{dimension}_1"] / own["floor"]
            row |= {
                f"H{dimension}, paper": paper.get((shape, samples, dimension), "—"),
                f"H{dimension}, seed 0": f"{values[own['seed'] == 0].iloc[0]:.2f}",
                f"H{dimension}, range": f"{values.min():.2f}–{values.max():.2f}",
            }
        rows[shape, samples] = row
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["shape", "M"])


def bundle_table() -> pd.DataFrame:
    """Return the study's bundles: density, seed, dimensions, number of bars, birth and death, margin over
    the floor."""
    rows = {}
    for shape in shapes_of("bowls"):
        row, mesh = shape_row(shape), surface(shape)
        given = {"shape": shape, "dimensions": row.dimensions}
        bundle = build_from_mesh(mesh.vertices, mesh.faces, row.samples, row.bundle_seed, **given)
        birth, death = bundle.bars[2][0]
        rows[shape] = {
            "M": row.samples,
            "seed": row.bundle_seed,
            "acts on": ", ".join(f"H{each}" for each in bundle.dimensions),
            "bars": sum(map(len, bundle.bars)),
            "birth": round(birth, 4),
            "death": round(death, 4),
            "floor": round(bundle.floor, 4),
            "margin": round((death - birth) / bundle.floor, 2),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("bowl")


def outcome_table(collected: Collected, table: pd.DataFrame) -> pd.DataFrame:
    """Return Table S10 seed by seed (see `tables.seed_table`), and half the clean void's lifetime at
    20,000 samples over the seeds of the staircase `table`: the cost of leaving it unmatched."""
    outcomes = seed_table(collected, "S10")
    voids = table[table["samples"] == 20_000].groupby("shape")["h2_1"].agg(["min", "max"]) / 2
    half = (voids["min"].map("{:.4f}".format) + "–" + voids["max"].map("{:.4f}".format)).str.replace(
        "0.", "."
    )
    return outcomes.assign(**{"half the void": outcomes.index.get_level_values("shape").map(half)})
