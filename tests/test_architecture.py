"""ARCHITECTURE.md says which room may use which, and the code keeps to it: every import is read, the ones
inside functions too."""

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from paper_artifact.files import REPOSITORY

PACKAGE = REPOSITORY / "paper_artifact"
FILES = sorted(PACKAGE.rglob("*.py"))
FRONT = ("paper_artifact", "paper_artifact.__main__")  # the package's face; the command line is behind it


@cache
def rooms() -> list[str]:
    """Return the rooms in the order of the table in ARCHITECTURE.md: a room uses those above it only."""
    text = (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
    table = text.split("## The rooms")[1].split("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)


def module_name(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


@cache
def imported(source: str) -> set[str]:
    """Return the project's modules that a source names: imports anywhere in it, and names in strings that are
    loaded later."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are written in full"
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in MODULES else str(node.module) for name in inner}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value.rstrip(".")} & MODULES.keys()  # "paper_artifact.cli." + a later name
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


def test_no_arrow_runs_back_up():
    inside = {module: path.read_text() for module, path in MODULES.items() if module not in FRONT}
    wrong = {module: upward(module, source) for module, source in inside.items()}
    assert {module: names for module, names in wrong.items() if names} == {}, "ARCHITECTURE.md, The rooms"


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


# what alpha and topology may use, and a program that uses all of them without anything heavy
ALONE = {
    "alpha": ({"errors", "kernel_cache"}, "alpha_persistence(points)[2].diagram"),
    "topology": (
        {"alpha", "arithmetic", "config", "errors", "files", "randomness", "sampling"},
        "TopologyLoss(build_bundle(points, 3.4))(torch.tensor(points, requires_grad=True)).backward()",
    ),
}
WORK = """
import sys, numpy as np
import paper_artifact.{room}
print("numba" in sys.modules)
if "{room}" == "topology":
    import torch
    from paper_artifact.topology import TopologyLoss, build_bundle
else:
    from paper_artifact.alpha import alpha_persistence
points = np.random.default_rng(0).normal(size=(300, 3))
points /= np.linalg.norm(points, axis=1, keepdims=True)
{program}
print(*sys.modules)
"""


@pytest.mark.parametrize("room", ALONE)
def test_persistence_and_loss_stand_alone(room):
    allowed, program = ALONE[room]
    own = [path for module, path in MODULES.items() if room_of(module) == room]
    assert {room_of(name) for path in own for name in imported(path.read_text())} - {room} == allowed
    code = WORK.format(room=room, program=program)
    told = subprocess.check_output([sys.executable, "-c", code], cwd=REPOSITORY, text=True).splitlines()
    assert told[0] == "False", "nothing is compiled before it is used"
    loaded = set(told[-1].split())
    rooms_loaded = {name.split(".")[1] for name in loaded if name.startswith("paper_artifact.")}
    assert rooms_loaded <= {*allowed, room, "kernel_cache"}
    heavy = {"trimesh", "pandas", "matplotlib", "gudhi", "PIL", "networkx"}
    assert not loaded & (heavy | ({"torch"} if room == "alpha" else set()))


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
