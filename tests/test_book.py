"""The book: every link and picture exists, all 28 items have the verdict of their claims, no notebook can run
script in it, and the README's picture shows today's records."""

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import nbformat
import pandas as pd
import pytest

from paper_artifact import results
from paper_artifact.book import build as module
from paper_artifact.book.build import MENU, Pages, build, csv_text, items, read_chapter, write_figures
from paper_artifact.book.main_result import PICTURE, main_runs, numbers, picture_numbers
from paper_artifact.catalogue import shapes_of, study_config
from paper_artifact.claims import COLUMNS, FOLDER, read_claims
from paper_artifact.files import REPOSITORY
from paper_artifact.notebooks import NOTEBOOKS
from paper_artifact.record.store import record_path
from paper_artifact.scene.shapes import make_shape

NOWHERE = Path("/nowhere")


class Page(HTMLParser):
    """A page's links, what it loads, its scripts, the names in it, and its pictures without words."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links, self.loads, self.names, self.wordless, self.scripts = [], [], set(), [], 0
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.names |= {given["id"]} if given.get("id") else set()
        self.scripts += tag == "script" or any(name.startswith("on") for name in given)
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag in ("img", "link", "script"):
            self.loads += [given[name] for name in ("src", "href") if given.get(name)]
        if tag == "img" and not given.get("alt"):
            self.wordless.append(given.get("src"))


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """The book of the committed records; a small mesh replaces every ground truth, which would take long."""
    folder = tmp_path_factory.mktemp("book")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "surface", lambda shape: make_shape("cube"))
        return folder, build(folder, executed=NOWHERE)


def test_every_link_leads_somewhere_and_nothing_comes_from_the_network(book):
    folder, _ = book
    pages = {path: Page(path) for path in sorted(folder.rglob("*.html"))}
    assert {folder / file for _, file in MENU} <= set(pages)
    for path, page in pages.items():
        if path.parent.name != "soups" and (folder / "api") not in path.parents:
            assert not page.scripts, path
        assert not page.wordless, path
        for link in [*page.links, *page.loads]:
            address, _, name = link.partition("#")
            if re.match(r"[a-z]+:", address):
                assert link in page.links or address.startswith("data:"), f"{path.name} loads {link}"
            elif address:
                target = (path.parent / unquote(address)).resolve()
                assert target.is_file(), f"{path.name}: {link}"
                if name and target in pages and "api" not in str(path):
                    assert name in pages[target].names, link


def test_every_notebook_has_its_page_and_its_pictures(book):
    folder, _ = book
    paths = sorted(NOTEBOOKS.glob("*.ipynb"))
    assert {path.stem for path in (folder / "notebooks").iterdir()} == {path.stem for path in paths}
    for path in paths:
        name, text = path.stem, (folder / "notebooks" / f"{path.stem}.html").read_text()
        drawn = "image/png" in path.read_text()
        assert "Content-Security-Policy" in text and (f"../figures/{name}_" in text) == drawn, name


def test_all_28_items_have_the_verdict_of_their_claims(book):
    folder, found = book
    tables, figures = (1, 2, *(f"S{n}" for n in range(1, 14))), (1, *(f"S{n}" for n in range(1, 13)))
    named = [*(f"Table {each}" for each in tables), *(f"Fig. {each}" for each in figures)]
    assert [each.name for each in found] == named
    table = pd.read_csv(folder / "tables" / "items.csv", keep_default_na=False).set_index("item")
    claims = pd.read_csv(folder / "tables" / "claims.csv", keep_default_na=False)
    front = (folder / "index.html").read_text()
    for each in found:
        said = claims[claims["item"] == each.name]["holds"]
        assert len(said), f"{each.name} has no claim"
        outcome = {(True, False): "agrees", (True, True): "partly", (False, True): "differs"}
        due = outcome[(said == "yes").any(), (said == "no").any()]
        assert each.word == table.loc[each.name, "verdict"] == due
        assert bool(each.reason) == (due != "agrees"), each.name
        assert f'href="items.html#{each.key}"' in front
        assert all((NOTEBOOKS / f"{name}.ipynb").is_file() for name in each.notebooks)


def test_the_committed_claims_have_one_schema_and_belong_to_a_notebook():
    for path in FOLDER.glob("*.csv"):
        assert tuple(pd.read_csv(path).columns) == COLUMNS and (NOTEBOOKS / f"{path.stem}.ipynb").is_file()
    assert set(read_claims()["holds"]) <= {"yes", "no", "not recorded"}


def test_eight_soups_and_more_are_shown_beside_their_ground_truth(book):
    folder, _ = book
    found = sorted(path.stem for path in (folder / "soups").glob("*.html"))
    assert len(found) >= 8 and set(shapes_of("loop group", "void group")) <= set(found)
    for name in found:
        text = (folder / "soups" / f"{name}.html").read_text()
        data = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.S)[1])
        assert [part["name"].split(",")[0] for part in data["parts"]] == ["ground truth", "C0", "C1", "C2"]


def test_a_missing_ground_truth_is_said(tmp_path, monkeypatch):
    def fail(shape):
        raise module.InputError("no mesh")

    monkeypatch.setattr(module, "surface", fail)
    tables = results.load()
    runs = main_runs(tables)
    (view,) = module.write_views(tables, runs[runs["shape"] == "bob"], tmp_path)
    assert "ground truth is not shown: no mesh" in view.note and len(view.arms) == 3


def test_the_readmes_picture_shows_the_committed_records():
    assert len(PICTURE.read_text()) <= 150_000
    assert "results/main_result.svg" in (REPOSITORY / "README.md").read_text()
    shown = numbers(main_runs(results.load()))
    assert picture_numbers() == shown, "python -m paper_artifact book --refresh makes it again"
    assert len(shown) == 15 and all(len(tails) >= 3 for arms in shown.values() for tails in arms.values())


def test_an_empty_folder_of_records_makes_a_book_that_says_so(tmp_path):
    (tmp_path / "runs").mkdir()
    found = build(tmp_path / "book", executed=NOWHERE, runs=tmp_path / "runs")
    assert {each.word for each in found} == {"not recorded"}
    assert "There are no records in this folder" in (tmp_path / "book" / "index.html").read_text()


def test_records_without_one_of_the_arms_and_odd_names_make_a_book(tmp_path):
    (tmp_path / "runs").mkdir()
    shutil.copy(
        record_path(study_config("sphere", "C0", 0), REPOSITORY / "results" / "runs"), tmp_path / "runs"
    )
    notebook(tmp_path / "own" / "Test #2.ipynb", 'x = 1\nplot.show("key", figure)')
    build(tmp_path / "book", tmp_path / "own", NOWHERE, tmp_path / "runs")
    index = (tmp_path / "book" / "index.html").read_text()
    assert "<th>sphere</th>" in index and "nan" not in index
    assert 'href="notebooks/Test%20%232.html"' in (tmp_path / "book" / "notebooks.html").read_text()
    for page in (tmp_path / "book").glob("*.html"):
        assert {*re.findall(r'href="(notebooks/[^"]*)"', page.read_text())} <= {"notebooks/Test%20%232.html"}
    assert "Notebook: 06_c_matrix." in (tmp_path / "book" / "items.html").read_text()
    assert 'src="../figures/Test%20%232_key.png"' in (tmp_path / "book/notebooks/Test #2.html").read_text()


def test_words_and_tallies():
    agrees, differs = ("Table 1", "a", "1", "1", "yes"), ("Table 1", "b", "2", "1", "no")
    rows = [agrees, differs, ("Table 2", "c", "", "1", "not recorded")]
    first, second, third, *_ = items(pd.DataFrame(rows, columns=list(COLUMNS)))
    assert (first.word, first.tally) == ("partly", "1 of 2")
    assert (second.word, second.tally) == ("not recorded", "0 of 0, 1 not recorded")
    assert (third.word, third.tally) == ("not recorded", "0 of 0")


def test_no_cell_of_a_csv_is_a_formula():
    frame = pd.DataFrame({"a": ["=1+1", "+cmd", "@x", "-.5", "plain"], "b": [-1.0, 2.0, 3.0, 4.0, 5.0]})
    assert csv_text(frame).splitlines()[1:] == ["'=1+1,-1.0", "'+cmd,2.0", "'@x,3.0", "-.5,4.0", "plain,5.0"]


def notebook(path: Path, source: str = 'show("x")', output: str = "committed", error: bool = False) -> Path:
    made = nbformat.v4.new_notebook()
    cell = nbformat.v4.new_code_cell(source, execution_count=1)
    cell.outputs = [nbformat.v4.new_output("display_data", {"image/png": "aGFsbG8=", "text/plain": output})]
    if error:
        cell.outputs.append(nbformat.v4.new_output("error", ename="E", evalue="", traceback=[]))
    made.cells = [nbformat.v4.new_markdown_cell("# A title (Table 1)"), cell]
    path.parent.mkdir(exist_ok=True)
    nbformat.write(made, path)
    return path


@pytest.mark.parametrize(
    ("changes", "fresh"), [({}, True), ({"source": "show('y')"}, False), ({"error": True}, False)]
)
def test_executed_copies_are_taken_only_where_they_have_this_code(tmp_path, changes, fresh):
    own = notebook(tmp_path / "notebooks" / "01_one.ipynb")
    copy = notebook(tmp_path / "executed" / "01_one.ipynb", output="executed", **changes)
    found = read_chapter(own, copy)
    assert (found.executed, found.title) == (fresh, "A title")
    assert found.notebook.cells[1].outputs[0]["data"]["text/plain"] == ("executed" if fresh else "committed")


def test_svg_pictures_of_run_all_come_before_those_in_the_notebooks(tmp_path):
    path = notebook(tmp_path / "n" / "01_one.ipynb", 'x = 1\nplot.show("key", figure)')
    chapter = read_chapter(path, NOWHERE)
    assert write_figures(chapter, tmp_path / "f", tmp_path) == {(1, 0): "01_one_key.png"}
    assert (tmp_path / "f" / "01_one_key.png").read_bytes() == b"hallo"
    (tmp_path / "01_one_key.svg").write_text("<svg/>")
    assert write_figures(chapter, tmp_path / "f", tmp_path) == {(1, 0): "01_one_key.png"}, "of an older code"
    chapter = read_chapter(path, path)
    assert write_figures(chapter, tmp_path / "f", tmp_path) == {(1, 0): "01_one_key.svg"}


TABLE = (
    "<div><style scoped>th { vertical-align: top; }</style><table class='dataframe'><thead><tr>"
    "<th colspan='2'>mean</th></tr></thead><tbody><tr><th>C1</th><td>.01</td></tr></tbody></table></div>"
)


def test_no_script_of_a_notebook_reaches_its_page(tmp_path):
    path = notebook(tmp_path / "n" / "01_one.ipynb")
    made = nbformat.read(path, as_version=4)
    evil = "<script>alert(1)</script><img src=x onerror=alert(2)><a href='javascript:alert(3)'>l</a>"
    evil += "<iframe src=x></iframe>"
    made.cells[0].source += "\n\n" + evil
    wide = {"image/jpeg": {"width": f'">{evil}'}}
    made.cells[1].outputs = [
        nbformat.v4.new_output("display_data", {"text/html": evil + "<svg onload=alert(4)></svg>"}),
        nbformat.v4.new_output("display_data", {"application/javascript": "alert(5)"}),
        nbformat.v4.new_output("display_data", {"image/jpeg": "AAAA"}, metadata=wide),
        nbformat.v4.new_output("display_data", {"image/svg+xml": "<svg xmlns='http://www.w3.org/2000/svg'><script>alert(6)</script></svg>"}),
    ]  # fmt: skip
    nbformat.write(made, path)
    text = str(Pages(tmp_path, ()).notebook_body(read_chapter(path, NOWHERE), {}))
    (tmp_path / "page.html").write_text(text)
    page = Page(tmp_path / "page.html")
    assert not page.scripts and not any("javascript:" in link for link in page.links)
    assert "<iframe" not in text and "onerror=alert" not in text and "data:image/jpeg" in text
    # What is no script stays: headings, tables with heads.
    made.cells[1].outputs = [nbformat.v4.new_output("display_data", {"text/html": TABLE})]
    made.cells[0].source = "# Title\n\nA *line*."
    nbformat.write(made, path)
    text = str(Pages(tmp_path, ()).notebook_body(read_chapter(path, NOWHERE), {}))
    assert "<h1" in text and "<p>A <em>line</em>" in text and '<th colspan="2">mean</th>' in text
    assert "&lt;" not in text and "vertical-align" not in text
