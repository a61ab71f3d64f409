"""The set-up: one place with versions, and a bootstrap that is fast the second time and gives hints, not
traces."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
import yaml

import paper_artifact
from paper_artifact.files import REPOSITORY

OPTIONAL = {"pycolmap", "dracopy"}  # no wheel for Linux on ARM; its tests are skipped where it is missing
# Stands for a Python: answers the version check, makes a "virtual environment" of itself, notes how it was
# called.
STUB = r"""#!/bin/bash
echo "$*" >> "$STUB_LOG"
case "$*" in
    "-c "*) exit "${STUB_OTHER_VERSION:-0}" ;;
    "-m venv "*) [ -z "$STUB_NO_VENV" ] || { echo "Traceback: ensurepip is not available"; exit 1; }
                 mkdir -p "$3/bin" && cp "$STUB_SOURCE" "$3/bin/python" ;;
    "-m pip install -r "*) [ -z "$STUB_NO_NETWORK" ] || { echo Traceback
                           echo "ERROR: No matching distribution"; exit 1; } ;;
    "-m ruff"*|"-m mypy"*) exit "${STUB_LINT:-0}" ;;
    "-m pytest"*) exit "${STUB_PYTEST:-0}" ;;
esac
"""
UV_STUB = r"""#!/bin/bash
echo "uv $*" >> "$STUB_LOG"
[ -z "$STUB_NO_UV" ] || exit 1
[ "$2" != find ] || echo "$STUB_SOURCE"
"""


def environment():
    return yaml.safe_load((REPOSITORY / "environment.yml").read_text())


def pins() -> dict[str, str]:
    pip = next(entry["pip"] for entry in environment()["dependencies"] if isinstance(entry, dict))
    assert pip[-1] == "-e ."
    return dict(entry.partition(";")[0].strip().split("==") for entry in pip[:-1])


def installed(name: str) -> str | None:
    """Return the installed version of a package; None for one that not every machine has a wheel of."""
    try:
        return metadata.version(name).split("+")[0]
    except metadata.PackageNotFoundError:
        if name in OPTIONAL:
            return None
        raise


def test_versions_stand_in_one_place_and_are_what_is_installed():
    assert "python=3.11" in environment()["dependencies"]
    for name, version in pins().items():
        assert installed(name) in ((version, None) if name in OPTIONAL else (version,)), (
            f"run bash test.sh: environment.yml pins {name}=={version}"
        )
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert set(extras) == {"study", "dev", "cluster", "photos", "meshes"}
    named = [*project["dependencies"], *(name for names in extras.values() for name in names)]
    assert len(named) == len(set(named)), "each package is named once"
    assert set(named) == set(pins()) - {"setuptools"}, "pyproject.toml names what environment.yml pins"
    assert all(name.replace("-", "_").isidentifier() for name in named), "names only, no versions"
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    assert citation["version"] == paper_artifact.__version__
    assert [author["family-names"] for author in citation["preferred-citation"]["authors"]] == [
        "Chongpermwattanapol",
        "Damnernyut",
        "Kanongchaiyos",
    ]


class Setup:
    """test.sh in a copy of the repository's top, with a PATH of stubs and basic tools alone."""

    def __init__(self, folder: Path):
        self.root, self.bin, self.log = folder / "a checkout", folder / "bin", folder / "calls.log"
        (self.root / ".ci").mkdir(parents=True)
        self.bin.mkdir()
        for name in ("test.sh", "environment.yml", "pyproject.toml", ".ci/bootstrap.sh", ".ci/run"):
            shutil.copy(REPOSITORY / name, self.root / name)
        for tool in (
            "bash",
            "sed",
            "awk",
            "cat",
            "cksum",
            "dirname",
            "grep",
            "tail",
            "mkdir",
            "rm",
            "mv",
            "cp",
            "env",
        ):
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.source = folder / "stub"
        self.source.write_text(STUB)
        self.source.chmod(0o755)

    def add(self, name: str, text: str | None = None) -> None:
        target = self.bin / name
        target.write_text(STUB if text is None else text)
        target.chmod(0o755)

    def run(
        self, *arguments: str, script: str = "test.sh", **variables: str
    ) -> subprocess.CompletedProcess[str]:
        self.log.write_text("")
        environment = {
            "PATH": str(self.bin),
            "HOME": str(self.root),
            "STUB_LOG": str(self.log),
            "STUB_SOURCE": str(self.source),
        }
        return subprocess.run(
            [str(self.bin / "bash"), str(self.root / script), *arguments],
            cwd=self.bin,
            timeout=60,
            env={**environment, **variables},
            capture_output=True,
            text=True,
        )

    def calls(self) -> list[str]:
        return self.log.read_text().splitlines()


@pytest.fixture
def setup(tmp_path):
    return Setup(tmp_path)


def test_first_run_installs_the_pins_and_the_second_does_not(setup):
    setup.add("python3.11")
    assert setup.run("-k", "x").returncode == 0
    calls = setup.calls()
    assert f"-m venv {setup.root}/.venv" in calls
    assert f"-m pip install --no-deps --no-build-isolation -e {setup.root}" in calls
    listed = (setup.root / ".venv" / "requirements.txt").read_text().splitlines()
    listed = [line.partition(";")[0] for line in listed]
    assert listed == [f"{name}=={version}" for name, version in pins().items()]
    assert calls[-1] == "-m pytest -k x"
    assert setup.run("-k", "x").stderr == ""
    assert not [call for call in setup.calls() if "install" in call or "venv" in call]
    (setup.root / "environment.yml").write_text(
        (setup.root / "environment.yml").read_text().replace("==1.17.1", "==1.17.2")
    )
    assert setup.run("-k", "x").returncode == 0
    assert [call for call in setup.calls() if "pip install -r" in call], "a changed pin installs again"
    assert not [call for call in setup.calls() if call.startswith("-m venv")], "into the same environment"


def test_runs_all_checks_and_passes_a_failure_on(setup):
    checks = [
        "-m ruff check .",
        "-m mypy",
        "-m pytest tests",
        "-m pytest --nbval --nbval-current-env notebooks",
    ]
    setup.add("python3.11")
    assert setup.run(script=".ci/run").returncode == 0
    assert setup.calls()[-4:] == checks
    for variable in ("STUB_LINT", "STUB_PYTEST"):
        assert setup.run(script=".ci/run", **{variable: "5"}).returncode == 5
        assert setup.calls()[-4:] == checks, "what follows a failing check is run all the same"


@pytest.mark.parametrize(
    "variables, words",
    [
        (
            {"STUB_NO_VENV": "1"},
            ["cannot make a virtual environment", "apt install python3.11-venv", "conda env create"],
        ),
        (
            {"STUB_NO_NETWORK": "1"},
            ["could not be installed", "PIP_INDEX_URL", "ERROR: No matching distribution"],
        ),
    ],
)
def test_hints_instead_of_traces(setup, variables, words):
    setup.add("python3.11")
    result = setup.run(**variables)
    assert result.returncode == 1
    assert all(word in result.stderr for word in words) and "Traceback" not in result.stderr + result.stdout
    assert not (setup.root / ".venv" / "paper_artifact.stamp").exists()
    assert setup.run("-k", "x").returncode == 0, "once the cause is gone the same command goes on"


def test_uv_brings_python_where_the_host_has_none(setup):
    setup.add("uv", UV_STUB)
    setup.add("python3", "#!/bin/bash\nexit 1\n")  # a Python of another version
    result = setup.run("-k", "x")
    assert result.returncode == 0, result.stderr
    assert [call for call in setup.calls() if call.startswith("uv")] == [
        "uv python install --quiet 3.11",
        "uv python find --managed-python 3.11",
    ]
    assert (setup.root / ".venv" / "bin" / "python").exists()
    shutil.rmtree(setup.root / ".venv")
    failing = setup.run(STUB_NO_UV="1")
    assert failing.returncode == 1 and "uv could not bring Python 3.11" in failing.stderr
    assert not (setup.root / ".venv").exists()


def test_no_python_at_all_and_broken_side_environment(setup):
    result = setup.run()
    assert result.returncode == 1 and "no Python on this machine" in result.stderr
    setup.add("python3", "#!/bin/bash\nexit 1\n")
    result = setup.run()
    assert result.returncode == 1 and "sudo apt install python3-venv" in result.stderr


def test_scripts_are_sound_bash():
    for name in ("test.sh", "reproduce.sh", ".ci/bootstrap.sh", ".ci/run"):
        assert subprocess.run(["bash", "-n", name], cwd=REPOSITORY).returncode == 0
    assert os.access(REPOSITORY / ".ci" / "run", os.X_OK)
