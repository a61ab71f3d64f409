"""The package installed alone, as `pip install .` does it: a wheel in a folder of its own, used from an empty
folder.

Whatever an extra of pyproject.toml brings is refused there, in child processes too, so that the split of the
dependencies is real. Kernels that the checkout has compiled already are borrowed: numba takes a cached kernel
for a source file of the same time and size.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from paper_artifact.files import REPOSITORY
from tests.test_readme import LIBRARY, blocks
from tests.tiny_run import tiny_arguments

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
IMPORTED_AS = {"scikit-image": "skimage", "scikit-learn": "sklearn", "pyyaml": "yaml"}
EXTRAS = sorted(
    IMPORTED_AS.get(name, name) for names in PROJECT["optional-dependencies"].values() for name in names
)
# Python imports the sitecustomize.py of its path before anything else. A refused package is as good as not
# installed.
REFUSING = f"""
from importlib.machinery import PathFinder
find = PathFinder.find_spec
def find_spec(name, path=None, target=None):
    return None if name.partition(".")[0] in {EXTRAS!r} else find(name, path, target)
PathFinder.find_spec = find_spec
"""


class Installed:
    """A folder with the installed package, an empty folder to work in, and how to run something there."""

    def __init__(self, base: Path) -> None:
        self.target, self.hook, self.empty = base / "installed", base / "hook", base / "empty"
        source = base / "source"
        left_out = shutil.ignore_patterns("__pycache__", ".paper_artifact-partial-*")
        shutil.copytree(REPOSITORY / "paper_artifact", source / "paper_artifact", ignore=left_out)
        for name in ("pyproject.toml", "README.md", "LICENSE"):
            shutil.copy(REPOSITORY / name, source / name)
        pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
        build = [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", base, source]
        subprocess.run(build, check=True, timeout=120)
        (self.wheel,) = base.glob("*.whl")
        install = [*pip, "install", "--no-deps", "--no-compile", "--target", self.target, self.wheel]
        subprocess.run(install, check=True, timeout=120)
        self._borrow_kernels()
        self.hook.mkdir()
        (self.hook / "sitecustomize.py").write_text(REFUSING)
        self.empty.mkdir()

    def _borrow_kernels(self) -> None:
        for file in sorted(self.target.glob("paper_artifact/**/*.py")):
            original = REPOSITORY / file.relative_to(self.target)
            assert file.read_bytes() == original.read_bytes()
            os.utime(file, ns=(original.stat().st_atime_ns, original.stat().st_mtime_ns))
            for kernel in original.parent.glob(f"__pycache__/{file.stem}.*.nb?"):
                (file.parent / "__pycache__").mkdir(exist_ok=True)
                shutil.copy2(kernel, file.parent / "__pycache__")

    def run(self, *command: str, **variables: str) -> subprocess.CompletedProcess[str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PAPER_ARTIFACT")}
        path = os.pathsep.join(map(str, (self.hook, self.target)))
        return subprocess.run(
            [sys.executable, *command],
            cwd=self.empty,
            env=kept | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": ""} | variables,
            capture_output=True,
            text=True,
            timeout=600,
        )

    def command(self, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run the installed console script."""
        return self.run(str(self.target / "bin" / "paper-artifact"), *arguments, **variables)

    def files(self) -> set[Path]:
        """Return the installed files, without what Python and numba keep compiled."""
        return {path for path in self.target.rglob("*") if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    return Installed(tmp_path_factory.mktemp("wheel"))


def test_the_wheel_holds_the_package_alone_and_says_it_is_typed(installed):
    assert (installed.target / "paper_artifact" / "py.typed").is_file()
    tops = {path.name for path in installed.target.iterdir()}
    assert tops == {"bin", "paper_artifact", f"paper_artifact-{installed.wheel.name.split('-')[1]}.dist-info"}
    metadata = next(installed.target.glob("*.dist-info/METADATA")).read_text()
    plain = set(re.findall(r"^Requires-Dist: ([\w-]+)$", metadata, re.MULTILINE))
    assert plain == set(PROJECT["dependencies"]) and not plain & set(EXTRAS)


def test_the_readmes_program_runs(installed):
    (program,) = blocks("python", LIBRARY)
    program += "\nimport paper_artifact\nprint(paper_artifact.__file__)"
    result = installed.run("-W", "error", "-c", program)
    assert result.returncode == 0, result.stderr
    assert "gradient: torch.Size([512, 3])" in result.stdout
    assert result.stdout.splitlines()[-1] == str(installed.target / "paper_artifact" / "__init__.py")


def test_training_writes_to_the_current_folder_or_where_the_variable_says(installed, tmp_path):
    before = installed.files()
    result = installed.command("train", "sphere", "--steps", "20", "--quiet")
    assert result.returncode == 0, result.stderr
    assert len(list(installed.empty.glob("results/runs/sphere-C0-s0-*.json"))) == 1
    assert len(list(installed.empty.glob("results/soups/sphere-C0-s0-*.npz"))) == 1
    elsewhere = {"PAPER_ARTIFACT_RESULTS": str(tmp_path / "elsewhere")}
    tiny = [*tiny_arguments(), "--condition=C1", "--loss=samples=256", "--set=steps=20"][:-1]
    result = installed.command(*tiny, **elsewhere)
    assert result.returncode == 0, result.stderr
    (soup,) = tmp_path.glob("elsewhere/soups/sphere-C1-s0-*.npz")
    assert len(list(tmp_path.glob("elsewhere/runs/*.json"))) == 1
    assert {path.name for path in installed.empty.iterdir()} == {"results"}
    for verb in (["evaluate", str(soup), "--target", "sphere"], ["export", str(soup), "--out", "exported"]):
        result = installed.command(*verb, "--quiet", **elsewhere)
        assert result.returncode == 0, result.stderr
    assert list(installed.empty.glob("exported/*.glb"))
    assert installed.files() == before, "nothing is written beside the installed package"


def test_a_name_that_needs_a_checkout_is_told_so_and_nonsense_is_nonsense(installed):
    for shape, words in {
        "spot": ["data_scripts/meshes.csv", "external meshes need a checkout of the repository"],
        "nonsense": ["unknown shape 'nonsense'; choose one of sphere, ", "or the path of a mesh file"],
        "gone.obj": ["gone.obj"],
    }.items():
        result = installed.command("train", shape, "--quiet")
        assert result.returncode == 1 and "Traceback" not in result.stderr
        assert all(word in result.stderr for word in words), result.stderr
        assert len(result.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    "arguments", [["run-all"], ["audit", "sphere"], ["ingest", "my.obj", "--out", "shell.ply"]]
)
def test_a_verb_of_an_extra_names_it(installed, arguments):
    result = installed.command(*arguments)
    assert result.returncode == 1 and "Traceback" not in result.stderr
    assert "pip install '.[study]'" in result.stderr
