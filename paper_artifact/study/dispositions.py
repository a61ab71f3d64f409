"""The candidate disposition of the group wave (paper, Table S12): every candidate's certificate beside what the paper says."""

from __future__ import annotations

from dataclasses import dataclass

from paper_artifact.certify.certificate import Certificate, certify_mesh
from paper_artifact.scene.find import find_mesh

# key: (the paper's certificate column, the paper's decision)
PUBLISHED = {
    "rocker-arm": ("pass (g1)", "loop group"),
    "eight": ("pass (g2)", "loop group"),
    "armadillo": ("pass (g0)", "void group"),
    "horse": ("pass (g0)", "void group"),
    "cheburashka": ("pass (g0)", "set aside"),
    "eight-dense": ("pass (g2)", "set aside"),
    "beast": ("fail: non-manifold", "-"),
    "cow": ("fail: odd χ", "-"),
    "max-planck": ("fail: 161 open edges", "-"),
    "ogre": ("fail: 200 open edges", "-"),
    "teapot": ("fail: 160 open edges", "-"),
}


@dataclass(frozen=True)
class Disposition:
    """One candidate: the paper's certificate and decision, ours in the same words, whether they agree, and our certificate.

    certificate and agrees are None for the candidate that could not be had.
    """

    key: str
    published: str
    decision: str
    measured: str
    agrees: bool | None
    certificate: Certificate | None


def dispositions(keys: tuple[str, ...] = tuple(PUBLISHED)) -> list[Disposition]:
    """Certify the candidates `keys` (fetched when needed). Raises InputError for an unknown key or a mesh that cannot be had."""
    rows = []
    for key in keys:
        published, decision = PUBLISHED[key]
        if key == "max-planck":
            rows.append(
                Disposition(
                    key,
                    published,
                    decision,
                    "not obtainable: none of nine public copies has 161 open edges",
                    None,
                    None,
                )
            )
            continue
        certificate = certify_mesh(find_mesh(key, welded=False))
        rows.append(Disposition(key, published, decision, *_compared(certificate, published), certificate))
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
        lines.append(
            f"{row.key:<13}{row.published:<23}{row.decision:<12}{betti:<13}"
            f"{ {True: 'yes', False: 'NO', None: '-'}[row.agrees]:<8}{row.measured}"
        )
    return "\n".join(lines)
