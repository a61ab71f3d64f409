"""Lists of like-shaped JSON objects stored as tables, so that a log of 200 refreshes stays small and
readable.

`unpack(pack(value)) == value` for every JSON value without keys that start with "#". Marks: {"#same": v,
"#count": n} is n times v; {"#table": {key: column}} is a list of objects with those keys; {"#lists": [column,
...]} is a list of lists of one length; {"#mixed": [[places, list], ...]} is a list of objects of several
kinds, each kind stored together.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from typing import Any

MOST = 5_000_000  # items that are unpacked; the largest log of a run has some ten thousand


def pack(value: Any) -> Any:
    """Return the compact form of a JSON value."""
    if isinstance(value, dict):
        return {key: pack(item) for key, item in value.items()}
    return _column(value) if isinstance(value, list) else value


def unpack(value: Any) -> Any:
    """Return the JSON value that `pack` made compact. Raises ValueError, KeyError, TypeError or
    AttributeError for a damaged form."""
    return _unpacked(value, itertools.count())


def _unpacked(value: Any, items: Iterator[int]) -> Any:
    """Return what `unpack` does; `items` counts what was unpacked so far."""
    if next(items) > MOST:
        raise ValueError("it unpacks without end")

    def unpack(value: Any) -> Any:
        return _unpacked(value, items)

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
