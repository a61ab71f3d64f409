"""Tables of arms: mean ± sd and ratio per shape and condition, ours beside the published."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pandas as pd

from paper_artifact.study.verdict import Arm, Rows, Verdict, verdict


def published_rows(published: pd.DataFrame) -> list[dict]:
    """Return the rows (as for `verdict`) of the per-seed tails in `published`, tables of `paper_artifact.report.published`."""
    chosen = _published_tails(published)
    return [
        {
            "shape": row["shape"],
            "condition": row["condition"],
            "seed": int(row["seed"]),
            "dimension": int(row["dimension"]),
            "tail": float(row["value"]),
        }
        for row in chosen[chosen["seed"].notna()].to_dict("records")
    ]


def arm_table(rows: Rows, published: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return one line per shape and condition: dimension, seeds, mean, sd (n - 1), ratio (C0 / this), low, high, chamfer, counts.

    published: tables of `paper_artifact.report.published` (several concatenated will do); adds "published mean", "published sd"
    and "published ratio" (C0 / this, of the published means), from the printed means where there are any, else from the seeds.
    """
    lines = []
    for shape, judged in verdict(rows).items():
        for condition, arm in judged.arms.items():
            lines.append(
                {
                    "shape": shape,
                    "dimension": judged.dimension,
                    "condition": condition,
                    "seeds": len(arm.seeds),
                    "mean": arm.mean,
                    "sd": arm.sd,
                    "ratio": arm.ratio,
                    "low": min(arm.tails),
                    "high": max(arm.tails),
                    "chamfer": arm.chamfer,
                    "counts": counts_text(arm),
                }
            )
    table = pd.DataFrame(lines)
    if published is None or table.empty:
        return table
    return table.merge(_published_arms(published), on=["shape", "condition"], how="left")


def verdict_table(rows: Rows, published: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the paper's Table 1 layout: one line per shape, "mean±sd (ratio×)" per condition, then verdict and reason.

    published: as for `arm_table`; adds a second line per shape ("source" says which), with a verdict only where the paper prints
    per-seed tails, because the rule needs them.
    """
    lines = [_line("ours", judged) for judged in verdict(rows).values()]
    if published is not None:
        shapes = [line["shape"] for line in lines]
        chosen = published[published["shape"].isin(shapes)]
        judged = verdict(published_rows(chosen))
        for line in _summary_lines(_published_arms(chosen)):
            if line["shape"] in judged:
                line |= {"verdict": judged[line["shape"]].outcome, "reason": judged[line["shape"]].reason}
            lines.append(line)
        lines.sort(key=lambda line: (shapes.index(line["shape"]), line["source"] != "ours"))
    table = pd.DataFrame(lines).fillna("")
    conditions = sorted(name for name in table.columns if name not in _FIXED)
    return table[["shape", "source", *conditions, *(name for name in _FIXED[2:] if name in table)]]


_FIXED = ("shape", "source", "seeds", "Chamfer C1/C0", "Welch C0-C1", "verdict", "reason")


def arm_text(mean: float, sd: float | None, ratio: float | None) -> str:
    """Return ".0156±.0013 (4.0×)" in the paper's style, without the parts that are unknown."""
    text = _short(mean) + ("" if sd is None or pd.isna(sd) else f"±{_short(sd)}")
    return text if ratio is None or pd.isna(ratio) else f"{text} ({ratio:.2f}×)"


def counts_text(arm: Arm) -> str:
    """Return the significant counts per seed, "2/2/1", "?" where unknown."""
    return "/".join("?" if count is None else str(count) for count in arm.counts)


def tails_text(values: Iterable[float]) -> str:
    """Return tails seed by seed, ".0161/.0171"."""
    return "/".join(f"{value:.4f}".removeprefix("0") for value in values)


def seeds_text(seeds: tuple[int, ...] | None) -> str:
    """Return the seeds "0, 2", "none" for no seed, "unknown" for None."""
    return "unknown" if seeds is None else "none" if not seeds else ", ".join(map(str, seeds))


def _line(source: str, judged: Verdict) -> dict:
    line = {"shape": judged.shape, "source": source}
    for condition, arm in judged.arms.items():
        line[condition] = arm_text(arm.mean, arm.sd, None if condition == "C0" else arm.ratio)
    line["seeds"] = "/".join(str(len(arm.seeds)) for arm in judged.arms.values())
    line["Chamfer C1/C0"] = "" if judged.parity_ratio is None else f"{judged.parity_ratio:.2f}"
    line["Welch C0-C1"] = f"{judged.welch['C0']:.1f}" if "C0" in judged.welch else ""
    return line | {"verdict": judged.outcome, "reason": judged.reason}


def _published_tails(published: pd.DataFrame) -> pd.DataFrame:
    chosen = published[published["quantity"] == "tail_bottleneck"].copy()
    if "seed" not in chosen:
        chosen["seed"] = float("nan")
    return chosen


def _published_arms(published: pd.DataFrame) -> pd.DataFrame:
    tails = _published_tails(published)
    printed = tails[tails["seed"].isna()].drop_duplicates(["shape", "condition"])
    printed = printed.set_index(["shape", "condition"])[["value", "sd"]].rename(columns={"value": "mean"})
    seeds = tails[tails["seed"].notna()].groupby(["shape", "condition"])["value"].agg(["mean", "std"])
    seeds = seeds.rename(columns={"std": "sd"})
    arms = printed.combine_first(seeds).reset_index()
    baseline: Mapping = arms[arms["condition"] == "C0"].set_index("shape")["mean"]
    arms["ratio"] = arms["shape"].map(baseline) / arms["mean"]
    return arms.rename(columns={name: f"published {name}" for name in ("mean", "sd", "ratio")})


def _summary_lines(arms: pd.DataFrame) -> list[dict]:
    lines: dict[str, dict] = {}
    for row in arms.to_dict("records"):
        line = lines.setdefault(row["shape"], {"shape": row["shape"], "source": "published"})
        ratio = None if row["condition"] == "C0" else row["published ratio"]
        line[row["condition"]] = arm_text(row["published mean"], row["published sd"], ratio)
    return list(lines.values())


def _short(value: float) -> str:
    return f"{value:.4f}".removeprefix("0") if value < 1 else f"{value:.4f}"
