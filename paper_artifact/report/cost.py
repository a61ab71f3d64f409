"""What the persistence step costs (App. H, "Cost scaling"): time against M beside gudhi and the paper, the loss's share of a run,
memory.

Times are CPU milliseconds of one process; each ratio is of two times taken in turns within that process. A stored table names the
machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from paper_artifact.bench.persistence import CLOUDS as DRAWN
from paper_artifact.bench.persistence import growth_exponent, persistence_rows
from paper_artifact.record.environment import host, packages
from paper_artifact.report.figures import new_figure
from paper_artifact.report.published import published
from paper_artifact.report.runs import Collected
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.find import surface

SIZES = (2048, 4096, 8192, 20_000)
STAGES = ("delaunay", "filtration", "reduction", "pairs")


def study_torus(count: int, generator: np.random.Generator) -> np.ndarray:
    """Return `count` area-weighted samples (count,3) of the study's torus mesh, world units: what targets and bundles are made
    of."""
    mesh = surface("torus")
    return sample_surface(mesh.vertices, mesh.faces, count, generator)[0]


# cloud: what it is, and how it is drawn (None: topology.benchmark has it)
CLOUDS = {
    "torus": ("samples of the study's torus mesh", study_torus),
    "soup": ("samples of 300 triangles around a torus, as the loss sees them", None),
    "smooth torus": ("points of an exact torus", DRAWN["torus"]),
}


def measure_all(
    sizes: Sequence[int] = SIZES, repetitions: int = 5, progress: Callable[[str], None] | None = None
) -> pd.DataFrame:
    """Return one line per cloud and M (see `topology.benchmark.persistence_rows`), with this machine's CPU and the versions;
    about three minutes of CPU."""
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


def growth_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return per cloud the exponents p of ours ~ M^p and gudhi's ~ M^p from the smallest to the largest M, and that of the number
    of Delaunay tetrahedra: what no method that builds them can fall below; ratios at both ends."""
    rows = {}
    for cloud, group in stored.groupby("cloud", sort=False):
        lines = group.to_dict("records")
        names = {"ours": "fast_ms", "gudhi": "gudhi_ms", "tetrahedra": "tetrahedra"}
        rows[cloud] = {
            f"exponent, {name}": round(growth_exponent(lines, key), 2) for name, key in names.items()
        }
        ends = (lines[0], lines[-1])
        rows[cloud] |= {
            f"tetrahedra per point, M = {line['M']}": round(line["tetrahedra"] / line["M"], 1)
            for line in ends
        }
        rows[cloud] |= {f"gudhi / ours, M = {line['M']}": round(line["ratio"], 1) for line in ends}
        rows[cloud] |= {"cloud": CLOUDS[cloud][0] if cloud in CLOUDS else cloud}
    return pd.DataFrame.from_dict(rows, orient="index")


def beside_paper(stored: pd.DataFrame) -> pd.DataFrame:
    """Return time per persistence step against M, torus cloud: ours, gudhi `safe` in the same process, their ratio, and the
    paper's (gudhi on its machine); last line: the growth exponent p of time ~ M^p from the smallest to the largest M."""
    paper = published("cost")
    paper = (
        paper[paper["quantity"] == "persistence_ms"].astype({"samples": int}).set_index("samples")["value"]
    )
    stored = torus_rows(stored)
    table = pd.DataFrame(
        {
            "ours ms": stored["fast_ms"].round(0),
            "gudhi ms": stored["gudhi_ms"].round(0),
            "gudhi / ours": stored["ratio"].round(1),
            "paper ms": stored["M"].map(paper),
        }
    ).set_axis(stored["M"].map("M = {}".format))
    rows = stored.to_dict("records")
    papers = [{"M": size, "ms": value} for size, value in paper.items()]
    exponents = {
        "ours ms": growth_exponent(rows),
        "gudhi ms": growth_exponent(rows, "gudhi_ms"),
        "paper ms": growth_exponent(papers, "ms"),
    }
    table.loc["growth exponent"] = pd.Series({name: round(value, 2) for name, value in exponents.items()})
    return table.astype(object).where(table.notna(), "")


def torus_rows(stored: pd.DataFrame) -> pd.DataFrame:
    """Return the lines of the torus cloud, which the paper measures on."""
    return stored[stored["cloud"] == "torus"].reset_index(drop=True)


def stage_table(stored: pd.DataFrame) -> pd.DataFrame:
    """Return milliseconds per stage and M, torus cloud, ours and gudhi's (its simplex tree is built within its filtration
    stage)."""
    columns = {}
    for row in torus_rows(stored).to_dict("records"):
        for name, key in (("ours", "fast"), ("gudhi", "gudhi")):
            columns[f"M = {row['M']}", name] = {stage: round(row[f"{key}_{stage}_ms"], 1) for stage in STAGES}
    return pd.DataFrame(columns)


def machine(stored: pd.DataFrame) -> str:
    """Return the line that says where the stored times come from."""
    row = stored.iloc[0]
    versions = f"gudhi {row['gudhi']}, numba {row['numba']}"
    return f"{row['cpu']}, one thread, {versions}; medians of {row['repetitions']} turns"


def cost_figure(stored: pd.DataFrame) -> Figure:
    """Return time against M on logarithmic axes, torus cloud: ours, gudhi, the paper's figures, and a line of slope 1."""
    stored = torus_rows(stored)
    figure, axes = new_figure(1, 1, 4.6, 3.4)
    axis, paper = axes[0][0], published("cost")
    paper = paper[paper["quantity"] == "persistence_ms"].astype({"samples": float})
    axis.plot(
        stored["M"],
        stored["gudhi_ms"],
        color="#c0392b",
        marker="o",
        markersize=4,
        label="gudhi safe, same process",
    )
    axis.plot(
        paper["samples"],
        paper["value"],
        color="#555555",
        marker="x",
        markersize=5,
        label="paper (gudhi, its machine)",
    )
    axis.plot(stored["M"], stored["fast_ms"], color="#1f5fbf", marker="o", markersize=4, label="ours")
    ends = np.array([stored["M"].min(), stored["M"].max()], dtype=float)
    axis.plot(
        ends,
        stored["fast_ms"].iloc[0] * ends / ends[0] * 0.8,
        color="black",
        linestyle=":",
        linewidth=0.9,
        label="slope 1",
    )
    axis.set(xscale="log", yscale="log", xlabel="samples M", ylabel="CPU ms per persistence step")
    axis.set_xticks(list(stored["M"]), [str(size) for size in stored["M"]])
    axis.minorticks_off()
    axis.grid(alpha=0.25)
    axis.legend(fontsize=7)
    return figure


def now_table(sizes: Sequence[int] = (2048, 4096), repetitions: int = 3) -> pd.DataFrame:
    """Return ours, gudhi and the ratio, measured now on this machine: for a cell that is not compared."""
    table = pd.DataFrame(persistence_rows(tuple(sizes), repetitions, "torus", study_torus)).set_index("M")
    return table[["fast_ms", "gudhi_ms", "ratio"]].round(1)


def share_table(collected: Collected) -> pd.DataFrame:
    """Return per shape what the loss adds to training, from the recorded C1 runs: its stage's seconds over the photometric
    training's in the same run (percent), its share of training, and CPU seconds and peak memory of whole runs (evaluation
    included) under C0 and C1; beside the paper's. Means over seeds. Evaluation is the study's cost, not the method's, and left
    out of the percentages."""
    paper = published("cost").set_index("quantity")["value"]
    low, high, own = (
        paper["photometric_seconds_low"],
        paper["photometric_seconds_high"],
        paper["loss_seconds_per_run"],
    )
    rows = []
    for shape in dict.fromkeys(record["config"]["shape"] for record in collected.records):
        baseline, loss = collected.of(shape, "C0"), collected.of(shape, "C1")
        if not baseline or not loss:
            continue
        added = float(np.mean([record["timings"]["topology"] / _photometric(record) for record in loss]))
        row = {
            "shape": shape,
            "seeds": len(loss),
            "loss adds %": round(100 * added),
            "share of training %": round(100 * added / (1 + added)),
        }
        groups = {"C0": baseline, "C1": loss}
        row |= {
            f"CPU s {name}": round(float(np.mean([record["cpu_seconds"] for record in group])))
            for name, group in groups.items()
        }
        row |= {
            f"peak MiB {name}": round(float(np.mean([record["host"]["peak_memory_mib"] for record in group])))
            for name, group in groups.items()
        }
        rows.append(row)
    printed = {
        "shape": "paper (training on a GPU, gudhi on the CPU)",
        "loss adds %": f"{100 * own / high:.0f}–{100 * own / low:.0f}",
        "share of training %": f"{100 * own / (high + own):.0f}–{100 * own / (low + own):.0f}",
        "CPU s C0": f"{low:.0f}–{high:.0f}",
        "CPU s C1": f"{low + own:.0f}–{high + own:.0f}",
    }
    return (
        pd.concat([pd.DataFrame(rows).astype(object), pd.DataFrame([printed])], ignore_index=True)
        .fillna("")
        .set_index("shape")
    )


def _photometric(record: dict) -> float:
    return sum(
        seconds for stage, seconds in record["timings"].items() if stage not in ("evaluate", "topology")
    )
