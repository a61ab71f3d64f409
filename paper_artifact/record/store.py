"""Run records: configuration, environment and results of one run, in one small JSON file.

File name: `<shape>-<condition>-s<seed>-<hash>.json` in `results/runs/`; hash is the first 12 hex digits of
the SHA-256 of the run's identity: what differs from the defaults (`paper_artifact.config.identity`), whose
version the record names under "defaults". A second hash, "digest", covers the whole record, so that a
hand-edited number is noticed. Numbers that are not finite are stored as null: JSON has no NaN.

Logs are lists of like-shaped JSON objects, stored as tables, so that 200 refreshes stay small and readable:
`unpack(pack(value)) == value` for every JSON value without keys that start with "#". Marks: {"#same": v,
"#count": n} is n times v; {"#table": {key: column}} is a list of objects with those keys; {"#lists": [column,
...]} is a list of lists of one length; {"#mixed": [[places, list], ...]} is a list of objects of several
kinds, each kind stored together.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.config import DEFAULTS_VERSION, RunConfig, config_from, config_values, identity
from paper_artifact.errors import InputError
from paper_artifact.files import RESULTS, cut_name, load_json, write_text
from paper_artifact.record.environment import host, packages
from paper_artifact.record.form import form_of, misfit

SCHEMA = "paper_artifact.run"
VERSION = 2
RUNS = RESULTS / "runs"
DIGITS = 7
HASH_DIGITS = 12
ROUNDED = ("dumps", "tails", "topology")  # sections of measurements, kept to DIGITS significant digits
REPLACED = "was changed, or another version wrote it, and would be replaced; move it elsewhere"
LOSS_POINTS = 250  # a trajectory of 2,500 steps is kept at every tenth


def plain(value: Any, digits: int | None = None) -> Any:
    """Return `value` as JSON knows it: mappings → dicts; arrays, tuples → lists; NaN, infinity → None.

    digits: significant digits that floats are rounded to, or None. Raises InputError for what a record cannot
    hold.
    """
    if isinstance(value, Mapping):
        if any(str(key).startswith("#") for key in value):
            raise InputError(
                "a record's names must not start with '#', which marks packed tables; rename the entry"
            )
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), digits)
    if isinstance(value, (list, tuple)):
        return [plain(item, digits) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return None if not math.isfinite(value) else value if digits is None else float(f"{value:.{digits}g}")
    if isinstance(value, Path):
        return value.as_posix()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    raise InputError(f"a record cannot hold a {type(value).__name__}; give numbers, texts, lists or mappings")


def config_hash(config: RunConfig, version: int = DEFAULTS_VERSION) -> str:
    """Return the first 12 hex digits of the SHA-256 of the run's identity under that version of the
    defaults."""
    return _hash(plain(identity(config, version)))[:HASH_DIGITS]


def record_path(config: RunConfig, folder: Path | str = RUNS, version: int = DEFAULTS_VERSION) -> Path:
    """Return where the record of `config` lies, or would lie, under that version of the defaults."""
    shape, condition = (
        cut_name(re.sub(r"[^A-Za-z0-9_.+-]", "_", Path(name).name))
        for name in (config.shape, config.condition)
    )
    return Path(folder) / f"{shape}-{condition}-s{config.seed}-{config_hash(config, version)}.json"


def recorded_path(config: RunConfig, folder: Path | str = RUNS) -> Path | None:
    """Return the path of the record of `config` that is there, under the newest version of the defaults that
    has one, or None. One's own data may have been called otherwise then: their content is looked for."""
    paths = [record_path(config, folder, version) for version in range(DEFAULTS_VERSION, 0, -1)]
    if config.given is not None and config.given.digest:
        ends = [f"*-s{config.seed}-{path.stem[-HASH_DIGITS:]}.json" for path in paths]
        paths += [found for end in ends for found in sorted(Path(folder).glob(end))]
    return next((path for path in paths if path.is_file()), None)


def config_of(record: Mapping) -> RunConfig:
    """Return the record's configuration; a field that is newer than the record has its default. InputError
    when it is not one."""
    return config_from(record["config"], record["defaults"])


def make_record(
    config: RunConfig,
    dumps: list,
    tails: Mapping,
    timings: Mapping[str, float],
    losses: Mapping[str, list] | None = None,
    **more: Any,
) -> dict:
    """Return a record as a JSON-ready dict; `timings` in seconds by stage, `losses` columns of equal length,
    "step" among them.

    more: further sections ("images", "topology", "soup", ...). Losses are thinned to LOSS_POINTS rows, the
    last kept. Raises InputError for a section that JSON cannot hold.
    """
    body = {
        "schema": SCHEMA,
        "version": VERSION,
        "defaults": DEFAULTS_VERSION,
        "config": plain(config_values(config)),
        "config_hash": config_hash(config),
        "packages": packages(),
        "host": host(),
        "timings": {name: round(float(seconds), 3) for name, seconds in timings.items()},
        "dumps": plain(dumps, DIGITS),
        "tails": plain(tails, DIGITS),
        "losses": _thinned(losses or {}),
    } | {name: plain(value, DIGITS if name in ROUNDED else None) for name, value in more.items()}
    return body | {"digest": _hash(body)}


def write_record(record: Mapping, folder: Path | str = RUNS) -> Path:
    """Write `record` (of `make_record`) atomically under its name in `folder` and return the path.

    One line per top-level key; long logs are packed as tables (see `packing`), which `read_record` undoes.
    """
    path = record_path(config_of(record), folder, record["defaults"])
    lines = [
        f" {json.dumps(key)}: {_canonical(pack(record[key]) if key in ROUNDED else record[key])}"
        for key in sorted(record)
    ]
    write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")
    return path


def read_record(path: Path | str) -> dict:
    """Return the record at `path`.

    Raises InputError, naming path and reason, for a file that is missing, cut off, no record, of another
    version, or changed since it was written (config against its hash and its file name, all of it against the
    digest).
    """
    path = Path(path)

    def fault(what: str, advice: str = "delete it and run again") -> InputError:
        return InputError(f"the record {path} {what}; {advice}")

    try:
        record = load_json(path)
    except OSError as error:
        raise InputError(f"cannot read the record {path}: {error.strerror}; check the path") from error
    except ValueError as error:
        raise fault(f"is damaged or cut off ({error})") from error
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise InputError(
            f"{path} is no run record of this artifact (schema {SCHEMA}); move it out of the folder"
        )
    if record.get("version") != VERSION:
        raise fault(
            f"has version {record.get('version')!r}, this code reads {VERSION}",
            "move it elsewhere, or take the version of the program that wrote it",
        )
    try:
        record |= {name: unpack(record[name]) for name in ROUNDED if name in record}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise fault(f"is damaged in its tables ({error})") from error
    if missing := [name for name in form_of(record) if not name.endswith("?") and name not in record]:
        raise fault(f"lacks {', '.join(missing)}")
    try:
        config, version = config_of(record), record["defaults"]
    except InputError as error:
        raise fault(
            f"has a configuration that this code does not know ({error})",
            "move it elsewhere and run it again",
        ) from error
    if record["config_hash"] != config_hash(config, version):
        raise fault("was changed: its config does not match its hash")
    expected = record_path(config, version=version).name
    if path.name != expected:
        raise fault(
            f"is misnamed: its config belongs to {expected}", "rename it back, or delete it and run again"
        )
    try:
        digest = _hash({key: value for key, value in record.items() if key != "digest"})
    except ValueError:  # a number beyond what a float holds, which no writer wrote
        digest = None
    if record["digest"] != digest or digest is None:
        raise fault("was changed after it was written (digest mismatch)")
    if (place := misfit(record)) is not None:
        raise fault(f"has no {place} as this program writes it", "move it elsewhere and run it again")
    return record


def check_unedited(path: Path) -> None:
    """Raise InputError where the record at `path`, or its soup, is not as this version wrote it: a run would
    replace it."""
    from paper_artifact.soup.state import load_soup, signed  # with torch: only where a run is made

    soup = path.parent.parent / "soups" / f"{path.stem}.npz"
    for file, read in ((path, read_record), (soup, load_soup)):
        try:
            if file.is_file():
                read(file)
        except InputError as error:
            raise InputError(f"{file} {REPLACED} ({error})") from error
    if soup.is_file() and not path.is_file() and not signed(soup):  # no record speaks of it
        raise InputError(f"{soup} {REPLACED}")


def _thinned(losses: Mapping[str, Any]) -> dict:
    length = len(losses.get("step", ()))
    kept = np.unique(np.linspace(0, length - 1, min(length, LOSS_POINTS)).round().astype(int))
    columns = {name: np.asarray(values, dtype=np.float64)[kept] for name, values in losses.items()}
    return {name: plain(x.astype(int) if name == "step" else x, 5) for name, x in columns.items()}


def _canonical(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _hash(value: Any) -> str:
    return hashlib.sha256(_canonical(value).encode("utf-8")).hexdigest()


MOST = 5_000_000  # items that are unpacked; the largest log of a run has some ten thousand


def pack(value: Any) -> Any:
    """Return the compact form of a JSON value."""
    if isinstance(value, dict):
        return {key: pack(item) for key, item in value.items()}
    return _column(value) if isinstance(value, list) else value


def unpack(value: Any) -> Any:
    """Return the JSON value that `pack` made compact. Raises ValueError, KeyError, TypeError or
    AttributeError for a damaged form."""
    return _unpacked(itertools.count(), value)


def _unpacked(items: Iterator[int], value: Any) -> Any:
    """Return what `unpack` does; `items` counts what was unpacked so far."""
    if next(items) > MOST:
        raise ValueError("it unpacks without end")
    unpack = partial(_unpacked, items)
    if isinstance(value, list):
        return [unpack(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "#same" in value:
        return [unpack(value["#same"]) for _ in range(value["#count"])]
    if "#table" in value:
        columns = {key: unpack(column) for key, column in value["#table"].items()}
        return [dict(zip(columns, cells, strict=True)) for cells in zip(*columns.values(), strict=True)]
    if "#lists" in value:
        return [list(cells) for cells in zip(*(unpack(column) for column in value["#lists"]), strict=True)]
    if "#mixed" in value:
        placed = {
            place: item
            for places, items in value["#mixed"]
            for place, item in zip(places, unpack(items), strict=True)
        }
        return [placed[place] for place in range(len(placed))]
    return {key: unpack(item) for key, item in value.items()}


def _column(values: list) -> Any:
    if len(values) < 2:
        return [pack(item) for item in values]
    if len({json.dumps(item, sort_keys=True) for item in values}) == 1:
        return {"#same": pack(values[0]), "#count": len(values)}
    if all(isinstance(item, dict) and item for item in values):
        kinds: dict[tuple, list[int]] = {}
        for place, item in enumerate(values):
            kinds.setdefault(tuple(sorted(item)), []).append(place)
        if len(kinds) == 1:
            return {"#table": {key: _column([item[key] for item in values]) for key in values[0]}}
        if len(kinds) <= len(values) // 2:
            return {
                "#mixed": [
                    [places, _column([values[place] for place in places])] for places in kinds.values()
                ]
            }
    if all(isinstance(item, list) for item in values):
        lengths = {len(item) for item in values}
        if (
            len(lengths) == 1
            and lengths != {0}
            and any(isinstance(cell, (dict, list)) for item in values for cell in item)
        ):
            return {"#lists": [_column([item[place] for item in values]) for place in range(len(values[0]))]}
    return [pack(item) for item in values]


# sections that are compared after the steps
ENDS = ("soup", "images", "tails", "statement", "bundle", "mesh", "scene", "frame")


def first_difference(recorded: Mapping, again: Mapping) -> str | None:
    """Return the first step and value of two records of one run that differ, as a sentence; None for the same
    bits.

    In the order of the run: losses, refreshes and dumps, then the sections of its end. Times, host and
    versions do not count.
    """
    pairs = itertools.zip_longest(_course(recorded), _course(again), fillvalue=(None, "nothing", None))
    for (step, name, before), (other_step, other_name, after) in pairs:
        where = "at the end" if step is None else f"step {step}"
        if (step, name) != (other_step, other_name):
            return f"{where}: the record has a {name} where this run has a {other_name}"
        if before != after:
            place, before, after = _first_leaf(name, before, after)
            return f"{where}: {place} is {after!r}, and {before!r} in the record"
    return None


def _course(record: Mapping) -> list[tuple[int | None, str, Any]]:
    """Return (step, name, value) of what happened in a run, in order."""
    losses = record["losses"]
    found = [(step, 0, "loss", value) for step, value in zip(losses["step"], losses["loss"], strict=True)]
    found += [(event.get("step", 0), 1, event["event"], event) for event in record.get("topology") or ()]
    found += [(dump["step"], 2, "dump", dump) for dump in record["dumps"]]
    found.sort(key=lambda each: each[:2])
    return [(step, name, value) for step, _, name, value in found] + [
        (None, name, record[name]) for name in ENDS if name in record
    ]


def _first_leaf(name: str, before: Any, after: Any) -> tuple[str, Any, Any]:
    """Return the name and both values of the first part that differs of two JSON values."""
    if isinstance(before, dict) and isinstance(after, dict) and before.keys() == after.keys():
        keys = [key for key in before if before[key] != after[key]]
        return _first_leaf(f"{name} {keys[0]}", before[keys[0]], after[keys[0]])
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        place = next(k for k in range(len(before)) if before[k] != after[k])
        return _first_leaf(f"{name}[{place}]", before[place], after[place])
    return name, before, after
