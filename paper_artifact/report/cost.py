"""Notebook 07: what the persistence step costs (App. H): time against M, its share of a run, memory.

Times are CPU milliseconds of one process; each ratio is of two times taken in turns within that process. A
stored table names the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.bench.persistence import CLOUDS as DRAWN
from paper_artifact.bench.persistence import growth_text, persistence_rows
from paper_artifact.catalogue import BASELINE, LOSS
from paper_artifact.plot import COLUMN, FAINT, INK, new_figure
from paper_artifact.record.environment import host, packages
from paper_artifact.report.kit.figures import SERIES, label_axis, legend_below, plain_log
from paper_artifact.report.kit.published import published
from paper_artifact.report.kit.records import Collected
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import surface

SIZES = (2048, 4096, 8192, 20_000)
STAGES = ("delaunay", "filtration", "reduction", "pairs")


def study_torus(count: int, generator: np.random.Generator) -> np.ndarray:
    """Return `count` area-weighted samples (count,3) of the study's torus mesh, world units, as targets and
    bundles have them."""
    mesh = surface("torus")
    return sample_surface(mesh.vertices, mesh.faces, count, generator)[0]


CLOUDS = {  # cloud: what it is, and how it is drawn (None: bench.persistence has it)
    "torus": ("samples of the study's torus mesh", study_torus),
    "soup": ("samples of 300 triangles around a torus, as the loss sees them", None),
    "smooth torus": ("points of an exact torus", DRAWN["torus"]),
}


def measure_cost(
    sizes: Sequence[int] = SIZES, repetitions: int = 5, progress: Callable[[str], None] | None = None
) -> pd.DataFrame:
    """Return one row per cloud and M (see `bench.persistence.persistence_rows`), with this machine's CPU and
    the versions; about three minutes of CPU."""
    rows = []
    for cloud, (_, draw) in CLOUDS.items():
        for size in sizes:
            rows += persistence_rows((size,), repetitions, cloud, draw)
            if progress is not None:
                progress(f"{cloud}, M = {size}")
    versions = packages()
    return pd.DataFrame(rows).assign(
        repetitions=repetitions, cpu=host()["cpu"], gudhi=versions["gudhi"], numba=versions["numba"]
    )


def now_table(sizes: Sequence[int] = (2048, 4096), repetitions: int = 3) -> pd.DataFrame:
    """Return ours, gudhi and the ratio on the torus cloud, measured now on this machine: for a cell that is
    not compared."""
    table = pd.DataFrame(persistence_rows(tuple(sizes), repetitions, "torus", study_torus)).set_index("M")
    return table[["fast_ms", "gudhi_ms", "ratio"]].round(1)


def machine(stored: pd.DataFrame) -> str:
    """Return the line that says where the stored times come from."""
    row = stored.iloc[0]
    versions = f"gudhi {row['gudhi']}, numba {row['numba']}"
    return f"{row['cpu']}, one thread, {versions}; medians of {row['repetitions']} turns"


def torus_rows(stored: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the torus cloud, which the paper measures on."""
    return stored[stored["cloud"] == "torus"].reset_index(drop=True)


def persistence_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return time per persistence step against M, torus cloud: ours, gudhi `safe` in the same process, their
    ratio, and the paper's (gudhi on its machine); then the largest M's time over the smallest's, and the
    growth exponent p of time ~ M^p, fitted over all sizes, with its standard error."""
    paper, own = published("cost").set_index("quantity"), torus_rows(stored)
    printed = paper.loc["persistence_ms"].set_index("samples")["printed"]
    table = pd.DataFrame(
        {
            "ours ms": own["fast_ms"].round(0),
            "gudhi ms": own["gudhi_ms"].round(0),
            "gudhi / ours": own["ratio"].round(1),
            "paper ms": own["M"].map(printed),
        },
        dtype=object,
    ).set_axis(own["M"].map("M = {}".format))
    first, last = own.iloc[0], own.iloc[-1]
    times = {"ours ms": "fast_ms", "gudhi ms": "gudhi_ms"}
    growth = f"M = {last['M']} / M = {first['M']}"
    table.loc[growth] = {name: round(last[key] / first[key], 1) for name, key in times.items()} | {
        "paper ms": paper["printed"].get(f"cost_ratio_{last['M']}_over_{first['M']}", "")
    }
    rows = own.to_dict("records")
    table.loc["growth exponent"] = {name: growth_text(rows, key) for name, key in times.items()}
    return table.fillna("")


def growth_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return per cloud the exponents p of ours ~ M^p and gudhi's ~ M^p, fitted over all sizes, with their
    standard errors, and that of the number of Delaunay tetrahedra: what no method that builds them can fall
    below; ratios at both ends."""
    rows = {}
    for cloud, group in stored.groupby("cloud", sort=False):
        lines = group.to_dict("records")
        ends = (lines[0], lines[-1])
        exponents = {"ours": "fast_ms", "gudhi": "gudhi_ms", "tetrahedra": "tetrahedra"}
        rows[cloud] = {f"exponent, {name}": growth_text(lines, key) for name, key in exponents.items()}
        for line in ends:
            rows[cloud][f"tetrahedra per point, M = {line['M']}"] = round(line["tetrahedra"] / line["M"], 1)
        rows[cloud] |= {f"gudhi / ours, M = {line['M']}": round(line["ratio"], 1) for line in ends}
        rows[cloud]["cloud"] = CLOUDS[cloud][0]
    return pd.DataFrame.from_dict(rows, orient="index")


def stage_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return milliseconds per stage and M, torus cloud, ours and gudhi's (its simplex tree is built within
    its filtration stage)."""
    columns = {}
    for row in torus_rows(stored).to_dict("records"):
        for name, key in (("ours", "fast"), ("gudhi", "gudhi")):
            columns[f"M = {row['M']}", name] = {stage: round(row[f"{key}_{stage}_ms"], 1) for stage in STAGES}
    return pd.DataFrame(columns)


def cost_figure(stored: pd.DataFrame) -> Figure:
    """Return time against M on logarithmic axes, torus cloud: ours, gudhi, the paper's figures, and a line of
    slope 1."""
    figure, axes = new_figure(1, 1, COLUMN, 2.9)
    axis, own = axes[0][0], torus_rows(stored)
    paper = published("cost").set_index("quantity").loc["persistence_ms"]
    slope = own["fast_ms"].iloc[0] * own["M"] / own["M"].iloc[0] * 0.7
    for x, y, label, style in (
        (own["M"], own["gudhi_ms"], "gudhi, same process", {"color": SERIES[5], "marker": "s"}),
        (paper["samples"], paper["value"], "paper (gudhi, its machine)", {"color": FAINT, "marker": "D"}),
        (own["M"], own["fast_ms"], "ours", {"color": SERIES[0], "marker": "o"}),
        (own["M"], slope, "slope 1", {"color": INK, "linestyle": ":"}),
    ):
        axis.plot(x, y, label=label, **style)
    label_axis(axis, "", "samples M", "CPU ms per persistence step")
    plain_log(axis)
    plain_log(axis, "x")
    axis.set_xticks(list(own["M"]), [f"{each:,}" for each in own["M"]])
    axis.minorticks_off()
    legend_below(figure, 2)
    return figure


def share_table(collected: Collected) -> pd.DataFrame:
    """Return per shape what the loss adds to training, from the recorded C1 runs: its stage's seconds, those
    over the photometric training's in the same run (percent), its share of training, and peak memory of whole
    runs (evaluation included) under C0 and C1; beside the seconds that the paper prints. Medians over seeds.

    Runs were made at different loads of the machine: ratios are within a run, and times of C0 and C1 are
    compared in `speed.run_table` only. Evaluation is the study's cost, not the method's, and left out."""
    rows = {}
    for shape in dict.fromkeys(record["config"]["shape"] for record in collected.records):
        arms = {condition: collected.of(shape, condition) for condition in (BASELINE, LOSS)}
        if not all(arms.values()):
            continue
        loss = [record["timings"]["topology"] for record in arms[LOSS]]
        rest = [sum(record["timings"].values()) - record["timings"]["evaluate"] for record in arms[LOSS]]
        added = np.median([own / (training - own) for own, training in zip(loss, rest, strict=True)])
        rows[shape] = {
            "seeds": len(loss),
            "loss adds s": round(np.median(loss)),
            "loss adds %": round(100 * added),
            "share of training %": round(100 * added / (1 + added)),
        }
        for arm, found in arms.items():
            peaks = [record["host"]["peak_memory_mib"] for record in found]
            rows[shape][f"peak MiB {arm}"] = round(np.median(peaks))
    paper = published("cost").set_index("quantity")["printed"]
    rows["paper (gudhi on the CPU)"] = {"loss adds s": paper["loss_seconds_per_run"]}
    return pd.DataFrame(rows, dtype=object).T.rename_axis("shape").fillna("")


TEN_MINUTES = 600  # seconds: the run whose share the paper projects


def overhead_table(collected: Collected) -> pd.DataFrame:
    """Return the paper's projection s / (T + s), the share that a loss of s seconds has in a run whose
    photometric cost is T, with ours per shape: medians over the recorded C1 runs of s and of T (training
    without the loss and without evaluation), their share, and the share of a ten-minute run; then with the
    paper's seconds."""
    rows = {}
    for shape in dict.fromkeys(record["config"]["shape"] for record in collected.records):
        timings = [record["timings"] for record in collected.of(shape, LOSS)]
        if not timings:
            continue
        loss = float(np.median([each["topology"] for each in timings]))
        rest = float(
            np.median([sum(each.values()) - each["topology"] - each["evaluate"] for each in timings])
        )
        rows[shape] = {"s": f"{loss:.1f}", "T": f"{rest:.1f}"} | _shares(loss, (rest,))
    paper = published("cost").set_index("quantity")
    names = ["photometric_seconds_low", "photometric_seconds_high"]
    low, high = paper["value"][names]
    rows["paper"] = {
        "s": paper["printed"]["loss_seconds_per_run"],
        "T": "–".join(paper["printed"][names]),
    } | _shares(paper["value"]["loss_seconds_per_run"], (high, low))
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def _shares(loss: float, rests: Sequence[float]) -> dict[str, str]:
    """Return the shares of a loss of that many seconds in runs of these photometric costs, least first."""
    own = "–".join(f"{100 * loss / (rest + loss):.0f}" for rest in rests)
    return {"s / (T + s) %": own, "of a ten-minute run %": f"{100 * loss / (TEN_MINUTES + loss):.1f}"}
