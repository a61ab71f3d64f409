"""Makes a wheel of `paper_artifact.alpha` alone and tries it in an empty environment.

    python data_scripts/alpha_wheel.py [FOLDER]      default: build/alpha

The wheel has alpha, errors, kernel_cache and the package's __init__, and needs numpy and numba (scipy for the
distances; torch, scikit-learn, matplotlib, gudhi for the names that use them). It is tried by a program that
uses all of numpy's part, in a fresh virtual environment with the pinned numpy, scipy and numba.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
FILES = ("__init__.py", "errors.py", "kernel_cache.py", "py.typed", "alpha")
PROJECT = """[build-system]
requires = ["setuptools>=70.1"]
build-backend = "setuptools.build_meta"

[project]
name = "paper_artifact_alpha"
description = "Exact differentiable alpha persistence of point clouds"
version = "{version}"
requires-python = ">=3.11"
license = "MIT"
dependencies = ["numba", "numpy", "scipy"]

[project.optional-dependencies]
all = ["gudhi", "matplotlib", "scikit-learn", "torch"]

[tool.setuptools]
packages = ["paper_artifact", "paper_artifact.alpha"]
package-data = {{ paper_artifact = ["py.typed"] }}
"""
PROGRAM = """
import sys, numpy as np
from paper_artifact.alpha import alpha_filtration, alpha_persistence, bottleneck
from paper_artifact.alpha import persistence_image, wasserstein
points = np.random.default_rng(0).normal(size=(200, 3))
points /= np.linalg.norm(points, axis=1)[:, None]
voids = alpha_persistence(points)[2]
assert voids.deaths.max() > 0.9 and "torch" not in sys.modules
loops = alpha_persistence(points[:, :2], infinite=True)[1]
print(len(voids), bottleneck(loops, loops), wasserstein(voids, []), persistence_image(loops).shape,
      [len(each) for each in alpha_filtration(points).radii])
"""


def made_and_tried(folder: Path) -> Path:
    """Return the wheel, made and tried in the empty `folder`."""
    source = folder / "source" / "paper_artifact"
    source.mkdir(parents=True)
    for name in FILES:
        path = ROOT / "paper_artifact" / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    shutil.copy(ROOT / "LICENSE", source.parent)
    version = re.search(r'__version__ = "(.+)"', (source / "__init__.py").read_text(encoding="utf-8"))[1]
    (source.parent / "pyproject.toml").write_text(PROJECT.format(version=version), encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    build = [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source.parent]
    run(build, folder)
    (wheel,) = folder.glob("*.whl")
    run([sys.executable, "-m", "venv", folder / "empty"], folder)
    python = folder / "empty" / "bin" / "python"
    pins = re.findall(
        r"- ((?:numpy|scipy|numba|llvmlite)==\S+)", (ROOT / "environment.yml").read_text(encoding="utf-8")
    )
    run([python, "-m", "pip", "--quiet", "install", wheel, *pins], folder)
    run([python, "-I", "-c", PROGRAM], folder)  # -I: without PYTHONPATH
    return wheel


def run(command: list, folder: Path) -> None:
    """Run a program in the folder, its temporary files too; an interrupt, which this script alone hears, ends
    it with all that it started."""
    own = {"cwd": folder, "env": os.environ | {"TMPDIR": str(folder)}}
    with subprocess.Popen(command, start_new_session=True, **own) as process:
        try:
            code = process.wait()
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if code:
        raise subprocess.CalledProcessError(code, command)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "alpha")
    folder = parser.parse_args().folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory() as made:
            print(shutil.copy(made_and_tried(Path(made)), folder))
    except KeyboardInterrupt:
        sys.exit("alpha_wheel.py: interrupted; no wheel was made")
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"alpha_wheel.py: {error}; no wheel was made")
