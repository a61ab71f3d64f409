"""The documents say what is there: programs run, commands parse, paths exist, the README names every
notebook."""

import re
import shlex
import subprocess
import sys
import tomllib

import pytest

from paper_artifact import cli
from paper_artifact.files import REPOSITORY
from paper_artifact.notebooks import NOTEBOOKS

PATHS = [*sorted(REPOSITORY.glob("*.md")), *sorted((REPOSITORY / "docs").glob("*.md"))]
DOCUMENTS = {path.stem: path.read_text(encoding="utf-8") for path in PATHS}
TEXT, LIBRARY = DOCUMENTS["README"], DOCUMENTS["library"]


def blocks(language: str, text: str) -> list[str]:
    """Return the code blocks of that language at the margin; indented ones are parts of something."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands() -> list[str]:
    text = "\n".join(DOCUMENTS.values())
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    inline = re.findall(r"`(python -m paper_artifact [^`]*)`", text)
    return sorted({line for line in [*lines, *inline] if line.startswith("python -m paper_artifact")})


def test_the_programs_for_contributors_run():
    assert blocks("python", DOCUMENTS["CONTRIBUTING"])
    for program in blocks("python", DOCUMENTS["CONTRIBUTING"]):
        result = subprocess.run([sys.executable, "-W", "error", "-c", program], cwd=REPOSITORY, timeout=300)
        assert result.returncode == 0


@pytest.mark.parametrize("command", commands())
def test_commands_parse(command):
    words = shlex.split(command)[3:]
    if words[0].startswith("-") or "VERB" in words or "--help" in words:
        assert words in (["--help"], ["VERB"], ["VERB", "--help"])
        return
    parser, runner = cli._parser(words[0])
    assert runner is not None and parser.parse_args(words).verb == words[0]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_paths_exist(document):
    folders = "paper_artifact|notebooks|data_scripts|results|tests|docs"
    named = re.findall(rf"`((?:{folders})/[\w./-]*)`", DOCUMENTS[document])
    # git-ignored, written by the commands
    made = {f"results/{each}" for each in ("executed/", "own/", "scenes/my", "book/index.html")}
    made |= {"data_scripts/downloads/", "results/measured/persistence.csv"}
    assert [path for path in named if path not in made and not (REPOSITORY / path).exists()] == []


def test_modules_that_documents_name_exist():
    named = re.findall(r"`(\w+/\w+\.py|\w+/\w+/\w+\.py)`", DOCUMENTS["ARCHITECTURE"])
    places = (REPOSITORY, REPOSITORY / "paper_artifact")
    assert [path for path in named if not any((place / path).exists() for place in places)] == []


def test_the_readme_names_what_the_package_brings():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    brought = re.search(r"`pip install \.` \(([^)]*)\)", LIBRARY)
    assert brought is not None and sorted(brought[1].split(", ")) == sorted(project["dependencies"])
    assert all(f"`.[{extra}]`" in LIBRARY for extra in project["optional-dependencies"])


def test_the_readme_is_short():
    assert len(TEXT.encode()) <= 8000
    pages = ("own_mesh", "photographs", "betti", "library", "study")
    assert all(f"`docs/{name}.md`" in TEXT for name in pages)


def test_the_table_names_every_notebook_and_no_other():
    rows = re.findall(r"^\|[^|]*\|\s*\[?`?(?:notebooks/)?(\d\d_\w+)", TEXT, re.MULTILINE)
    assert set(rows) == {path.stem for path in NOTEBOOKS.glob("*.ipynb")}
