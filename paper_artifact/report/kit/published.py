"""The paper's own numbers, from `results/published/` (see the README there for tables, columns and units)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY

PUBLISHED = REPOSITORY / "results" / "published"  # also where runs are written elsewhere
NUMBERS = ("dimension", "value", "sd", "seeds", "seed", "samples", "genus")


def tables(folder: Path | str = PUBLISHED) -> list[str]:
    """Return the names that `published` takes: "1", "2", "S1" … "S13" (tables), "noise", "cost", …
    (numbers in the text)."""
    names = [path.stem.split("_", 1)[1] for path in Path(folder).glob("t*_*.csv")]
    numbered = [name for name in names if name.lstrip("S").isdigit()]
    numbered.sort(key=lambda name: (name[0] == "S", int(name.lstrip("S"))))
    return numbered + sorted(set(names) - set(numbered))


def published(table: str, folder: Path | str = PUBLISHED) -> pd.DataFrame:
    """Return one table of the paper ("1", "S7", "noise", ...): numbers NaN, texts "" where the paper has
    none.

    Column "printed" is the value as the paper prints it, a text. Raises InputError for a name that is no
    table.
    """
    for kind in ("table", "text"):
        path = Path(folder) / f"{kind}_{table}.csv"
        if path.is_file():
            frame = pd.read_csv(path, dtype=str, keep_default_na=False)
            if "value" in frame:
                frame["printed"] = frame["value"]
            frame = frame.assign(**{name: pd.to_numeric(frame[name]) for name in NUMBERS if name in frame})
            return frame.astype({name: float for name in ("value", "sd") if name in frame})
    known = ", ".join(tables(folder)) or f"none, since {folder} holds none: work in a checkout"
    raise InputError(f"the paper has no table '{table}' here; known: {known}")
