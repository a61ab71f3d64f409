"""The audit as one self-contained HTML page: tables, diagrams, margins, commands, a 3-D view."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.axes import Axes

from paper_artifact.audit.marks import colour_of_mark, view_parts
from paper_artifact.audit.measure import Audit
from paper_artifact.audit.rule import NAMES, NOUNS, counted
from paper_artifact.audit.view import light_mesh
from paper_artifact.certify.certificate import certificate_text, verdict_text
from paper_artifact.export.figures import draw_diagram, new_figure, svg
from paper_artifact.export.viewer import html_page
from paper_artifact.topology.floor import MULTIPLIER

STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:1060px;margin:1.5em auto;padding:0 1em;color:#222}\n"
    "h1{font-size:1.5em;margin-bottom:.2em;overflow-wrap:anywhere}h2{font-size:1.1em;margin:1.4em 0 .4em}"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}\n"
    "td,th{border:1px solid #ccc;padding:.15em .6em;text-align:right}"
    "th{background:#f3f3f3}tr.chosen td{background:#e3edfb;font-weight:600}"
    "td small{font-weight:400;white-space:nowrap}\n"
    "pre{background:#f6f6f6;padding:.7em;overflow-x:auto;font-size:12.5px;margin:.4em 0}"
    ".command{display:flex;align-items:start;gap:.5em;margin:.4em 0}"
    ".command pre{flex:1;white-space:pre-wrap;overflow-wrap:anywhere;margin:0}\n"
    "button{font:inherit;font-size:13px;padding:.4em .8em;cursor:pointer}.wide{overflow-x:auto}"
    ".row{display:flex;flex-wrap:wrap;gap:.5em}.row img{flex:0 1 auto;min-width:0}"
    "iframe{width:100%;height:460px;border:1px solid #ccc;box-sizing:border-box}\n"
    ".pass{color:#1f5fbf}.fail{color:#b4521e}img{max-width:100%}li{margin:.2em 0;overflow-wrap:anywhere}"
)
COPY = (
    "document.querySelectorAll('.command button').forEach(b=>b.addEventListener('click',()=>{"
    "const p=b.parentElement.querySelector('pre'),s=getSelection(),r=document.createRange();"
    "r.selectNodeContents(p);s.removeAllRanges();s.addRange(r);"  # selected, where copying is not allowed
    "const done=()=>{b.textContent='copied';setTimeout(()=>b.textContent='copy',1500)};"
    "if(navigator.clipboard)navigator.clipboard.writeText(p.textContent).then(done,()=>0);"
    "else if(document.execCommand('copy'))done()}))"
)
WORDS = (
    "<b>M</b> is the number of points drawn on the surface, uniformly by area: the more, the finer the "
    "features that can be seen, and the slower the loss.",
    f"The <b>floor</b> is {MULTIPLIER:g} times the median distance between neighbouring points: what is "
    "shorter could be a gap between samples.",
    "A <b>bar</b> is one component, loop or void seen while balls grow around the points: from the radius at "
    "which it appears to the one at which it is filled; it is measurable when it is longer than the floor.",
)
SHOWN = 4  # bars per dimension in the staircase table


def audit_page(audit: Audit) -> str:
    """Return the page as text. Raises InputError when the mesh cannot be shown."""
    decision = audit.decision
    title = f"Audit of {audit.mesh.name}"
    kind = "pass" if audit.certificate.passed else "fail"
    samples = _shown_samples(audit)
    sections = [
        f"<h1>{html.escape(title)}</h1><p>Certificate: "
        f"<b class='{kind}'>{verdict_text(audit.certificate)}</b>. {html.escape(headline(audit))}</p>",
        "<h2>What to run next</h2>" + _next(audit),
        "<h2>Where it is</h2>" + _marks(audit, samples),
        "<h2>Certificate</h2>" + _pre(certificate_text(audit.certificate)),
        "<h2>Density staircase</h2>" + _list(WORDS, escape=False) + _staircase_table(audit),
        _row(_margin_image(audit, dimension) for dimension in range(3)),
        "<h2>Observable and density</h2>" + _list(decision.reasons),
        "<p><b>Warnings</b></p>" + _list(decision.warnings) if decision.warnings else "",
        f"<h2>Diagrams at M = {samples}</h2><p>Births and deaths are radii divided by the bounding-box "
        "diagonal; dotted: the floor. Large dots are measurable; a star is what the loss aims at.</p>"
        + _row(_diagram_image(audit, dimension) for dimension in range(3)),
        _bundle_section(audit),
    ]
    return (
        "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'><link rel='icon' href='data:,'>"
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>{''.join(sections)}"
        f"<script>{COPY}</script></body></html>\n"
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
    acts = " and ".join(NOUNS[d][1] for d in decision.dimensions)
    return (
        f"Measurable at M = {decision.samples}: {', '.join(found)}; the loss acts on {acts} at that density."
    )


def rung_text(audit: Audit, rung: int) -> str:
    """Return one rung of the staircase as a line: M, seed, floor, and what is measurable in words."""
    each = audit.rungs[rung]
    found = []
    for d, margins in enumerate(each.margins):
        longest = f" ({margins[0]:.2f})" if margins else ""
        found.append(f"{counted(d, each.counts[d], audit.decision.expected[d])}{longest}")
    return f"M = {each.samples:<6} seed {each.seed}  floor {each.floor:.4f}  " + "  ".join(
        f"{text:<22}" for text in found
    )


def _shown_samples(audit: Audit) -> int:
    return audit.decision.samples or max(rung.samples for rung in audit.rungs)


def _staircase_table(audit: Audit) -> str:
    expected = audit.decision.expected
    heads = ["M", "seed", "floor", *(f"{NOUNS[d][1]}<br><small>longest / floor</small>" for d in range(3))]
    rows = []
    for rung in audit.rungs:
        cells = [str(rung.samples), str(rung.seed), f"{rung.floor:.4f}"]
        for d, margins in enumerate(rung.margins):
            longest = " ".join(f"{margin:.2f}" for margin in margins[:SHOWN]) or "–"
            count = counted(d, rung.counts[d], expected[d]).rpartition(" ")[0]
            cells.append(f"{count}<br><small>{longest}</small>")
        chosen = " class='chosen'" if rung.samples == audit.decision.samples else ""
        rows.append(f"<tr{chosen}>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{text}</th>" for text in heads)
    return f"<div class='wide'><table><tr>{head}</tr>{''.join(rows)}</table></div>"


def _margin_image(audit: Audit, dimension: int) -> str:
    def draw(axis: Axes) -> None:
        samples = sorted({rung.samples for rung in audit.rungs})
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
        axis.set(xscale="log", title=NAMES[dimension], xlabel="samples M", ylabel="lifetime / floor")
        axis.set_ylim(bottom=0)
        axis.set_xticks(samples, [str(m) for m in samples], rotation=45)
        axis.minorticks_off()

    return _image(draw, 3.4, 2.4, "svg", f"{NAMES[dimension]}: longest bars over the floor, by M")


def _diagram_image(audit: Audit, dimension: int) -> str:
    floor = next(rung.floor for rung in audit.rungs if rung.samples == _shown_samples(audit))
    limit = 1.08 * max([float(bars.max()) for bars in audit.diagram if len(bars)], default=1.0)
    bundle, target = audit.bundle, None
    if bundle is not None and dimension in bundle.dimensions:
        target = bundle.bars[dimension]
    bars, title = (
        audit.diagram[dimension],
        NAMES[dimension] + (", star: target" if target is not None else ""),
    )

    def draw(axis: Axes) -> None:
        draw_diagram(axis, bars, floor, limit, target, title)

    return _image(draw, 3.2, 3.2, "png", f"persistence diagram, {title}")  # thousands of dots: as pixels


def _bundle_section(audit: Audit) -> str:
    if audit.bundle is None:
        return "<h2>Bundle</h2><p>None: nothing is measurable.</p>"
    lines = [f"{NAMES[d]}: {reason}" for d, reason in enumerate(audit.bundle.reasons)]
    return "<h2>Bundle</h2>" + _list(lines)


def _next(audit: Audit) -> str:
    commands = "".join(
        f"<div class='command'><pre>{html.escape(line)}</pre><button>copy</button></div>"
        for line in audit.commands
    )
    told = "The first trains from the images alone (C0)"
    if audit.bundle is not None:
        told += (
            "; the others add the loss, with this very bundle (same mesh, M, seed). Repeat them with "
            "--seed 1, --seed 2 for the protocol's three seeds"
        )
    if not audit.certificate.passed:
        told = (
            "The certificate fails, so the first two make one closed surface around the mesh and audit that; "
            "the rest train on the mesh as it is: " + told.replace("The first trains", "one trains")
        )
    return f"{commands}<p>{told}.</p>"


def _marks(audit: Audit, samples: int) -> str:
    light = light_mesh(audit.mesh)
    page = html.escape(html_page(view_parts(light, audit.marks), audit.mesh.name), quote=True)
    numbers = [0, 0, 0]
    lines = []
    for rank, mark in enumerate(audit.marks):
        numbers[mark.dimension] += 1
        what = ("gap before component", "loop", "void")[mark.dimension]
        number = numbers[mark.dimension] + int(mark.dimension == 0)
        sign = f"<span style='color:{colour_of_mark(rank)}'>■</span>"
        word = "measurable" if mark.measurable else "too short to be measured"
        lines.append(f"{sign} {what} {number}: {mark.margin:.2f} of the floor, {word}")
    told = (
        f"The longest bars at M = {samples}: a tube is a loop's cycle (the shortest way around it through "
        "the samples) or the gap between two components, a ball is the largest that fits into a void; balls "
        "are inside and show in the see-through view."
        if lines
        else f"No bar at M = {samples} is worth a mark."
    )
    return f"<p>{told}</p>{_list(lines, escape=False)}<iframe title='3-D view' srcdoc=\"{page}\"></iframe>"


def _image(draw: Callable[[Axes], None], width: float, height: float, kind: str, words: str) -> str:
    figure, axes = new_figure(1, 1, width, height)
    draw(axes[0][0])
    data = io.BytesIO()
    if kind == "svg":
        data.write(svg(figure))
    else:
        figure.savefig(data, format=kind)
    mime = "svg+xml" if kind == "svg" else kind
    text = base64.b64encode(data.getvalue()).decode("ascii")
    return f"<img alt='{html.escape(words, quote=True)}' src='data:image/{mime};base64,{text}'>"


def _row(images: Iterable[str]) -> str:
    return f"<div class='row'>{''.join(images)}</div>"


def _list(lines: Iterable[str], escape: bool = True) -> str:
    items = "".join(f"<li>{html.escape(line) if escape else line}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def _pre(text: str) -> str:
    return f"<pre>{html.escape(text)}</pre>"
