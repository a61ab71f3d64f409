"""What a malicious or an unlucky user found: each fault once, with the words or the file that it is about.

`pytest -m faults` runs these and the other tests of the kind. By hand, being slow or in need of a machine's
help: `book` while `run-all` runs; `photos` ended by SIGKILL and by SIGINT while it maps, and started again;
an ordinary user in a read-only checkout; a clock that jumps back; a locale with a decimal comma; a full pipe
that nobody reads (the command waits, and ends with its reader or with Ctrl-C, exit code 1); `sweep` twice at
once, by the verb (each run is trained once; tests/test_train_resume.py has two runs); 240 builds of scenes by
four processes (`python -m tests.test_files 240`); 20 runs of `photos` in a row; a folder of other people's
cases (`python -m tests.cases FOLDER`).
"""

import base64
import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
from html import unescape
from pathlib import Path

import nbformat
import numpy as np
import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.audit import measure
from paper_artifact.book.build import read_chapter, told, write_figures
from paper_artifact.claims import read_claims
from paper_artifact.errors import InputError
from paper_artifact.export.models import Triangles
from paper_artifact.export.viewer import html_page
from paper_artifact.files import REPOSITORY, load_json, write_text
from paper_artifact.pages import script_policy
from paper_artifact.topology.bundle import build_from_mesh
from tests.test_book_browser import BROWSER, FLAGS

pytestmark = pytest.mark.faults


def contents(folder: Path) -> dict[str, bytes]:
    return {str(each): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


# Of each verb: what its arguments alone make wrong, and what only a look at its input shows.
WRONG = {
    "fetch": ("nope", "spot --mirror nowhere --out none"),
    "photos": ("in --out s --size 9", "nowhere --out s"),
    "reconstruct": ("in --out a.txt", "nowhere"),
    "scene": ("--out s", "--mesh none.ply --out s"),
    "train": ("sphere --device tpu", "none.ply --results r"),
    "evaluate": ("ball.npz", "none.npz --target sphere"),
    "export": ("ball.npz --formats gif", "none.npz --out o"),
    "run-all": ("--profile all", "--notebooks nowhere --out o --figures f"),
    "book": ("--refresh=x", "--out notebooks"),
    "certify": ("ball.ply --json - --where a.txt", "none.ply"),
    "audit": ("ball.ply --densities 3", "none.ply --out o"),
    "ingest": ("ball.ply --out a.txt", "none.ply --out a.ply"),
    "solidify": ("ball.ply --out a.txt", "none.ply --out a.ply"),
    "sweep": ("baseline --device tpu", "--scene nowhere --results r"),
}


@pytest.mark.parametrize("verb", cli.VERBS)
@pytest.mark.parametrize("code", [2, 1])
def test_wrong_usage_is_exit_code_2_and_a_failure_is_1_in_every_verb(verb, code, folder, command):
    error = command(f"{verb} {WRONG[verb][2 - code]}", code=code).err
    assert "Traceback" not in error and "paper_artifact" in error and "Error" not in error


def run_outside(*words: str, **variables: str) -> subprocess.CompletedProcess[bytes]:
    """Run a program in the current folder, with the package in reach."""
    known = os.environ | {"PYTHONPATH": str(REPOSITORY)} | variables
    return subprocess.run(words, capture_output=True, timeout=300, env=known)


def test_escape_sequences_in_names_are_shown_and_commands_keep_them(folder, command):
    name = "\x1b[31m\r\x9b'\\.ply"
    os.rename("ball.ply", name)
    shown = command("certify", name).out
    assert not re.search("[\x1b\r\x9b]", shown) and "\\u001b[31m\\u000d" in shown
    (given,) = re.findall("audit (.*)", shown)
    assert run_outside("bash", "-c", f"printf %s {given}", LC_ALL="C.UTF-8").stdout == name.encode()


def test_a_name_that_is_no_text_is_a_page_and_a_command(folder):
    name = os.fsdecode(b"\xff\xfe \xe4.ply")
    os.rename("ball.ply", name)
    small = shlex.split("--densities 64 --working 64 --out page")
    result = run_outside(sys.executable, "-m", "paper_artifact", "audit", name, *small)
    assert result.returncode == 0 and os.fsencode(shlex.quote(name)) in result.stdout
    assert "\\udcff" in Path("page/audit.html").read_text(encoding="utf-8")


def test_half_letters_keep_json_sound(tmp_path):
    text = json.dumps("\ud800", ensure_ascii=False)
    write_text(tmp_path / "a.json", text)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == "\ud800"


def page() -> str:
    corners = np.eye(3, dtype=np.float32)[None]
    return html_page({"</script><b>": Triangles(corners, np.ones((1, 3, 3)), np.ones((1, 3)))}, "<script>x")


def test_a_view_runs_its_own_script_and_no_other():
    shown = page()
    policy = unescape(re.search(r'Policy" content="([^"]*)"', shown)[1])
    assert policy == script_policy() and "default-src 'none'" in policy
    (script,) = re.findall(r"<script>(.*?)</script>", shown, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in policy and "unsafe-inline' 'sha" not in policy


@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_a_browser_refuses_a_script_that_was_put_into_a_view(folder):
    view = page().replace("</body>", "<script>document.title = 'run'</script><p onclick=x></body>")
    (folder / "view.html").write_text(view, encoding="utf-8")
    page_of = [f"--user-data-dir={folder / 'profile'}", (folder / "view.html").as_uri()]
    result = subprocess.run([BROWSER, *FLAGS.split(), *page_of], capture_output=True, text=True, timeout=300)
    assert "Refused to execute inline script" in result.stderr or "violates the following" in result.stderr
    assert "<title>run" not in result.stdout
    assert re.search('<div id="names"[^>]*><div', result.stdout), "its own script ran"


def test_a_file_whose_name_was_not_given_is_not_replaced(folder, command):
    Path("ball_filled.ply").write_text("precious")
    assert "ball_filled.ply is there already; --out" in command("certify ball.ply --fill 1", code=1).err
    assert "must end in" in command("certify ball.ply --fill 1 --out x.xyz", code=1).err
    assert Path("ball_filled.ply").read_text() == "precious"


def test_an_audit_is_not_replaced_by_that_of_another_mesh_of_the_same_name(folder, monkeypatch, command):
    monkeypatch.setattr("paper_artifact.cli.meshes.RESULTS", folder / "results")
    Path("other").mkdir()
    trimesh.creation.box().export("other/ball.ply")
    for _ in range(2):
        command("audit ball.ply --densities 64 --working 64")
    before = contents(folder / "results")
    for out in ("", "--out results/audits/ball"):
        said = command(f"audit other/ball.ply --densities 64 --working 64 {out}", code=2).err
        assert "has the audit of" in said and contents(folder / "results") == before


def test_of_two_audits_at_once_the_second_is_refused(folder, monkeypatch, command):
    Path("other").mkdir()
    trimesh.creation.box().export("other/ball.ply")
    lines = [f"audit {mesh} --densities 64 --working 64 --out a" for mesh in ("ball.ply", "other/ball.ply")]
    real, others = measure.audit_mesh, lines[1:]

    def meanwhile(*arguments, **options):
        if others:
            command(others.pop())
        return real(*arguments, **options)

    monkeypatch.setattr(measure, "audit_mesh", meanwhile)
    assert "is there and was not written by this command" in command(lines[0], code=1).err
    assert load_json(Path("a/audit.json"))["mesh"] == "../other/ball.ply"


@pytest.mark.parametrize("limit", (200_000, 220_000, 250_000))
def test_too_little_memory_to_import_a_library_is_one_sentence(limit, folder):
    line = f"ulimit -v {limit}; exec {sys.executable} -m paper_artifact certify ball.ply"
    done = run_outside("bash", "-c", line)
    assert done.returncode == 1
    assert b"the verb 'certify' takes at least 0.25 GiB of memory, " in done.stderr
    assert b"Traceback" not in done.stderr


def test_a_library_that_finds_too_little_memory_is_one_sentence(folder, monkeypatch, command):
    def fails(*_):
        raise ImportError("libx.so: failed to map segment from shared object")

    monkeypatch.setattr("paper_artifact.cli._parser", fails)
    assert "the verb 'certify' needs more memory than there is" in command("certify ball.ply", code=1).err


def test_python_without_docstrings_is_one_sentence(folder):
    done = run_outside(sys.executable, "-OO", "-m", "paper_artifact", "certify", "ball.ply")
    assert done.returncode == 2 and b"leave -OO out" in done.stderr and b"Traceback" not in done.stderr


def test_the_library_refuses_what_the_verbs_refuse():
    points, faces = np.eye(3), np.array([[0, 1, 2]])
    for wrong in (faces + 10**6, faces - 1):
        with pytest.raises(InputError, match="refers to vertex"):
            build_from_mesh(points, wrong, 100)
    with pytest.raises(InputError, match="GiB of memory"):
        build_from_mesh(points, faces, 10**10)


CLAIMS = "item,what,ours,paper,holds\n"


@pytest.mark.parametrize(
    "text", ["", "what;item\na;b\n", CLAIMS + "a,b,c,d,e,f\n", CLAIMS + "a,b,c,d,maybe\n"]
)
def test_a_table_of_something_else_is_no_claims(text, tmp_path):
    (tmp_path / "01_a.csv").write_text(text)
    with pytest.raises(InputError, match=r"01_a.csv"):
        read_claims(tmp_path)


@pytest.mark.parametrize("damage", ("empty", "picture", "tags"))
def test_a_notebook_of_others_makes_a_chapter_or_a_sentence(damage, tmp_path):
    cells = [nbformat.v4.new_markdown_cell("\n\n"), nbformat.v4.new_code_cell("1")]
    notebook = json.loads(json.dumps(nbformat.v4.new_notebook(cells=cells)))
    if damage == "picture":
        output = {"output_type": "display_data", "metadata": {}, "data": {"image/png": 1}}
        notebook["cells"][1]["outputs"] = [output]
    if damage == "tags":
        notebook["cells"][1]["metadata"]["tags"] = None
    path = tmp_path / "01_a.ipynb"
    path.write_text(json.dumps(notebook))
    if damage == "empty":
        assert read_chapter(path, tmp_path / "none").title == "01_a"
        return
    with pytest.raises(InputError, match="cannot read the notebook 01_a"), told("01_a"):
        write_figures(read_chapter(path, tmp_path / "none"), tmp_path / "figures", tmp_path)


def test_the_record_of_a_soup_is_not_replaced_by_what_is_written(folder, command):
    for place in ("runs/a.json", "soups/a.npz"):
        Path(place).parent.mkdir()
        Path(place).write_text("precious")
    said = command("evaluate soups/a.npz --target ball.ply --json runs/a.json", code=2).err
    assert "the record of" in said and Path("runs/a.json").read_text() == "precious"


def test_a_figure_of_the_users_is_not_replaced_by_a_notebooks(folder):
    from paper_artifact.notebooks import figures_of

    Path("figures").mkdir()
    Path("figures/a_plot.svg").write_text("precious")
    with pytest.raises(InputError, match="a_plot.svg is there"), figures_of(Path("a.ipynb"), Path("figures")):
        pass
    assert Path("figures/a_plot.svg").read_text() == "precious"


def test_a_file_of_the_scene_that_is_read_is_not_replaced(folder, command):
    Path("scene/sparse").mkdir(parents=True)
    Path("scene/images").mkdir()
    Path("scene/transforms.json").write_text('{"ply_file_path": "./a/my%20cloud.ply", "frames": []}')

    def refused(scene: str, name: str) -> None:
        Path("scene", name).write_text("precious")
        line = f"evaluate ball.ply --target ball.ply --scene {scene} --json"
        assert f"is a file of --scene {scene}" in command(line, f"scene/{name}", code=2).err

    for name in ("sparse/points3D.bin", "images.txt", "my cloud.ply", "ground_truth.npz"):
        refused("scene", name)
    Path("scene/sparse/cameras.bin").write_text("precious")
    for place in ("scene/sparse", "scene/images"):
        refused(place, "images/a.png")
    Path("a.gltf").write_text('{"buffers": [{"uri": "a%20\\u00e9.bin"}]}')
    Path("a é.bin").write_text("precious")
    command("certify a.gltf --json 'a é.bin'", code=2)
    Path("ball.obj").write_text("mtllib its colours.mtl\nv 0 0 0\n")
    Path("its colours.mtl").write_text("precious")
    command("certify ball.obj --json 'its colours.mtl'", code=2)
