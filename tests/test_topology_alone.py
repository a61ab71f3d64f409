"""What alpha and topology import: nothing of the project above them, nothing heavy that they do not use."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import paper_artifact

ROOT = Path(paper_artifact.__file__).parent
LIBRARIES = {
    "alpha": {"numpy", "numba", "scipy", "torch", "sklearn", "matplotlib"},
    "topology": {"numpy", "scipy", "torch"},
}
# kernel_cache is numba with a cache of our own: it knows nothing of the project.
BELOW = {"errors", "kernel_cache"}
ROOMS = {"alpha": BELOW, "topology": BELOW | {"alpha", "config", "files", "randomness", "sampling"}}
HEAVY = {"trimesh", "pandas", "matplotlib", "gudhi", "PIL", "networkx"}
FACES = {
    "alpha": {
        "AlphaPersistence",
        "AlphaTransformer",
        "DiagramTensor",
        "Pairs",
        "alpha_diagrams",
        "alpha_filtration",
        "alpha_persistence",
        "bottleneck",
        "circumradius",
        "persistence_image",
        "plot_diagram",
        "wasserstein",
    },
    "topology": {
        "BettiLoss",
        "Bundle",
        "Plan",
        "TopologyLoss",
        "build_bundle",
        "build_from_mesh",
        "build_plan",
        "cleaned",
        "load_bundle",
    },
}


def imported(package: str) -> list[tuple[str, str, bool]]:
    """Return (module, what it imports, whether on its first level) of every import in the package."""
    found = []
    for path in sorted((ROOT / package).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name}: relative import"
                names = [node.module or ""]
            found += [(path.stem, name, node in tree.body) for name in names]
    assert found
    return found


@pytest.mark.parametrize("package", LIBRARIES)
def test_imports_are_the_stated_ones(package):
    for module, name, first_level in imported(package):
        root, *rest = name.split(".")
        if root == "paper_artifact":
            assert rest[0] == package or rest[0] in ROOMS[package], f"{package}.{module} imports {name}"
        elif root == "gudhi":  # the oracle, and its simplex tree
            assert (package, module, first_level) == ("alpha", "persistence", False)
        else:
            stated = root in sys.stdlib_module_names or root in LIBRARIES[package]
            assert stated, f"{package}.{module} imports {name}"


def loaded_by(statement: str) -> set[str]:
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("package", LIBRARIES)
def test_the_package_loads_alone(package):
    loaded = loaded_by(f"import paper_artifact.{package}")
    rooms = {name.split(".")[1] for name in loaded if name.startswith("paper_artifact.")}
    assert package in rooms and rooms <= ROOMS[package] | {package}
    assert not HEAVY & loaded
    assert "numba" not in loaded  # nothing is compiled before it is used


def test_a_loss_is_computed_without_heavy_libraries():
    """Kernels and all: a bundle, a plan, a gradient."""
    work = (
        "import numpy as np, torch\n"
        "from paper_artifact.topology import TopologyLoss, build_bundle\n"
        "points = np.random.default_rng(0).normal(size=(300, 3))\n"
        "points /= np.linalg.norm(points, axis=1, keepdims=True)\n"
        "TopologyLoss(build_bundle(points, 3.4))(torch.tensor(points, requires_grad=True)).backward()\n"
    )
    loaded = loaded_by(work)
    rooms = {name.split(".")[1] for name in loaded if name.startswith("paper_artifact.")}
    assert rooms <= ROOMS["topology"] | {"topology"} and not HEAVY & loaded and "numba" in loaded


@pytest.mark.parametrize("package", FACES)
def test_the_face_is_plain_re_exports(package):
    """Checkers see every public name: `from module import name as name`; alpha loads later."""
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {alias.asname for node in imports for alias in node.names} - {None} == FACES[package]
    face = importlib.import_module(f"paper_artifact.{package}")
    assert all(getattr(face, name).__name__ == name for name in FACES[package])
    if package == "alpha":
        assert set(face.__all__) == FACES[package]
