"""The public pieces as the book's reference: names, signatures and docstrings, read from the code."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import textwrap
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

PACKAGES = ("paper_artifact.alpha", "paper_artifact.topology")  # what they export is public
FIELD = re.compile(r"    (\w+): ")  # how a field's line begins


@dataclass(frozen=True)
class Entry:
    """One function, class, method or property."""

    name: str
    kind: str  # "function", "class", "method", "property"
    signature: str  # "(points, gate=True) -> …", "" for a property
    text: str  # its docstring
    module: str  # where it is defined
    fields: tuple[tuple[str, str], ...] = ()  # of a dataclass: name, comment
    members: tuple[Entry, ...] = field(default=())  # of a class


@dataclass(frozen=True)
class Package:
    """One package of the reference."""

    name: str  # "paper_artifact.alpha"
    text: str  # its docstring
    entries: tuple[Entry, ...]  # what it exports, in the order of the names


def packages(names: tuple[str, ...] = PACKAGES) -> list[Package]:
    """Return the reference of these packages."""
    return [_package(importlib.import_module(name)) for name in names]


def _package(package: ModuleType) -> Package:
    public = {
        name: value
        for name, value in vars(package).items()
        if not name.startswith("_") and not inspect.ismodule(value) and callable(value)
    }
    entries = tuple(_entry(name, public[name]) for name in sorted(public, key=str.lower))
    return Package(package.__name__, inspect.getdoc(package) or "", entries)


def _entry(name: str, value: Any) -> Entry:
    text, module = inspect.getdoc(value) or "", getattr(value, "__module__", "")
    if not inspect.isclass(value):
        return Entry(name, "function", _signature(value), text, module)
    members = []
    for member, raw in vars(value).items():
        if member.startswith("_"):
            continue
        if isinstance(raw, property):
            members.append(Entry(member, "property", "", inspect.getdoc(raw) or "", module))
        elif inspect.isfunction(raw) or isinstance(raw, (classmethod, staticmethod)):
            bound = getattr(value, member)
            members.append(Entry(member, "method", _signature(bound), inspect.getdoc(bound) or "", module))
    constructor = value.__dict__.get("__init__")
    signature = _signature(value) if constructor is not None else ""
    if not dataclasses.is_dataclass(value):
        own = inspect.getdoc(constructor) if constructor is not None else None
        text = f"{text}\n\n{own}" if own and own != inspect.getdoc(object.__init__) else text
    return Entry(name, "class", signature, text, module, _fields(value), tuple(members))


def _fields(value: type) -> tuple[tuple[str, str], ...]:
    if not dataclasses.is_dataclass(value):
        return ()
    comments = field_comments(inspect.getsource(value))
    shown = [each for each in dataclasses.fields(value) if not each.name.startswith("_")]
    return tuple((each.name, comments.get(each.name, "")) for each in shown)


def field_comments(source: str) -> dict[str, str]:
    """Return {field: the comment beside or above it} of a dataclass's source."""
    found: dict[str, list[str]] = {}
    above: list[str] = []
    name = ""
    for line in source.splitlines():
        code, mark, comment = line.partition("#")
        if start := FIELD.match(code):
            name, found[start[1]], above = start[1], above, []
        elif code.startswith(("    def ", "    @")):
            break
        if mark and not code.strip():
            above.append(comment.strip())
        elif mark and name:
            found[name].append(comment.strip())
    return {field: " ".join(words) for field, words in found.items()}


def _signature(value: Any) -> str:
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return ""
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(signature))  # annotations are texts
    return re.sub(r"\b(?:[a-z_]+\.)+(\w+)", r"\1", text)  # without the modules' names


def blocks(text: str) -> list[tuple[str, str]]:
    """Return a docstring as ("text" or "code", content): indented paragraphs are code."""
    found: list[tuple[str, str]] = []
    for paragraph in re.split(r"\n\s*\n", text.strip("\n")):
        kind = "code" if paragraph.startswith("    ") else "text"
        content = textwrap.dedent(paragraph) if kind == "code" else " ".join(paragraph.split())
        found.append((kind, content))
    return [each for each in found if each[1]]
