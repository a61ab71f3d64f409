"""The command line: registry, help, exit codes. Verbs' own work is tested with their modules."""

from __future__ import annotations

import os
import subprocess
import sys
import types

import pytest

from paper_artifact import cli
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY


def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **environment},
    )


@pytest.fixture
def verb(monkeypatch):
    """Register a verb `trial` with one option --number; returns a setter for what its run does."""
    module = types.ModuleType("paper_artifact.cli.trial")
    module.add_arguments = lambda parser: parser.add_argument("--number", type=int)
    monkeypatch.setitem(cli.VERBS, "trial", cli.Verb("trial", "a verb for the tests"))
    monkeypatch.setitem(sys.modules, "paper_artifact.cli.trial", module)

    def set_run(run):
        module.run = run
        return module

    return set_run


def test_help_names_every_verb_and_imports_none_of_them():
    result = python("-X", "importtime", "-m", "paper_artifact", "--help")
    assert result.returncode == 0
    assert all(name in result.stdout for name in cli.VERBS)
    imported = {
        line.rsplit("|", 1)[1].strip()
        for line in result.stderr.splitlines()
        if line.startswith("import time:")
    }
    assert "paper_artifact.cli" in imported
    assert not imported & {"numpy", "torch", "numba", "scipy", "tqdm", "pandas", "matplotlib"}


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, verb in cli.VERBS.items()
        if (REPOSITORY / "paper_artifact" / "cli" / f"{verb.module}.py").is_file()
    ],
)
def test_each_verb_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main([name, "--help"])
    text = capsys.readouterr().out
    assert caught.value.code == 0
    assert f"paper_artifact {name}" in text and "--quiet" in text
    assert cli.VERBS[name].summary[:20].lower() in " ".join(text.split()).lower()


def test_every_module_of_the_folder_is_a_registered_verb():
    modules = {path.stem for path in (REPOSITORY / "paper_artifact" / "cli").glob("*.py")} - {"__init__"}
    assert {name for name in modules if not name.startswith("_")} <= {
        verb.module for verb in cli.VERBS.values()
    }


@pytest.mark.parametrize("arguments", [[], ["nope"], ["fetch", "--nope"], ["trial", "--number", "many"]])
def test_wrong_usage_is_exit_code_2(arguments, verb, capsys):
    verb(lambda arguments: 0)
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    assert caught.value.code == 2
    assert "usage:" in capsys.readouterr().err


def test_run_gets_its_arguments_and_gives_the_exit_code(verb):
    seen = []
    verb(lambda arguments: seen.append((arguments.number, arguments.quiet)) or 3)
    assert cli.main(["trial", "--number", "7", "--quiet"]) == 3
    verb(lambda arguments: None)
    assert cli.main(["trial"]) == 0
    assert seen == [(7, True)]


def test_a_verb_may_define_quiet_itself(verb):
    module = verb(lambda arguments: len(arguments.quiet))
    module.add_arguments = lambda parser: parser.add_argument("--quiet", help="its own", default="four")
    assert cli.main(["trial"]) == 4


@pytest.mark.parametrize(
    "error, words",
    [
        (InputError("the mesh a.obj is empty; give another"), "the mesh a.obj is empty"),
        (KeyboardInterrupt(), "interrupted"),
    ],
)
def test_failure_is_one_line_and_exit_code_1(error, words, verb, capsys):
    def run(arguments):
        raise error

    verb(run)
    assert cli.main(["trial"]) == 1
    text = capsys.readouterr().err
    assert words in text and len(text.splitlines()) == 1


def test_a_fault_of_our_own_keeps_its_trace(verb):
    verb(lambda arguments: {}["missing"])
    with pytest.raises(KeyError):
        cli.main(["trial"])


def test_missing_verb_module_and_missing_package_are_told_apart(monkeypatch, capsys):
    monkeypatch.setitem(cli.VERBS, "later", cli.Verb("later_than_this", "a verb without a module"))
    assert cli.main(["later"]) == 1
    assert "the verb 'later' is not part of this version" in capsys.readouterr().err

    def without_package(name):
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr(cli.importlib, "import_module", without_package)
    assert cli.main(["train"]) == 1
    assert "needs the Python package 'torch'" in capsys.readouterr().err


def test_a_reader_that_goes_away_is_no_trace():
    command = f"{sys.executable} -u -m paper_artifact fetch --list | head -n 1"
    result = subprocess.run(
        ["bash", "-c", command], cwd=REPOSITORY, capture_output=True, text=True, timeout=120
    )
    assert "Traceback" not in result.stderr and result.stdout.startswith("spot")
