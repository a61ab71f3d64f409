"""The paper's own numbers, from `results/published/` (see the README there for tables, columns and units)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY

PUBLISHED = REPOSITORY / "results" / "published"  # also where results go elsewhere
NUMBERS = ("dimension", "value", "sd", "seeds", "seed", "samples", "genus")
TEXTS = ("shape", "condition", "quantity", "note", "source", "knob", "setting")


def tables(folder: Path | str = PUBLISHED) -> list[str]:
    """Return the names that `published` takes: "1", "2", "S1" … "S13" (tables), "noise", "cost", … (numbers in the text)."""
    names = [path.stem.split("_", 1)[1] for path in Path(folder).glob("t*_*.csv")]
    numbered = [name for name in names if name.lstrip("S").isdigit()]
    return sorted(numbered, key=lambda name: (name[0] == "S", int(name.lstrip("S")))) + sorted(
        set(names) - set(numbered)
    )


def published(table: str, folder: Path | str = PUBLISHED) -> pd.DataFrame:
    """Return one table of the paper ("1", "S7", "noise", ...): numbers NaN, texts "" where the paper has none.

    Raises InputError for a name that is no table.
    """
    for kind in ("table", "text"):
        path = Path(folder) / f"{kind}_{table}.csv"
        if path.is_file():
            frame = pd.read_csv(path, keep_default_na=False, na_values=dict.fromkeys(NUMBERS, ""))
            kinds = dict.fromkeys(TEXTS, str) | dict.fromkeys(("value", "sd"), float)
            return frame.astype({name: kind for name, kind in kinds.items() if name in frame})
    known = ", ".join(tables(folder)) or f"none, since {folder} holds none: work in a checkout of the repository"
    raise InputError(f"the paper has no table '{table}' here; known: {known}")


def published_value(
    table: str, *, quantity: str = "tail_bottleneck", **columns: str | int
) -> tuple[float, float]:
    """Return (value, sd) of the one row of `table` with this quantity and these columns; sd is NaN where none is printed.

    published_value("1", shape="sphere", condition="C0") is (.0623, .0063). Raises InputError unless exactly one row fits.
    """
    frame = published(table)
    unknown = [name for name in columns if name not in frame]
    if unknown:
        raise InputError(
            f"table {table} has no column {', '.join(unknown)}; it has {', '.join(frame.columns)}"
        )
    chosen = frame["quantity"] == quantity
    for name, wanted in columns.items():
        chosen &= frame[name] == wanted
    if chosen.sum() != 1:
        raise InputError(
            f"{int(chosen.sum())} rows of table {table} have {quantity} and {columns}; name exactly one"
        )
    row = frame[chosen].iloc[0]
    return float(row["value"]), float(row["sd"])
