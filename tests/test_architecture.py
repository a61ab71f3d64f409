"""ARCHITECTURE.md says which room may use which, and the code keeps to it: every import is read, the ones
inside functions too."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from paper_artifact.files import REPOSITORY

PACKAGE = REPOSITORY / "paper_artifact"
FILES = sorted(PACKAGE.rglob("*.py"))
FRONT = ("paper_artifact", "paper_artifact.__main__")  # the package's face; the command line is behind it
ALLOWED: dict[tuple[str, str], str] = {}  # (importing, imported module): the reason. Empty, to stay so


def rooms() -> list[str]:
    """Return the rooms in the order of the table in ARCHITECTURE.md: a room uses those above it only."""
    text = (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
    table = text.split("## The rooms")[1].split("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)


def module_name(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


def imported(source: str, modules=MODULES) -> set[str]:
    """Return the project's modules that a source names: imports anywhere in it, and names in strings that are
    loaded later."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are written in full"
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in modules else str(node.module) for name in inner}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value.rstrip(".")} & modules.keys()  # "paper_artifact.cli." + a later name
    return {name for name in found if name.partition(".")[0] == "paper_artifact"}


def room_of(module: str) -> str:
    """Return the room of a module; the package's face is in none."""
    return module.split(".")[1] if "." in module else ""


def upward(module: str, source: str) -> set[str]:
    """Return what `module` imports from rooms below its own in the table."""
    place = {room: number for number, room in enumerate(rooms())}
    used = imported(source) - {"paper_artifact"}
    return {name for name in used if place[room_of(name)] > place[room_of(module)]}


def test_the_table_has_every_room_once():
    inside = {room_of(module) for module in MODULES if module not in FRONT}
    assert len(rooms()) == len(set(rooms()))
    assert set(rooms()) == inside


@pytest.mark.parametrize("module", [module for module in MODULES if module not in FRONT])
def test_no_arrow_runs_back_up(module):
    wrong = {name for name in upward(module, MODULES[module].read_text()) if (module, name) not in ALLOWED}
    assert not wrong, f"{module} may not use {', '.join(sorted(wrong))} (ARCHITECTURE.md, The rooms)"


def test_an_arrow_that_runs_back_up_would_be_seen():
    for source in (
        "import paper_artifact.study.sweep",
        "from paper_artifact.study import sweep",
        "def late():\n    from paper_artifact.study.sweep import sweep",
        "load('paper_artifact.study.sweep')",
        "load(f'paper_artifact.study.{name}')",
    ):
        assert upward("paper_artifact.alpha.diagrams", source), source
        assert not upward("paper_artifact.results", source), source


def test_no_two_modules_import_each_other():
    graph = {module: imported(path.read_text()) - {module} for module, path in MODULES.items()}
    for package in [name for name, path in MODULES.items() if path.name == "__init__.py"]:
        # A package's face re-exports its modules; a module inside may be imported through the face's name.
        graph[package] = {name for name in graph[package] if not name.startswith(package + ".")}
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))


def test_every_kernel_has_the_packages_cache():
    numbas = re.compile(r"numba(\.| import .*\b)njit")
    own = {module for module, path in MODULES.items() if numbas.search(path.read_text())}
    assert own == {"paper_artifact.kernel_cache"}, "take njit from paper_artifact.kernel_cache"


def outsiders(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    names = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names += [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    tops = {str(name).partition(".")[0] for name in names}
    return tops - set(sys.stdlib_module_names) - {"paper_artifact"}


def test_the_persistence_stands_alone():
    alpha = [path for module, path in MODULES.items() if room_of(module) == "alpha"]
    used = {room_of(name) for path in alpha for name in imported(path.read_text())}
    assert used - {"alpha"} == {"errors", "kernel_cache"}
    others = {"numpy", "numba", "scipy", "torch", "gudhi", "matplotlib", "sklearn"}
    assert set().union(*map(outsiders, alpha)) == others
    code = (
        "import sys, paper_artifact.alpha; print(sorted({name.split('.')[1] for name in sys.modules "
        "if name.startswith('paper_artifact.')}), 'gudhi' in sys.modules)"
    )
    told = subprocess.check_output([sys.executable, "-c", code], cwd=REPOSITORY, text=True)
    assert told.strip() == "['alpha', 'errors'] False", "gudhi is the oracle, loaded when asked for"


def test_the_method_uses_what_the_package_brings_and_no_more():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    brought = {{"pillow": "PIL"}.get(name, name) for name in project["dependencies"]}
    alone = {*rooms()[: rooms().index("pipeline") + 1], "export", "pages"} - {"ingest"}  # ingest: [study]
    used = {module: outsiders(path) for module, path in MODULES.items() if room_of(module) in alone}
    # imported where they are needed; a sentence where they are missing
    optional = {"DracoPy", "matplotlib", "pycolmap", "sklearn"}
    others = {module: names - brought - optional for module, names in used.items()}
    assert {module: names for module, names in others.items() if names} == {}
    assert set().union(*used.values()) - optional == brought - {"argcomplete"}, "nothing imports it"


def test_modules_are_short_and_say_what_they_are():
    lengths = {module: len(path.read_text().splitlines()) for module, path in MODULES.items()}
    assert max(lengths.values()) <= 400, max(lengths, key=lengths.get)
    for module, path in MODULES.items():
        if path.read_text().strip():
            assert ast.get_docstring(ast.parse(path.read_text())), f"{module} has no docstring"
