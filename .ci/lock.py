"""Writes requirements/*.lock from environment.yml: every package, transitive ones too, with hashes.

    .venv/bin/python .ci/lock.py             after a change of a pin; what is locked already keeps its version
    .venv/bin/python .ci/lock.py --upgrade   takes the newest versions of what environment.yml does not name

packages.lock has everything but torch, torch-cpu.lock torch's CPU builds, torch-cuda.lock the builds that
PyPI has for Linux, with the CUDA libraries that they need. uv resolves for all platforms; what no Python 3.11
on Linux or macOS installs is left out.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from packaging.markers import Marker

ROOT = Path(__file__).resolve().parents[1]
LOCKS = ROOT / "requirements"
HEAD = "# Made by .ci/lock.py from environment.yml; read by pip install --require-hashes.\n"
OF_CUDA = re.compile(r"torch==|nvidia-|cuda-|triton==")
# The CPU builds of https://download.pytorch.org/whl/cpu, which PyPI lacks: Linux on x86_64, on ARM.
CPU_BUILDS = {
    "2.13.0": (
        "6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b",
        "84453b69508ec79902f899c5ed9495acb9e2bbe9fda5f1d5d6f19e3c3842e1a7",
    )
}


def pins() -> list[str]:
    """Return the pip section of environment.yml, a requirement each."""
    section = (ROOT / "environment.yml").read_text(encoding="utf-8").partition("- pip:")[2]
    lines = (line.partition("#")[0].strip() for line in section.splitlines())
    return [
        line.removeprefix("- ") for line in lines if line.startswith("- ") and not line.startswith("- -e")
    ]


def entries(text: str) -> list[str]:
    """Return the packages of a lock file, each with its hashes."""
    return re.findall(r"^\S.*\\\n(?:    .*\n)+", text, re.MULTILINE)


def ours(entry: str) -> str:
    """Return the entry for Python 3.11 on Linux and macOS, without a marker that always holds, or ""."""
    first, rest = entry.split("\n", 1)
    name, _, marker = first.rstrip(" \\").partition(" ; ")
    holds = [
        not marker
        or Marker(marker).evaluate(
            {
                "sys_platform": system,
                "platform_system": "Linux" if system == "linux" else "Darwin",
                "platform_machine": machine,
                "os_name": "posix",
                "python_full_version": f"3.11.{patch}",
            }
        )
        for system in ("linux", "darwin")
        for machine in ("x86_64", "aarch64", "arm64")
        for patch in (0, 15)
    ]
    return f"{name} \\\n{rest}" if all(holds) else entry if any(holds) else ""


def cpu_builds(torch: str) -> list[str]:
    """Return the entries of torch's CPU builds: on macOS PyPI's, on Linux pytorch.org's."""
    first, hashes = torch.split("\n", 1)
    version = first.split()[0].removeprefix("torch==")
    found = [f"torch=={version} ; sys_platform == 'darwin' \\\n{hashes}"]
    if version in CPU_BUILDS:
        known = " \\\n".join(f"    --hash=sha256:{digest}" for digest in CPU_BUILDS[version])
        found.append(f"torch=={version}+cpu ; sys_platform == 'linux' \\\n{known}\n")
    else:
        print(f"no CPU build of torch {version} is known; add its hashes to CPU_BUILDS in .ci/lock.py")
    return found


def main() -> int:
    old = [path for path in LOCKS.glob("*.lock") if path.name != "torch-cpu.lock"]
    with TemporaryDirectory() as folder:
        wanted, made = Path(folder) / "pins.txt", Path(folder) / "made.lock"
        wanted.write_text("\n".join(pins()) + "\n", encoding="utf-8")
        if "--upgrade" not in sys.argv:  # uv keeps the versions that its output file has
            made.write_text("".join(path.read_text(encoding="utf-8") for path in old), encoding="utf-8")
        options = [
            "--universal",
            "--python-version",
            "3.11",
            "--generate-hashes",
            "--no-header",
            "--no-annotate",
        ]
        uv = Path(sys.executable).with_name("uv")
        subprocess.run([uv, "pip", "compile", "--quiet", *options, wanted, "-o", made], check=True)
        found = [kept for entry in entries(made.read_text(encoding="utf-8")) if (kept := ours(entry))]
    cuda = [entry for entry in found if OF_CUDA.match(entry)]
    files = {
        "packages": [entry for entry in found if entry not in cuda],
        "torch-cpu": cpu_builds(next(entry for entry in cuda if entry.startswith("torch=="))),
        "torch-cuda": cuda,
    }
    LOCKS.mkdir(exist_ok=True)
    for name, kept in files.items():
        (LOCKS / f"{name}.lock").write_text(HEAD + "".join(kept), encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
