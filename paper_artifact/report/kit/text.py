"""The wording of table cells: arms, tails, counts and seeds, the same in every notebook."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

NOT_RECORDED = "not recorded"


def short(value: float) -> str:
    """Return a tail with four decimals as the paper prints it, ".0156"."""
    return f"{value:.4f}".removeprefix("0") if value < 1 else f"{value:.4f}"


def span(values: Iterable[float], digits: int) -> str:
    """Return the least and the largest value, "0.97–1.03"."""
    values = list(values)
    return f"{min(values):.{digits}f}–{max(values):.{digits}f}"


def arm_text(mean: float, sd: float | None = None, ratio: float | str | None = None) -> str:
    """Return ".0156±.0013 (4.0×)" without the parts that are None, NaN or ""; a ratio that is a text is
    printed as it is."""
    text = short(mean) + ("" if pd.isna(sd) else f"±{short(sd)}")
    if ratio == "" or pd.isna(ratio):
        return text
    return f"{text} ({ratio if isinstance(ratio, str) else f'{ratio:.2f}'}×)"


def tails_text(tails: Iterable[float]) -> str:
    """Return tails seed by seed, ".0161/.0171"."""
    return "/".join(map(short, tails))


def range_text(tails: Iterable[float], others: Iterable[float]) -> str:
    """Return how one arm's tails lie to another's: "below" or "above" where the ranges do not touch, else
    "overlaps"; "" where either has none."""
    tails, others = list(tails), list(others)
    if not tails or not others:
        return ""
    return "below" if max(tails) < min(others) else "above" if min(tails) > max(others) else "overlaps"


def counts_text(counts: Iterable[int | None]) -> str:
    """Return significant counts seed by seed, "2/2/1", "?" where unknown."""
    return "/".join("?" if count is None else str(count) for count in counts)


def seeds_text(seeds: Iterable[int] | None) -> str:
    """Return the seeds "0, 2", "none" for no seed, "unknown" for None."""
    return "unknown" if seeds is None else ", ".join(map(str, seeds)) or "none"


def blank(table: pd.DataFrame | pd.Series) -> pd.DataFrame | pd.Series:
    """Return the table or column with "" where it holds None or NaN."""
    return table.astype(object).where(table.notna(), "")
