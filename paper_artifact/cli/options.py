"""A verb's options are the fields of a dataclass; its docstring says what each is for.

    @dataclass(frozen=True, kw_only=True)
    class Export(Options):
        \"\"\"Options of `export`.

        soup SOUP: a trained soup
        size: side in pixels
        \"\"\"

        soup: Positional[Source]
        size: Annotated[int, 16, 4096] = 400        # --size, from 16 to 4096

A type decides what is read: bool is a switch, tuple[int, ...] takes several words, list[str] may be given
several times, `X | None` may be left out, Annotated[str, NAMES] has choices. A capital word is how the help
names the value; texts may name constants of the module in braces. Wrong usage, here or in a verb, is
`WrongUsage`, exit code 2.
"""

from __future__ import annotations

import argparse
import inspect
import math
import os
import re
import sys
import types
import typing
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import MISSING, Field, dataclass, fields
from itertools import pairwise
from os.path import realpath
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, NewType, TypeVar
from urllib.parse import unquote

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY, decoded, load_json, run_record

T = TypeVar("T")
POSITIONAL = "positional"
Positional = Annotated[T, POSITIONAL]
Source = NewType("Source", str)  # a file or folder to read, or a name of the catalogue
LONGEST_NAME, LONGEST_PATH = 255, 4000  # bytes that file systems take
MODEL = ("cameras", "images", "points3D", "rigs", "frames")  # files of COLMAP's
SCENE_FILES = {
    "scene.json",
    "ground_truth.npz",
    "transforms.json",
    *(f"{name}.{end}" for name in MODEL for end in ("txt", "bin", "ply")),
}
SPARE = 35  # bytes that temporary and derived files add to a name


class WrongUsage(InputError):
    """An InputError that the command line alone is to blame for: exit code 2."""


@contextmanager
def usage_checked() -> Iterator[None]:
    """Raise every InputError of the block as WrongUsage: nothing but arguments is looked at there."""
    try:
        yield
    except InputError as error:
        raise WrongUsage(str(error)) from error


@dataclass(frozen=True, kw_only=True)
class Options:
    """What every verb takes.

    quiet: no progress bar; without a terminal there is none anyway
    """

    quiet: bool = False


class _Option:
    """A field of a dataclass of options, its type and its text taken apart."""

    def __init__(self, field: Field, hint: Any, text: tuple[str, str | None, str]) -> None:
        self.name = field.name
        self.limits: tuple = ()  # least, and largest value
        self.choices: Sequence | None = None
        positional = False
        while typing.get_origin(hint) in (Annotated, types.UnionType, typing.Union):
            if typing.get_origin(hint) is Annotated:
                hint, *more = typing.get_args(hint)
                positional |= POSITIONAL in more
                self.choices = next((each for each in more if isinstance(each, (tuple, list))), None)
                numbers = [each for each in more if isinstance(each, (int, float))]
                self.limits = (*numbers, math.inf)[:2] if numbers else self.limits
            else:
                hint = next(each for each in typing.get_args(hint) if each is not type(None))
        self.container = typing.get_origin(hint) if typing.get_origin(hint) in (list, tuple) else None
        self.item: Any = typing.get_args(hint)[0] if self.container else hint
        name, self.metavar, self.text = text
        self.flag = "" if positional else f"--{name}"
        self.required = field.default is MISSING and field.default_factory is MISSING
        self.default = [] if self.container is list else None if self.required else field.default


def _declared(kind: type[Options]) -> list[_Option]:
    hints, texts = typing.get_type_hints(kind, include_extras=True), _texts(kind)
    return [_Option(each, hints[each.name], texts[each.name]) for each in fields(kind)]


def add_options(parser: argparse.ArgumentParser, kind: type[Options]) -> None:
    """Declare an option of `parser` for each field of the dataclass `kind`."""
    for each in _declared(kind):
        told = each.default and "(default" not in each.text
        text = f"{each.text} (default: {shown(each.default)})" if told else each.text
        settings: dict[str, Any] = {"help": text.replace("%", "%%")}
        if each.item is bool:
            settings |= {"action": "store_true"}
        else:
            kind_of = {Source: _named, Path: lambda text: Path(_named(text))}.get(each.item, each.item)
            settings |= {"type": kind_of, "metavar": each.metavar}
            settings |= {"default": each.default, "choices": each.choices}
        if each.container is list:
            settings |= {"action": "append"}
        if not each.flag:
            settings["nargs"] = "*" if each.container else None if each.required else "?"
            action = parser.add_argument(each.name, **settings)
        else:
            settings |= {"nargs": "+"} if each.container is tuple else {}
            settings |= {"required": each.required} if each.item is not bool else {}
            action = parser.add_argument(each.flag, dest=each.name, **settings)
        if each.item in (str, Source):
            action.completer = _proposals  # type: ignore[attr-defined]


def read_options(kind: type[Options], namespace: argparse.Namespace) -> Options:
    """Return the options of `kind` that argparse found. Raises WrongUsage for a number out of range, a name
    that no file can have, and an output in the place of an input."""
    values: dict[str, Any] = {}
    named: list[tuple[str, Any, Path]] = []
    for each in _declared(kind):
        value, flag = getattr(namespace, each.name), each.flag or each.name
        for item in value if isinstance(value, (list, tuple)) else [] if value is None else [value]:
            if each.limits and not each.limits[0] <= item <= each.limits[1]:
                low, high = each.limits
                limits = f"at least {low}" if high == math.inf else f"from {low} to {high}"
                raise WrongUsage(f"{flag} must be {limits}, got {item}")
            if each.item in (Source, Path):
                _check_length(flag, os.fsencode(item), SPARE if each.item is Path else 0)
                named.append((flag, each.item, path := Path(item)))
                for place, above in pairwise([path, *path.parents]):  # the system goes through every folder
                    if place.name == ".." and not above.exists():
                        raise WrongUsage(f"{flag} {path} leads through {above}, which is not there")
        values[each.name] = tuple(value) if each.container is tuple else value
    _keep_apart(named)
    values["quiet"] = values["quiet"] or not sys.stderr.isatty()
    return kind(**values)


def words_of(options: Options, *without: str) -> list[object]:
    """Return the words of a command line that gives these options, but for the fields `without`."""
    words: list[object] = []
    for each in _declared(type(options)):
        value = getattr(options, each.name)
        if each.name in ("quiet", *without) or value == each.default:
            continue
        flag = [each.flag] if each.flag else []
        if each.container is list:
            words += [word for item in value for word in (*flag, item)]
        else:
            words += flag if each.item is bool else [*flag, *(value if each.container else [value])]
    return words


def _keep_apart(named: Sequence[tuple[str, Any, Path]]) -> None:
    """Raise WrongUsage where two files or folders to write (Path), or a file that is read (Source) and one to
    write, are the same. named: (flag, type, path) of each option."""
    soups = [(flag, path) for flag, _, path in named if path.suffix.lower() == ".npz"]
    records = [(f"the record of {flag}", Source, run_record(path)) for flag, path in soups]
    for flag, _, path in (each for each in named if each[1] is Path):
        for other, kind, known in (*named, *records):
            if other != flag and (kind is Path or path.is_file()) and realpath(path) == realpath(known):
                raise WrongUsage(
                    f"{other} and {flag} are both {path}, which would be lost; give one another name"
                )
            if kind is Source and path.is_file() and _is_part(Path(realpath(path)), Path(realpath(known))):
                raise WrongUsage(f"{flag} {path} is a file of {other} {known}; give another name")


def _is_part(file: Path, known: Path) -> bool:
    """Return whether `file` belongs to what is read at `known`: to a scene's folder, whose top level may hold
    what others wrote, or to the files that a transforms.json, a .gltf or an .obj names. Both are resolved."""
    from paper_artifact.formats.named import IMAGE_ENDINGS
    from paper_artifact.scene.folder import scene_root

    top = scene_root(known) if known.is_dir() else known.parent
    if top not in file.parents:
        return False
    if known.is_dir() and (file.parent != top or file.name in SCENE_FILES):
        return True
    listing = top / "transforms.json" if known.is_dir() else known
    with suppress(OSError, ValueError):
        if listing.suffix.lower() == ".obj":
            text = decoded(listing.read_bytes())
            lines = re.findall(r"(?im)^[ \t]*mtllib[ \t]+(.*?)[ \t]*$", text)  # a name may have blanks
            return file.name in {PurePosixPath(word).name for line in lines for word in (line, *line.split())}
        if listing.suffix.lower() not in (".json", ".gltf"):
            return False
        content = load_json(listing)
        if listing.suffix.lower() == ".gltf" or "frames" in content:
            names = {PurePosixPath(unquote(text)).name for text in _texts_of(content) if len(text) < 4096}
            return file.name in names or (file.suffix.lower() in IMAGE_ENDINGS and file.stem in names)
    return False


def _texts_of(value: Any) -> Iterator[str]:
    """Yield the texts of a JSON value."""
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from (each,) if isinstance(each, str) else _texts_of(each)


def _texts(kind: type) -> dict[str, tuple[str, str | None, str]]:
    """Return {field: (option's name, metavar, help)} of a dataclass and its bases, from their docstrings."""
    found: dict[str, tuple[str, str | None, str]] = {}
    for base in reversed(kind.__mro__[:-1]):
        constants = {
            name: ", ".join(map(str, value)) if isinstance(value, (tuple, list, dict)) else value
            for name, value in vars(sys.modules[base.__module__]).items()
        }
        entries = re.split(r"(?m)^(\w+)(?:/(\w+))?(?: (\S+))?: ", inspect.getdoc(base) or "")[1:]
        for name, other, metavar, text in zip(*(entries[place::4] for place in range(4)), strict=True):
            said = " ".join(text.split()).format_map(constants)
            found[name] = ((other or name).replace("_", "-"), metavar, said)
    return found


def _named(text: str) -> str:
    """Return the word. Raises argparse's error for an empty one, which as a path is the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty; is a variable of the shell not set?")
    return text


def _check_length(flag: str, name: bytes, spare: int) -> None:
    longest = max(map(len, name.split(b"/")))
    if longest > LONGEST_NAME - spare or len(name) > LONGEST_PATH:
        raise WrongUsage(
            f"{flag} names a file by {len(name)} bytes, {longest} of them in one name, which is too long for "
            f"a file system (at most {LONGEST_NAME - spare} in one name); give a shorter one"
        )


def shown(value: Any) -> str:
    """Return a value as a command line has it."""
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    if isinstance(value, Path) and value.is_relative_to(REPOSITORY):
        return str(value.relative_to(REPOSITORY))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _proposals(prefix: str, action: argparse.Action, **context: Any) -> list[str]:
    """Return what argcomplete proposes for an option: names of the catalogue, and files."""
    from argcomplete.completers import FilesCompleter

    from paper_artifact.catalogue import CONDITIONS, SHAPES
    from paper_artifact.study.studies import STUDIES

    shapes = [each.name for each in SHAPES]
    names = {"condition": [each.name for each in CONDITIONS], "study": [*STUDIES]}
    names |= dict.fromkeys(("shape", "mesh", "target", "raw", "key"), shapes)
    known = names.get(action.dest, [])
    return [name for name in known if name.startswith(prefix)] + list(FilesCompleter()(prefix))
