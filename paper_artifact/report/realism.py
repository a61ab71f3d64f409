"""Notebook 16: the troubles of real scenes, one at a time: where C1 breaks, where T1 and T2 do.

Fewer views, noisy pictures and poses, a patterned surrounding, a dirty SfM cloud. Training views and start
suffer, the evaluation stays clean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from paper_artifact.catalogue import tag_of
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, counts_text, short
from paper_artifact.report.words import WORDS
from paper_artifact.study.verdict import BASELINE, LOSS

AS_IT_IS = "clean, 48 views"
BROKEN = 1.5  # mean tail over the clean scene's beyond which a trouble counts as breaking the design
ARMS = (BASELINE, LOSS, *WORDS)


@dataclass(frozen=True)
class Troubled:
    """An arm under one trouble, over its seeds."""

    tails: tuple[float, ...]  # bottleneck in the judged dimension, seed by seed
    counts: tuple[float, ...]  # significant bars there at the end
    chamfer: float  # mean, a fraction of the diagonal

    @property
    def mean(self) -> float:
        """The mean tail."""
        return float(np.mean(self.tails))


def realism_table(realism: Collected, clean: Collected, shape: str) -> pd.DataFrame:
    """Return a row per trouble (the clean scene, same seeds, first) for one shape: the mean tails of C0, C1,
    T1, T2, with C0 of that trouble over them ("!": the ranges overlap); bars in the judged dimension, seed by
    seed; Chamfer."""
    rows: dict[str, dict] = {}
    for trouble, arms in _troubles(realism, clean, shape).items():
        base, row = arms.get(BASELINE), {}
        for arm in ARMS:
            own = arms.get(arm)
            if own is None:
                row[arm] = NOT_RECORDED
                continue
            gain = ""
            if arm != BASELINE and base is not None:
                gain = f" ({base.mean / own.mean:.1f}×{'' if _clear(own, base) else ' !'})"
            row[arm] = f"{short(own.mean)}{gain}"
        row["bars"] = "  ".join(f"{arm} {counts_text(arms[arm].counts)}" for arm in ARMS if arm in arms)
        row["Chamfer %"] = "/".join(
            "?" if arm not in arms else f"{100 * arms[arm].chamfer:.2f}" for arm in ARMS
        )
        row["seeds"] = "/".join(str(len(arms[arm].tails)) if arm in arms else "0" for arm in ARMS)
        rows[trouble] = row
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(f"{shape}: trouble")


def realism_text(realism: Collected, clean: Collected) -> str:
    """Return per design and shape under how many troubles every seed is below every one of C0's, under which
    only the mean is, under which it is no better, and which take its mean beyond BROKEN times that of the
    clean scene."""
    lines = []
    for arm in (LOSS, *WORDS):
        for shape in frames.shapes(realism):
            troubles = _troubles(realism, clean, shape)
            own = {name: arms[arm] for name, arms in troubles.items() if arm in arms and BASELINE in arms}
            best = own.pop(AS_IT_IS, None)
            if not own or best is None:
                lines.append(f"{arm}, {shape}: {NOT_RECORDED}")
                continue
            bases = {name: troubles[name][BASELINE] for name in own}
            clear = [name for name in own if _clear(own[name], bases[name])]
            useless = [name for name in own if own[name].mean >= bases[name].mean]
            between = [name for name in own if name not in clear and name not in useless]
            worse = [name for name in own if own[name].mean > BROKEN * best.mean]
            lines.append(
                f"{arm}, {shape}: every seed below C0's under {len(clear)} of {len(own)} troubles; "
                f"in the mean alone under {'; '.join(between) or 'none'}; "
                f"no better under {'; '.join(useless) or 'none'}; "
                f"beyond {BROKEN} times its clean tail under {'; '.join(worse) or 'none'}"
            )
    return "\n".join(lines)


def clear_text(realism: Collected, clean: Collected) -> str:
    """Return per design in how many cases (shape and trouble) every seed's tail is below all of C0's."""
    found: dict[str, list[bool]] = {arm: [] for arm in (LOSS, *WORDS)}
    for shape in frames.shapes(realism):
        for trouble, arms in _troubles(realism, clean, shape).items():
            for arm, cases in found.items():
                if trouble != AS_IT_IS and {arm, BASELINE} <= set(arms):
                    cases.append(_clear(arms[arm], arms[BASELINE]))
    if not any(found.values()):
        return f"Real scenes' troubles: {NOT_RECORDED}"
    said = ", ".join(f"{arm} in {sum(cases)} of {len(cases)}" for arm, cases in found.items())
    return f"Under the troubles of real scenes every seed is below C0's: {said} cases"


def _clear(own: Troubled, base: Troubled) -> bool:
    """Return whether every seed's tail is below all of the baseline's."""
    return max(own.tails) < min(base.tails)


def _troubles(realism: Collected, clean: Collected, shape: str) -> dict[str, dict[str, Troubled]]:
    """Return {trouble: {arm: what came of it}} over the seeds of `realism`, the clean scene first."""
    found: dict[str, dict[str, Troubled]] = {AS_IT_IS: {}}
    seeds = sorted({seed for _, _, seed in realism.wanted})
    for shaped, arm, _ in realism.wanted:
        if shaped == shape:
            found.setdefault(arm.partition(", ")[2], {})
    for runs in (clean, realism):
        rows = frames.runs(runs).sort_values("seed")
        rows = rows[(rows["shape"] == shape) & rows["seed"].isin(seeds)]
        for arm, own in rows.groupby("condition", observed=True):
            trouble = str(arm).partition(", ")[2] or AS_IT_IS
            if trouble in found:
                found[trouble][tag_of(str(arm))] = Troubled(
                    tuple(own["tail"]), tuple(own["count"]), float(own["chamfer"].mean())
                )
    return found
