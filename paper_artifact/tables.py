"""Tables of the repository (CSV) as frames: what is damaged or is no file is named, with what to do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from paper_artifact.errors import InputError
from paper_artifact.files import plain


def read_table(path: Path, *columns: str, advice: str, numbers: Sequence[str] | None = ()) -> pd.DataFrame:
    """Return the CSV (UTF-8) at `path`, cells as the texts that they are.

    columns: what it must have, among others. numbers: of these columns the cells are numbers, NaN where
    empty; None: of all columns, where all cells are. Raises InputError, which ends with `advice`, where it
    cannot be read, is no such table, lacks a column, or a cell of `numbers` is none.
    """
    as_written: dict[str, Any] = {} if numbers is None else {"dtype": str, "keep_default_na": False}
    try:
        frame = pd.read_csv(plain(path), encoding="utf-8", **as_written)
        for name in numbers or ():
            if name in frame:
                frame[name] = pd.to_numeric(frame[name].replace("", float("nan")))
    except (OSError, ValueError) as error:  # pandas' own are ValueErrors
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:150]
        raise InputError(f"cannot read the table {path} ({reason}); {advice}") from error
    if missing := [name for name in columns if name not in frame]:
        raise InputError(f"the table {path} has no column {', '.join(missing)}; {advice}")
    return frame
