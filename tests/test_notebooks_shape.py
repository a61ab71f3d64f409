"""What every committed notebook must look like. nbval compares outputs, but passes a stripped notebook: so
this.
"""

import re

import nbformat
import pytest

from paper_artifact.notebooks import NOTEBOOKS, cleaned

FILES = sorted(NOTEBOOKS.glob("*.ipynb"))
MACHINE_PATH = re.compile(r"(?<![\w.])/(home|root|work|tmp|Users|opt)/\w")


@pytest.fixture(params=FILES, ids=lambda path: path.stem)
def path(request):
    return request.param


@pytest.fixture
def notebook(path):
    return nbformat.read(path, as_version=4)


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def is_parameters(cell):
    return "parameters" in cell.metadata.get("tags", [])


def test_opens_with_a_title_and_its_parameters(path, notebook):
    assert re.fullmatch(r"\d\d_[a-z0-9_]+", path.stem), "NN_name.ipynb"
    assert notebook.cells[0].cell_type == "markdown" and notebook.cells[0].source.startswith("# ")
    code = code_cells(notebook)
    tagged = [is_parameters(cell) for cell in code]
    assert tagged == [True] + [False] * (len(code) - 1), "the first code cell, and only it"
    assert re.search(r'^profile\s*=\s*"recorded"', code[0].source, re.MULTILINE), "run-all injects `profile`"


def test_cells_are_short_and_were_executed_in_order(notebook):
    counts = [cell.execution_count for cell in code_cells(notebook)]
    assert counts == list(range(1, len(counts) + 1))
    for cell in code_cells(notebook):
        assert sum(bool(line.strip()) for line in cell.source.splitlines()) <= 25, cell.source
        assert "sys.path" not in cell.source


def test_outputs_are_clean(notebook):
    for cell in code_cells(notebook):
        for output in cell.outputs:
            assert output.output_type != "error"
            # Bars and warnings differ from run to run: use --quiet, fix the warning.
            assert output.get("name") != "stderr"
            data = output.get("data", {}).items()
            texts = [output.get("text", ""), *(value for kind, value in data if kind.startswith("text/"))]
            assert not [text for text in texts if MACHINE_PATH.search(text)], "a path of one machine"


def test_every_figure_is_also_written_as_svg(notebook):
    """Through `plot.show`, each under its own key."""
    keys = []
    for cell in code_cells(notebook):
        shown = sum("image/png" in output.get("data", {}) for output in cell.outputs)
        own = re.findall(r'(?<!\w)show\("(\w+)", ', cell.source)
        assert shown == len(own), cell.source
        keys += own
    assert len(keys) == len(set(keys))


def test_figures_have_their_numbers_beside_them(notebook):
    """nbval compares no pictures: between two texts, a cell that draws follows or holds a table or printed
    values."""
    compared = False
    for cell in notebook.cells:
        compared &= cell.cell_type != "markdown"
        outputs = cell.get("outputs", [])
        shown = [output.get("data", {}) for output in outputs]
        compared |= any(output.get("text") for output in outputs)
        compared |= any("text/html" in data for data in shown)
        compared |= any(not data.get("text/plain", "<Figure").startswith("<Figure") for data in shown)
        assert compared or not any("image/png" in data for data in shown), cell.source


def test_is_as_refresh_writes_it(path, notebook):
    """Written by `run-all --refresh`: no times, no injected cell. Also small enough for the repository."""
    assert path.read_text(encoding="utf-8") == nbformat.writes(cleaned(notebook)) + "\n"
    assert path.stat().st_size < 2_000_000
