"""What the measurements of this folder share: the clock, the machine, the CSV.

A measurement is a script, `python data_scripts/measure/NAME.py`, that writes results/measured/NAME.csv or
prints ratios; a notebook reads the CSV with `results.measured(NAME)`. Times are CPU seconds of the process on
one thread, medians of turns in which the compared calls alternate, so that the load of the machine touches
all alike.
"""

import argparse
import gc
import importlib
import os
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any, Self

from paper_artifact.cli import as_script

as_script()  # before what takes long to import
os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy and torch start their threads

import pandas as pd

from paper_artifact.files import check_writable, write_text
from paper_artifact.results import MEASURED


class Clock:
    """CPU and wall seconds between entering and leaving the block `with Clock() as taken`."""

    cpu = wall = 0.0

    def __enter__(self) -> Self:
        self._begin = time.process_time(), time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        self.cpu = time.process_time() - self._begin[0]
        self.wall = time.perf_counter() - self._begin[1]


def in_turn(calls: Mapping[str, Callable[[], Any]], turns: int) -> dict[str, pd.DataFrame]:
    """Return each call's clocks, a frame with columns cpu and wall (seconds) and a row for each of `turns`
    turns in which the calls alternate, after one uncounted turn (compilation, caches)."""
    taken: dict[str, list[Clock]] = {name: [] for name in calls}
    for _ in range(turns + 1):
        for name, call in calls.items():
            gc.collect()  # so that no call is charged for another's garbage
            with Clock() as clock:
                call()
            taken[name].append(clock)
    return {
        name: pd.DataFrame({"cpu": [each.cpu for each in clocks], "wall": [each.wall for each in clocks]})[1:]
        for name, clocks in taken.items()
    }


def in_own_process(work: Callable, *arguments: Any) -> Any:
    """Return work(*arguments), computed in a new process: for peak memory. work: a function of a module."""
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    try:
        return pool.submit(work, *arguments).result()
    finally:
        for child in active_children():  # which an interrupt would wait for
            child.kill()
        pool.shutdown()


def count(text: str) -> int:
    """Return the whole number, at least 1, that an option gives; ValueError for another."""
    if int(text) < 1:
        raise ValueError(f"{text} is less than 1")
    return int(text)


def options(text: str | None, **extra: Mapping[str, Any]) -> argparse.Namespace:
    """Return the command line of a script with the docstring `text`: --out, the folder of the CSV, and the
    `extra` options, {name: keywords of `add_argument`}."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=MEASURED, help="folder of the CSV (%(default)s)")
    for name, keywords in extra.items():
        parser.add_argument(f"--{name}", **keywords)
    given = parser.parse_args()
    if given.out.exists() and not given.out.is_dir():
        parser.error(f"--out {given.out} is no folder; name another")
    check_writable(given.out / f"{parser.prog}.csv")  # before anything is measured
    return given


def needed(runs: pd.Series, shapes: Iterable[str], sweep: str) -> pd.Series:
    """Return the runs, by shape; ends the program where one of `shapes` has none."""
    if missing := [shape for shape in shapes if shape not in runs.index]:
        raise SystemExit(f"no run of {missing[0]} is recorded; python -m paper_artifact sweep {sweep}")
    return runs


def import_pymeshlab() -> Any:
    """Return the module; ends the program where it is not installed."""
    try:
        return importlib.import_module("pymeshlab")
    except ImportError as error:
        raise SystemExit(f"pymeshlab does not import ({error}); see docs/study.md") from error


def _read(path: Path) -> pd.DataFrame:
    """Return the table at `path`; one without columns where the file holds none."""
    try:
        return pd.read_csv(path)
    except ValueError:  # pandas' own are
        return pd.DataFrame()


def kept(path: Path, key: list[str]) -> pd.DataFrame:
    """Return the table at `path` that a script goes on with, an empty one with the columns `key` where there
    is none. Ends the program where it is another table."""
    table = _read(path) if path.is_file() else pd.DataFrame(columns=key)
    if not {*key} <= {*table.columns}:
        raise SystemExit(f"{path} is no table of this script; choose another folder with --out")
    return table


def write(table: pd.DataFrame, path: Path) -> None:
    """Write a table with 6 significant digits, whole or not at all. What is at `path` and has other columns
    or more rows stays; the table is written beside it then, as NAME-new.csv, NAME-new-new.csv, …"""
    while path.is_file():
        before = _read(path)
        if [*before.columns] == [*table.columns] and len(before) <= len(table):
            break
        print(f"kept: {path}, which has other columns or more rows")
        path = path.with_stem(f"{path.stem}-new")
    write_text(path, table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))
    print(f"written: {path}, {len(table)} rows")
