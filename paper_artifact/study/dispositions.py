"""The candidate disposition of the group wave (paper, Table S12): every candidate's certificate beside what
the paper says.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.sources import sources

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
    try:
        with open(TABLE, newline="", encoding="utf-8") as handle:
            rows = list(csv.DictReader(handle))
    except OSError as error:
        raise InputError(
            f"cannot read {TABLE}: {error.strerror}; work in a checkout of the repository"
        ) from error
    found = {}
    for row in rows:
        why = (
            f" (g{row['genus']})"
            if row["certificate"] == "pass"
            else f": {row['reason'].replace('chi', 'χ')}"
        )
        found[row["shape"]] = row["certificate"] + why, row["decision"] or "-"
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


def disposition_text(rows: list[Disposition]) -> str:
    """Return the table as text, one line per candidate."""
    lines = [f"{'candidate':<13}{'paper':<23}{'decision':<12}{'Betti':<13}{'agrees':<8}measured"]
    for row in rows:
        betti = str(row.certificate.betti) if row.certificate else "-"
        agrees = {True: "yes", False: "NO", None: "-"}[row.agrees]
        lines.append(
            f"{row.key:<13}{row.published:<23}{row.decision:<12}{betti:<13}{agrees:<8}{row.measured}"
        )
    return "\n".join(lines)
