"""What a malicious or an unlucky user found: each fault once, with the words or the file that it is about.

`pytest -m faults` runs these and the other tests of the kind.
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
from paper_artifact.export.models import Triangles
from paper_artifact.export.viewer import html_page
from paper_artifact.files import REPOSITORY, write_text
from paper_artifact.pages import script_policy
from paper_artifact.soup.state import Soup, initial_mlp, save_soup
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


def test_export_keeps_a_target_that_has_the_name_of_its_output(folder, capsys):
    save_soup(
        "ball.npz", Soup(torch.eye(3)[None], torch.zeros(1, 3, 7), torch.full((1, 3), 6.0), initial_mlp(0))
    )
    before = contents(folder)
    assert cli.main(["export", "ball.npz", "--out", ".", "--target", "ball.ply"]) == 2
    assert "--target ball.ply would be lost" in capsys.readouterr().err
    assert contents(folder) == before


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
