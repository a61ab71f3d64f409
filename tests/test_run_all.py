"""run-all on tiny notebooks: order, profile, failures that do not stop the rest, and a refresh that repeats
itself.
"""

import errno
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat import v4

from paper_artifact.cli import main
from paper_artifact.cli.notebooks import execution_table
from paper_artifact.errors import InputError
from paper_artifact.files import FIGURES_VARIABLE, REPOSITORY
from paper_artifact.notebooks import Execution, cleaned, execute, notebook_files, own_kernel

PARAMETERS = 'profile = "recorded"'


def write_notebook(path: Path, *sources: str) -> Path:
    parameters = v4.new_code_cell(PARAMETERS, metadata={"tags": ["parameters"]})
    path.parent.mkdir(parents=True, exist_ok=True)
    cells = [v4.new_markdown_cell("# Title"), parameters, *map(v4.new_code_cell, sources)]
    nbformat.write(v4.new_notebook(cells=cells), path)
    return path


def printed(path: Path) -> str:
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    return "".join(output.get("text", "") for cell in cells for output in cell.outputs)


def executed(path: Path, **options) -> Execution:
    with own_kernel():
        return execute(path, "recorded", **{"executed": path.parent / "out", "quiet": True} | options)


def test_a_notebook_in_another_language_and_a_magic_that_does_not_exist_fail(tmp_path, capfd):
    folder = tmp_path / "notebooks"
    for name, cell, metadata in (
        ("01_julia", "x = 1", {"language_info": {"name": "julia"}}),
        ("02_r", "x <- 1", {"kernelspec": {"name": "ir", "display_name": "R", "language": "R"}}),
        ("03_magic", "%nomagic", {}),
        ("04_conda", "1", {"kernelspec": {"name": "conda-env-x-py", "display_name": "x"}}),
    ):
        notebook = v4.new_notebook(cells=[v4.new_code_cell(cell)], metadata=metadata)
        folder.mkdir(exist_ok=True)
        nbformat.write(notebook, folder / f"{name}.ipynb")
    code = main(["run-all", f"--notebooks={folder}", f"--out={tmp_path / 'out'}", "--quiet"])
    said = capfd.readouterr()
    rows = said.out.splitlines()[1:5]
    assert code == 1 and said.err == "paper_artifact: 3 of 4 notebooks failed: 01_julia, 02_r, 03_magic\n"
    assert "in julia; run-all runs those in Python" in rows[0] and "in R; run-all runs" in rows[1]
    assert "see the executed copy" in rows[2] and rows[3].endswith("ok")


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_kernels_start_where_a_stream_is_closed(closed, tmp_path):
    write_notebook(tmp_path / "notebooks" / "01_a.ipynb", "print(1)")
    words = ["run-all", "--quiet", f"--notebooks={tmp_path}/notebooks", f"--out={tmp_path}/out"]
    command = shlex.join([sys.executable, "-m", "paper_artifact", *words, f"--figures={tmp_path}/f"])
    ended = subprocess.run(f"{command} {closed}", shell=True, cwd=REPOSITORY, capture_output=True)
    assert ended.returncode == 0 and ended.stderr == b""
    assert printed(tmp_path / "out" / "01_a.ipynb") == "1\n"


def test_a_full_disk_names_the_copy(tmp_path, monkeypatch):
    def full(*arguments, **words):
        raise OSError(errno.EFBIG, "File too large")

    monkeypatch.setattr("papermill.execute_notebook", full)
    error = executed(write_notebook(tmp_path / "01_a.ipynb", "1"), executed=tmp_path / "out").error
    assert error.startswith(f"cannot write {tmp_path}/out/01_a.ipynb: File too large; raise the file size")


def test_order_profile_failure_and_exit_code(tmp_path, capsys):
    folder, out = tmp_path / "notebooks", tmp_path / "out"
    write_notebook(
        folder / "02_broken.ipynb", "print('before')", "raise ValueError('no such\\nshape')", "print('after')"
    )
    write_notebook(folder / "01_first.ipynb", "print(profile)")
    write_notebook(folder / "03_last.ipynb", "import os, sys; print(sys.executable, os.getcwd(), sep='\\n')")
    assert main(["run-all", f"--notebooks={folder}", f"--out={out}", "--profile=full", "--quiet"]) == 1
    printed_here = capsys.readouterr()
    rows = printed_here.out.splitlines()
    assert [row.split()[0] for row in rows[:4]] == ["notebook", "01_first", "02_broken", "03_last"]
    assert [row.split()[2] for row in rows[1:4]] == ["ok", "FAILED:", "ok"]
    assert "ValueError: no such shape" in rows[2]
    assert "1 of 3 notebooks failed: 02_broken" in printed_here.err
    assert printed(out / "01_first.ipynb") == "full\n"
    assert "before" in printed(out / "02_broken.ipynb") and "after" not in printed(out / "02_broken.ipynb")
    assert printed(out / "03_last.ipynb").split("\n")[:2] == [sys.executable, str(folder)]
    assert printed(folder / "01_first.ipynb") == "", "without --refresh the notebooks stay as they are"


def test_refresh_repeats_itself_byte_for_byte(tmp_path, capsys):
    path = write_notebook(
        tmp_path / "notebooks" / "01_a.ipynb", "value = 2 if profile == 'recorded' else 3", "value * 21"
    )
    command = ["run-all", f"--notebooks={path.parent}", f"--out={tmp_path / 'out'}", "--refresh", "--quiet"]
    assert main(command) == 0
    first = path.read_bytes()
    assert main(command) == 0
    assert path.read_bytes() == first
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == [1, 2, 3]
    assert code[0].source == PARAMETERS and code[0].metadata == {"tags": ["parameters"]}
    assert code[2].outputs[0].data["text/plain"] == "42" and code[2].outputs[0].execution_count == 3
    assert b"papermill" not in first and str(tmp_path).encode() not in first and b"iopub" not in first
    capsys.readouterr()


@pytest.mark.parametrize(
    "code, error", [("1 / 0", "In [3]: ZeroDivisionError"), ("import sys; sys.exit(0)", "a cell ended the")]
)
def test_refresh_leaves_a_failing_notebook_alone(tmp_path, code, error):
    path = write_notebook(tmp_path / "01_bad.ipynb", code, "print(2)")
    before = path.read_bytes()
    outcome = executed(path, refresh=True)
    assert path.read_bytes() == before
    assert outcome.error.startswith(error)


def test_a_notebook_of_the_same_name_elsewhere_replaces_nothing(tmp_path):
    paths = [write_notebook(tmp_path / folder / "01_a.ipynb", f"'{folder}'") for folder in ("x", "y")]
    for path in (paths[0], paths[0]):
        assert not executed(path, executed=tmp_path / "out").error
    before = (tmp_path / "out" / "01_a.ipynb").read_bytes()
    with pytest.raises(InputError, match="01_a.ipynb is there and was not written by this command"):
        executed(paths[1], executed=tmp_path / "out")
    assert (tmp_path / "out" / "01_a.ipynb").read_bytes() == before
    project = write_notebook(tmp_path / "p" / "nb" / "01_a.ipynb", "1").parents[1]
    assert not executed(project / "nb" / "01_a.ipynb", executed=project / "ex").error
    moved = project.rename(tmp_path / "q{b}")
    assert not executed(moved / "nb" / "01_a.ipynb", executed=moved / "ex").error


def test_refresh_leaves_what_was_edited_meanwhile(tmp_path):
    """As an editor that saves while the notebook runs: its first cell writes to the notebook itself."""
    path = tmp_path / "01_edited.ipynb"
    write_notebook(path, f"with open({str(path)!r}, 'a') as file:\n    file.write(' ')")
    before = path.read_bytes()
    outcome = executed(path, refresh=True)
    assert path.read_bytes() == before + b" " and "changed while it ran" in outcome.error


def test_figures_that_are_shown_are_written_as_svg(tmp_path):
    path = write_notebook(
        tmp_path / "01_drawn.ipynb",
        "from paper_artifact.plot import new_figure, show",
        "figure, axes = new_figure(1, 1, 2, 2)",
        "axes[0][0].plot([1, 2], [3, 4])",
        "show('line', figure)",
    )
    folder = tmp_path / "figures"
    folder.mkdir()
    (folder / "02_other.svg").write_text("another notebook's")
    outcome = executed(path, figures=folder, refresh=True)
    written = (folder / "01_drawn_line.svg").read_bytes()
    executed(path, figures=folder)
    assert not outcome.error and b"<svg" in written
    assert sorted(each.name for each in folder.glob("*.svg")) == ["01_drawn_line.svg", "02_other.svg"]
    assert (folder / "01_drawn_line.svg").read_bytes() == written, "the same bytes in every run"
    shown = nbformat.read(path, as_version=4).cells[-1].outputs
    assert [set(each.data) for each in shown] == [{"image/png", "text/plain"}]
    assert FIGURES_VARIABLE not in os.environ


def test_a_file_that_is_no_notebook_is_named(tmp_path):
    (tmp_path / "01_noise.ipynb").write_text("{ not json")
    outcome = executed(tmp_path / "01_noise.ipynb")
    assert outcome.name == "01_noise" and outcome.error and "\n" not in outcome.error
    os.mkfifo(tmp_path / "02_pipe.ipynb")
    assert "it is no file" in executed(tmp_path / "02_pipe.ipynb").error


def test_choice_of_notebooks(tmp_path):
    for name in ("01_a", "02_b", "02_bc"):
        write_notebook(tmp_path / f"{name}.ipynb")
    names = lambda *only: [path.stem for path in notebook_files(tmp_path, only)]  # noqa: E731
    assert names() == ["01_a", "02_b", "02_bc"]
    assert names("02_b") == ["02_b"]
    assert names("02") == ["02_b", "02_bc"]
    assert names("02_bc.ipynb", "01") == ["01_a", "02_bc"]
    with pytest.raises(InputError, match="no notebook is called '9'; there are 01_a"):
        notebook_files(tmp_path, ["9"])
    with pytest.raises(InputError, match="no notebooks in"):
        notebook_files(tmp_path / "none")


def test_bad_profile_and_unwritable_folder(tmp_path, capsys):
    path = write_notebook(tmp_path / "01_a.ipynb")
    with pytest.raises(SystemExit) as caught:
        main(["run-all", "--profile", "quick"])
    assert caught.value.code == 2 and "invalid choice" in capsys.readouterr().err
    with pytest.raises(InputError, match="profile 'quick' is unknown"):
        execute(path, "quick", executed=tmp_path / "out")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        execute(path, "recorded", executed=tmp_path / "file" / "out")
    write_notebook(tmp_path / "mine" / path.name, "precious")
    with pytest.raises(InputError, match="was not written by this command"):
        execute(path, "recorded", executed=tmp_path / "mine")
    assert "precious" in (tmp_path / "mine" / path.name).read_text()


def test_cleaned_removes_what_changes(tmp_path):
    notebook = nbformat.read(write_notebook(tmp_path / "a.ipynb", "1"), as_version=4)
    notebook.metadata.update(
        papermill={"start_time": "now"}, widgets={"state": {}}, language_info={"version": "3.11.2"}
    )
    notebook.cells.insert(2, v4.new_code_cell("profile = 'full'", metadata={"tags": ["injected-parameters"]}))
    notebook.cells[3].metadata.update(
        papermill={"duration": 1}, execution={"iopub.status.busy": "now"}, tags=["keep"]
    )
    notebook.metadata.authors = [{"name": "me"}]
    result = cleaned(notebook)
    assert set(result.metadata) == {"authors", "kernelspec", "language_info"}
    assert "version" not in result.metadata.language_info
    notebook.metadata.kernelspec = {"name": "myenv", "display_name": "mine"}
    assert cleaned(notebook).metadata.kernelspec.name == "myenv"
    assert [cell.metadata for cell in result.cells] == [{}, {"tags": ["parameters"]}, {"tags": ["keep"]}]
    assert "papermill" in json.dumps(notebook), "the argument is left as it was"
    nbformat.validate(result)


def test_table_shows_minutes_and_cuts_long_errors():
    text = execution_table([Execution("a", 61.25, ""), Execution("longer", 3.0, "x" * 500)])
    lines = text.splitlines()
    assert lines[1].split() == ["a", "1:01.2", "ok"]
    assert len(lines) == 3 and len(lines[2]) < 200 and lines[2].endswith("...")


def test_the_connection_file_lies_where_a_later_command_clears_it(tmp_path):
    path = write_notebook(
        tmp_path / "a.ipynb", "from ipykernel import get_connection_file", "print(get_connection_file())"
    )
    assert executed(path).error == ""
    connection = Path(printed(tmp_path / "out" / "a.ipynb").strip())
    assert connection.parent.name.startswith(".paper_artifact-partial-") and not connection.parent.exists()
