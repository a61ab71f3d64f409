"""Notebook 15: where the paper contradicts itself, each with its arithmetic, from the published values alone.

Nothing here uses a run of ours; what our runs say of a point stands in the notebook that the last column
names.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from paper_artifact.report.kit import frames
from paper_artifact.report.kit.published import PUBLISHED, published
from paper_artifact.report.kit.text import blank, counts_text
from paper_artifact.topology.matching import match_bars

EUCLIDEAN_DIAGONAL = 0.5  # of (d - b)²: what W2 with the Euclidean ground metric charges a bar left alone
LOSS_ARMS = ("C1", "C3", "C5", "C6", "C7", "C7h")  # of the paper; each logs its refreshes


def rows(table: str, **keys: Any) -> pd.DataFrame:
    """Return the rows of a published table that have these values in these columns."""
    frame = published(table)
    for name, value in keys.items():
        frame = frame[frame[name] == value]
    return frame


def value(table: str, **keys: Any) -> float:
    """Return the value of the one row of a published table that these columns name; ValueError otherwise."""
    return float(rows(table, **keys)["value"].item())


def tails(condition: str, *tables: str) -> pd.DataFrame:
    """Return the paper's mean tails of a condition (value, sd, seeds), by shape."""
    found = pd.concat([rows(table, condition=condition, quantity="tail_bottleneck") for table in tables])
    if "seed" in found:
        found = found[found["seed"].isna()]
    return found.drop_duplicates("shape").set_index("shape")


def welch(first: pd.Series, second: pd.Series, seeds: tuple[float, float]) -> float:
    """Return |mean a − mean b| / sqrt(sd a² / n + sd b² / m) of two printed arms."""
    variance = first["sd"] ** 2 / seeds[0] + second["sd"] ** 2 / seeds[1]
    return float(abs(first["value"] - second["value"]) / math.sqrt(variance))


def _single_bar() -> tuple[str, str]:
    logged, missing = (
        value("plans", shape="eight", quantity="recruited_bars"),
        value("plans", quantity="missing_targets"),
    )
    return (
        f"eight recruits {logged:.0f} bars at its first refreshes, §3.3 allows {missing:.0f}",
        "two, not one",
    )


def _identical() -> tuple[str, str]:
    counts = published("plans")
    counts = counts[counts["quantity"].str.startswith("significant_count_seed")]
    texts = [
        f"{shape} {condition} {counts_text(own['value'].astype(int))}"
        for (shape, condition), own in counts.groupby(frames.ARM, sort=False)
    ]
    return (
        f"seed by seed in the text: {', '.join(texts)}",
        "not of the wave; which shapes are shown is not said",
    )


def _never_clear() -> tuple[str, str]:
    own = rows("S11", shape="rocker-arm", quantity="significant_count")
    counts = own.pivot(index="samples", columns="dimension", values="value").astype(int)
    loops = [f"{samples:.0f}" for samples in counts.index[counts[1] >= 2]]
    voids = [f"{samples:.0f}" for samples in counts.index[counts[2] >= 1]]
    return (
        f"its row counts two loops at M = {', '.join(loops)} and a void at M = {', '.join(voids)}",
        "the loop clears it, and the void above M = 2048",
    )


def _rocker_floor() -> tuple[str, str]:
    lifetime = value("S11", shape="rocker-arm", quantity="lifetime", samples=20_000)
    margin = value("S11", shape="rocker-arm", quantity="top_bar_over_floor", samples=20_000)
    floor = value("S11", shape="rocker-arm", quantity="floor", samples=2048)
    law = floor * math.sqrt(2048 / 20_000)
    return (
        f"{lifetime:.4f} / {margin} = {lifetime / margin:.4f}; the law takes its own floor from "
        f"{floor:.4f} to {law:.4f}",
        f"floors {100 * (1 - lifetime / margin / law):.0f} % apart",
    )


def _tube_ratio() -> tuple[str, str]:
    floor = value("floor", shape="double_torus", quantity="floor")
    lifetime = value("floor", shape="double_torus", quantity="lifetime")
    pin = value("1", shape="double_torus", condition="C0")
    printed = value("floor", shape="double_torus", quantity="lifetime_over_floor", samples=20_000)
    low, high = (math.floor(lifetime * 1000) / 1000, math.ceil(lifetime * 1000) / 1000)
    return (
        f"{low:.3f}–{high:.3f} over {floor:.4f} is {low / floor:.2f}–{high / floor:.2f}; "
        f"twice the pin, {2 * pin:.4f}, over it is {2 * pin / floor:.2f}",
        f"{lifetime / floor:.2f}, not {printed}; the lifetime belongs to another M",
    )


def _floor_anchor() -> tuple[str, str]:
    torus, end = (
        value("floor", shape="torus", quantity="floor"),
        value("floor", shape="double_torus", quantity="floor"),
    )
    law = torus * math.sqrt(2048 / 20_000)
    return (
        f"{torus:.4f} · sqrt(2048 / 20000) = {law:.4f}, the caption ends at {end:.4f}",
        "another shape's floor",
    )


def _variation() -> tuple[str, str]:
    arms = pd.concat({name: tails(name, "1", "2", "S10") for name in ("C0", "C1", "C3", "C5", "C6")})
    arms = arms[(arms["sd"] > 0) & (arms["value"] > 0)]
    cv = (100 * arms["sd"] / arms["value"]).sort_values()
    low, high = (value("plans", quantity=f"tail_cv_percent_{end}") for end in ("low", "high"))
    inside = cv.between(low - 0.5, high + 0.5)
    ends = [f"{name[1]} {name[0]} {cv[name]:.1f} %" for name in (cv.index[0], cv.index[-1])]
    return (
        f"sd / mean of its tables: {ends[0]} to {ends[1]}, median {cv.median():.1f} %",
        f"{inside.sum()} of {len(cv)} arms lie in {low:.0f}–{high:.0f} %",
    )


def _no_ramp() -> tuple[str, str]:
    texts = []
    for shape, seeds, where in (("sphere", 5, "1"), ("torus", 5, "1"), ("bob", 3, "2")):
        plain = tails("C1", where).loc[shape]
        constant = tails("C3", "1" if where == "1" else "ablations").loc[shape]
        texts.append(f"{shape} {welch(plain, constant, (seeds, seeds)):.1f}")
    return f"Welch of its own numbers, C1 against C3: {', '.join(texts)} σ", "C3 is better on two of three"


def _two_baselines() -> tuple[str, str]:
    texts = []
    for shape in ("sphere", "torus"):
        own, other = tails("C0", "1").loc[shape], tails("B0", "S2").loc[shape]
        sigma = abs(own["value"] - other["value"]) / (own["sd"] * math.sqrt(2 / own["seeds"]))
        texts.append(
            f"{shape} B0 {other['printed']}, C0 {own['printed']} ({sigma:.1f} σ with C0's sd for both)"
        )
    return "; ".join(texts), "not one pipeline, or more noise than printed"


def _default_ramp() -> tuple[str, str]:
    default = rows("S8", setting="20-50%").iloc[0]
    main = tails("C1", "1").loc["sphere"]
    return (
        f"three seeds {default['printed']}±{default['sd']:.4f}; five seeds (Table 1) "
        f"{main['printed']}±{main['sd']:.4f}",
        "the five-seed value" if (default[["value", "sd"]] == main[["value", "sd"]]).all() else "two values",
    )


def _wasserstein() -> tuple[str, str]:
    live, target = np.array([[0.06, 0.16]]), np.array([[0.0, 0.1]])
    pair = float(np.square(live - target).sum())
    alone = float(np.square(np.diff(np.vstack([live, target]), axis=1)).sum())
    found = [len(match_bars(live, target, factor).matched) for factor in (0.25, EUCLIDEAN_DIAGONAL)]
    return (
        f"bars (.06, .16) and (0, .1): together {pair:.4f}, alone {0.25 * alone:.4f} by the printed cost, "
        f"{EUCLIDEAN_DIAGONAL * alone:.4f} in W2: matched {found[0]} and {found[1]}",
        "another matching",
    )


def _ceiling() -> tuple[str, str]:
    pin, samples = value("1", shape="double_torus", condition="C1"), 2048
    below = rows("floor", shape="double_torus", quantity="lifetime_over_floor", samples=samples)["printed"]
    counts = rows("S3", shape="double_torus", samples=4096, dimension=1)["printed"].item()
    return (
        f"the loss ran at M = {samples}, where the tubes stand at {'–'.join(below)} of the floor and are no "
        f"target; the pin {pin:.4f} is half a bar that nothing asked for; all {counts} loops clear the floor "
        "at 4096",
        "untested: the loss never had the tubes",
    )


def _refreshes() -> tuple[str, str]:
    printed, per_run = (
        value("plans", quantity="logged_refreshes"),
        value("plans", quantity="refreshes_per_run"),
    )
    arms = pd.concat([published(name) for name in ("1", "noise")])
    arms = arms[(arms["quantity"] == "tail_bottleneck") & arms["condition"].isin(LOSS_ARMS)]
    runs = arms["seeds"].sum()
    return (
        f"Table 1 and the noise runs alone are {runs:.0f} runs with the loss × {per_run:.0f} = "
        f"{runs * per_run:.0f}",
        f"{printed:.0f} is {100 * printed / (runs * per_run):.0f} % of them: not every run was logged",
    )


def _spot() -> tuple[str, str]:
    pin = rows("2", shape="spot", condition="C1")["printed"].item()
    return (
        f"C1 reads {pin} with sd 0: half of a bar of {2 * float(pin):.4f} that nothing matches",
        "a void of the surface",
    )


def _positions() -> tuple[str, str]:
    least, most = (
        rows("plans", quantity=f"positions_per_pair_{end}")["printed"].item() for end in ("least", "most")
    )
    return (
        "an H0 pair is one edge: 2 positions; H1 edge and triangle, 3–5; H2 triangle and tetrahedron, 4–7 "
        f"(printed {least}–{most})",
        "true of loops and voids",
    )


ARITHMETIC: dict[str, Callable[[], tuple[str, str]]] = {  # key in claims.csv: numbers, and what they come to
    "single_bar": _single_bar,
    "identical": _identical,
    "never_clear": _never_clear,
    "rocker_floor": _rocker_floor,
    "tube_ratio": _tube_ratio,
    "floor_anchor": _floor_anchor,
    "variation": _variation,
    "no_ramp": _no_ramp,
    "two_baselines": _two_baselines,
    "default_ramp": _default_ramp,
    "wasserstein": _wasserstein,
    "ceiling": _ceiling,
    "refreshes": _refreshes,
    "spot": _spot,
    "positions": _positions,
}


def error_table() -> pd.DataFrame:
    """Return the errors found, a row each: the claim, where it stands, the arithmetic from published values,
    what it comes to, and the notebook that has our own measurement of it."""
    table = {}
    for row in pd.read_csv(PUBLISHED / "claims.csv", dtype=str).itertuples():
        numbers, outcome = ARITHMETIC[row.key]()
        table[row.claim] = {"where": row.where, "arithmetic": numbers, "comes to": outcome, "ours": row.ours}
    return pd.DataFrame.from_dict(table, orient="index").rename_axis("the paper says")


def variation_table() -> pd.DataFrame:
    """Return sd / mean (percent) of every arm whose sd the paper prints, shapes × conditions, behind the
    claim of 7–10 %."""
    arms = frames.paper_arms("tail_bottleneck", "1", "2", "S10", "noise", "ablations")
    arms = arms[(arms["sd"] > 0) & (arms["value"] > 0)]
    cv = (100 * arms["sd"] / arms["value"]).round(1).set_axis(pd.MultiIndex.from_frame(arms[frames.ARM]))
    table = cv.unstack("condition")
    return blank(table.loc[frames.shapes_in_order(table.index)])
