"""The set-up: one place with versions, locks that follow it, a bootstrap that is fast the second time."""

import json
import os
import re
import shutil
import subprocess
import tomllib
from importlib import metadata

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import paper_artifact
from paper_artifact.files import REPOSITORY

OPTIONAL = {"pycolmap", "dracopy"}  # no wheel for Linux on ARM; its tests are skipped where it is missing
TOOLS = ["bash", "sed", "awk", "cat", "cksum", "dirname", "rmdir", "grep", "tail", "tr"]
TOOLS += ["mkdir", "rm", "mv", "cp", "env"]
LOCKS = sorted((REPOSITORY / "requirements").glob("*.lock"))
# Stands for a Python: answers the version check, makes a "virtual environment" of itself, notes its calls.
STUB = r"""#!/bin/bash
echo "$*" >> "$STUB_LOG"
case "$*" in
    "-c "*) exit "${STUB_OTHER_VERSION:-0}" ;;
    "-m venv "*) [ -z "$STUB_NO_VENV" ] || { echo "Traceback: ensurepip is not available"; exit 1; }
                 mkdir -p "$3/bin" && cp "$STUB_SOURCE" "$3/bin/python" ;;
    "-m pip install --no-deps --require-hashes -r "*"$STUB_MISSING"*)
        [ -z "$STUB_MISSING" ] || { echo Traceback; echo "ERROR: No matching distribution"; exit 1; } ;;
    "-m ruff"*|"-m mypy"*) exit "${STUB_LINT:-0}" ;;
    "-m pytest"*) exit "${STUB_PYTEST:-0}" ;;
esac
"""
UV_STUB = r"""#!/bin/bash
echo "uv $*" >> "$STUB_LOG"
[ -z "$STUB_NO_UV" ] || exit 1
[ "$2" != find ] || echo "$STUB_SOURCE"
"""
OTHER_PYTHON = "#!/bin/bash\nexit 1\n"


def environment():
    return yaml.safe_load((REPOSITORY / "environment.yml").read_text())


def pins() -> dict[str, str]:
    pip = next(entry["pip"] for entry in environment()["dependencies"] if isinstance(entry, dict))
    assert pip[-1] == "-e ."
    return dict(entry.partition(";")[0].strip().split("==") for entry in pip[:-1])


def test_versions_stand_in_one_place_and_are_what_is_installed():
    assert "python=3.11" in environment()["dependencies"]
    for name, version in pins().items():
        try:
            found = metadata.version(name).split("+")[0]
        except metadata.PackageNotFoundError:
            assert name in OPTIONAL
            continue
        assert found == version, f"run bash test.sh: environment.yml pins {name}=={version}"
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert set(extras) == {"study", "dev", "cluster", "photos", "meshes"}
    named = [*project["dependencies"], *(name for names in extras.values() for name in names)]
    assert len(named) == len(set(named)), "each package is named once"
    assert set(named) == set(pins()) - {"setuptools", "uv"}, "pyproject.toml names what environment.yml pins"
    assert all(name.replace("-", "_").isidentifier() for name in named), "names only, no versions"


def test_citation_and_archive_say_the_same_as_the_package():
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    archive = json.loads((REPOSITORY / ".zenodo.json").read_text())
    assert citation["version"] == archive["version"] == paper_artifact.__version__
    assert citation["title"] == archive["title"] and citation["license"] == archive["license"]


def test_the_locks_have_every_pin_and_a_hash_for_every_file():
    """What is transitive is followed through the installed packages."""
    locked: dict[str, set[str]] = {}
    for path in LOCKS:
        for entry in re.findall(r"^[^\s#].*(?:\n    .*)*", path.read_text(), re.MULTILINE):
            name, version = re.match(r"([\w.-]+)==([\w.]+)", entry).groups()
            locked.setdefault(name, set()).add(version)
            hashes = entry.split(" \\\n    ")[1:]
            assert hashes and all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", each) for each in hashes), name
    pinned = {name: {version} for name, version in pins().items()}
    assert pinned.items() <= locked.items(), "python .ci/lock.py"
    waiting, needed = list(pins()), set()
    while waiting:
        name = waiting.pop()
        if name in needed:
            continue
        needed.add(name)
        try:
            requirements = [Requirement(text) for text in metadata.requires(name) or ()]
        except metadata.PackageNotFoundError:
            continue
        here = [each for each in requirements if each.marker is None or each.marker.evaluate({"extra": ""})]
        waiting += [canonicalize_name(each.name) for each in here]
    assert needed <= set(locked), f"python .ci/lock.py: {sorted(needed - set(locked))}"


class Setup:
    """test.sh in a copy of the repository's top, with a PATH of stubs and basic tools alone."""

    def __init__(self, folder):
        self.root, self.bin, self.log = folder / "a checkout", folder / "bin", folder / "calls.log"
        (self.root / ".ci").mkdir(parents=True)
        self.bin.mkdir()
        for name in ("test.sh", "environment.yml", "pyproject.toml", ".ci/bootstrap.sh", ".ci/run"):
            shutil.copy(REPOSITORY / name, self.root / name)
        shutil.copytree(REPOSITORY / "requirements", self.root / "requirements")
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.source = folder / "stub"
        self.source.write_text(STUB)
        self.source.chmod(0o755)

    def add(self, name: str, text: str = STUB) -> None:
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def run(self, *arguments: str, script: str = "test.sh", **variables: str) -> subprocess.CompletedProcess:
        self.log.write_text("")
        places = {"PATH": self.bin, "HOME": self.root, "STUB_LOG": self.log, "STUB_SOURCE": self.source}
        return subprocess.run(
            [str(self.bin / "bash"), str(self.root / script), *arguments],
            cwd=self.bin,
            timeout=60,
            env={name: str(path) for name, path in places.items()} | variables,
            capture_output=True,
            text=True,
        )

    def calls(self) -> list[str]:
        return self.log.read_text().splitlines()

    def installs(self) -> list[str]:
        """The lock files that were installed, in order."""
        return [call.rpartition("/")[2] for call in self.calls() if " --require-hashes -r " in call]


@pytest.fixture
def setup(tmp_path):
    return Setup(tmp_path)


def test_first_run_installs_the_locks_and_the_second_does_not(setup):
    setup.add("python3.11")
    assert setup.run("-k", "x").returncode == 0
    calls = setup.calls()
    assert f"-m venv {setup.root}/.venv" in calls
    assert setup.installs() == ["torch-cpu.lock", "packages.lock"]
    assert calls[-3:-1] == [f"-m pip install --no-deps --no-build-isolation -e {setup.root}", "-m pip check"]
    assert calls[-1] == "-m pytest -k x"
    assert setup.run("-k", "x").stderr == ""
    assert not [call for call in setup.calls() if "install" in call or "venv" in call]
    pin = setup.root / "environment.yml"
    pin.write_text(pin.read_text().replace("scipy==1.17.1", "scipy==1.17.2"))
    result = setup.run("-k", "x")
    assert result.returncode == 1
    assert "requirements/ lacks what environment.yml names: scipy==1.17.2" in result.stderr
    lock = setup.root / "requirements" / "packages.lock"
    lock.write_text(lock.read_text().replace("scipy==1.17.1", "scipy==1.17.2"))
    assert setup.run("-k", "x").returncode == 0
    assert setup.installs() and not [call for call in setup.calls() if call.startswith("-m venv")]


def test_takes_the_torch_of_pypi_where_no_cpu_build_is_found(setup):
    setup.add("python3.11")
    assert setup.run("-k", "x", STUB_MISSING="torch-cpu.lock").returncode == 0
    assert setup.installs() == ["torch-cpu.lock", "torch-cuda.lock", "packages.lock"]


def test_runs_all_checks_and_passes_a_failure_on(setup):
    setup.add("python3.11")
    assert setup.run(script=".ci/run").returncode == 0
    checks = setup.calls()[-4:]
    assert checks[:2] == ["-m ruff check .", "-m mypy"]
    assert checks[2].startswith("-m pytest tests ")
    assert checks[3].startswith("-m pytest --nbval --nbval-current-env notebooks ")
    for variable in ("STUB_LINT", "STUB_PYTEST"):
        assert setup.run(script=".ci/run", **{variable: "5"}).returncode == 5
        assert setup.calls()[-4:] == checks, "what follows a failing check is run all the same"


@pytest.mark.parametrize(
    "variable, words",
    [
        (
            "STUB_NO_VENV",
            ("cannot make a virtual environment", "apt install python3.11-venv", "conda env create"),
        ),
        ("STUB_MISSING", ("could not be installed", "PIP_INDEX_URL", "ERROR: No matching distribution")),
    ],
)
def test_hints_instead_of_traces(setup, variable, words):
    setup.add("python3.11")
    result = setup.run(**{variable: ".lock"})
    assert result.returncode == 1
    assert all(word in result.stderr for word in words) and "Traceback" not in result.stderr + result.stdout
    assert not (setup.root / ".venv" / "paper_artifact.stamp").exists()
    assert setup.run("-k", "x").returncode == 0, "once the cause is gone the same command goes on"


def test_a_folder_of_the_users_is_not_cleared_for_the_environment(setup, tmp_path):
    setup.add("python3.11")
    mine = tmp_path / "envs" / "notes.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    for place in (mine.parent, mine):
        result = setup.run("-k", "x", PAPER_ARTIFACT_VENV=str(place))
        assert result.returncode == 1 and f"{place} is in the way" in result.stderr
        assert mine.read_text() == "mine"
    mine.unlink()
    assert setup.run("-k", "x", PAPER_ARTIFACT_VENV=str(mine.parent)).returncode == 0, "empty"
    (mine.parent / "bin" / "python").unlink()
    assert setup.run("-k", "x", PAPER_ARTIFACT_VENV=str(mine.parent)).returncode == 0, "its own"


def test_uv_brings_python_where_the_host_has_none(setup):
    result = setup.run()
    assert result.returncode == 1 and "no Python on this machine" in result.stderr
    setup.add("python3", OTHER_PYTHON)
    result = setup.run()
    assert result.returncode == 1 and "sudo apt install python3-venv" in result.stderr
    setup.add("uv", UV_STUB)
    result = setup.run("-k", "x")
    assert result.returncode == 0, result.stderr
    asked = [call for call in setup.calls() if call.startswith("uv")]
    assert asked == ["uv python install --quiet 3.11", "uv python find --managed-python 3.11"]
    assert (setup.root / ".venv" / "bin" / "python").exists()
    shutil.rmtree(setup.root / ".venv")
    failing = setup.run(STUB_NO_UV="1")
    assert failing.returncode == 1 and "uv could not bring Python 3.11" in failing.stderr
    assert not (setup.root / ".venv").exists()


def test_uv_itself_is_taken_by_its_hash(setup):
    """Where neither Python 3.11 nor uv is there, a Python of another version installs uv in a side folder."""
    setup.add("python3", STUB.replace('exit "${STUB_OTHER_VERSION:-0}"', "exit 1"))
    setup.run()
    (asked,) = [call for call in setup.calls() if "--require-hashes" in call]
    assert asked.endswith("/.python/uv.lock")
    entry = (setup.root / ".python" / "uv.lock").read_text()
    assert entry.startswith(f"uv=={pins()['uv']} \\\n") and entry.count("==") == 1
    assert "--hash=sha256:" in entry


def test_scripts_are_sound_bash_also_in_a_checkout_on_windows(tmp_path):
    for name in ("test.sh", "reproduce.sh", ".ci/bootstrap.sh", ".ci/run"):
        assert subprocess.run(["bash", "-n", name], cwd=REPOSITORY).returncode == 0
        ask = ["git", "check-attr", "eol", name]
        asked = subprocess.run(ask, cwd=REPOSITORY, capture_output=True, text=True)
        assert asked.stdout.strip() in (f"{name}: eol: lf", ""), "Git for Windows would write CRLF"
    assert os.access(REPOSITORY / ".ci" / "run", os.X_OK)


def test_workflow_actions_are_pinned_by_commit():
    for path in (REPOSITORY / ".github" / "workflows").glob("*.yml"):
        actions = re.findall(r"uses: (\S+)", path.read_text())
        assert actions and all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in actions)
