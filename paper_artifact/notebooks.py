"""Execute the notebooks through papermill, and write them back in a form that stays the same from run to run.

Every notebook has one cell tagged `parameters` whose `profile` is "recorded" (read committed records, train
only what is short) or "full" (train everything). Kernels run this very interpreter, in the notebook's own
folder, as nbval does.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from glob import escape
from pathlib import Path

import nbformat
from nbformat import NotebookNode

from paper_artifact.errors import InputError
from paper_artifact.files import (
    DISK_FULL,
    FIGURES_VARIABLE,
    REPOSITORY,
    RESULTS,
    listed,
    partial_folder,
    renewed_folder,
    write_failure,
    write_text,
)

NOTEBOOKS = REPOSITORY / "notebooks"
EXECUTED = RESULTS / "executed"
FIGURES = RESULTS / "book" / "figures"
PROFILES = ("recorded", "full")
KERNEL = "python3"


@dataclass(frozen=True)
class Execution:
    """What became of one notebook."""

    name: str
    seconds: float  # wall time
    error: str  # "" when it ran to its end


def notebook_files(folder: Path = NOTEBOOKS, only: Sequence[str] = ()) -> list[Path]:
    """Return the folder's notebooks in name order; with `only`, those whose name starts with one of its
    words.

    Raises InputError when there is none, or when a word of `only` names none.
    """
    files = sorted(folder.glob("*.ipynb"))
    if not files:
        advice = "restore them with git" if folder == NOTEBOOKS else "name a folder that holds some (.ipynb)"
        raise InputError(f"there are no notebooks in {folder}; {advice}")
    chosen: set[Path] = set()
    for word in only:
        exact = [path for path in files if path.stem == word.removesuffix(".ipynb")]
        hits = exact or [path for path in files if word and path.stem.startswith(word)]
        if not hits:
            raise InputError(
                f"no notebook is called '{word}'; there are {', '.join(path.stem for path in files)}"
            )
        chosen.update(hits)
    return [path for path in files if not only or path in chosen]


@contextmanager
def own_kernel() -> Iterator[str]:
    """Yield the name of a kernel that is this interpreter, whatever kernels the user's machine has under the
    same name.

    Jupyter looks into JUPYTER_PATH first, so a kernel description in a temporary folder there wins. Its
    connection files lie in that folder too, so that a kill leaves none behind.
    """
    from ipykernel.kernelspec import get_kernel_dict

    before, place = os.environ.get("JUPYTER_PATH"), tempfile.tempdir
    with partial_folder() as folder:  # which a later one clears after a kill
        spec = folder / "kernels" / KERNEL / "kernel.json"
        spec.parent.mkdir(parents=True)
        module = ["-m", "ipykernel_launcher", "-f", "{connection_file}", "--log-level=CRITICAL"]
        spec.write_text(json.dumps(get_kernel_dict() | {"argv": [sys.executable, *module]}))
        os.environ["JUPYTER_PATH"] = str(folder) if not before else f"{folder}{os.pathsep}{before}"
        tempfile.tempdir = str(folder)
        try:
            yield KERNEL
        finally:
            tempfile.tempdir = place
            if before is None:
                del os.environ["JUPYTER_PATH"]
            else:
                os.environ["JUPYTER_PATH"] = before


def _part(path: Path, name: str, made: Path) -> str:
    """Return `name`, by which what a notebook makes is listed in the folder `made`; of one that is not ours
    with its folder from there, which stays where both are moved."""
    folder = path.resolve().parent
    return name if folder == NOTEBOOKS.resolve() else f"{name} in {os.path.relpath(folder, made.resolve())}"


@contextmanager
def figures_of(path: Path, folder: Path) -> Iterator[None]:
    """Have the figures that a notebook shows written to `folder` as <notebook>_<key>.svg (see `plot.show`),
    in place of those that an earlier execution of it wrote there. Raises InputError for one of such a name
    that no execution wrote."""
    known = {name for names in listed(folder).values() for name in names}
    mine = [each.name for each in folder.glob(f"{escape(path.stem)}_*.svg")]
    with renewed_folder(folder, _part(path, path.stem, folder), {*mine} - known) as new:
        os.environ[FIGURES_VARIABLE] = str(new.absolute() / path.stem)
        try:
            yield
        finally:
            del os.environ[FIGURES_VARIABLE]


def execute(
    path: Path,
    profile: str,
    *,
    executed: Path = EXECUTED,
    figures: Path = FIGURES,
    refresh: bool = False,
    quiet: bool = False,
) -> Execution:
    """Execute one notebook with the parameter `profile`; keep the executed copy in `executed` and its
    figures in `figures`.

    A failing cell ends the notebook, not the program: the copy then shows the trace and the outcome names the
    error. refresh: also write outputs and counts back to `path`, through `cleaned`, if every cell ran and the
    notebook is as it was. Call inside `own_kernel`. Raises InputError for an unknown profile, a folder that
    cannot be written, and a notebook of this name in `executed` that no execution wrote.
    """
    import papermill
    from papermill.exceptions import PapermillExecutionError

    if profile not in PROFILES:
        raise InputError(f"the profile '{profile}' is unknown; use one of {', '.join(PROFILES)}")
    bar = False if quiet else {"desc": path.stem, "leave": False, "position": 1}
    start, failure = time.monotonic(), ""
    try:
        if not path.is_file():
            raise OSError("it is no file")
        before = path.read_bytes()
        told = nbformat.reads(before.decode(), as_version=4).metadata
        names = told.get("language_info", {}).get("name"), told.get("kernelspec", {}).get("language")
        language = names[0] or names[1] or KERNEL
        if "python" not in language.lower():
            raise ValueError(f"it is a notebook in {language}; run-all runs those in Python")
        part = _part(path, path.name, executed)
        with figures_of(path, figures), renewed_folder(executed, part, [path.name]) as new:
            try:
                notebook = papermill.execute_notebook(
                    *(str(each).replace("{", "{{").replace("}", "}}") for each in (path, new / path.name)),
                    parameters={"profile": profile},
                    cwd=path.parent,
                    kernel_name=KERNEL,
                    language="python",
                    progress_bar=bar,
                )
            except PapermillExecutionError as caught:
                reason = caught.evalue or "see the executed copy"  # a magic says it there alone
                failure = f"In [{caught.exec_count}]: {caught.ename}: {reason}"
            else:  # papermill takes exit() for an end
                results = [each for cell in notebook.cells for each in cell.get("outputs", [])]
                if any(each.get("ename") == "SystemExit" for each in results):
                    failure = "a cell ended the program (SystemExit); take exit() out of it"
        if refresh and not failure and path.read_bytes() != before:
            failure = "it was changed while it ran, and is left as it is; refresh it again"
        elif refresh and not failure:
            write_text(path, nbformat.writes(cleaned(notebook)) + "\n")
    except InputError:
        raise
    except Exception as caught:  # a dead kernel, a file that is no notebook: the others still run
        failure = f"{type(caught).__name__}: {caught}"
        if isinstance(caught, OSError) and caught.errno in DISK_FULL:  # papermill's say not of what
            failure = str(write_failure(executed / path.name, caught))
    return Execution(path.stem, time.monotonic() - start, " ".join(failure.split()))


def cleaned(notebook: NotebookNode) -> NotebookNode:
    """Return a copy with outputs and counts but nothing that changes from run to run.

    Removed: papermill's and the client's metadata (times, paths), the cell of injected parameters, widget
    states, the interpreter's patch version. Other metadata stays, and a kernel that is not Jupyter's default.
    Code cells are numbered 1, 2, … as a run without injection would.
    """
    result = nbformat.from_dict(json.loads(nbformat.writes(notebook)))
    result.cells = [
        cell for cell in result.cells if "injected-parameters" not in cell.metadata.get("tags", [])
    ]
    for key in ("papermill", "widgets"):
        result.metadata.pop(key, None)
    if result.metadata.get("kernelspec", {}).get("name", KERNEL) == KERNEL:
        result.metadata |= {
            "kernelspec": {"display_name": "Python 3 (ipykernel)", "language": "python", "name": KERNEL},
            "language_info": {"file_extension": ".py", "mimetype": "text/x-python", "name": "python"},
        }
    count = 0
    for cell in result.cells:
        for key in ("papermill", "execution"):
            cell.metadata.pop(key, None)
        if not cell.metadata.get("tags", [True]):
            del cell.metadata["tags"]
        if cell.cell_type == "code":
            count += 1
            cell.execution_count = count
            for output in cell.outputs:
                if output.output_type == "execute_result":
                    output.execution_count = count
    return result
