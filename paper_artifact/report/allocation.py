"""Notebook 13: the allocation study (App. A, Table S2): importance fields on their surfaces, the search of
the levers' strengths, tails, the torus's counts, verdicts.

The study's baseline B0 is C0: the same runs. Chamfer is the SUM of both directions, in percent of the
diagonal, as the paper gives it for this study.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from paper_artifact.catalogue import BASELINE, PRIOR, shape_row, study_config, tag_of
from paper_artifact.export.flat import render_flat
from paper_artifact.mesh import Mesh
from paper_artifact.pipeline import make_run_importance
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import image_rows
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.tables import beside
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text, blank, counts_text, range_text
from paper_artifact.sampling import face_areas
from paper_artifact.scene.shapes import surface
from paper_artifact.study.verdict import Verdict, verdict, welch_sigma
from paper_artifact.topology.importance import ImportanceField

B0 = "B0"  # the paper's name of the baseline
# What the appendix asks, as (question, the arm that is judged, the control that it must beat).
QUESTIONS = (
    ("spread beats concentrated?", "B4", "B2"),
    ("narrow: topological beats random?", "B2", "B3"),
    ("wide: topological beats random?", "B4", "B5"),
)
FIELD_ARMS = ("B2", "B4", "B5")
GRID = ("protection", "subdivided")


def run_field(shape: str, condition: str, seed: int = 0) -> tuple[Mesh, ImportanceField]:
    """Return the mesh of a shape and the importance field that a run of that arm and seed has."""
    mesh, config = surface(shape), study_config(shape, condition, seed)
    return mesh, make_run_importance(config, config.allocation, mesh)


def field_figure(
    shapes: Iterable[str], conditions: Iterable[str] = FIELD_ARMS, seed: int = 0, size: int = 220
) -> Figure:
    """Return pictures of the surfaces, a row per arm, a column per shape, coloured by the importance at the
    faces' centroids."""
    shapes, rows = list(shapes), []
    for condition in conditions:
        images = []
        for shape in shapes:
            mesh, field = run_field(shape, condition, seed)
            importance = field(mesh.vertices[mesh.faces].mean(axis=1))
            colours = colormaps["viridis"](importance)[:, :3]
            up = row.up if (row := shape_row(shape)) else (0.0, 0.0, 1.0)
            images.append(render_flat(mesh.vertices, mesh.faces, size, up=up, material=colours))
        rows.append((condition, images))
    figure = image_rows(rows, 1.7)
    pictures = list(figure.axes)
    for axis, shape in zip(pictures, shapes, strict=False):
        axis.set_title(shape)
    scale = ScalarMappable(Normalize(0, 1), "viridis")
    figure.colorbar(scale, ax=pictures, label="importance (no unit), before shading", shrink=0.6)
    return figure


def field_table(shapes: Iterable[str], conditions: Iterable[str] = FIELD_ARMS, seed: int = 0) -> pd.DataFrame:
    """Return the figure's numbers per shape and arm: the importance's least value, mean and the share of the
    area above one half."""
    rows = {}
    for shape in shapes:
        for condition in conditions:
            mesh, field = run_field(shape, condition, seed)
            importance, area = (
                field(mesh.vertices[mesh.faces].mean(axis=1)),
                face_areas(mesh.vertices, mesh.faces),
            )
            rows[shape, condition] = {
                "least": importance.min(),
                "mean": np.average(importance, weights=area),
                "area above .5, %": 100 * np.average(importance > 0.5, weights=area),
            }
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis(frames.ARM)
    return table.round({"least": 2, "mean": 2, "area above .5, %": 0})


def search_frame(collected: Collected) -> pd.DataFrame:
    """Return one row per setting of the search that has a record: protection, subdivided, seeds, mean (of the
    tails), chamfer sum %."""
    rows = []
    for arm in frames.arms(collected).itertuples():
        found = dict(re.findall(r"(\w+)=([\d.]+)", arm.condition))
        if arm.seeds and set(found) == set(GRID):
            values = {name: float(found[name]) for name in GRID}
            rows.append(values | {"seeds": len(arm.seeds), "mean": arm.mean, "chamfer %": 200 * arm.chamfer})
    return pd.DataFrame(rows, columns=[*GRID, "seeds", "mean", "chamfer %"])


def search_table(collected: Collected) -> pd.DataFrame:
    """Return the search: λ down, the subdivided share across; mean tail of B4 and its Chamfer (sum, %)."""
    found = search_frame(collected)
    cells = [f"{arm_text(row.mean)}, {row[-1]:.2f} %" for row in found.itertuples(index=False)]
    return blank(found.assign(cell=cells).pivot(index=GRID[0], columns=GRID[1], values="cell"))


def search_text(collected: Collected) -> str:
    """Return the setting that the rule chooses (the mean tail nearest to the paper's B4 on the sphere; weaker
    levers where tied) and whether it is the one that the catalogue's PRIOR froze."""
    frozen = f"frozen in the catalogue: protection {PRIOR.protection:g}, subdivided {PRIOR.subdivided:g}"
    if collected.missing or not collected.records:
        return f"the rule needs every run of the search; {frozen}"
    found = search_frame(collected)
    away = (found["mean"] - paper_arms()["value"]["sphere", "B4"]).abs()
    best = found.assign(away=away).sort_values(["away", *GRID]).iloc[0]
    same = (best[GRID[0]], best[GRID[1]]) == (PRIOR.protection, PRIOR.subdivided)
    chosen = f"the rule chooses protection {best[GRID[0]]:g}, subdivided {best[GRID[1]]:g}"
    return f"{chosen}; {frozen}: {'the same' if same else 'NOT THE SAME'}"


def paper_arms(quantity: str = "tail_bottleneck") -> pd.DataFrame:
    """Return the paper's arms of the study, its B0 under our baseline's name."""
    frame = frames.paper_arms(quantity, "S2")
    return frame.assign(condition=frame["condition"].replace(B0, BASELINE)).set_index(frames.ARM)


def allocation_table(collected: Collected) -> pd.DataFrame:
    """Return Table S2: a row per shape, two columns per arm: ours (mean ± sd of the tails) beside the
    paper's."""
    arms = frames.arms(collected).set_index(frames.ARM)
    ours = arms.apply(lambda arm: arm_text(arm["mean"], arm["sd"]) if arm["seeds"] else NOT_RECORDED, axis=1)
    table = beside(ours, paper_arms()["printed"], across="condition")
    return table.rename(columns={BASELINE: f"{B0} = {BASELINE}"}, level=0)


def gain_table(collected: Collected) -> pd.DataFrame:
    """Return per shape how far each arm's mean lies below the baseline's, in percent of it (negative: above),
    ours beside the paper's."""
    ours, paper = (
        frame.set_index(frames.ARM)[column].astype(float)
        for frame, column in ((frames.arms(collected), "mean"), (paper_arms().reset_index(), "value"))
    )
    texts = []
    for means in (ours, paper):
        table = means.unstack("condition")
        gains = 100 * (1 - table.div(table[BASELINE], axis=0)) if BASELINE in table else table
        texts.append(gains.drop(columns=BASELINE, errors="ignore").stack().dropna().map("{:.0f} %".format))
    index = ours.index[ours.index.get_level_values("condition") != BASELINE]
    return beside(texts[0].reindex(index), texts[1], across="condition")


def torus_table(collected: Collected, shape: str = "torus") -> pd.DataFrame:
    """Return the torus paragraph, a row per arm: tail, mean of the final significant counts (and seed by
    seed), Chamfer (sum, %), each ours beside the paper's."""
    arms = frames.arms(collected).set_index("shape").loc[[shape]].set_index("condition")
    recorded = arms[arms["seeds"].map(len) > 0]
    table = pd.DataFrame(
        {
            "tail": recorded["mean"].map(arm_text),
            "loops": recorded["counts"].map(lambda counts: f"{np.mean(counts):.1f} ({counts_text(counts)})"),
            "Chamfer %": (200 * recorded["chamfer"]).map("{:.2f}".format),
        },
        index=arms.index,
    )
    quantities = ("tail_bottleneck", "significant_count", "chamfer_percent")
    for name, quantity in zip(list(table), quantities, strict=True):
        own = paper_arms(quantity)["printed"]
        table[f"{name}, paper"] = own[own.index.get_level_values(0) == shape].droplevel(0)
    order = [text for name in ("tail", "loops", "Chamfer %") for text in (name, f"{name}, paper")]
    return blank(table[order]).rename(index={BASELINE: f"{B0} = {BASELINE}"})


def torus_text(collected: Collected, shape: str = "torus") -> str:
    """Return the paragraph's claims, each with yes or no by our runs: does any prior pass, is the random wide
    control best, does B2 make phantom loops, has B2 the worst Chamfer."""
    arms = frames.arms(collected)
    arms = arms[(arms["shape"] == shape) & (arms["seeds"].map(len) > 0)].set_index("condition")
    absent = [name for name in (BASELINE, "B2", "B3", "B4", "B5") if name not in arms.index]
    if absent:
        return f"no runs of {', '.join(absent)} on the {shape}"
    expected = frames.runs(collected).query("shape == @shape")["expected"].max()
    passed = [name for name in ("B2", "B4") if _judged(collected, name, _random_twin(name))[shape].passed]
    phantoms = {name: np.mean(counts) - expected for name, counts in arms["counts"].items()}
    worst = arms["chamfer"].idxmax()
    lines = {
        "every topological prior fails against its random twin": not passed,
        f"the best arm is B5 (ours: {_b0(arms['mean'].idxmin())})": arms["mean"].idxmin() == "B5",
        f"B2 is the worst arm (ours: {_b0(arms['mean'].idxmax())})": arms["mean"].idxmax() == "B2",
        f"B2 makes phantom loops (ours: {phantoms['B2']:+.1f} a run)": phantoms["B2"] > 0,
        f"B2 has the worst Chamfer (ours: {_b0(worst)})": worst == "B2",
    }
    return "\n".join(f"{claim}: {'yes' if holds else 'no'}" for claim, holds in lines.items())


def verdict_table(collected: Collected) -> pd.DataFrame:
    """Return per shape and question the verdict of the study's own rule on our runs (the arm's tails below
    the baseline's and the control's, ranges disjoint, Chamfer at parity) with its reason; how the arm's range
    lies to the control's alone; Welch's sigma between control and arm, positive where the arm is lower, ours
    beside the paper's; and the paper's two means."""
    means, sigmas = paper_arms(), paper_arms("welch_sigma")
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for question, arm, control in QUESTIONS:
        for shape, judged in _judged(collected, arm, control).items():
            pair = [judged.arms[name].tails for name in (control, arm) if name in judged.arms]
            sigma = welch_sigma(*pair) if len(pair) == 2 else None
            quoted = (shape, f"{arm} vs {control}")
            printed = (sigmas["printed"][quoted] or sigmas["note"][quoted]) if quoted in sigmas.index else ""
            known = all((shape, name) in means.index for name in (arm, control))
            rows[shape, f"{arm} vs {control}: {question}"] = {
                "ours": judged.outcome,
                "range to control's": range_text(*reversed(pair)) if len(pair) == 2 else "",
                "Welch": "" if sigma is None else f"{sigma:.1f}",
                "Welch, paper": printed,
                "paper's means": " / ".join(means["printed"][shape, name] for name in (arm, control))
                if known
                else "",
                "reason": judged.reason,
            }
    order = sorted(rows, key=lambda each: frames.shapes(collected).index(each[0]))
    index = pd.MultiIndex.from_tuples(order, names=["shape", "question"]) if order else None
    return pd.DataFrame([rows[each] for each in order], index=index)


def start_text(collected: Collected, shape: str = "sphere") -> str:
    """Return B1, the prior at initialisation only, beside the baseline, ours and the paper's: does one-shot
    placement wash out?"""
    judged = _judged(collected, "B1", "B2").get(shape)
    if judged is None or not {"B1", BASELINE} <= set(judged.arms):
        return f"no runs of B1 and {BASELINE} on the {shape}"
    printed, ours = paper_arms()["printed"], [judged.arms[name] for name in ("B1", BASELINE)]
    sigma = welch_sigma(ours[1].tails, ours[0].tails)
    means = " against ".join(arm_text(arm.mean, arm.sd) for arm in ours)
    theirs = " against ".join(printed[shape, name] for name in ("B1", BASELINE))
    welch = "" if sigma is None else f", Welch {abs(sigma):.1f}"
    return f"B1 on the {shape}: {means}{welch} (paper {theirs})"


def _judged(collected: Collected, arm: str, control: str) -> dict[str, Verdict]:
    return verdict(frames.runs(collected), (control,), arm)


def _random_twin(condition: str) -> str:
    return {arm: control for _, arm, control in QUESTIONS[1:]}[condition]


def _b0(condition: str) -> str:
    return B0 if tag_of(condition) == BASELINE else condition
