"""Kernels are kept, taken again while nothing that they hold has changed, and do without a folder to be kept
in."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from paper_artifact import kernel_cache
from paper_artifact.kernel_cache import PACKAGE, imported_files, source_stamp
from paper_artifact.soup import adam

# A package with one kernel (in `kernels`) that holds a function and a constant of other modules; the locator
# takes its folder for this package's. Prints the kernel's value and how often it was compiled.
_PROGRAM = """
import importlib, json, sys
from pathlib import Path
from paper_artifact import kernel_cache
kernel_cache.PACKAGE = Path(sys.argv[1])
kernel_cache.source_stamp = lambda path, of=kernel_cache.source_stamp: of(path, kernel_cache.PACKAGE)
sys.path.insert(0, sys.argv[1])
sys.modules["paper_artifact.callees"] = importlib.import_module("callees")
import kernels
value = kernels.kernel(1.0)
print(json.dumps([value, sum(kernels.kernel.stats.cache_misses.values())]))
if "child" in sys.argv:
    import subprocess
    command = [sys.executable, *sys.orig_argv[1:-1]]
    print(subprocess.check_output(command, text=True, stderr=subprocess.STDOUT))
"""
_KERNELS = """
from paper_artifact.kernel_cache import njit
from paper_artifact.callees import twice

@njit(cache=True)
def kernel(x):
    return twice(x)
"""
_CALLEES = """
from numba import njit

@njit
def twice(x):
    return FACTOR * x

FACTOR = 2.0
"""


@pytest.fixture
def package(tmp_path):
    """A folder with a kernel and what it calls."""
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "kernels.py").write_text(_KERNELS)
    (folder / "callees.py").write_text(_CALLEES)
    return folder


def run(package: Path, *words: str, **variables: str):
    """Run the program in a process of its own; return (stdout lines, stderr)."""
    command = [sys.executable, "-B", "-c", _PROGRAM, str(package), *words]
    environment = {**os.environ, "NUMBA_CACHE_DIR": "", "PYTHONPATH": str(PACKAGE.parent), **variables}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n"), done.stderr


def test_a_kept_kernel_is_taken_until_something_that_it_holds_changes(package):
    runs = []
    for edit in (None, None, ("FACTOR * x", "FACTOR * x + 1"), None, ("FACTOR = 2.0", "FACTOR = 3.0")):
        if edit:
            file = package / "callees.py"
            file.write_text(file.read_text().replace(*edit))
        lines, errors = run(package)
        runs.append(json.loads(lines[0]))
        assert errors == ""
    assert runs == [[2.0, 1], [2.0, 0], [3.0, 1], [3.0, 0], [4.0, 1]]
    assert list(package.glob("__pycache__/kernels.kernel-*.nbi"))


def test_without_a_folder_that_can_be_written_it_runs_and_says_so_once(package, tmp_path):
    # Root may write anywhere, but no one below a file: its own cache, and the user's, are files here.
    (package / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    (tmp_path / "tmp").mkdir()
    closed = {name: str(tmp_path / "home" / "cache") for name in ("HOME", "XDG_CACHE_HOME")}
    lines, errors = run(package, "child", TMPDIR=str(tmp_path / "tmp"), **closed)
    assert json.loads(lines[0]) == [2.0, 1]
    assert json.loads(lines[1]) == [2.0, 0], "a child process takes what its parent compiled, in silence"
    assert lines[2:] == ["", ""]
    assert len(errors.splitlines()) == 1 and "NUMBA_CACHE_DIR names a folder" in errors
    assert list((tmp_path / "tmp").iterdir()) == [], "the end of the process removes its folder"


def test_a_damaged_index_is_as_none(package):
    assert json.loads(run(package)[0][0]) == [2.0, 1]
    (index,) = package.glob("__pycache__/kernels.kernel-*.nbi")
    index.write_bytes(index.read_bytes()[: index.stat().st_size // 2])
    lines, errors = run(package)
    assert (json.loads(lines[0]), errors) == ([2.0, 1], "")


def test_a_stamp_covers_what_a_module_imports_however_it_is_written(tmp_path):
    (tmp_path / "room").mkdir()
    for name in ("a.py", "b.py", "c.py", "d.py", "room/__init__.py", "room/e.py", "unrelated.py"):
        (tmp_path / name).write_text("")
    (tmp_path / "a.py").write_text(
        "import numpy\nimport paper_artifact.b\nfrom paper_artifact.c import (\n    one,\n    two,\n)\n"
        "from paper_artifact.room import e\n\n\ndef late():\n    from paper_artifact import unrelated\n"
    )
    (tmp_path / "room/e.py").write_text("from paper_artifact import d\nfrom paper_artifact.a import x\n")
    found = imported_files(tmp_path / "a.py", tmp_path)
    names = {str(path.relative_to(tmp_path)) for path in found}
    assert names == {"b.py", "c.py", "room/__init__.py", "room/e.py"}
    stamps = {}
    for name in ("a.py", "b.py", "c.py", "d.py", "room/e.py", "unrelated.py"):
        before = source_stamp(tmp_path / "a.py", tmp_path)
        (tmp_path / name).write_text((tmp_path / name).read_text() + "# changed\n")
        source_stamp.cache_clear()
        stamps[name] = source_stamp(tmp_path / "a.py", tmp_path) != before
    assert stamps == dict.fromkeys(stamps, True) | {"unrelated.py": False}


def test_the_packages_kernels_are_stamped_so_and_nobody_elses_are():
    assert adam.adam._cache._impl.locator.get_source_stamp() == source_stamp(Path(adam.__file__))
    names = {str(path.relative_to(PACKAGE)) for path in imported_files(PACKAGE / "raster" / "shading.py")}
    assert {"raster/lanes.py", "raster/arrays.py"} <= names

    @numba.njit(cache=True)
    def foreign(x):
        return x

    assert not isinstance(foreign._cache._impl.locator, kernel_cache.PackageLocator)
