"""The repository's tables (CSV) and notebooks where they are damaged, folders or pipes: one sentence."""

import os
from pathlib import Path

import nbformat
import pytest

from paper_artifact import claims, results
from paper_artifact.book import build
from paper_artifact.errors import InputError
from paper_artifact.scene.fetch import sources
from paper_artifact.study import dispositions
from paper_artifact.tables import read_table

pytestmark = pytest.mark.faults

READERS = {  # name: (module, the attribute that says where the table lies, what is read)
    "items.csv": (claims, "PUBLISHED", claims.paper_items),
    "starts.csv": (results, "MEASURED", results._starts),
    "speed.csv": (results, "MEASURED", lambda: results.measured("speed")),
    "table_1.csv": (results, "PUBLISHED", results._published.__wrapped__),
    "table_S6.csv": (results, "PUBLISHED", results._published.__wrapped__),
    "06_c_matrix.csv": (claims, "FOLDER", lambda: claims.read_claims(claims.FOLDER)),
}


def pipe(path):
    os.mkfifo(path)


DAMAGE = {
    "a pipe": pipe,
    "a folder": Path.mkdir,
    "random bytes": lambda path: path.write_bytes(bytes(range(256)) * 3),
    "another table": lambda path: path.write_text("a,b\n1,2\n"),
    "nothing": lambda path: path.write_text(""),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("name", READERS)
def test_a_table_that_is_damaged_is_named(name, damage, tmp_path, monkeypatch):
    module, place, read = READERS[name]
    monkeypatch.setattr(module, place, tmp_path)
    DAMAGE[damage](tmp_path / name)
    if name == "speed.csv" and damage == "another table":
        assert [*read()] == ["a", "b"]
    else:
        with pytest.raises(InputError, match=rf"{name}.*(restore it|again)"):
            read()


@pytest.mark.parametrize("cell", ["1.2.3", "many", "1,000"])
def test_a_number_that_is_none_is_named(cell, tmp_path):
    (tmp_path / "t.csv").write_text(f'value,note\n1.5,a\n,b\n"{cell}",c\n')
    with pytest.raises(InputError, match=r"cannot read the table .*t.csv \(.*\); measure it"):
        read_table(tmp_path / "t.csv", "value", advice="measure it", numbers=("value",))


@pytest.mark.parametrize("damage", ["a pipe", "a folder", "random bytes", "nothing"])
def test_the_tables_of_meshes_and_candidates(damage, tmp_path, monkeypatch):
    DAMAGE[damage](table := tmp_path / "meshes.csv")
    monkeypatch.setattr(dispositions, "TABLE", table)
    with pytest.raises(InputError, match=r"meshes.csv"):
        dispositions.candidates()
    if damage != "nothing":
        with pytest.raises(InputError, match=r"meshes.csv"):
            sources(table)


def test_a_damaged_executed_copy_is_named(tmp_path):
    nbformat.write(nbformat.v4.new_notebook(), tmp_path / "02.ipynb")
    (tmp_path / "copy.ipynb").write_text("{")
    with pytest.raises(InputError, match="the notebook 02 in its executed copy .*copy.ipynb"):
        build.read_chapter(tmp_path / "02.ipynb", tmp_path / "copy.ipynb")


def test_a_pipe_is_no_notebook(tmp_path):
    pipe(tmp_path / "02.ipynb")
    with pytest.raises(InputError, match=r"cannot read the notebook 02 \(.*it is a device or a pipe\)"):
        build.read_chapter(tmp_path / "02.ipynb", tmp_path / "executed.ipynb")
