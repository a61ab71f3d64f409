"""The run records as four tidy frames, and the paper's numbers as one more. Notebooks compute every table
from these.

    from paper_artifact import results

    tables = results.load()                                # every committed record
    runs = tables.of("table1")                             # one row per run of a study
    runs.groupby(["shape", "condition"])["tail"].agg(["mean", "std", "size"])
    results.published("1")                                 # the paper's Table 1

Lengths are divided by the diagonal of the ground truth's bounding box; births and deaths are radii. A
dimension is that of homology: 0 components, 1 loops, 2 voids; the judged one decides a shape's verdict
(`catalogue.SHAPES`). A column whose name ends with _h0, _h1 or _h2 exists for each dimension. Shapes and
conditions are ordered categories, in the catalogue's order."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from paper_artifact.catalogue import CONDITIONS, SHAPES, shape_row, study_config
from paper_artifact.config import AllocationConfig, LossConfig, RunConfig, config_values
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, RESULTS, atomic_path
from paper_artifact.record.store import read_record, recorded_path
from paper_artifact.study.studies import STUDIES
from paper_artifact.tables import read_table

PUBLISHED = REPOSITORY / "results" / "published"  # committed, also where runs are written elsewhere
MEASURED = REPOSITORY / "results" / "measured"  # one CSV per script of data_scripts/measure
RETRAINED = RESULTS / "retrained"  # the profile "full" writes here
RESTORE = "restore it with git"
NUMBERS = ("dimension", "value", "sd", "ratio", "seeds", "seed", "samples", "genus")  # columns of PUBLISHED

# What a record must have for `_run_row`, and the columns of a refresh, for folders without any.
NOTHING: dict[str, Any] = {
    "config": config_values(RunConfig("")),
    "host": {"cpu": "", "peak_memory_mib": 0},
    **dict.fromkeys(("tails", "images", "soup", "timings"), {}),
    "cpu_seconds": 0,
}
REFRESH = (
    *("run", "step", "samples", "floor", "live_floor", "dimension", "significant", "matched", "recruited"),
    *("unreached", "diagonal", "gabriel_failures", "wanted", "surplus", "residual", "margins"),
)
_study_config = cache(study_config)
Frames = tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, pd.DataFrame]


@dataclass(frozen=True)
class Results:
    """The four frames of a folder of records.

    runs, one row per record: run (the record's file name without ".json"); shape, condition, seed, dimension
    (judged), group; every setting of the run (steps, budget, views …), of its loss with the prefix loss_
    (loss_rho, loss_samples …) and of its allocation prior with the prefix allocation_; NaN where a run has no
    such part, no ground truth, no dumps or no held-out views. Results: tail (mean bottleneck distance to the
    target in the judged dimension over the last three dumps: steps 2300, 2400, 2500 of 2,500) and tail_h0 …
    tail_h2; chamfer (mean of both directions, last dumps), hausdorff95; count (significant bars at the end in
    the judged dimension; the infinite component is not counted) and count_h0 … count_h2; expected (the count
    of the shape's target bundle in the judged dimension, else of the mesh's Betti numbers; NaN where neither
    is known); psnr (dB) and ssim over the held-out views; triangles. The loss: lambda_peak, photo_norm,
    topo_norm (calibration); bundle_h0 … bundle_h2 (the target's bars (k,2)); statement (stated Betti
    numbers); events (list of the topology log's other entries). Ground truth: diagonal (world units), floor,
    betti_h0 … betti_h2. Machine: cpu, cpu_seconds, seconds_* by stage (wall time), peak_memory_mib.

    dumps, one row per evaluation during training: run, shape, condition, seed, step, bottleneck and count
    (judged dimension), bottleneck_h0 …, count_h0 …, bars_h0 … (arrays (k,2) of births and deaths; the
    longest), floor, chamfer, hausdorff95, triangles. Step 0 is the soup before training, with bottleneck,
    count and chamfer alone, where `measured/starts.csv` has it.

    refreshes, one row per refresh of the plan and dimension: run, step, dimension, samples, floor (that
    decides), live_floor, significant, matched, recruited, unreached, diagonal, gabriel_failures (counts of
    bars), wanted and surplus (stated Betti numbers only), residual (the largest |live - target| over births
    and deaths of matched and recruited bars; NaN without any), margins (list: lifetimes over the floor,
    longest first; stated Betti numbers only).

    studies, one row per run of a study: study, setting ("rho=0.03": what the block changes; "" for nothing),
    shape, condition, seed, run (NaN where no record exists)."""

    runs: pd.DataFrame
    dumps: pd.DataFrame
    refreshes: pd.DataFrame
    studies: pd.DataFrame
    folder: Path  # of the records; soups lie in ../soups beside it

    def of(self, *studies: str) -> pd.DataFrame:
        """Return the runs of these studies, each run once, with the columns study and setting of the first
        that has it.

        Raises InputError for a study that does not exist.
        """
        unknown = [name for name in studies if name not in STUDIES]
        if unknown:
            raise InputError(f"unknown study {unknown[0]!r}; choose among {', '.join(STUDIES)}")
        rows = pd.concat([self.studies[self.studies["study"] == name] for name in studies])
        rows = rows.dropna(subset="run").drop_duplicates("run")[["study", "setting", "run"]]
        # A folder may also hold runs without ground truth, whose judged dimension is NaN.
        return rows.merge(self.runs, on="run", validate="1:1").astype({"dimension": int})

    def soup_path(self, run: str) -> Path:
        """Return the path of a run's trained soup; not every soup is committed."""
        return self.folder.parent / "soups" / f"{run}.npz"


def load(profile: str = "recorded", studies: Iterable[str] = (), folder: Path = RESULTS / "runs") -> Results:
    """Return the frames of the records in `folder`.

    profile "recorded": the records as they are; prints one line for each of the named studies (default: all)
    that lacks runs. "full": trains every run of the named studies into RETRAINED (hours; recorded ones there
    are kept) and returns the frames of that folder. The first call reads JSON (half a minute for 926 records)
    and keeps the study's frames; later calls take a second. Raises InputError for a damaged record, an
    unknown profile or study."""
    names = tuple(studies) or tuple(STUDIES)
    if profile not in ("recorded", "full"):
        raise InputError(f"the profile {profile!r} is unknown; use 'recorded' or 'full'")
    if unknown := {*names} - {*STUDIES}:
        raise InputError(f"no study is called {min(unknown)!r}; give a list of {', '.join(STUDIES)}")
    if profile == "full":
        folder = _retrain(names)
    frames = _cached(folder)
    for name, line in _missing(frames.studies[frames.studies["study"].isin(names)]):
        print(f"{name}: {line}; python -m paper_artifact sweep {name} makes them")
    return frames


def _retrain(names: Iterable[str]) -> Path:
    from paper_artifact.pipeline import run
    from paper_artifact.scene.shapes import find_mesh

    for name in names:
        for block in STUDIES[name]:
            for config in block.configs():
                run(config, mesh=find_mesh(config.shape), results=RETRAINED)
    return RETRAINED / "runs"


def _missing(rows: pd.DataFrame) -> Iterator[tuple[str, str]]:
    for study, own in rows.groupby("study", sort=False):
        absent = own[own["run"].isna()]
        if len(absent):
            arms = absent.groupby(["shape", "condition"], observed=True)["seed"].agg(
                lambda seeds: sorted({*seeds})
            )
            text = ", ".join(f"{shape} {name} seeds {seeds}" for (shape, name), seeds in arms.items())
            yield str(study), f"{len(absent)} of {len(own)} runs are not recorded: {text}"


def _cached(folder: Path) -> Results:
    """Return the frames; of the study's own folders from the file that keeps them, where neither records nor
    the code have changed. A pickle can run code: none beside others' records is opened."""
    paths = sorted(Path(folder).glob("[!.]*.json"))
    try:
        states = [(path.name, state.st_size, state.st_mtime_ns) for path in paths for state in (path.stat(),)]
    except OSError as error:  # a link that leads nowhere, or removed just now
        raise InputError(f"cannot read the record {error.filename}: {error.strerror}; remove it") from error
    code = [each.read_bytes() for each in (Path(__file__), MEASURED / "starts.csv") if each.is_file()]
    key = hashlib.sha256(repr((states, code, str(STUDIES), pd.__version__)).encode()).digest()
    kept = Path(folder).resolve().parent / ".frames" / f"{Path(folder).name}.pickle"
    own = kept.parent.parent in (RESULTS.resolve(), RETRAINED.resolve())
    if own and kept.is_file() and kept.stat().st_uid == os.getuid():
        with suppress(Exception), open(kept, "rb") as file:  # cut off or of another pandas: made again
            if file.read(len(key)) == key:
                kept_frames: Frames = pickle.load(file)
                return Results(*kept_frames, Path(folder))
    frames = _read(paths)
    if own:
        with suppress(InputError, OSError), atomic_path(kept) as partial:  # where it can be written
            partial.write_bytes(key + pickle.dumps(frames, protocol=5))
    return Results(*frames, Path(folder))


def _read(paths: list[Path]) -> Frames:
    runs: list[dict[str, Any]] = []
    dumps: list[dict[str, Any]] = []
    refreshes: list[dict[str, Any]] = []
    starts = _starts()
    for path in paths:
        record = read_record(path)
        row = _run_row(path.stem, record)
        key = {name: row[name] for name in ("run", "shape", "condition", "seed")}
        runs.append(row)
        if (start := _start_of(record["config"], starts)) is not None:
            dumps.append(key | {"step": 0} | start)
        dumps += [key | _dump_row(dump, row["dimension"]) for dump in record["dumps"]]
        for entry in record.get("topology") or ():
            if entry["event"] == "refresh" and "dimensions" in entry:
                refreshes += [{"run": path.stem} | each for each in _refresh_rows(entry)]
    settings = [f"loss_{field.name}" for field in fields(LossConfig)]
    settings += [f"allocation_{field.name}" for field in fields(AllocationConfig)]
    frame = _frame(runs, _run_row("", NOTHING))
    frame = frame.reindex(columns=[*frame, *(name for name in settings if name not in frame)])
    frame["expected"] = _expected(frame)
    studies = pd.DataFrame(_study_rows({row["run"] for row in runs}, paths[0].parent if paths else RESULTS))
    dumped = _frame(dumps, ("run", "shape", "condition", "seed", *_dump_row({}, np.nan)))
    return _ordered(frame), _ordered(dumped), _frame(refreshes, REFRESH), _ordered(studies)


def _frame(rows: list[dict[str, Any]], columns: Iterable[str]) -> pd.DataFrame:
    """Return the frame of these rows, with these columns where there is none."""
    return pd.DataFrame(rows, columns=None if rows else [*columns])


def _run_row(name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    config, mesh, tails = record["config"], record.get("mesh") or {}, record["tails"]
    judged = mesh.get("dimension", np.nan)
    shape = shape_row(config["shape"])
    row: dict[str, Any] = {"run": name} | {key: config[key] for key in ("shape", "condition", "seed")}
    row |= {"dimension": judged, "group": shape.group if shape else ""}
    parts = {"loss": config.get("loss") or {}, "allocation": config.get("allocation") or {}}
    row |= {key: value for key, value in config.items() if key not in parts}
    row |= {f"{part}_{key}": value for part, values in parts.items() for key, value in values.items()}
    row |= _by_dimension(judged, tail=tails.get("bottleneck"), count=tails.get("counts"))
    row |= _numbers(tails, "chamfer", "hausdorff95") | _numbers(record["images"], "psnr", "ssim")
    row |= _numbers(record["soup"], "triangles")
    events = [entry for entry in record.get("topology") or () if entry["event"] != "refresh"]
    calibrated: dict = next((entry for entry in events if entry["event"] == "lambda"), {})
    row |= {key: calibrated.get(key) for key in ("lambda_peak", "photo_norm", "topo_norm")}
    bars = (record.get("bundle") or {}).get("bars")
    row |= {f"bundle_h{d}": None if bars is None else _bars(bars[d]) for d in range(3)}
    row |= {"statement": (record.get("statement") or {}).get("betti"), "events": events}
    row |= _numbers(mesh, "diagonal", "floor") | _by_dimension(None, betti=mesh.get("betti"))
    row |= {"cpu": record["host"]["cpu"], "cpu_seconds": record["cpu_seconds"]}
    row |= {f"seconds_{stage}": seconds for stage, seconds in record["timings"].items()}
    return row | {"peak_memory_mib": record["host"]["peak_memory_mib"]}


def _dump_row(dump: Mapping[str, Any], judged: Any) -> dict[str, Any]:
    row = {"step": dump.get("step")}
    row |= _by_dimension(judged, bottleneck=dump.get("bottleneck"), count=dump.get("counts"))
    row |= _numbers(dump, "floor", "chamfer", "hausdorff95", "triangles")
    return row | {f"bars_h{d}": _bars(bars) for d, bars in enumerate(dump.get("bars") or [[]] * 3)}


def _refresh_rows(entry: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    common = {key: entry[key] for key in ("step", "samples", "floor", "live_floor")}
    for dimension, plan in entry["dimensions"].items():
        off = [
            abs(live - target)
            for pair in plan["targets"]
            if pair.get("live")
            for live, target in zip(pair["live"], pair["target"], strict=True)
        ]
        counts = {key: value for key, value in plan.items() if key != "targets"}
        yield common | {"dimension": int(dimension)} | counts | {"residual": max(off, default=np.nan)}


def _by_dimension(judged: Any, **columns: Sequence[Any] | None) -> dict[str, Any]:
    """Return {name: value in the judged dimension} of every column, but for None, and {name_h0: value, …};
    NaN for what is not known."""
    found = {
        name: [np.nan if each is None else each for each in values or [None] * 3]
        for name, values in columns.items()
    }
    known = judged in (0, 1, 2)
    row = (
        {name: values[judged] if known else np.nan for name, values in found.items()}
        if judged is not None
        else {}
    )
    return row | {f"{name}_h{d}": value for name, values in found.items() for d, value in enumerate(values)}


def _numbers(values: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: np.nan if values.get(name) is None else values[name] for name in names}


def _bars(bars: Any) -> np.ndarray:
    return np.asarray(bars, dtype=np.float64).reshape(-1, 2)


def _expected(runs: pd.DataFrame) -> pd.Series:
    """Return the count of significant bars that a run should end with in the judged dimension: what its
    bundle holds; without one what the shape's bundle at the study's density holds; else what the mesh's Betti
    numbers say."""

    def held(row: Any) -> float:
        bars = getattr(row, f"bundle_h{row.dimension:.0f}", None)
        return np.nan if bars is None else len(bars)

    own = pd.Series([held(row) for row in runs.itertuples()], index=runs.index)
    study = {row.name: row.samples for row in SHAPES}
    usual = runs["loss_samples"].astype(object) == runs["shape"].map(study)
    by_shape = own[usual & own.notna()].groupby(runs["shape"]).first()
    betti = [getattr(row, f"betti_h{row.dimension:.0f}", np.nan) for row in runs.itertuples()]
    known = pd.to_numeric(pd.Series(betti, index=runs.index)) - (runs["dimension"] == 0)
    return own.fillna(runs["shape"].map(by_shape)).fillna(known)


def _starts() -> dict[tuple[str, int], dict[str, float]]:
    path, numbers = MEASURED / "starts.csv", ("seed", "bottleneck", "count", "chamfer")
    if not path.exists():
        return {}
    table = read_table(path, "shape", *numbers, advice=RESTORE, numbers=numbers)
    return table.set_index(["shape", "seed"]).to_dict("index")


def _start_of(config: Mapping[str, Any], starts: Mapping) -> dict[str, float] | None:
    """Return the stored start of a run; None where it does not begin as the study's runs of that shape and
    seed do."""
    if shape_row(config["shape"]) is None:
        return None
    usual = _study_config(config["shape"])
    allocation = config.get("allocation") or {}
    noisy = any(config.get(name) for name in ("cloud_noise", "cloud_outliers", "cloud_missing"))
    other = any(config[name] != getattr(usual, name) for name in ("budget", "initial_ratio"))
    if other or config.get("given") or noisy or allocation.get("levers") == "start":
        return None
    return starts.get((config["shape"], config["seed"]))


def _study_rows(recorded: set[str], folder: Path) -> Iterator[dict[str, Any]]:
    for name, blocks in STUDIES.items():
        for block in blocks:
            for config in block.configs():
                path = recorded_path(config, folder)
                row = {"study": name, "setting": block.setting, "shape": config.shape}
                run = path.stem if path is not None and path.stem in recorded else None
                yield row | {"condition": config.condition, "seed": config.seed, "run": run}


def _ordered(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the frame with shape and condition as ordered categories."""
    for column, rows in (("shape", SHAPES), ("condition", CONDITIONS)):
        known = [row.name for row in rows]
        names = known + sorted(set(frame[column]) - set(known))
        frame[column] = pd.Categorical(frame[column], names, ordered=True)
    return frame


@cache
def _published() -> pd.DataFrame:
    frames = []
    for path in sorted(PUBLISHED.glob("t*_*.csv")):
        kind, _, table = path.stem.partition("_")
        own = read_table(path, "source", advice=RESTORE)
        if "value" in own:
            own = read_table(path, advice=RESTORE, numbers=NUMBERS).assign(printed=own["value"])
        elif {"shape", "method"} & {*own}:  # tables of texts: a row per cell
            own = own.rename(columns={"method": "shape"}).melt(
                ["shape", "source"], var_name="quantity", value_name="printed"
            )
        else:
            raise InputError(f"the table {path} has neither values nor methods nor shapes; {RESTORE}")
        frames.append(own.assign(table=table, kind=kind))
    if not frames:
        raise InputError(f"{PUBLISHED} holds no table of the paper; work in a checkout")
    frame = pd.concat(frames, ignore_index=True)
    texts = frame.columns.difference(NUMBERS)
    frame[texts] = frame[texts].fillna("")
    columns = ["table", "shape", "dimension", "condition", "seed", "samples", "quantity", "value", "printed"]
    columns += ["sd", "ratio", "seeds", "knob", "setting", "note", "source"]
    return frame.reindex(columns=[*columns, *frame.columns.difference([*columns, "kind"])])


def published(*tables: str, quantity: str = "") -> pd.DataFrame:
    """Return the paper's numbers, one row each, in one schema for all tables and texts (default: all of
    them).

    Columns: table ("1", "S7", or "noise", "chamfer" … for numbers in the text), shape, dimension, condition,
    seed, samples (the density M), quantity ("tail_bottleneck" unless the README of results/published says
    otherwise), value, printed (the same as the paper prints it, a text), sd, ratio (C0 / this, as printed),
    seeds (how many), knob, setting, note, source. NaN and "" where the paper gives nothing. Tables S6 and S12
    hold texts: one row per cell, quantity is its column, shape its row, value NaN. quantity: only these rows.
    Raises InputError for an unknown table, and outside of a checkout."""
    frame = _published()
    known = frame["table"].unique()
    for table in tables:
        if table not in known:
            raise InputError(f"the paper has no table {table!r} here; known: {', '.join(known)}")
    chosen = frame[frame["table"].isin(tables)] if tables else frame
    if quantity:
        chosen = chosen[chosen["quantity"] == quantity]
    place = {table: number for number, table in enumerate(tables or known)}  # as asked for
    return chosen.sort_values("table", key=lambda names: names.map(place), kind="stable")


def measured(name: str) -> pd.DataFrame:
    """Return results/measured/<name>.csv, the output of data_scripts/measure/<name>.py.

    Raises InputError when the file does not exist or is no table.
    """
    path = MEASURED / f"{name}.csv"
    if not path.exists():
        raise InputError(f"{path} does not exist; python data_scripts/measure/{name}.py makes it")
    return read_table(path, advice="delete it and measure again", numbers=None)
