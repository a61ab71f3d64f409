"""The audit as one self-contained HTML page: tables, diagrams, margins, commands, a 3-D view."""

from __future__ import annotations

import base64
import html
import io

import numpy as np
from matplotlib.figure import Figure

from paper_artifact.audit.measure import Audit
from paper_artifact.audit.rule import NAMES
from paper_artifact.audit.view import light_mesh
from paper_artifact.certify.text import certificate_text
from paper_artifact.export.figures import draw_diagram, new_figure, svg
from paper_artifact.export.triangles import mesh_triangles
from paper_artifact.export.viewer import html_page
from paper_artifact.topology.floor import MULTIPLIER

STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:1060px;margin:1.5em auto;padding:0 1em;color:#222}\n"
    "h1{font-size:1.5em;margin-bottom:.2em}h2{font-size:1.1em;margin:1.4em 0 .4em}"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}\n"
    "td,th{border:1px solid #ccc;padding:.15em .6em;text-align:right}"
    "th{background:#f3f3f3}tr.chosen td{background:#e3edfb;font-weight:600}\n"
    "pre{background:#f6f6f6;padding:.7em;overflow-x:auto;font-size:12.5px}"
    "iframe{width:100%;height:460px;border:1px solid #ccc}\n"
    ".pass{color:#1f5fbf}.fail{color:#b4521e}img{max-width:100%}li{margin:.2em 0}"
)
SHOWN = 4  # bars per dimension in the staircase table


def audit_page(audit: Audit) -> str:
    """Return the page as text. Raises InputError when the mesh cannot be shown."""
    decision = audit.decision
    title = f"Audit of {audit.name}"
    verdict = ("pass", "passes") if audit.certificate.passed else ("fail", "fails")
    sections = [
        f"<h1>{html.escape(title)}</h1><p>The certificate <b class='{verdict[0]}'>{verdict[1]}</b>. "
        f"{html.escape(headline(audit))}</p>",
        "<h2>Certificate</h2>" + _pre(certificate_text(audit.certificate)),
        "<h2>Density staircase</h2><p>Significant bars (components with the infinite one, loops, voids) of M "
        "points drawn uniformly by area, and the longest lifetimes as multiples of the floor "
        f"{MULTIPLIER:g}·r<sub>med</sub>(M).</p>" + _staircase_table(audit),
        _image(_margin_figure(audit)),
        "<h2>Observable and density</h2>" + _list(decision.reasons),
        "<p><b>Warnings</b></p>" + _list(decision.warnings) if decision.warnings else "",
        f"<h2>Diagrams at M = {_shown_samples(audit)}</h2><p>Births and deaths are radii divided by the "
        "bounding-box diagonal; dotted: the floor.</p>"
        + _image(_diagram_figure(audit), "png"),  # thousands of dots: smaller as pixels
        _bundle_section(audit),
        "<h2>3-D view</h2>"
        + f'<iframe title="3-D view" srcdoc="{html.escape(_view(audit), quote=True)}"></iframe>',
    ]
    return (
        f"<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style></head><body>{''.join(sections)}</body></html>\n"
    )


def headline(audit: Audit) -> str:
    """Return the decision in one sentence."""
    decision = audit.decision
    if decision.samples is None:
        return (
            "Nothing is measurable at any working density: there is nothing that the loss could act on, "
            "and no command to train it."
        )
    acts = " and ".join(NAMES[d] for d in decision.dimensions)
    return (
        f"Observable: {NAMES[decision.dimension]}, {'all expected' if decision.complete else 'not all'} "
        f"measurable; working density M = {decision.samples}; the loss acts on {acts}."
    )


def _shown_samples(audit: Audit) -> int:
    return audit.decision.samples or max(rung.samples for rung in audit.rungs)


def _staircase_table(audit: Audit) -> str:
    head = "".join(
        f"<th>{text}</th>"
        for text in ("M", "seed", "floor", "significant", *(f"{name}: longest / floor" for name in NAMES))
    )
    rows = []
    for rung in audit.rungs:
        cells = [str(rung.samples), str(rung.seed), f"{rung.floor:.4f}", rung.signature]
        cells += [" ".join(f"{margin:.2f}" for margin in margins[:SHOWN]) or "–" for margins in rung.margins]
        chosen = " class='chosen'" if rung.samples == audit.decision.samples else ""
        rows.append(f"<tr{chosen}>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return f"<table><tr>{head}</tr>{''.join(rows)}</table>"


def _margin_figure(audit: Audit) -> Figure:
    figure, axes = new_figure(1, 3, 3.2, 2.3, sharex=True)
    samples = sorted({rung.samples for rung in audit.rungs})
    for dimension, axis in enumerate(axes[0]):
        for rank in range(SHOWN):
            points = [
                (rung.samples, rung.margins[dimension][rank])
                for rung in audit.rungs
                if len(rung.margins[dimension]) > rank
            ]
            if points:
                axis.plot(*np.transpose(points), "o", markersize=3.5, color="#1f5fbf", alpha=1 - 0.2 * rank)
                middle = {m: [value for each, value in points if each == m] for m in samples}
                centre = [(m, np.median(values)) for m, values in middle.items() if values]
                axis.plot(*np.transpose(centre), color="#1f5fbf", linewidth=0.9, alpha=1 - 0.2 * rank)
        axis.axhline(1.0, color="black", linestyle=":", linewidth=0.8)
        axis.set(xscale="log", title=NAMES[dimension], xlabel="samples M")
        axis.set_ylim(bottom=0)
        axis.set_xticks(samples, [str(m) for m in samples], rotation=45)
        axis.minorticks_off()
    axes[0][0].set_ylabel("lifetime / floor")
    return figure


def _diagram_figure(audit: Audit) -> Figure:
    floor = next(rung.floor for rung in audit.rungs if rung.samples == _shown_samples(audit))
    figure, axes = new_figure(1, 3, 3.2, 3.2)
    limit = 1.08 * max([float(bars.max()) for bars in audit.diagram if len(bars)], default=1.0)
    for dimension, axis in enumerate(axes[0]):
        target = (
            audit.bundle.bars[dimension]
            if audit.bundle is not None and dimension in audit.bundle.dimensions
            else None
        )
        draw_diagram(
            axis,
            audit.diagram[dimension],
            floor,
            limit,
            target,
            NAMES[dimension] + (", star: target" if target is not None else ""),
        )
    return figure


def _bundle_section(audit: Audit) -> str:
    if audit.bundle is None:
        return "<h2>Training</h2><p>No bundle: nothing is measurable.</p>"
    lines = [f"{NAMES[d]}: {reason}" for d, reason in enumerate(audit.bundle.reasons)]
    return (
        "<h2>Bundle</h2>"
        + _list(lines)
        + "<h2>Training</h2><p>These commands build this very bundle again (same mesh, M, seed); "
        "repeat them with --seed 1, --seed 2 for the protocol's three seeds.</p>"
        + _pre("\n".join(audit.commands))
    )


def _view(audit: Audit) -> str:
    return html_page({"mesh": mesh_triangles(light_mesh(audit.mesh))}, audit.name)


def _image(figure: Figure, kind: str = "svg") -> str:
    data = io.BytesIO()
    if kind == "svg":
        data.write(svg(figure))
    else:
        figure.savefig(data, format=kind)
    mime = "svg+xml" if kind == "svg" else kind
    text = base64.b64encode(data.getvalue()).decode("ascii")
    return f"<p><img alt='' src='data:image/{mime};base64,{text}'></p>"


def _list(lines) -> str:
    return "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in lines) + "</ul>"


def _pre(text: str) -> str:
    return f"<pre>{html.escape(text)}</pre>"
