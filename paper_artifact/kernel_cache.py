"""numba's `njit` for the package's kernels, with a cache that is never stale and never in the way.

numba keeps compiled kernels beside their module, in __pycache__, or where NUMBA_CACHE_DIR says, and takes
them again as long as that one file is the same. But a kernel also holds what it took from other modules:
functions that were compiled into it, and constants. So a kernel of this package is stamped with the text of
its module and of every module of the package that this one imports, directly or not: after an edit, exactly
what may depend on it is compiled again.

Where no folder can be written, numba raises. Here the kernels go to a temporary folder, which child processes
share and the end of this process removes; where that cannot be written either, or the disk is full, they are
not kept. Either is said once, on stderr. A damaged file is as none.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba import config
from numba import njit as njit
from numba.core import caching
from numba.core.runtime import rtsys

PACKAGE = Path(__file__).parent
_VARIABLE = "NUMBA_CACHE_DIR"
_IMPORT = re.compile(r"^(?:from|import) +(paper_artifact[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)
_NUMBAS_OWN = (  # where numba itself looks, in its order
    caching.UserProvidedCacheLocator,
    caching.InTreeCacheLocator,
    caching.UserWideCacheLocator,
)


def imported_files(path: Path, package: Path = PACKAGE) -> set[Path]:
    """Return the package's files that the module at `path` imports at its top level, itself not counted."""
    found = set()
    for module, names in _IMPORT.findall(path.read_text(encoding="utf-8")):
        base = package.joinpath(*module.split(".")[1:])
        for candidate in (base, *(base / name for name in re.findall(r"\w+", names))):
            found |= {candidate.with_suffix(".py"), candidate / "__init__.py"}
    return {file for file in found - {path} if file.is_file()}


@functools.cache
def source_stamp(path: Path, package: Path = PACKAGE) -> str:
    """Return the sha256 (hex) of the module at `path` and of all that it imports of the package, directly or
    not."""
    seen, waiting = set(), {path}
    while waiting:
        file = waiting.pop()
        seen.add(file)
        waiting |= imported_files(file, package) - seen
    content = hashlib.sha256()
    for file in sorted(seen):
        content.update(hashlib.sha256(file.read_bytes()).digest())
    return content.hexdigest()


class PackageLocator:
    """Where a kernel of this package is kept, as numba asks for it; what is not this package's stays
    numba's."""

    def __init__(self, place: caching._CacheLocator, path: Path) -> None:
        """Keep the kernels of the module at `path` where numba's locator `place` does."""
        self._place, self._path = place, path

    @classmethod
    def from_function(cls, function: Any, file: str) -> PackageLocator | None:
        """Return the locator of a function in a file, None for a file that is not of this package."""
        path = Path(file)
        if PACKAGE not in path.parents or not path.is_file():
            return None
        place = _first_place(function, file)
        if place is None:
            _use_temporary_folder()
            place = _first_place(function, file) or caching.UserProvidedCacheLocator(function, file)
        return cls(place, path)

    def get_source_stamp(self) -> str:
        """Return what must be equal for a kept kernel to be taken."""
        return source_stamp(self._path)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._place, name)  # folder, its making, the line number that tells kernels apart


def _first_place(function: Any, file: str) -> caching._CacheLocator | None:
    places = (locator.from_function(function, file) for locator in _NUMBAS_OWN)
    return next((place for place in places if place is not None), None)


def _use_temporary_folder() -> None:
    try:
        folder = tempfile.mkdtemp(prefix="paper_artifact-kernels-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    except OSError:
        folder = str(PACKAGE / "__pycache__" / "none")  # cannot be made either, and nothing is kept
    os.environ[_VARIABLE] = config.CACHE_DIR = folder  # child processes find it there and say nothing
    _tell("neither beside the package nor in the user's cache folder")


def _tell(why: str) -> None:
    """Say on stderr, once, that compiled kernels are lost and what to do."""
    if not _told:
        _told.append(why)
        with suppress(OSError):  # a full disk behind stderr
            print(
                f"paper_artifact: compiled kernels cannot be kept ({why}), so each start compiles them "
                f"again, about half a minute; {_VARIABLE} names a folder that can be written",
                file=sys.stderr,
            )


def _save_or_go_on(cache: caching.Cache, signature: Any, kernel: Any) -> None:
    """Keep a compiled kernel as numba does; where that fails, one of this package is used unkept."""
    try:
        _numbas_save(cache, signature, kernel)
    except OSError as error:
        if not isinstance(cache._impl.locator, PackageLocator):
            raise
        _tell(error.strerror or str(error))


def _load_or_compile(cache: caching.Cache, signature: Any, context: Any) -> Any:
    """Return a kept kernel as numba does; None, and what was kept is forgotten, where its file is damaged.

    numba loads its whole compiler before it takes a kept kernel, and scipy.linalg with it. This package's
    need the runtime alone: what is missing still is loaded when something has to be compiled.
    """
    if not isinstance(cache._impl.locator, PackageLocator):
        return _numbas_load(cache, signature, context)
    try:
        rtsys.initialize(context)
        return cache._load_overload(signature, context)
    except Exception:  # pickle raises many kinds; numba does not fsync, so a power cut leaves such files
        with suppress(OSError):
            os.unlink(cache._cache_file._index_path)
        return None


_told: list[str] = []
_numbas_load = caching.Cache.load_overload
caching.Cache.load_overload = _load_or_compile
_numbas_save = caching.Cache.save_overload
caching.Cache.save_overload = _save_or_go_on
caching.CacheImpl._locator_classes.insert(0, PackageLocator)
