"""The candidate disposition of the group wave (paper, Table S12): every candidate's certificate beside what
the paper says.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.files import REPOSITORY
from paper_artifact.scene.fetch import sources
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.tables import read_table

TABLE = REPOSITORY / "results" / "published" / "table_S12.csv"


@dataclass(frozen=True)
class Disposition:
    """One candidate, the paper's words and ours."""

    key: str  # of data_scripts/meshes.csv
    published: str  # the paper's certificate, "pass (g1)" or "fail: 200 open edges"
    decision: str  # what the paper does with it, "-" where it fails
    measured: str  # our certificate in the same words
    agrees: bool | None  # None for the candidate that cannot be had
    certificate: Certificate | None  # ours, of the file as it is


def candidates() -> dict[str, tuple[str, str]]:
    """Return {key: (the paper's certificate, its decision)}. Raises InputError when the published table
    cannot be read."""
    names = ("shape", "certificate", "genus", "reason", "decision")
    table = read_table(TABLE, *names, advice="restore it with git, or work in a checkout")
    found = {}
    for row in table.itertuples():
        why = f" (g{row.genus})" if row.certificate == "pass" else f": {row.reason.replace('chi', 'χ')}"
        found[row.shape] = row.certificate + why, row.decision or "-"
    return found


def dispositions(keys: Iterable[str] | None = None) -> list[Disposition]:
    """Return the dispositions of these candidates (None: all), certified now, fetched when needed.

    Raises InputError for a mesh that cannot be had though the table of sources says where it is.
    """
    paper, rows = candidates(), []
    for key in paper if keys is None else keys:
        if not sources()[key].obtainable:
            words, agrees, certificate = f"not obtainable: {sources()[key].notes}", None, None
        else:
            certificate = certify_mesh(find_mesh(key, welded=False))
            words, agrees = _compared(certificate, paper[key][0])
        rows.append(Disposition(key, *paper[key], words, agrees, certificate))
    return rows


def _compared(certificate: Certificate, published: str) -> tuple[str, bool]:
    """Our certificate in the paper's words, and whether the paper's words hold of it."""
    if certificate.passed:
        words = f"pass (g{certificate.genus})"
        return words, words == published
    holds = {
        "fail: non-manifold": certificate.nonmanifold_edges > 0,
        "fail: odd χ": any(each.euler % 2 for each in certificate.components) and certificate.closed,
        f"fail: {certificate.open_edges} open edges": True,
    }
    return "fail: " + "; ".join(certificate.reasons), holds.get(published, False)


def polygon_counts(path: Path | str) -> tuple[int, int, int] | None:
    """Return (edges with one polygon, edges with more than two, vertices - edges + polygons) of an OBJ file's
    own polygons, indexed by position; None when it is no OBJ file or all its faces are triangles."""
    if Path(path).suffix != ".obj":
        return None
    polygons: list[list[int]] = []
    points: dict[tuple[float, ...], int] = {}
    number: list[int] = []
    for line in Path(path).read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:  # equal points are one vertex
            number.append(points.setdefault(tuple(map(float, words[1:4])), len(points)))
        elif words[:1] == ["f"]:
            indices = [int(word.split("/")[0]) for word in words[1:]]
            polygons.append([number[index - 1 if index > 0 else index] for index in indices])
    if all(len(polygon) == 3 for polygon in polygons):
        return None
    pairs = ((a, b) for polygon in polygons for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True))
    edges = Counter((min(pair), max(pair)) for pair in pairs)
    used = {index for polygon in polygons for index in polygon}
    return (
        sum(n == 1 for n in edges.values()),
        sum(n > 2 for n in edges.values()),
        len(used) - len(edges) + len(polygons),
    )


def same_certificate(left: dict, right: dict) -> bool:
    """Return whether two certificates (as JSON) agree, volumes to a relative 1e-9 (a machine's last bits)."""
    both = json.loads(json.dumps([left, right]))
    volumes = [[part.pop("volume", None) for part in each.get("components", ())] for each in both]
    if both[0] != both[1]:
        return False
    first, second = (np.array(each, dtype=float) for each in volumes)  # None becomes NaN
    return np.allclose(first, second, rtol=1e-9, atol=0, equal_nan=True)
