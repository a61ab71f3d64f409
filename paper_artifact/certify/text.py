"""A certificate as a readable table."""

from __future__ import annotations

from paper_artifact.certify.certificate import Certificate

LONGEST = 12  # components that are listed


def verdict_text(certificate: Certificate) -> str:
    """Return the verdict in a few words: PASS, PASS as a surface with boundary (how open), or FAIL."""
    if not certificate.passed or certificate.closed:
        return certificate.verdict.upper()
    loops = certificate.boundary_loops
    return f"PASS as a surface with boundary ({loops} boundary loop{'s' * (loops != 1)}; not closed)"


def certificate_text(certificate: Certificate) -> str:
    """Return the certificate as lines of text, the verdict first."""
    c = certificate
    lines = [f"{c.name}: {verdict_text(c)}"]
    lines += [f"  reason: {reason}" for reason in c.reasons] + [f"  note: {note}" for note in c.notes]
    rows = [
        ("kind", c.kind),
        (
            "as indexed",
            f"{c.vertices_as_indexed} vertices, {c.faces_as_indexed} triangles, "
            f"{c.open_edges_as_indexed} open edges",
        ),
        ("after exact weld", f"{c.vertices} vertices, {c.edges} edges, {c.faces} triangles"),
        (
            "open edges",
            f"{c.open_edges}" + (f" in {c.boundary_loops} boundary loops" if c.open_edges else ""),
        ),
        ("non-manifold", f"{c.nonmanifold_edges} edges, {c.pinched_vertices} pinched vertices"),
        (
            "winding",
            ("orientable" if c.orientable else "not orientable")
            + f", {c.reversed_edges} edges wound alike by both faces",
        ),
        ("components", f"{len(c.components)}" + (f", total genus {c.genus}" if c.genus is not None else "")),
        (
            "Betti numbers, Z/2",
            f"{c.betti}, b2 by duality "
            + ("not counted (too large)" if c.betti2_dual is None else str(c.betti2_dual)),
        ),
        (
            "Euler characteristic",
            f"{c.euler}"
            + (f" ({c.euler_as_given} with repeated faces)" if c.euler != c.euler_as_given else ""),
        ),
    ]
    lines += [f"  {label:<21}{text}" for label, text in rows]
    lines.append(
        f"  {'component':<11}{'vertices':>9}{'triangles':>10}{'χ':>6}  {'Betti':<14}{'expected':<14}"
        f"{'open':>5}{'loops':>6}{'genus':>6}"
    )
    for number, each in enumerate(c.components[:LONGEST], start=1):
        lines.append(
            f"  {number:<11}{each.vertices:>9}{each.faces:>10}{each.euler:>6}  {str(each.betti):<14}"
            f"{_or_dash(each.expected):<14}{each.open_edges:>5}{each.boundary_loops:>6}{_or_dash(each.genus):>6}"
        )
    if len(c.components) > LONGEST:
        lines.append(f"  … and {len(c.components) - LONGEST} smaller components (all of them in --json)")
    return "\n".join(lines)


def _or_dash(value: object) -> str:
    return "-" if value is None else str(value)
