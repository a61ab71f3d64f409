"""The form of a record: the sections it must have, and the type of every entry that this program reads back.

A form is a type or a union of types (an int alone is a count, 0 at least), a value, a list [form] of any
length, a tuple of forms (a list of exactly these), `Either` of some forms, or a dict {name: form}, in which
"name?" may be missing and `str` stands for every other name. What a form doesn't name isn't looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import UnionType
from typing import Any


@dataclass(frozen=True)
class Either:
    """One of some forms."""

    forms: tuple[Any, ...]


MISSING = object()  # of no form
NEVER = Either(())
LARGEST = 1e300  # of a number: users' units may be huge, and a float holds it
REAL = int | float
NUMBER = REAL | None  # None: it was not finite
NUMBERS, COUNTS = (NUMBER,) * 3, (int,) * 3  # one per dimension
BAR = (NUMBER, NUMBER)  # birth and death

DUMP = {"step": int, "counts": COUNTS, "bars?": ([BAR],) * 3, "floor?": NUMBER, "triangles?": NUMBER}
AGAINST_TRUTH = {"bottleneck": NUMBERS, "chamfer?": NUMBER, "hausdorff95?": NUMBER}
TAILS = {"counts": COUNTS, "bottleneck": (REAL,) * 3, "chamfer": REAL, "hausdorff95": REAL}
ALONE = {"margins": ([REAL],) * 3}
PLAN = {
    "targets": [{"target": (REAL, REAL), "live?": Either(((REAL, REAL), None))}],
    **dict.fromkeys(("significant", "matched", "recruited", "unreached"), int),
}
STATED = PLAN | {"margins": [REAL], "surplus": int, "wanted": int}
PLANNED = {"event": "refresh", "step": int, "samples": int, "floor": NUMBER, "live_floor": NUMBER}
EVENTS = (
    {"event": "refresh", "step": int, "pairs": int},
    {"event": "lambda"} | dict.fromkeys(("step", "lambda_peak", "photo_norm", "topo_norm"), REAL),
    {"event": "audit", "step": int, "warnings": [str], "notes": [str]},
    {"event": "no-op", "step": int, "reason": str},
    {"event": "density", "samples": int},
)
RECORD = {
    "config": {"shape": str, "condition": str, "seed": int, "budget": int, "initial_ratio": REAL},
    "config_hash": str,
    "defaults": int,
    "digest": str,
    "packages": {str: str | None},
    "host": {"cpu": str | None, "peak_memory_mib": int},
    "cpu_seconds": REAL,
    "timings": {str: REAL},
    "soup": {"triangles": int},
    "losses": {"step": [int], "loss": [NUMBER]},
    "images": Either(({"psnr": NUMBER, "ssim": REAL}, {"psnr?": NEVER})),
    "bundle?": {"bars": ([BAR],) * 3},
    "statement?": {"betti": COUNTS, "diagonal": REAL},
}
MESH = {
    "dimension": Either((0, 1, 2)),
    "betti?": Either((COUNTS, None)),
    "diagonal?": NUMBER,
    "floor?": NUMBER,
}


def form_of(record: Mapping[str, Any]) -> dict:
    """Return the form of a record, by whether it has a ground truth and stated Betti numbers."""
    plan = STATED if "statement" in record else PLAN
    planned = PLANNED | {"dimensions": dict.fromkeys(("0?", "1?", "2?"), plan) | {str: NEVER}}
    form = RECORD | {"topology?": [Either((planned, *EVENTS))]}
    if "mesh" not in record:
        return form | {"dumps": [DUMP | ALONE], "tails": Either(({"counts": COUNTS}, {str: NEVER}))}
    return form | {"mesh": MESH, "dumps": [DUMP | AGAINST_TRUTH], "tails": Either((TAILS, {str: NEVER}))}


def misfit(record: Mapping[str, Any]) -> str | None:
    """Return the place of the first entry of a record, tables unpacked, that is not of its form, as
    "dumps[3] step"; None where all are."""
    found = _misfit(record, form_of(record))
    return _unequal(record) if found is None else found.strip()


def _unequal(record: Mapping[str, Any]) -> str | None:
    """Return the place of the first list that is shorter than what belongs to it."""
    if len(record["losses"]["step"]) != len(record["losses"]["loss"]):
        return "losses loss"
    for k, event in enumerate(record.get("topology") or ()):
        for name, plan in event.get("dimensions", {}).items():
            if "statement" in record and len(plan["margins"]) < plan["wanted"] + bool(plan["surplus"]):
                return f"topology[{k}] dimensions {name} margins"
    return "dumps" if record["tails"] and not record["dumps"] else None


def _misfit(value: Any, form: Any) -> str | None:
    """Return the place in `value` of the first entry that is not of `form`, "" for all of it."""
    if isinstance(form, (type, UnionType)):
        fits = isinstance(value, form) and not isinstance(value, bool)
        if fits and isinstance(value, (int, float)):
            fits = abs(value) <= LARGEST and (form is not int or value >= 0)
        return None if fits else ""
    if isinstance(form, dict) and isinstance(value, dict):
        for name, each, kind in _named(value, form):
            if (inner := _misfit(each, kind)) is not None:
                return f" {name}{inner}"
        return None
    if isinstance(form, (list, tuple)) and isinstance(value, list):
        if isinstance(form, tuple) and len(value) != len(form):
            return ""
        for k, each in enumerate(value):
            if (inner := _misfit(each, form[k if isinstance(form, tuple) else 0])) is not None:
                return f"[{k}]{inner}"
        return None
    if isinstance(form, Either):
        return None if any(_misfit(value, each) is None for each in form.forms) else ""
    return None if type(value) is type(form) and value == form else ""


def _named(value: Mapping, form: Mapping) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, value and form of each entry of a dict that its form names."""
    for key, each in form.items():
        if key is str:
            yield from ((name, value[name], each) for name in value if not {name, f"{name}?"} & form.keys())
        elif (name := key.removesuffix("?")) in value or name == key:
            yield name, value.get(name, MISSING), each
