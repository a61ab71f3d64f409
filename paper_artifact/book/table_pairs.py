"""The paper's fifteen tables, each as pairs of ours and the paper's. Which pairs: `items.csv`, in words."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import product

import numpy as np
import pandas as pd

from paper_artifact.book.htmltable import Rows
from paper_artifact.book.pairs import Pair, equal, one_of, sides, within, within_text
from paper_artifact.book.sources import Sources
from paper_artifact.report import group_wave, knobs, literature, staircase, windows
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.text import NOT_RECORDED, arm_text
from paper_artifact.study.verdict import LOSS

ABLATIONS = ("C2", "C2g", "C3", "C5", "C6", "C7", "C7h")


def table_1(sources: Sources) -> list[Pair]:
    """Each arm against C0, and C1 against the control."""
    pairs = [(arm, "C0") for arm in (LOSS, *ABLATIONS)] + [(LOSS, "C2")]
    return sides(sources.study("table1"), ("1", "noise", "ablations"), pairs)


def table_2(sources: Sources) -> list[Pair]:
    """C1 and C2 against C0, C1 against C2, and the two groups' mean ratios."""
    pairs = sides(sources.study("table2"), ("2",), ((LOSS, "C0"), ("C2", "C0"), (LOSS, "C2")))
    arms = frames.arms(sources.study("table2")).set_index(frames.ARM)
    for row in frames.paper("ratio_C0_over_C1", "2").itertuples():
        members = [shape for shape in frames.shapes(sources.study("table2")) if _group(shape) == row.shape]
        ratios = [arms["ratio"][shape, LOSS] for shape in members]
        if any(map(pd.isna, ratios)):
            pairs.append(Pair(f"{row.shape}: C0 / C1", NOT_RECORDED, row.printed, None))
            continue
        mean, sd = float(np.mean(ratios)), float(np.std(ratios, ddof=1))
        holds = abs(mean - row.value) <= sd + row.sd
        pairs.append(
            Pair(f"{row.shape}: C0 / C1", f"{mean:.2f} ± {sd:.2f}", f"{row.printed} ± {row.sd}", holds)
        )
    return pairs


def _group(shape: str) -> str:
    from paper_artifact.catalogue import shape_row

    row = shape_row(shape)
    return row.group if row else ""


def table_s1(sources: Sources) -> list[Pair]:
    """Per probe: by which factor B's bottleneck is above A's, and which of the two Hausdorff95 prefers."""
    rows = {row[0]: row[1:] for row in sources.table("02_blindness_probes", "paper's B", "bottleneck B")}
    if not rows:
        return [Pair("all three probes", NOT_RECORDED, "Table S1", None)]
    pairs = []
    for place, case in enumerate(rows["case"]):
        ours = [_number(rows[f"bottleneck {each}"][place]) for each in "BA"]
        paper = [_number(rows[f"paper's {each}"][place]) for each in "BA"]
        texts = [f"{each[0]:.4f} to {each[1]:.4f}" for each in (ours, paper)]
        pairs.append(
            Pair(f"{case}: bottleneck of B above ten times A's", *texts, _ten(*ours) == _ten(*paper))
        )
        seeds = set(rows["Hausdorff95 prefers"][place].split("/"))
        printed = rows["paper: prefers"][place]
        pairs.append(
            Pair(f"{case}: Hausdorff95 prefers", "/".join(sorted(seeds)), printed, seeds == {printed})
        )
    return pairs


def _ten(large: float, small: float) -> bool:
    return large > 10 * small


def _number(text: str) -> float:
    return float(re.findall(r"\d*\.?\d+", text)[0])


def table_s2(sources: Sources) -> list[Pair]:
    """B1 to B5 against B0, spread against concentrated, topological against random."""
    arms = [(arm, "C0") for arm in ("B1", "B2", "B3", "B4", "B5")]
    against = (*arms, ("B4", "B2"), ("B2", "B3"), ("B4", "B5"))
    variation = published("plans").set_index("quantity")["value"]["tail_cv_percent_high"] / 100
    return sides(sources.study("allocation"), ("S2",), against, variation)


def _staircase(table: pd.DataFrame, prefix: str = "") -> list[Pair]:
    """Every density of a table of ours above the paper's (`beside_published`)."""
    pairs = []
    for shape in table.index.unique(0):
        if (shape, "paper") in table.index:
            for level in table.columns:
                ours, paper = table.loc[(shape, "ours"), level], table.loc[(shape, "paper"), level]
                if isinstance(paper, str):
                    pairs.append(one_of(f"{prefix}{shape}, {level}", ours, paper))
    return pairs


def table_s3(sources: Sources) -> list[Pair]:
    """Significant H1 / H2 per shape and density: the paper's counts are those of one of our seeds."""
    return _staircase(staircase.table_s3(sources.measured("staircase")))


def table_s4(sources: Sources) -> list[Pair]:
    """Every number of the inventory: the stand-in's beside the pot's."""
    rows = sources.table("11_hot_pot", "paper's pot", "stand-in", "open shells")
    head = next((row for row in rows if "stand-in" in row), [])
    pairs = []
    for row in rows:
        cells = dict(zip(head, row, strict=True))
        if row[0] and row is not head and cells["paper's pot"]:
            ours = cells["stand-in"].split(", voids")[0]
            pairs.append(equal(row[0], ours, cells["paper's pot"]))
    return pairs or [Pair("the inventory", NOT_RECORDED, "Table S4", None)]


def table_s5(sources: Sources) -> list[Pair]:
    """The counts per density: the paper's are those of one of our seeds."""
    ours = sources.cells("11_hot_pot", "stand-in", "paper's pot", "void / floor")
    paper = sources.cells("11_hot_pot", "paper's pot", "void / floor")
    pairs = [one_of(f"M = {level}", ours[level], paper[level]) for level in paper if paper[level]]
    return pairs or [Pair("the staircase", NOT_RECORDED, "Table S5", None)]


def table_s6(sources: Sources) -> list[Pair]:
    """Every method of the table has a source."""
    methods, found = published("S6")["method"], literature.sources()
    own = ("DiffSoup + prior (§ A)", "this work")  # the paper's own rows have no source
    wanted = sorted(set(methods) - set(own))
    named = sum(method in set(found["method"]) for method in wanted)
    read = found[found["checked"] == "abstract"]["method"].nunique()
    ours = f"{named}, {read} of them held against the abstract"
    return [Pair("methods with a source", ours, str(len(wanted)), named == len(wanted))]


def table_s7(sources: Sources) -> list[Pair]:
    """The verdict per shape, by the study's rule on the seeds of both."""
    ours, paper = (frames.verdicts(sources.study("table1", "table2")), frames.paper_verdicts("S7"))
    return [
        equal(f"{shape}: verdict", ours[shape].outcome if shape in ours else None, paper[shape].outcome)
        for shape in frames.shapes_in_order(paper)
    ]


def table_s8(sources: Sources) -> list[Pair]:
    """Every setting against the default: do the tails differ by more than both standard deviations?"""
    collected = sources.study("table1", "knobs")
    arms = frames.arms(collected).set_index(frames.ARM)
    printed = published("S8")
    spread = printed[printed["setting"] == "20-50%"]["sd"].item()
    pairs = []
    for knob, own in printed.groupby("knob", sort=False):
        names = own["setting"].map(lambda setting, knob=knob: knobs.knob_arm(knob, setting))
        default = own[names == LOSS].iloc[0]
        for row, arm in zip(own.itertuples(), names, strict=True):
            if arm == LOSS:
                continue
            sd = spread if pd.isna(row.sd) else row.sd  # ρ is printed for one seed
            same = abs(row.value - default["value"]) <= sd + spread
            paper = f"{arm_text(row.value, row.sd)} to {arm_text(default['value'], default['sd'])}"
            what = f"{knob} {row.setting}: no difference to the default"
            found = arms.loc[(row.shape, arm)] if (row.shape, arm) in arms.index else None
            base = arms.loc[(row.shape, LOSS)]
            if found is None or not found["tails"] or not base["tails"]:
                pairs.append(Pair(what, NOT_RECORDED, paper, None))
                continue
            level = abs(found["mean"] - base["mean"]) <= found["sd"] + base["sd"]
            ours = f"{arm_text(found['mean'], found['sd'])} to {arm_text(base['mean'], base['sd'])}"
            pairs.append(Pair(what, ours, paper, bool(level) == bool(same)))
    return pairs


def table_s9(sources: Sources) -> list[Pair]:
    """The margins of void and rim at each density: the paper's lie in the range of our seeds."""
    rows = sources.table("12_bowls", "H2, paper", "H2, range")
    head = next((row for row in rows if "H2, paper" in row), [])
    pairs = []
    for row, bar in product(rows, ("H2", "H1")):
        cells = dict(zip(head, row, strict=True))
        paper = cells[f"{bar}, paper"]
        if re.fullmatch(r"\d*\.?\d+", paper):
            pairs.append(within_text(f"{row[0]}, M = {row[1]}, {bar}", cells[f"{bar}, range"], paper))
    return pairs or [Pair("the staircase", NOT_RECORDED, "Table S9", None)]


def table_s10(sources: Sources) -> list[Pair]:
    """C1 and C2 against C0, C1 against C2."""
    return sides(sources.study("bowls"), ("S10",), ((LOSS, "C0"), ("C2", "C0"), (LOSS, "C2")))


def table_s11(sources: Sources) -> list[Pair]:
    """The counts per shape and density, and the lifetimes and margins that App. G names."""
    stored = sources.measured("group_wave")
    pairs = _staircase(group_wave.table_s11(stored))
    for (shape, samples, what), row in group_wave.quoted_table(stored).iterrows():
        holds = {"yes": True, "no": False}.get(row["paper in range"])
        pairs.append(
            Pair(
                f"{shape}, M = {samples}, {what}",
                f"{row['least']}–{row['largest']}",
                str(row["paper"]),
                holds,
            )
        )
    return pairs


def table_s12(sources: Sources) -> list[Pair]:
    """The certificate of every candidate: what it says first ("pass (g1)", "fail")."""
    rows: Rows = sources.table("10_group_wave", "paper's origin", "agrees")
    head = next((row for row in rows if "agrees" in row), [])
    pairs = []
    for row in rows:
        cells = dict(zip(head, row, strict=True))
        if cells["agrees"] in ("yes", "NO", "—"):
            missing = cells["agrees"] == "—"
            holds = None if missing else cells["agrees"] == "yes"
            pairs.append(
                Pair(row[0], "could not be had" if missing else cells["ours"], cells["paper"], holds)
            )
    return pairs or [Pair("the candidates", NOT_RECORDED, "Table S12", None)]


def table_s13(sources: Sources) -> list[Pair]:
    """The margins that bind, shape by shape: the paper's lie in the range of our seeds; and the window."""
    margins = sources.measured("windows")
    table = windows.table_s13(margins)
    pairs = []
    for shape, row in table.iterrows():
        for which in ("IN", "OUT"):
            if row[f"paper's {which}"] != "—":
                pairs.append(
                    within_text(f"{shape}, {which}", row[f"{which}, seeds"], row[f"paper's {which}"])
                )
    found = windows.global_window(margins)
    seeds = next(name for name in found.index if "seeds: least" in name)
    for end in ("k from", "k to"):
        least, _, largest = map(float, found.loc[seeds, end].split("–"))
        printed = found.loc["paper", end]
        pairs.append(within(f"the window, {end}", float(printed), printed, (least, largest)))
    return pairs


TABLES: Mapping[str, Callable[[Sources], list[Pair]]] = {
    "Table 1": table_1,
    "Table 2": table_2,
    "Table S1": table_s1,
    "Table S2": table_s2,
    "Table S3": table_s3,
    "Table S4": table_s4,
    "Table S5": table_s5,
    "Table S6": table_s6,
    "Table S7": table_s7,
    "Table S8": table_s8,
    "Table S9": table_s9,
    "Table S10": table_s10,
    "Table S11": table_s11,
    "Table S12": table_s12,
    "Table S13": table_s13,
}
