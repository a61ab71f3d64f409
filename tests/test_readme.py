"""The README says what is there: its program runs, its commands parse, its paths exist, its table names every notebook."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys

import pytest

from paper_artifact import cli
from paper_artifact.files import REPOSITORY
from paper_artifact.notebooks import NOTEBOOKS

TEXT = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def commands() -> list[str]:
    lines = [line.split("#")[0].strip() for line in "\n".join(blocks("bash")).splitlines()]
    inline = re.findall(r"`(python -m paper_artifact [^`]*)`", TEXT)
    return sorted({line for line in [*lines, *inline] if line.startswith("python -m paper_artifact")})


def test_the_program_runs(tmp_path):
    assert blocks("python")
    for program in blocks("python"):
        result = subprocess.run(
            [sys.executable, "-W", "error", "-c", program],
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert result.returncode == 0, result.stderr
        assert "longest loop: 0." in result.stdout and "gradient: torch.Size([512, 3])" in result.stdout


@pytest.mark.parametrize("command", commands())
def test_commands_parse(command):
    words = shlex.split(command)[3:]
    if words[0].startswith("-") or "VERB" in words or "--help" in words:
        assert words in (["--help"], ["VERB"], ["VERB", "--help"])
        return
    parser, runners = cli._parser(words[0])
    assert parser.parse_args(words).verb in runners


def test_paths_exist():
    named = re.findall(r"`((?:paper_artifact|notebooks|data_scripts|results|tests)/[\w./-]*)`", TEXT)
    made = {
        "results/executed/",
        "results/scenes/my",
        "data_scripts/downloads/",
    }  # git-ignored, written by the commands
    assert [path for path in named if path not in made and not (REPOSITORY / path).exists()] == []


def test_the_table_names_every_notebook_and_no_other():
    rows = re.findall(r"^\|[^|]*\|\s*\[?`?(?:notebooks/)?(\d\d_\w+)", TEXT, re.MULTILINE)
    assert set(rows) == {path.stem for path in NOTEBOOKS.glob("*.ipynb")}
