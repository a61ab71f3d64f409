"""The book in a real browser, where one is installed: no message on the console, every page as narrow as a
telephone, the 3-D view draws. Skipped without chromium."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from paper_artifact.book import build as module
from paper_artifact.book.build import build
from paper_artifact.scene.shapes import make_shape

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WIDTH = 360  # pixels of a small telephone
FLAGS = (
    "--headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--allow-file-access-from-files --enable-logging=stderr --virtual-time-budget=20000 --dump-dom"
)
# A page that loads each of the book's into a frame of a telephone's width and notes what does not fit. A
# browser window cannot be made that narrow.
PROBE = """<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,"><pre id="found"></pre><script>
const files = @FILES@, found = {};
async function look(file) {
  const frame = document.createElement("iframe");
  frame.width = @WIDTH@; frame.height = 740; frame.src = file;
  await new Promise(done => { frame.onload = done; document.body.append(frame); });
  const page = frame.contentDocument, root = page.documentElement;
  const broken = [...page.images].filter(each => each.complete && !each.naturalWidth).map(each => each.src);
  const canvas = page.querySelector("canvas");
  const drawn = canvas && canvas.getContext("webgl") ? page.querySelectorAll("#names div").length : null;
  found[file] = { over: root.scrollWidth - root.clientWidth, broken, drawn };
  frame.remove();
}
(async () => {
  for (const file of files) await look(file);
  document.getElementById("found").textContent = JSON.stringify(found);
})();
</script>"""


@pytest.mark.skipif(BROWSER is None, reason="no chromium here")
def test_every_page_fits_a_telephone_and_says_nothing_on_the_console(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "surface", lambda shape: make_shape("cube"))
    book = tmp_path / "book"
    build(book, executed=Path("/nowhere"))
    files = sorted(str(path.relative_to(book)) for path in book.rglob("*.html") if "api" not in path.parts)
    probe = book / "probe.html"
    probe.write_text(PROBE.replace("@FILES@", json.dumps(files)).replace("@WIDTH@", str(WIDTH)))
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    result = subprocess.run(
        [str(BROWSER), *FLAGS.split(), profile, probe.as_uri()], capture_output=True, text=True, timeout=540
    )
    found = json.loads(re.search(r'<pre id="found">(.*?)</pre>', result.stdout, re.DOTALL)[1])
    assert list(found) == files
    assert {file: each for file, each in found.items() if each["over"] > 0 or each["broken"]} == {}
    assert found["soups/bob.html"]["drawn"] == 4
    said = [line for line in result.stderr.splitlines() if "CONSOLE" in line]
    assert said == []
