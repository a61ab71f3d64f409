"""What a malicious or an unlucky user found: each fault once, with the words or the file that it is about.

`pytest -m faults` runs these and the other tests of the kind. By hand, being slow or in need of a machine's
help: `book` while `run-all` runs; `photos` ended by SIGKILL and by SIGINT while it maps, and started again;
an ordinary user in a read-only checkout; a clock that jumps back; a locale with a decimal comma; a full pipe
that nobody reads (the command waits, and ends with its reader or with Ctrl-C, exit code 1); `sweep` twice at
once, by the verb (each run is trained once; tests/test_train_resume.py has two runs); 240 builds of scenes by
four processes (`python -m tests.test_files 240`); 20 runs of `photos` in a row; a folder of other people's
cases (`python -m tests.cases FOLDER`).
"""

from __future__ import annotations

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
import torch
import trimesh

from paper_artifact import cli
from paper_artifact.book.build import read_chapter, told, write_figures
from paper_artifact.claims import read_claims
from paper_artifact.errors import InputError
from paper_artifact.export.models import Triangles
from paper_artifact.export.viewer import html_page
from paper_artifact.files import REPOSITORY, write_text
from paper_artifact.pages import script_policy
from paper_artifact.scene.colmap import read_model
from paper_artifact.soup.state import Soup, initial_mlp, save_soup
from paper_artifact.topology import BettiLoss
from paper_artifact.topology.bundle import build_from_mesh
from tests.test_book_browser import BROWSER, FLAGS

pytestmark = pytest.mark.faults
SMALL = "--densities 64 --working 64 --out page"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with ball.ply, a link to it and notebooks/01_a.ipynb."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(1).export("ball.ply")
    os.symlink("ball.ply", "link.ply")
    Path("notebooks").mkdir()
    nbformat.write(nbformat.v4.new_notebook(), "notebooks/01_a.ipynb")
    return tmp_path


@pytest.fixture
def soup(folder):
    """A soup file of one triangle in the current folder."""
    save_soup(
        "ball.npz", Soup(torch.eye(3)[None], torch.zeros(1, 3, 7), torch.full((1, 3), 6.0), initial_mlp(0))
    )
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(each): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


@pytest.mark.parametrize(
    "command, words",
    [
        ("certify ball.ply --json ball.ply", "mesh and --json are both ball.ply, which would be lost"),
        ("certify link.ply --json ./notebooks/../ball.ply", "mesh and --json are both"),
        ("ingest ball.ply --out ball.ply", "raw and --out are both"),
        ("ingest ball.ply --out x.ply --json x.ply", "are both x.ply"),
        ("solidify ball.ply --out ball.ply", "soup and --out are both"),
        ("solidify soup.npz --out ball.ply --target ball.ply", "--target and --out are both"),
        ("evaluate ball.ply --target sphere --json ball.ply", "surface and --json are both"),
        ("run-all --notebooks notebooks --out notebooks", "--out and --notebooks are both notebooks"),
        ("ingest ball.ply --out x.ply --offset nan", "the offset must be in (0, 0.25]"),
        ("ingest ball.ply --out x.ply --cells 0", "at least one grid cell"),
        ("train sphere --condition C1 --loss noise=1e300", "noise must be at least 0 and at most 1"),
        ("train sphere --condition T1 --loss pull=1e300", "pull must be at least 0 and at most 1e+06"),
        ("fetch nope", "known are ogre, …"),
    ],
)
def test_wrong_usage_is_said_before_any_work_and_no_file_is_touched(command, words, folder, capsys):
    before = contents(folder)
    assert cli.main(shlex.split(command)) == 2
    assert words in capsys.readouterr().err
    assert contents(folder) == before


@pytest.mark.parametrize(
    "command, words",
    [
        ("solidify ball.ply --out ball.ply/x.ply", "cannot write ball.ply/x.ply"),
        ("ingest ball.ply --out ball.ply/x.ply", "cannot write ball.ply/x.ply"),
        ("certify ball.ply --json notebooks", "cannot write notebooks: it is a folder"),
        ("ingest ball.ply --out x.ply --offset 1e-12", "take a larger offset or fewer cells"),
    ],
)
def test_an_output_that_cannot_be_written_is_said_before_any_work(command, words, folder, capsys):
    assert cli.main(shlex.split(command)) == 1
    captured = capsys.readouterr()
    assert words in captured.err and captured.out == ""


def test_export_keeps_a_target_that_has_the_name_of_its_output(soup, capsys):
    before = contents(soup)
    assert cli.main(["export", "ball.npz", "--out", ".", "--target", "ball.ply"]) == 2
    assert "--target ball.ply would be lost" in capsys.readouterr().err
    assert contents(soup) == before


@pytest.mark.parametrize(
    "command, words",
    [
        ("train sphere --condition C1 --loss samples=200000000", "the diagram of 200000000 samples"),
        ("train sphere --condition B2 --set samples=200000000", "the diagram of 200000000 samples"),
        ("evaluate ball.ply --target sphere --samples 200000000", "the diagram of 200000000 samples"),
        ("audit ball.ply --densities 64 200000000", "the diagram of 200000000 samples"),
        ("export ball.npz --views 100000 --size 4096 --formats png", "100000 views of 4096×4096 pixels"),
    ],
)
def test_what_takes_more_memory_than_there_is_is_refused_with_the_amount(command, words, soup, capsys):
    out = "--json x.json" if "evaluate" in command else "--results r" if "train" in command else "--out o"
    before = contents(soup)
    assert cli.main(shlex.split(f"{command} {out}")) == 1
    error = capsys.readouterr().err
    assert re.search(f"{words} takes at least [^ ]+ GiB of memory, .* GiB are available; ", error)
    assert contents(soup) == before


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
def test_wrong_usage_is_exit_code_2_and_a_failure_is_1_in_every_verb(verb, code, soup, capsys):
    try:
        found = cli.main([verb, *shlex.split(WRONG[verb][2 - code])])
    except SystemExit as refused:
        found = refused.code
    error = capsys.readouterr().err
    assert (
        found == code and "Traceback" not in error and error.count("paper_artifact") and "Error" not in error
    )


def test_export_of_a_soup_beyond_reason_is_one_sentence(folder, capsys):
    far = Soup(torch.eye(3)[None] * 1e37, torch.zeros(1, 3, 7), torch.full((1, 3), 6.0), initial_mlp(0))
    save_soup("far.npz", far)
    before = contents(folder)
    assert cli.main(["export", "far.npz", "--out", "o"]) == 1
    assert "too large or not finite" in capsys.readouterr().err and contents(folder) == before


def test_escape_sequences_in_names_are_shown_and_commands_keep_them(folder, capsys):
    name = "\x1b[31m\r\x9b'\\.ply"
    os.rename("ball.ply", name)
    assert cli.main(["certify", name]) == 0
    shown = capsys.readouterr().out
    assert not re.search("[\x1b\r\x9b]", shown) and "\\u001b[31m\\u000d" in shown
    (command,) = re.findall("audit (.*)", shown)
    echoed = ["bash", "-c", f"printf %s {command}"]
    assert (
        subprocess.run(echoed, capture_output=True, env=os.environ | {"LC_ALL": "C.UTF-8"}).stdout
        == name.encode()
    )


def test_a_name_that_is_no_text_is_a_page_and_a_command(folder):
    name = os.fsdecode(b"\xff\xfe \xe4.ply")
    os.rename("ball.ply", name)
    command = [sys.executable, "-m", "paper_artifact", "audit", name, *SMALL.split()]
    result = subprocess.run(
        command, capture_output=True, timeout=300, env=os.environ | {"PYTHONPATH": str(REPOSITORY)}
    )
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
    command = [
        str(BROWSER),
        *FLAGS.split(),
        f"--user-data-dir={folder / 'profile'}",
        (folder / "view.html").as_uri(),
    ]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert "Refused to execute inline script" in result.stderr or "violates the following" in result.stderr
    assert "<title>run" not in result.stdout
    assert re.search('<div id="names"[^>]*><div', result.stdout), "its own script ran"


def test_a_file_whose_name_was_not_given_is_not_replaced(folder, capsys):
    Path("ball_filled.ply").write_text("precious")
    assert cli.main(["certify", "ball.ply", "--fill", "1"]) == 1
    assert "ball_filled.ply is there already; --out" in capsys.readouterr().err
    assert cli.main(["certify", "ball.ply", "--fill", "1", "--out", "x.xyz"]) == 1
    assert "must end in" in capsys.readouterr().err
    assert Path("ball_filled.ply").read_text() == "precious"


def test_an_audit_is_not_replaced_by_that_of_another_mesh_of_the_same_name(folder, monkeypatch, capsys):
    monkeypatch.setattr("paper_artifact.cli.meshes.RESULTS", folder / "results")
    Path("other").mkdir()
    trimesh.creation.box().export("other/ball.ply")
    words = ["--densities", "64", "--working", "64"]
    assert cli.main(["audit", "ball.ply", *words]) == cli.main(["audit", "ball.ply", *words]) == 0
    before = contents(folder / "results")
    assert cli.main(["audit", "other/ball.ply", *words]) == 2
    assert "has the audit of" in capsys.readouterr().err
    assert contents(folder / "results") == before
    given = ["--out", str(folder / "results" / "audits" / "ball")]
    assert cli.main(["audit", "other/ball.ply", *words, *given]) == 2
    assert contents(folder / "results") == before


@pytest.mark.parametrize("limit", (200_000, 250_000))
def test_too_little_memory_to_import_a_library_is_one_sentence(limit, folder):
    command = f"ulimit -v {limit}; exec {sys.executable} -m paper_artifact certify ball.ply"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.returncode == 1
    assert "needs more memory than there is" in done.stderr and "Traceback" not in done.stderr


def test_python_without_docstrings_is_one_sentence(folder):
    command = [sys.executable, "-OO", "-m", "paper_artifact", "certify", "ball.ply"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and "leave -OO out" in done.stderr and "Traceback" not in done.stderr


def test_the_library_refuses_what_the_verbs_refuse():
    points, faces = np.eye(3), np.array([[0, 1, 2]])
    for wrong in (faces + 10**6, faces - 1):
        with pytest.raises(InputError, match="refers to vertex"):
            build_from_mesh(points, wrong, 100)
    with pytest.raises(InputError, match="GiB of memory"):
        build_from_mesh(points, faces, 10**10)
    with pytest.raises(InputError, match="three whole numbers"):
        BettiLoss(None)


@pytest.mark.parametrize("scale", (1e-200, 1e200))
def test_stated_numbers_work_at_any_scale(scale):
    points = torch.from_numpy(np.random.default_rng(0).random((80, 3)))
    plain, scaled = (BettiLoss((1, 1, 0))(points * factor).item() for factor in (1.0, scale))
    assert scaled == pytest.approx(plain)


@pytest.mark.parametrize(
    "text",
    (
        "",
        "what;item\na;b\n",
        "item,what,ours,paper,holds\na,b,c,d,e,f\n",
        "item,what,ours,paper,holds\na,b,c,d,maybe\n",
    ),
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


def test_an_id_that_comes_twice_in_a_colmap_model_is_refused(tmp_path):
    pose = "{} 1 0 0 0 0 0 2 1 {}.png\n"
    for name, text in (
        ("cameras", "1 PINHOLE 8 8 9 9 4 4\n"),
        ("images", pose.format(1, "a") + pose.format(1, "b")),
        ("points3D", "".join(f"{i} {i % 3} {i % 2} {i} 0 0 0 1\n" for i in range(1, 6))),
    ):
        (tmp_path / f"{name}.txt").write_text(text)
    with pytest.raises(InputError, match="the id 1 is there twice"):
        read_model(tmp_path)


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("property float z\n", "property float z\nproperty float z\n", "declares 'z' twice"),
        ("element face", "element vertex 0\nproperty float x\nelement face", "declares 'vertex' twice"),
        (
            "property list uchar int vertex_indices\n",
            "property list uchar int vertex_indices\nproperty list uchar int vertex_index\n",
            "vertex_indices, or two of it",
        ),
    ],
)
def test_a_ply_that_declares_a_thing_twice_is_refused(old, new, words, folder, capsys):
    text = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = {"z": "0 0 0 0\n1 0 0 0\n0 1 0 0\n3 0 1 2\n"}.get(words.split("'")[1] if "'" in words else "")
    rows = rows or "0 0 0\n1 0 0\n0 1 0\n3 0 1 2" + (" 3 0 1 2\n" if "two" in words else "\n")
    Path("twice.ply").write_text(text.replace(old, new) + rows)
    assert cli.main(["certify", "twice.ply"]) == 1
    assert words in capsys.readouterr().err


def test_the_record_of_a_soup_is_not_replaced_by_what_is_written(folder, capsys):
    for place in ("runs/a.json", "soups/a.npz"):
        Path(place).parent.mkdir()
        Path(place).write_text("precious")
    assert cli.main(["evaluate", "soups/a.npz", "--target", "ball.ply", "--json", "runs/a.json"]) == 2
    assert "the record of" in capsys.readouterr().err
    assert Path("runs/a.json").read_text() == "precious"


def test_a_figure_of_the_users_is_not_replaced_by_a_notebooks(folder):
    from paper_artifact.notebooks import figures_of

    Path("figures").mkdir()
    Path("figures/a_plot.svg").write_text("precious")
    with pytest.raises(InputError, match="a_plot.svg is there"), figures_of(Path("a.ipynb"), Path("figures")):
        pass
    assert Path("figures/a_plot.svg").read_text() == "precious"


def test_a_file_of_the_scene_that_is_read_is_not_replaced(folder, capsys):
    Path("scene/sparse").mkdir(parents=True)
    Path("scene/transforms.json").write_text('{"ply_file_path": "./a/my%20cloud.ply", "frames": []}')
    words = ["evaluate", "ball.ply", "--target", "ball.ply", "--scene", "scene", "--json"]
    for name in ("sparse/points3D.bin", "images.txt", "my cloud.ply", "ground_truth.npz"):
        Path("scene", name).write_text("precious")
        assert cli.main([*words, f"scene/{name}"]) == 2
        assert "is a file of --scene scene" in capsys.readouterr().err
    Path("scene/images").mkdir()
    for name in ("sparse/cameras.bin", "images/a.png"):
        Path("scene", name).write_text("precious")
    for place in ("scene/sparse", "scene/images"):
        assert cli.main([*words[:-2], place, "--json", "scene/images/a.png"]) == 2
        assert f"is a file of --scene {place}" in capsys.readouterr().err
    Path("a.gltf").write_text('{"buffers": [{"uri": "a%20\\u00e9.bin"}]}')
    Path("a é.bin").write_text("precious")
    assert cli.main(["certify", "a.gltf", "--json", "a é.bin"]) == 2
