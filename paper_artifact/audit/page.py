"""The audit as one self-contained HTML page: tables, diagrams, margins, commands, a 3-D view."""

from __future__ import annotations

import base64
import io

import numpy as np
from matplotlib.figure import Figure

from paper_artifact.audit.marks import COLOURS, light_mesh, view_parts
from paper_artifact.audit.measure import Audit
from paper_artifact.audit.rule import NAMES, counted
from paper_artifact.certify.certificate import certificate_text, verdict_text
from paper_artifact.export.viewer import framing, html_page, up_of
from paper_artifact.frame import frame_for
from paper_artifact.mesh import FEATURES
from paper_artifact.pages import render
from paper_artifact.plot import draw_diagram, new_figure, svg
from paper_artifact.topology.floor import MULTIPLIER

SHOWN = 4  # bars per dimension in the staircase table
BLUE = "#1f5fbf"


def audit_page(audit: Audit) -> str:
    """Return the page as text. Raises InputError when the mesh cannot be shown."""
    bundle = audit.bundle
    frame = frame_for(audit.mesh.centre, audit.mesh.radius)
    seen = framing(frame.inward(audit.mesh.vertices), up=up_of(audit.name))
    parts = view_parts(light_mesh(audit.mesh), audit.marks, frame)
    return render(
        "audit.html",
        audit=audit,
        name=audit.mesh.name,
        verdict=verdict_text(audit.certificate),
        headline=headline(audit),
        samples=_shown_samples(audit),
        marks=_mark_lines(audit),
        view=html_page(parts, audit.mesh.name, seen),
        certificate=certificate_text(audit.certificate),
        multiplier=MULTIPLIER,
        features=FEATURES,
        staircase=_staircase(audit),
        margins=[_margin_image(audit, dimension) for dimension in range(3)],
        diagrams=[_diagram_image(audit, dimension) for dimension in range(3)],
        bundle=[] if bundle is None else [f"{NAMES[d]}: {reason}" for d, reason in enumerate(bundle.reasons)],
    )


def headline(audit: Audit) -> str:
    """Return the decision in one sentence."""
    decision = audit.decision
    if decision.samples is None:
        return (
            "Nothing is measurable at any working density: the loss has nothing to act on, but C0, the "
            "images alone, trains."
        )
    rung = next(rung for rung in audit.rungs if rung.samples == decision.samples)
    found = [
        counted(d, rung.counts[d], decision.expected[d])
        for d in range(3)
        if d in decision.dimensions or decision.expected[d]
    ]
    acts = " and ".join(FEATURES[d][1] for d in decision.dimensions)
    return (
        f"Measurable at M = {decision.samples}: {', '.join(found)}; the loss acts on {acts} at that density."
    )


def _shown_samples(audit: Audit) -> int:
    return audit.decision.samples or max(rung.samples for rung in audit.rungs)


def _mark_lines(audit: Audit) -> list[tuple[str, str]]:
    """Return (colour, text) of every mark."""
    numbers, lines = [1, 0, 0], []
    for rank, mark in enumerate(audit.marks):
        numbers[mark.dimension] += 1
        what = ("gap before component", "loop", "void")[mark.dimension]
        word = "measurable" if mark.margin > 1 else "too short to be measured"
        text = f"{what} {numbers[mark.dimension]}: {mark.margin:.2f} of the floor, {word}"
        lines.append((COLOURS[rank % len(COLOURS)], text))
    return lines


def _staircase(audit: Audit) -> list[tuple]:
    """Return (rung, per dimension (count of the expected, the longest bars)) of the staircase."""
    expected = audit.decision.expected
    return [
        (
            rung,
            [
                (
                    counted(d, rung.counts[d], expected[d]).rpartition(" ")[0],
                    " ".join(f"{margin:.2f}" for margin in margins[:SHOWN]) or "–",
                )
                for d, margins in enumerate(rung.margins)
            ],
        )
        for rung in audit.rungs
    ]


def _margin_image(audit: Audit, dimension: int) -> tuple[str, str]:
    """Return (words, address) of the longest bars over the floor by M: each seed a dot, their median a
    line."""
    figure, axes = new_figure(1, 1, 3.4, 2.4)
    axis = axes[0][0]
    samples = sorted({rung.samples for rung in audit.rungs})
    for rank in range(SHOWN):
        found = [
            (rung.samples, rung.margins[dimension][rank])
            for rung in audit.rungs
            if len(rung.margins[dimension]) > rank
        ]
        if not found:
            continue
        places, values = np.transpose(found)
        known = np.unique(places)
        medians = [np.median(values[places == place]) for place in known]
        axis.plot(places, values, "o", markersize=3.5, color=BLUE, alpha=1 - 0.2 * rank)
        axis.plot(known, medians, color=BLUE, linewidth=0.9, alpha=1 - 0.2 * rank)
    axis.axhline(1.0, color="black", linestyle=":", linewidth=0.8)
    axis.set(xscale="log", title=NAMES[dimension], xlabel="samples M", ylabel="lifetime / floor")
    axis.set_ylim(bottom=0)
    axis.set_xticks(samples, [str(m) for m in samples], rotation=45)
    axis.minorticks_off()
    return _image(figure, "svg", f"{NAMES[dimension]}: longest bars over the floor, by M")


def _diagram_image(audit: Audit, dimension: int) -> tuple[str, str]:
    """Return (words, address) of the diagram of one dimension at the chosen density."""
    floor = next(rung.floor for rung in audit.rungs if rung.samples == _shown_samples(audit))
    limit = 1.08 * max([float(bars.max()) for bars in audit.diagram if len(bars)], default=1.0)
    bundle, target = audit.bundle, None
    if bundle is not None and dimension in bundle.dimensions:
        target = bundle.bars[dimension]
    title = NAMES[dimension] + (", star: target" if target is not None else "")
    figure, axes = new_figure(1, 1, 3.2, 3.2)
    draw_diagram(axes[0][0], audit.diagram[dimension], floor, limit, target, title)
    return _image(figure, "png", f"persistence diagram, {title}")  # thousands of dots: as pixels


def _image(figure: Figure, kind: str, words: str) -> tuple[str, str]:
    data = io.BytesIO()
    if kind == "svg":
        data.write(svg(figure))
    else:
        figure.savefig(data, format=kind)
    mime = "svg+xml" if kind == "svg" else kind
    return words, f"data:image/{mime};base64,{base64.b64encode(data.getvalue()).decode('ascii')}"
