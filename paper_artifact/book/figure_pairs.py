"""The paper's thirteen figures, each as the statements of its caption beside our runs. Which: `items.csv`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping

import pandas as pd

from paper_artifact.book.pairs import LAST_DIGIT, Pair, equal, sides
from paper_artifact.book.sources import Sources
from paper_artifact.book.table_pairs import table_s8
from paper_artifact.catalogue import shape_row
from paper_artifact.config import LossConfig
from paper_artifact.files import REPOSITORY
from paper_artifact.report import diagrams, plans, schematic, staircase
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected
from paper_artifact.report.kit.text import NOT_RECORDED, counts_text, span
from paper_artifact.study.verdict import LOSS

LOOSE = 1.25  # how far a step that the paper prints with "~" may lie from ours, a factor
LOSS_ARMS = (
    LOSS,
    "C3",
    "C5",
    "C7",
    "C7h",
)  # of Figs. S3, S4, S6; C6 is the ablation that the captions set apart


def figure_1(sources: Sources) -> list[Pair]:
    """The control erases the voids, the loss reads them all, and its largest gain."""
    study = sources.study("table2")
    shapes = ("spot", "fandisk", "pot")
    found = [_counted(study, shape, arm) for shape in shapes for arm in ("C2", LOSS)]
    return [*found, _largest(sources)]


def figure_s1(sources: Sources) -> list[Pair]:
    """The void's death: drifts in C0, returns under the loss, is dragged away by the control; the carpet."""
    stored = sources.measured("diagrams")
    if not len(stored):
        return [Pair("the void's death", NOT_RECORDED, "Fig. S1", None)]
    table = diagrams.diagram_table(stored)
    short = table["death short by"].astype(float)
    last = f"step {max(diagrams.STEPS)}"
    ends = {arm: (short[arm, "start"], short[arm, last]) for arm in diagrams.CONDITIONS}
    text = {
        arm: f"short by {first:.4f} at the start, {end:.4f} at the end" for arm, (first, end) in ends.items()
    }
    drawn = table["bars drawn"]
    middle = short[LOSS, "step 200"]
    return [
        Pair("C0: the void drifts off", text["C0"], "drifts off target", ends["C0"][1] > ends["C0"][0]),
        Pair(
            "C1: it returns after the ramp",
            f"short by {middle:.4f} before it, {ends[LOSS][1]:.4f} at the end",
            "returns to the target",
            ends[LOSS][1] < middle,
        ),
        Pair("C2: it is dragged away", text["C2"], "further than in C0", ends["C2"][1] > ends["C0"][1]),
        Pair(
            "C2: bars near the diagonal",
            f"{drawn['C2', last]}, C0 {drawn['C0', last]}",
            "accumulate",
            bool(drawn["C2", last] > drawn["C0", last]),
        ),
    ]


def figure_s2(sources: Sources) -> list[Pair]:
    """bob keeps both loops and halves the error, the control loses one; fandisk's gain is the largest."""
    study = sources.study("table2")
    return [
        _counted(study, "bob", LOSS),
        _counted(study, "bob", "C2"),
        *sides(study, ("2",), ((LOSS, "C0"), ("C2", "C0")))[0:2],
        _largest(sources),
    ]


def figure_s3(sources: Sources) -> list[Pair]:
    """Every loss arm below C0, both controls above it, ρ makes no difference."""
    arms = [(arm, "C0") for arm in (*LOSS_ARMS, "C6", "C2", "C2g")]
    own = _only(sides(sources.study("table1"), ("1", "noise", "ablations"), arms), "sphere")
    return own + [pair for pair in table_s8(sources) if pair.what.startswith("rho")]


def figure_s4(sources: Sources) -> list[Pair]:
    """The torus's loops at the end: two in every loss arm, one in the control; when that one goes."""
    study = sources.study("table1")
    pairs = [_counted(study, "torus", arm) for arm in (*LOSS_ARMS, "C6", "C2")]
    dumps = frames.dumps(study)
    means = dumps[(dumps["shape"] == "torus") & (dumps["condition"] == "C2")].groupby("step")["count"].mean()
    two = [step for step in means.index if means[step] > 1]
    later = [step for step in means.index if step > max(two, default=0)]
    printed = published("plans").set_index("quantity")["value"]["collapse_step"]
    text = f"after step {max(two, default=0)}, by step {later[0]}" if later else "never"
    holds = bool(later) and max(two, default=0) <= printed * LOOSE and later[0] >= printed / LOOSE
    what = "C2 has one loop for good from (within a quarter; dumps are 300 steps apart)"
    return [*pairs, Pair(what, text, f"step {printed:.0f}", holds)]


def figure_s5(sources: Sources) -> list[Pair]:
    """Each probe reaches the paper's factor, the spurious handle dies, the bridge is cut."""
    stored = sources.measured("deviations")
    gate = stored[(stored["subject"] == "gate")] if len(stored) else stored
    pairs = []
    for row in published("gate").itertuples():
        probe = row.shape.split()[0]
        if row.quantity == "significant_count":
            table = sources.table("05_repair_gate", "significant before", "after")
            cells = {each[0]: each[1:] for each in table}
            titles = cells.get("probe", [])
            after = [cells["after"][n] for n, title in enumerate(titles) if title.startswith(f"{probe}:")]
            pairs.append(equal(f"{row.shape}: bars left", after[0] if after else None, row.printed))
            continue
        own = gate[
            (gate["case"] == probe) & gate["quantity"].str.startswith("factor at the end, rate to 0.01")
        ]
        factor = float(own["value"].item())
        pairs.append(Pair(f"{row.shape}: factor reached", f"{factor:.3g}", row.printed, factor >= row.value))
    return pairs


def figure_s6(sources: Sources) -> list[Pair]:
    """Every arm against C0 on sphere and torus, and which loss arm is the best."""
    arms = [(arm, "C0") for arm in (*LOSS_ARMS, "C6", "C2", "C2g")]
    study = sources.study("table1")
    found = sides(study, ("1", "noise", "ablations"), arms)
    pairs = _only(found, "sphere") + _only(found, "torus")
    ours, paper = (
        table.set_index(frames.ARM)
        for table in (frames.arms(study), frames.paper_arms("tail_bottleneck", "1", "noise"))
    )
    for shape in ("sphere", "torus"):
        best = paper.loc[shape]["value"].idxmin()
        arm = ours.loc[shape]["mean"]
        recorded = best in arm.index and pd.notna(arm[best])
        pairs.append(equal(f"{shape}: the best arm", arm.idxmin() if recorded else None, best))
    return pairs


def figure_s7(sources: Sources) -> list[Pair]:
    """The pot's export and its certified shell, and the one void at M = 8192 that the loss is given."""
    ours = sources.cells("11_hot_pot", "stand-in", "paper's pot", "open shells")
    paper = sources.cells("11_hot_pot", "paper's pot", "stand-in", "open shells")
    names = ("open shells", "non manifold junction edges", "genus", "betti")
    pairs = [equal(name, ours.get(name), paper.get(name, "")) for name in names]
    level = f"{shape_row('pot').samples}"
    stairs = [sources.cells("11_hot_pot", each, "void / floor") for each in ("stand-in", "paper's pot")]
    return [*pairs, equal(f"counts at M = {level}", *(each.get(level) for each in stairs))]


def figure_s8(sources: Sources) -> list[Pair]:
    """bob's loops in the three arms, half the tail, and the control's Chamfer."""
    study = sources.study("table2")
    arms = frames.arms(study).set_index(frames.ARM)
    pairs = [_counted(study, "bob", arm) for arm in ("C0", "C2", LOSS)]
    for shape, arm, ours, printed in (
        ("bob", LOSS, arms["ratio"]["bob", LOSS], frames.paper_arms("tail_bottleneck", "2")),
        (
            "bob",
            "C2",
            arms["chamfer ratio"]["bob", "C2"],
            frames.paper_arms("chamfer_ratio_to_C0", "chamfer"),
        ),
    ):
        row = printed.set_index(frames.ARM).loc[(shape, arm)]
        ratio = row["ratio"] or row["printed"]
        what = f"{arm}: C0 / C1 of the tail" if arm == LOSS else f"{arm}: Chamfer over C0's"
        text = NOT_RECORDED if pd.isna(ours) else f"{ours:.2f}"
        holds = None if pd.isna(ours) else ours >= 0.9 * float(ratio)
        pairs.append(Pair(f"{what}, at least nine tenths of the paper's", text, f"{ratio}", holds))
    return pairs


def figure_s9(sources: Sources) -> list[Pair]:
    """Every box of the schematic is a module of this package; M and K."""
    modules = list(schematic.module_table()["module"])
    there = sum((REPOSITORY / path).is_file() for path in modules)
    settings, loss = published("system").set_index("quantity")["printed"], LossConfig()
    return [
        Pair("boxes that are a module here", str(there), f"{len(modules)} boxes", there == len(modules)),
        equal("M, samples of the live soup", loss.samples, settings["samples"]),
        equal("K, steps between two plans", loss.refresh_every, settings["refresh_every"]),
    ]


def figure_s10(sources: Sources) -> list[Pair]:
    """The floors, and at which M the double torus's tubes and the torus's second loop stand to them."""
    stored = sources.measured("staircase")
    floors = stored.set_index(["shape", "samples"])["floor"]
    pairs = []
    printed = published("floor")
    for row in printed[printed["quantity"] == "floor"].itertuples():
        own = floors.loc[(row.shape, int(row.samples))]
        holds = own.min() - LAST_DIGIT <= row.value <= own.max() + LAST_DIGIT
        pairs.append(
            Pair(f"{row.shape}, M = {row.samples:.0f}: floor", span(own, 4), row.printed, bool(holds))
        )
    margins = staircase.crossing_table(stored, {"torus": ("loop 2",), "double_torus": ("loop 3", "loop 4")})
    tubes = margins.loc["double_torus"][["M = 2048", "M = 4096"]].astype(float)
    below, above = tubes["M = 2048"], tubes["M = 4096"]
    pairs.append(Pair("tubes at M = 2048", span(below, 2), "below the floor", bool((below < 1).all())))
    pairs.append(Pair("tubes at M = 4096", span(above, 2), "above it", bool((above > 1).all())))
    second = stored[(stored["shape"] == "torus") & (stored["samples"] == 2048)]
    own = second["h1_2"] / second["floor"]
    row = printed[(printed["shape"] == "torus") & (printed["quantity"] == "lifetime_over_floor")].iloc[0]
    holds = bool(own.min() - 0.005 <= row["value"] <= own.max() + 0.005)
    return [*pairs, Pair("torus, loop 2 over the floor", span(own, 2), row["printed"], holds)]


def figure_s11(sources: Sources) -> list[Pair]:
    """The counts of the group wave: all right on rocker-arm, two of four loops of eight, the voids."""
    study = sources.study("table2")
    pairs = [_counted(study, "rocker-arm", arm) for arm in ("C0", "C2", LOSS)]
    pairs += [_counted(study, "eight", arm) for arm in ("C2",)]
    counts = published("plans")
    counts = counts[(counts["shape"] == "eight") & counts["quantity"].str.startswith("significant_count")]
    found = _counts(study, "eight", LOSS)
    printed = counts_text(sorted(counts["value"].astype(int)))
    pairs.append(
        equal("eight C1: loops of the seeds", counts_text(sorted(found)) if found else None, printed)
    )
    for shape in ("armadillo", "horse"):
        pairs += [_counted(study, shape, arm) for arm in ("C0", "C2", LOSS)]
    return pairs


def figure_s12(sources: Sources) -> list[Pair]:
    """The plans of seed 0: C6 on the torus, the recruits of eight, the pot's one bar."""
    study = sources.study("table1", "table2")
    panels = (("torus", "C6"), ("eight", LOSS), ("pot", LOSS))
    table = plans.composition_table(study, panels)
    named = published("plans").set_index(["shape", "condition", "quantity"])["value"]
    pairs = []
    for shape, condition in panels:
        own = table[(table["shape"] == shape) & (table["condition"] == condition)]
        if not len(own):
            pairs.append(Pair(f"{shape} {condition}", NOT_RECORDED, "Fig. S12", None))
        elif condition == "C6":
            unreached = sorted(set(own["unreached"]))
            wanted = int(named["torus", "C6", "unreached_targets"])
            pairs.append(
                Pair("torus C6: targets unreached", _texts(unreached), f"{wanted}", unreached == [wanted])
            )
        elif shape == "eight":
            most, wanted = own["recruited"].max(), named["eight", LOSS, "recruited_bars"]
            fewer = own["recruited"].min()
            text = f"at most {most}, at least {fewer}"
            holds = most == wanted and fewer < most
            pairs.append(
                Pair("eight C1: loops recruited", text, f"{wanted:.0f}, handed over later", bool(holds))
            )
        else:
            log = plans.refresh_table(study.of(shape, condition, 0)[0])
            late = log[log["matched"] < log["targets"]]["step"].max() - log["step"].min()
            printed = named["pot", LOSS, "settled_after_steps"]
            what = "pot C1: the bar is matched for good after (steps; within a quarter)"
            holds = bool(printed / LOOSE <= late <= printed * LOOSE)
            pairs.append(Pair(what, f"{late:.0f}", f"{printed:.0f}", holds))
    return pairs


def _counts(study: Collected, shape: str, arm: str) -> tuple[int, ...]:
    arms = frames.arms(study).set_index(frames.ARM)
    return arms["counts"].get((shape, arm), ())


def _counted(study: Collected, shape: str, arm: str) -> Pair:
    """The final significant counts of an arm: in every seed what the paper says. That is the number that a
    note of its tables names ("beta_2 1->0", "2 of 4 loops"), else the expected count."""
    rows = frames.paper_arms("tail_bottleneck", "1", "2").set_index(frames.ARM)
    note = rows["note"].get((shape, arm), "")
    runs = frames.runs(study)
    named = re.search(r"beta_\d \d->(\d)|(\d) of \d", note)
    expected = runs[runs["shape"] == shape]["expected"].max()
    wanted = int(next(filter(None, named.groups()))) if named else int(expected)
    found = _counts(study, shape, arm)
    what = f"{shape} {arm}: significant bars, H{shape_row(shape).judged}"
    if not found:
        return Pair(what, NOT_RECORDED, f"{wanted} in every seed", None)
    return Pair(what, counts_text(found), f"{wanted} in every seed", set(found) == {wanted})


def _largest(sources: Sources) -> Pair:
    """The shape with the largest C0 / C1 of Tables 1 and 2."""
    ours = frames.arms(sources.study("table1", "table2"))
    ours = ours[ours["condition"] == LOSS].set_index("shape")["ratio"].dropna()
    paper = frames.paper_arms("tail_bottleneck", "1", "2")
    paper = (
        paper[(paper["condition"] == LOSS) & (paper["ratio"] != "")].set_index("shape")["ratio"].astype(float)
    )
    texts = [f"{each.idxmax()}, {each.max():.1f}×" for each in (ours, paper)]
    return Pair("the largest C0 / C1 of the tables", *texts, ours.idxmax() == paper.idxmax())


def _only(pairs: Iterable[Pair], shape: str) -> list[Pair]:
    return [pair for pair in pairs if pair.what.startswith(f"{shape}:")]


def _texts(values: Iterable[object]) -> str:
    return ", ".join(map(str, values))


FIGURES: Mapping[str, Callable[[Sources], list[Pair]]] = {
    "Fig. 1": figure_1,
    "Fig. S1": figure_s1,
    "Fig. S2": figure_s2,
    "Fig. S3": figure_s3,
    "Fig. S4": figure_s4,
    "Fig. S5": figure_s5,
    "Fig. S6": figure_s6,
    "Fig. S7": figure_s7,
    "Fig. S8": figure_s8,
    "Fig. S9": figure_s9,
    "Fig. S10": figure_s10,
    "Fig. S11": figure_s11,
    "Fig. S12": figure_s12,
}
