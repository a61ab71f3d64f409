"""Notebook 16: what hurts a statement in words: lies, and what the audit says of them; the five lines of
advice.

A lie differs from what dense samples show. "Too many loops" says more than there are, "too few" fewer. The
audit's margins are lifetimes of the longest bar beyond the stated ones, in floors of the live cloud, at the
first refresh.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pandas as pd

from paper_artifact.catalogue import shape_row, tag_of
from paper_artifact.pipeline import audit_remarks, closing_notes
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, short
from paper_artifact.report.realism import clear_text
from paper_artifact.report.words import DEVISED, WORDS, judged, reach_table
from paper_artifact.study.verdict import BASELINE, LOSS
from paper_artifact.topology.statement import NAMES, SURPLUS

THRESHOLDS = (0.5, 0.75, 1.0, 1.5, 2.0)  # floors: where the audit might warn
HARMFUL, BROKEN = 1.15, 1.5  # tail over the truthful one's beyond which a lie counts as harmful, as broken


def truth(shape: str) -> tuple[int, ...]:
    """Return the Betti numbers that dense samples of a shape of the study show."""
    row = shape_row(shape)
    return (row.features[0] + 1, *row.features[1:])


def kinds(shape: str, said: tuple[int, ...]) -> list[str]:
    """Return what is wrong with the words: "too many loops", "too few voids"; empty for the truth."""
    pairs = zip(NAMES, said, truth(shape), strict=True)
    return [
        f"too {'many' if more > there else 'few'} {name[1]}" for name, more, there in pairs if more != there
    ]


def lie_table(lies: Collected, truthful: Collected) -> pd.DataFrame:
    """Return a row per lie and design, with its kind: tail, over that of the true words (same shape, design
    and seed), over C0's, bars of all dimensions at the end, Chamfer over the true words', whether the audit
    warned before the loss set in, and which stated classes the last plan does not show.

    truthful: has T1, T2 and C0 of the same shapes.
    """
    rows = {}
    for shape, arm, seed in lies.wanted:
        design, found = tag_of(arm), lies.of(shape, arm, seed)
        said = _said(arm)
        row = {"kind": ", ".join(kinds(shape, said)), "design": design}
        if not found:
            rows[shape, _text(said), design] = row | {"tail": NOT_RECORDED}
            continue
        tails = found[0]["tails"]
        own = tails["bottleneck"][found[0]["mesh"]["dimension"]]
        true, base = (_tails(truthful, shape, name, seed) for name in (design, BASELINE))
        rows[shape, _text(said), design] = row | {
            "tail": short(own),
            "÷ true words'": _ratio(own, true, "tail"),
            "÷ C0's": _ratio(own, base, "tail"),
            "bars": ",".join(map(str, tails["counts"])),
            "Chamfer ÷ true words'": _ratio(tails["chamfer"], true, "chamfer"),
            "the audit": "; ".join(filter(None, (_count(found[0], "warnings"), _count(found[0], "notes"))))
            or "—",
            "not seen at the end": ", ".join(map(_subject, closing_notes(found[0]))) or "—",
        }
    table = pd.DataFrame.from_dict(rows, orient="index").fillna("")
    table.index = pd.MultiIndex.from_tuples(table.index, names=["shape", "said", ""])
    return table.drop(columns="design")


def lie_text(lies: Collected, truthful: Collected) -> str:
    """Return per design and kind of lie how many runs it harmed (tail beyond HARMFUL times the true words'),
    how many it broke (BROKEN), the worst, and how many of both the audit had warned of; then, of true words
    and of lies, how many runs end with a stated class not seen."""
    lines = []
    for (design, kind), runs in sorted(_lie_groups(lies, truthful).items()):
        harmed = [warned for ratio, warned in runs if ratio > HARMFUL]
        worst = max(ratio for ratio, _ in runs)
        lines.append(
            f"{design}, {kind}: {len(harmed)} of {len(runs)} runs harmed ({sum(r > BROKEN for r, _ in runs)} "
            f"beyond {BROKEN} times the true words' tail, worst {worst:.1f}); warned of {sum(harmed)} of "
            f"these, and of {sum(warned for _, warned in runs)} in all"
        )
    if not lines:
        return f"lies and true words: {NOT_RECORDED}"
    ends: dict[str, list[bool]] = {"true words": [], "too many": [], "too few": []}
    for record in (*truthful.records, *lies.records):
        if record["config"]["loss"] is not None and record["config"]["loss"]["kind"] == "betti":
            wrong = kinds(record["config"]["shape"], tuple(record["config"]["loss"]["betti"]))
            name = "true words" if not wrong else "too many" if "many" in " ".join(wrong) else "too few"
            ends[name].append(bool(closing_notes(record)))
    counts = (f"{sum(noted)} of {len(noted)} runs with {name}" for name, noted in ends.items())
    return "\n".join([*lines, f"a stated class is not seen when the run ends: {', '.join(counts)}"])


def _lie_groups(lies: Collected, truthful: Collected) -> dict[tuple[str, str], list[tuple[float, bool]]]:
    """Return {(design, kind of lie): [(tail over the true words', whether the audit warned)]}."""
    groups: dict[tuple[str, str], list[tuple[float, bool]]] = {}
    for shape, arm, seed in lies.wanted:
        found, true = lies.of(shape, arm, seed), _tails(truthful, shape, tag_of(arm), seed)
        if not found or true is None:
            continue
        ratio = found[0]["tails"]["bottleneck"][found[0]["mesh"]["dimension"]] / true["tail"]
        warned = bool(audit_remarks(found[0], "warnings"))
        for kind in kinds(shape, _said(arm)):
            groups.setdefault((tag_of(arm), kind), []).append((ratio, warned))
    return groups


def threshold_table(lies: Collected, truthful: Collected) -> pd.DataFrame:
    """Return, per threshold in floors, how many runs with true words the audit would warn of (false alarms),
    and how many with too few classes in some dimension and with too many; and in the last rows the largest
    margin of each group, and the smallest of those with too few."""
    groups: dict[str, list[float]] = {"true words": [], "too few": [], "too many": []}
    for record in (*truthful.records, *lies.records):
        arm, shape = record["config"]["condition"], record["config"]["shape"]
        margins = dict(surplus_margins(record)) if tag_of(arm) in WORDS else {}
        if not margins:
            continue
        wrong = kinds(shape, tuple(record["config"]["loss"]["betti"]))
        name = (
            "true words" if not wrong else "too few" if any("few" in each for each in wrong) else "too many"
        )
        groups[name].append(max(margins.values()))
    rows = {
        f"warned beyond {threshold:g} floors": {
            name: f"{sum(value > threshold for value in values)} of {len(values)}"
            for name, values in groups.items()
        }
        for threshold in THRESHOLDS
    }
    rows["longest surplus bar"] = {
        name: f"{max(values):.2f}" if values else "" for name, values in groups.items()
    }
    rows["shortest"] = {name: f"{min(values):.2f}" if values else "" for name, values in groups.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(f"threshold (the audit's is {SURPLUS:g})")


def surplus_margins(record: Mapping) -> Iterator[tuple[int, float]]:
    """Yield (dimension, floors of the longest bar beyond the stated ones) at the first refresh."""
    first = next((each for each in record.get("topology") or () if each["event"] == "refresh"), None)
    for dimension, report in (first or {"dimensions": {}})["dimensions"].items():
        if len(report["margins"]) > report["wanted"]:
            yield int(dimension), report["margins"][report["wanted"]]


def advice(runs: Collected, lies: Collected, realism: Collected) -> list[str]:
    """Return the summary in five lines: which design to use when, and what remains unproven. Every number is
    counted from the runs; without them a line says so."""
    test = {arm: _counted(runs, arm, devised=False) for arm in (LOSS, *WORDS)}
    devised = {arm: _counted(runs, arm, devised=True) for arm in (LOSS, *WORDS)}
    many, few = (_harmed(lies, runs, word) for word in ("many", "few"))
    if many is None or few is None:
        doubt = f"Lies: {NOT_RECORDED}"
    else:
        doubt = "In doubt say more, not fewer" if many[0] * few[1] < few[0] * many[1] else "No side is safe"
        doubt += f": too many classes harmed {many[0]} of {many[1]} runs, too few {few[0]} of {few[1]}"
    return [
        f"1. With a ground truth (a study, a regression test): C1; it passes the rule on {test[LOSS]}.",
        f"2. With words alone: T1 passes on {test['T1']}, T2 on {test['T2']}.",
        f"3. Many small loops: T2 at a dense M ({_dense_text(runs)}; post hoc, T2 was devised there, where "
        f"T2 passes on {devised['T2']}, T1 on {devised['T1']}, C1 on {devised[LOSS]}). `samples=auto` asks "
        "at which M the classes show, not at which the loss reaches them.",
        f"4. {doubt}; --strict stops where the images show a class that the words deny.",
        "5. The pull has no aim: where the images have the class nearly right or see nothing, it goes too "
        f"far ({_beyond_text(runs)}; the mug's handle, notebook 18). {clear_text(realism, runs)}. Unproven: "
        "gaps of a cloud, which read as loops.",
    ]


def _dense_text(runs: Collected) -> str:
    """Return per shape that T2 was devised on its mean tail at every M it ran at."""
    found = []
    for shape in DEVISED:
        tails: dict[int, list[float]] = {}
        for record in runs.records:
            config = record["config"]
            if config["shape"] == shape and tag_of(config["condition"]) == "T2":
                tail = record["tails"]["bottleneck"][record["mesh"]["dimension"]]
                tails.setdefault(record["statement"]["samples"], []).append(tail)
        said = [f"{short(sum(own) / len(own))} at {samples}" for samples, own in sorted(tails.items())]
        found.append(f"{shape} {', '.join(said) or NOT_RECORDED}")
    return "; ".join(found)


def _beyond_text(runs: Collected) -> str:
    """Return on which shapes words go beyond the target in every seed."""
    table = reach_table(runs)
    found = [f"{arms} on {shape}" for shape, arms in table["beyond"].items() if arms]
    return f"{', '.join(found) or 'no shape'} of {len(table)} shapes"


def _counted(runs: Collected, arm: str, *, devised: bool) -> str:
    own = [
        each
        for shape, each in judged(runs, arm).items()
        if arm in each.arms and (shape in DEVISED) == devised
    ]
    return f"{sum(each.passed for each in own)} of {len(own)} shapes" if own else f"({arm} {NOT_RECORDED})"


def _harmed(lies: Collected, truthful: Collected, word: str) -> tuple[int, int] | None:
    """Return (harmed runs, runs) of the lies of a kind with that word, None without any."""
    groups = _lie_groups(lies, truthful).items()
    ratios = [each[0] for (_, kind), group in groups if word in kind for each in group]
    return (sum(ratio > HARMFUL for ratio in ratios), len(ratios)) if ratios else None


def _tails(runs: Collected, shape: str, arm: str, seed: int) -> dict | None:
    """Return tail and Chamfer of one run, None where it is not recorded."""
    found = runs.of(shape, arm, seed)
    if not found:
        return None
    tails = found[0]["tails"]
    return {"tail": tails["bottleneck"][found[0]["mesh"]["dimension"]], "chamfer": tails["chamfer"]}


def _ratio(value: float, other: dict | None, name: str) -> str:
    return "" if other is None else f"{value / other[name]:.2f}"


def _said(arm: str) -> tuple[int, ...]:
    """Return the words of an arm "T1, betti=(1, 2, 1)"."""
    numbers = arm.partition("betti=(")[2].partition(")")[0]
    return tuple(int(each) for each in numbers.split(","))


def _text(said: tuple[int, ...]) -> str:
    return ",".join(map(str, said))


def _count(record: Mapping, kind: str) -> str:
    word = {"warnings": "warned", "notes": "not seen yet"}[kind]
    dims = [_subject(each) for each in audit_remarks(record, kind)]
    return f"{word}: {', '.join(dims)}" if dims else ""


def _subject(remark: str) -> str:
    """Return what a remark is about: "2 voids" of "you said 2 voids; …"."""
    return remark.partition(";")[0].removeprefix("you said ")
